"""Where to train: quasi-random points fill the box, and training takes them."""

import numpy as np
import pytest
from scenes import pressed_block
from scipy.stats import qmc

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import ParameterError, StudyError

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
    assert kind(count) == kind(count, seed=1, corners=False) and hash(kind(count)) == hash(kind(count))


@pytest.mark.parametrize("kind", KINDS)
def test_they_fill_the_box_more_evenly_than_random_ones(kind):
    here, random = (qmc.discrepancy(unit(points)) for points in (kind(128).points(SPACE), SPACE.random(128, 1)))
    assert here < random
    counts = np.array([np.histogram(column, bins=16, range=(0, 1))[0] for column in unit(kind(128).points(SPACE)).T])
    assert (counts == 8).all()  # in every projection on an axis


def test_sobol_points_are_even_in_pairs_too():
    points = unit(hhr.Sobol(64).points(SPACE))
    for first, second in ((0, 1), (0, 2), (1, 2)):
        counts, *_ = np.histogram2d(points[:, first], points[:, second], bins=4, range=((0, 1), (0, 1)))
        assert (counts == 4).all()


@pytest.mark.parametrize("kind", KINDS)
def test_corners_come_first_and_beside_the_count(kind):
    points = kind(5, corners=True).points(SPACE)
    assert points.shape == (13, 3)
    assert {tuple(row) for row in unit(points[:8]).round(12)} == {tuple(row) for row in np.ndindex(2, 2, 2)}
    assert np.array_equal(points[8:], kind(5).points(SPACE))
    ten = hhr.ParameterSpace(tuple("abcdefghij"), (0.0,) * 10, (1.0,) * 10)
    assert len(kind(3, corners=True).points(ten)) == 1027
    eleven = hhr.ParameterSpace(tuple("abcdefghijk"), (0.0,) * 11, (1.0,) * 11)
    assert kind(3).points(eleven).shape == (3, 11)
    with pytest.raises(ParameterError, match="a box of 11 parameters has too many corners: leave them out"):
        kind(3, corners=True).points(eleven)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("given", [(0,), (-3,), (2.0,), ("8",), (None,), (True,), (8, -1), (8, 1.5), (8, "a")])
def test_counts_and_seeds_that_are_none(kind, given):
    with pytest.raises(ParameterError, match=rf"{kind.__name__}\(.*: the count must be a positive integer, the seed"):
        kind(*given)


def test_training_takes_them(tmp_path):
    scene = pressed_block("plane_stress")
    training = hhr.train(scene, hhr.Sobol(8), held_out=4, folder=tmp_path)
    assert np.array_equal(training.snapshots.points, hhr.Sobol(8).points(scene.parameters))
    assert np.array_equal(
        training.snapshots.forces[:, 3], training.full_order.solve(training.snapshots.points[3]).forces()
    )
    # what is there is not solved again
    again = hhr.train(scene, hhr.Sobol(8), held_out=4, folder=tmp_path)
    assert any("were read from" in item["why"] for item in again.log.skipped)
    assert len(hhr.train(scene, hhr.LatinHypercube(3, corners=True), held_out=0).snapshots.points) == 5
    with pytest.raises(StudyError, match="needs at least 2"):
        hhr.train(scene, hhr.Sobol(1))
