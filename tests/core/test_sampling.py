"""The box of parameters: quasi-random points fill it, training and its parts take them.

Differences in it, tables.
"""

import time

import contract
import numpy as np
import pytest
from needs import needs
from scenes import pressed_block
from scipy.stats import qmc

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import NotOfferedError, ParameterError, StudyError
from hhr_dolfinx.full_order.full import FullOrderModel
from hhr_dolfinx.group import share
from hhr_dolfinx.study.training.train import train_part

SPACE = hhr.ParameterSpace(("E", "gap", "load"), (70e9, -1e-6, 0.0), (210e9, 3e-6, 1.0))
KINDS = [hhr.Sobol, hhr.LatinHypercube]


def unit(points):
    """Points of the box as points of the unit cube."""
    lower, upper = np.array([SPACE.lower, SPACE.upper])
    return (points - lower) / (upper - lower)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("count", [1, 7, 64])
def test_points_lie_in_the_box_and_are_the_same_again(kind, count):
    points = kind(count).points(SPACE)
    assert points.shape == (count, 3)
    assert np.array_equal(SPACE.points(points), points)  # which refuses what is outside
    assert np.array_equal(kind(count).points(SPACE), points)
    assert not np.array_equal(kind(count, seed=2).points(SPACE), points)
    assert kind(count) == kind(count, seed=1, corners=False) and hash(kind(count)) == hash(
        kind(count)
    )


@pytest.mark.parametrize("kind", KINDS)
def test_they_fill_the_box_more_evenly_than_random_ones(kind):
    here, random = (
        qmc.discrepancy(unit(points)) for points in (kind(128).points(SPACE), SPACE.random(128, 1))
    )
    assert here < random
    counts = np.array(
        [
            np.histogram(column, bins=16, range=(0, 1))[0]
            for column in unit(kind(128).points(SPACE)).T
        ]
    )
    assert (counts == 8).all()  # in every projection on an axis


@pytest.mark.parametrize("kind", KINDS)
def test_corners_come_first_and_beside_the_count(kind):
    points = kind(5, corners=True).points(SPACE)
    assert points.shape == (13, 3)
    assert {tuple(row) for row in unit(points[:8]).round(12)} == {
        tuple(row) for row in np.ndindex(2, 2, 2)
    }
    assert np.array_equal(points[8:], kind(5).points(SPACE))
    ten, eleven = (
        hhr.ParameterSpace(tuple("abcdefghijk")[:n], (0.0,) * n, (1.0,) * n) for n in (10, 11)
    )
    assert len(kind(3, corners=True).points(ten)) == 1027
    assert kind(3).points(eleven).shape == (3, 11)
    with pytest.raises(
        ParameterError, match="a box of 11 parameters has too many corners: leave them out"
    ):
        kind(3, corners=True).points(eleven)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    "given", [(0,), (-3,), (2.0,), ("8",), (None,), (True,), (8, -1), (8, 1.5), (8, "a")]
)
def test_counts_and_seeds_that_are_none(kind, given):
    with pytest.raises(
        ParameterError,
        match=rf"{kind.__name__}\(.*: the count must be a positive integer, the seed",
    ):
        kind(*given)


def test_training_takes_them():
    scene = pressed_block("plane_stress")
    training = hhr.train(scene, hhr.Sobol(8), held_out=4)
    snapshots = training.snapshots
    assert np.array_equal(snapshots.points, hhr.Sobol(8).points(scene.parameters))
    assert np.array_equal(
        snapshots.forces[:, 3], training.full_order.solve(snapshots.points[3]).forces()
    )
    assert (
        len(hhr.train(scene, hhr.LatinHypercube(3, corners=True), held_out=0).snapshots.points) == 5
    )
    with pytest.raises(StudyError, match="needs at least 2"):
        hhr.train(scene, hhr.Sobol(1))


BOX = hhr.ParameterSpace(("a", "b"), (0.0, -2.0), (1.0, 3.0))


@pytest.mark.parametrize("point", [(0.0, -2.0), (1.0, 3.0), (0.5, 0.0), (0.0, 3.0), (5e-4, 2.999)])
def test_differences_are_of_second_order_up_to_the_ends(point):
    """The error falls with the square of the step, in the middle, at the ends and nearer to them
    than a step.
    """
    a, b = point
    slopes = [[2 * np.exp(2 * a), 1.0], [np.cos(a) * b, np.sin(a)]]
    inside = []

    def value(moved):
        inside.append(((moved >= BOX.lower) & (moved <= BOX.upper)).all())
        return np.array([np.exp(2 * moved[0]) + moved[1], np.sin(moved[0]) * moved[1]])

    coarse, fine = (
        np.abs(BOX.differences(value, np.array(point), part) - slopes).max()
        for part in (4e-3, 1e-3)
    )
    assert all(inside)
    # sixteen for the square; 12 leaves room for the next term, 4 is the first order
    assert fine <= coarse / 12 and fine <= 2e-5


def test_a_table_is_checked_as_a_whole():
    """A million rows in a moment; the first wrong row is named, and NaN is wrong."""
    table = BOX.random(1_000_000, 0)
    start = time.perf_counter()
    found = BOX.points(table)
    assert time.perf_counter() - start < 3.0  # row by row it took 13 s
    assert np.array_equal(found, table) and found is not table
    ends = np.array([BOX.lower, BOX.upper]) + 1e-13 * np.array([[-1.0, -1.0], [1.0, 1.0]])
    assert np.array_equal(BOX.points(ends), ends)  # grids that end there, to round-off
    for value, said in (
        (1.5, r"row 70: a = 1.5 is outside \[0, 1\]"),
        (np.nan, "row 70: a = nan is not finite"),
    ):
        table[[70, 900], 0] = value
        with pytest.raises(ParameterError, match=said):
            BOX.points(table)


# ---------------------------------------------------------------- parts that know nothing of each
# other but a folder


@pytest.mark.parametrize("count", [0, 1, 7, 8, 20])
def test_every_place_is_in_one_part(count):
    shares = [list(share(count, number, 8)) for number in range(8)]
    assert [place for part in shares for place in part] == list(range(count))
    assert max(map(len, shares)) - min(map(len, shares)) <= 1


def test_a_training_reads_what_its_parts_have_solved(tmp_path, monkeypatch):
    """In whatever order they ran, one of them twice; what is left are points where contact
    grazes.
    """
    how = hhr.Sobol(8), {"held_out": 10, "seed": 3}
    alone = hhr.train(contract.blocks(), how[0], **how[1])
    for number in (3, 1, 2, 3):
        found = train_part(contract.blocks(), how[0], number, 3, tmp_path, **how[1])
    assert (found.training, found.held_out, found.read) == (2, 2, 4)
    solved = []
    plain = FullOrderModel.solve
    monkeypatch.setattr(
        FullOrderModel, "solve", lambda *given, **how: solved.append(1) or plain(*given, **how)
    )
    training = hhr.train(contract.blocks(), how[0], folder=tmp_path, **how[1])
    assert training.read == 16 and len(solved) == 2
    np.testing.assert_array_equal(training.snapshots.points, alone.snapshots.points)
    np.testing.assert_array_equal(training.held_out.points, alone.held_out.points)
    np.testing.assert_allclose(
        training.snapshots.forces, alone.snapshots.forces, rtol=1e-9, atol=1e-12
    )


@needs("friction")
def test_histories_have_parts_too(tmp_path):
    """Where contact rubs; the paths held out as well."""
    scene = contract.blocks(friction=0.2)
    lower, upper = np.array([scene.parameters.lower, scene.parameters.upper])
    paths = [[(0.0, lower), (1.0, lower + share * (upper - lower))] for share in (0.5, 0.8, 1.0)]
    for number in (1, 2):
        train_part(scene, paths[:2], number, 2, tmp_path, held_out=paths[2:])
    training = hhr.train(scene, paths[:2], held_out=paths[2:], folder=tmp_path)
    assert training.read == 3  # the first answer of a path is its rest


@pytest.mark.parametrize("part", [(0, 3), (4, 3), (1, 0), (1.5, 3)])
def test_no_such_part(part, tmp_path):
    with pytest.raises(StudyError, match="part"):
        train_part(contract.blocks(), hhr.Sobol(8), *part, tmp_path)


@needs("greedy")
def test_a_greedy_training_has_none(tmp_path):
    with pytest.raises(NotOfferedError, match="greedy"):
        train_part(contract.blocks(), hhr.Greedy(budget=10), 1, 2, tmp_path)
