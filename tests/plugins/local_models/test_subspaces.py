"""Angles and distances of spaces: closed forms, digits of small angles, theorem 9, what is
refused.
"""

import time

import dissimilarity
import numpy as np
import pytest
from scipy import linalg

from hhr_dolfinx.errors import ReductionError
from hhr_dolfinx.plugins.local_models.subspaces import (
    basis_distances,
    coordinates,
    snapshot_distances,
    theorem_9,
)

RNG = np.random.default_rng(3)
ANGLES = np.array([1e-13, 3e-9, 1e-4, 0.2, 1.1, np.pi / 2])


def orthonormal(rows, count, rng=RNG):
    return linalg.qr(rng.standard_normal((rows, count)), mode="economic")[0]


def turned(angles, rows=40, rng=RNG):
    """Two bases with given principal angles, each in an orthonormal basis of its own."""
    axes = orthonormal(rows, 2 * len(angles), rng)
    first, beside = axes[:, : len(angles)], axes[:, len(angles) :]
    second = first * np.cos(angles) + beside * np.sin(angles)
    return first @ orthonormal(len(angles), len(angles), rng), second @ orthonormal(
        len(angles), len(angles), rng
    )


# ---------------------------------------------------------------- closed forms


def test_known_angles_to_the_last_digits_in_any_basis_of_the_spaces():
    for angles in (ANGLES, ANGLES[:1], ANGLES[:2], ANGLES[2:3]):
        first, second = turned(angles)
        for pair in ((first, second), (second, first @ orthonormal(len(angles), len(angles)))):
            assert basis_distances(pair)[0, 1] == pytest.approx(
                np.linalg.norm(angles), rel=1e-14, abs=3e-15
            )


def test_other_dimensions_count_right_angles():
    """(4.2): a plane within a space of five dimensions is three right angles away from it."""
    large = orthonormal(30, 5)
    small = large @ orthonormal(5, 2)
    assert basis_distances([small, large])[0, 1] == pytest.approx(np.sqrt(3) * np.pi / 2)
    first, second = turned(ANGLES)
    found = basis_distances([second, first[:, :4]])[0, 1]
    others = linalg.subspace_angles(second, first[:, :4])
    assert found == pytest.approx(np.sqrt(2 * np.pi**2 / 4 + others @ others), rel=1e-14)


# ---------------------------------------------------------------- matrices of many


def test_distances_of_bases_are_those_of_each_pair():
    first, second = turned(ANGLES[:4] * 0.01)
    bases = [
        first,
        second,
        orthonormal(40, 4),
        orthonormal(40, 2),
        first[:, :1],
        second[:, [0, 2]],
        first,
    ]
    found = basis_distances(bases)
    expected = [[basis_distances([one, other])[0, 1] for other in bases] for one in bases]
    assert found == pytest.approx(np.array(expected), abs=1e-13)
    assert found[0, 1] == pytest.approx(np.linalg.norm(ANGLES[:4] * 0.01), rel=1e-10)
    assert found[0, 6] < 1e-14  # cosines would say 1e-8


def test_many_bases_go_through_in_blocks(monkeypatch):
    bases = [orthonormal(20, 1 + k % 3) for k in range(9)]
    bases += [
        linalg.qr(basis + 1e-5 * RNG.standard_normal(basis.shape), mode="economic")[0]
        for basis in bases
    ]
    whole = basis_distances(bases)
    monkeypatch.setattr("hhr_dolfinx.plugins.local_models.subspaces.PAIR_BLOCK_NUMBERS", 100)
    assert basis_distances(bases) == pytest.approx(whole, rel=1e-13, abs=1e-15)


@pytest.mark.parametrize("rows", [4, 300])
def test_snapshots_are_as_far_apart_as_their_lines(rows):
    """More snapshots than unknowns, and fewer; lengths and signs of any size."""
    columns = (
        RNG.standard_normal((rows, 25)) * np.geomspace(1e-200, 1e200, 25) * RNG.choice([-1, 1], 25)
    )
    found = snapshot_distances(columns)
    units = columns / np.abs(columns).max(axis=0)
    units /= np.linalg.norm(units, axis=0)
    expected = np.arccos(np.minimum(np.abs(units.T @ units), 1))
    assert (
        found == pytest.approx(expected, abs=1e-7)
        and (found == found.T).all()
        and not np.diag(found).any()
    )
    assert found == pytest.approx(
        basis_distances([column[:, None] for column in units.T]), abs=1e-14
    )


@pytest.mark.parametrize("angle", [1e-15, 1e-12, 1e-9, 1e-5, 0.01, 1.0, np.pi / 2])
def test_small_angles_of_snapshots_keep_their_digits(angle):
    one, beside = orthonormal(500, 2).T
    columns = np.column_stack(
        [one, 7 * (one * np.cos(angle) + beside * np.sin(angle)), -3 * one, beside]
    )
    # a dozen round-offs of sums of 500 products: 2.7e-15 with the BLAS of Debian
    assert snapshot_distances(columns)[:3, :3] == pytest.approx(
        np.array([[0, angle, 0], [angle, 0, angle], [0, angle, 0]]),
        abs=1e-13 if angle > 1e-3 else 4e-15,
    )


def test_distances_of_2000_snapshots_take_seconds():
    """A quarter of the size, which must take a tenth of the time: pairs one by one take minutes."""
    columns = RNG.standard_normal((7000, 500))
    start = time.process_time()
    snapshot_distances(columns)
    assert time.process_time() - start < 10


def test_coordinates_keep_lengths_and_products():
    columns = RNG.standard_normal((30, 6))
    found = coordinates(columns)
    assert found.shape == (6, 6) and found.T @ found == pytest.approx(
        columns.T @ columns, rel=1e-10, abs=1e-10
    )
    wide = columns[:3]
    assert coordinates(wide) is wide
    flat = np.outer(np.arange(20.0), [1.0, 2.0, 3.0])  # dependent columns
    assert snapshot_distances(flat).max() < 1e-14


# ---------------------------------------------------------------- theorem 9


@pytest.mark.parametrize("case", range(20))
def test_theorem_9(case):
    """The first right side is the distance of the answer to the reduced space, the second no less,
    in any basis.
    """
    rng = np.random.default_rng(case)
    count, more = int(rng.integers(1, 6)), int(rng.integers(0, 4))
    exact, reduced = turned(rng.uniform(0, 10.0 ** rng.integers(-9, 1), count), 60, rng)
    if more:
        reduced = linalg.qr(
            np.column_stack([reduced, rng.standard_normal((60, more))]), mode="economic"
        )[0]
    weights = rng.standard_normal(count)
    field = exact @ weights
    infimum = np.linalg.norm(field - reduced @ (reduced.T @ field))
    angles, distance = theorem_9(exact, reduced, weights)
    assert angles == pytest.approx(infimum, rel=1e-10, abs=1e-14) and angles <= distance * (
        1 + 1e-12
    )
    sines = np.linalg.svd(exact - reduced @ (reduced.T @ exact), compute_uv=False)
    assert distance == pytest.approx(
        np.linalg.norm(sines) * np.sqrt(count) * np.linalg.norm(weights), rel=1e-9, abs=1e-14
    )
    other = orthonormal(count, count, rng)
    assert theorem_9(exact @ other, reduced, other.T @ weights) == pytest.approx(
        (angles, distance), abs=1e-13
    )
    assert theorem_9(exact, reduced, weights, 7.0) == pytest.approx((7 * angles, 7 * distance))


# ---------------------------------------------------------------- refused


def test_what_is_no_orthonormal_basis_is_refused():
    good = np.eye(4)[:, :2]
    for bad, why in (
        (2 * good, r"basis 1 of the bases is not orthonormal, by 3 of V\^T V - I: .*QR"),
        (good * (1 + 1e-7), "1 of the bases is not orthonormal"),
        (np.eye(4)[:, [0, 0]], "basis 1 of the bases is not orthonormal"),
        (np.eye(5)[:, :2], r"bases have \[4, 5\] rows"),
        (np.full((4, 1), np.nan), r"columns \[0\] of basis 1 of the bases are not finite"),
        (np.zeros((4, 0)), "at least one column"),
        (np.zeros(4), "at least one column"),
        ("basis", "real numbers"),
    ):
        with pytest.raises(ReductionError, match=why):
            basis_distances([good, bad])
    with pytest.raises(ReductionError, match="no basis is given"):
        basis_distances([])


def test_snapshots_without_direction_are_refused():
    columns = np.ones((5, 4))
    columns[:, 2] = 0
    with pytest.raises(ReductionError, match=r"snapshots \[2\] are zero.*parameters without load"):
        snapshot_distances(columns)
    columns[1, 2] = np.inf
    with pytest.raises(ReductionError, match=r"columns \[2\] of columns are not finite"):
        snapshot_distances(columns)


def test_theorem_9_refuses_what_it_is_not_on():
    good = np.eye(4)[:, :2]
    weights = [
        ((np.array(bad), 1.0), "must be 2 finite numbers") for bad in ([1.0], [1.0, np.nan], 1.0)
    ]
    for given, why in (
        *weights,
        *(((np.ones(2), factor), r"1 \+ M_a") for factor in (0.0, np.nan, np.inf)),
    ):
        with pytest.raises(ReductionError, match=why):
            theorem_9(good, good, *given)


# ---------------------------------------------------------------- figure 2.13


def test_figure_2_13(tmp_path):
    """No error of the pellet with five modes exceeds a right side, with either constants, and the
    first is nearer.
    """
    found = dissimilarity.figure_2_13(tmp_path, quick=True)
    rows, summary = found["rows"], found["summary"]
    assert len(rows) == 45 and summary["modes"] == 5 and (tmp_path / "figure_2_13.png").exists()
    assert {row["h1"] for row in rows} == {0.5, 0.75, 1.0, 1.25, 1.5}
    assert all(row["holds"] and row["bound_129"] <= row["bound_130"] for row in rows)
    assert summary["exceeded"] == summary["printed_exceeded"] == 0
    # the space of the reduced model is no nearer to an answer than its infimum, which its own
    # answer cannot beat
    assert all(row["error"] >= row["bound_129"] / summary["factor"] * (1 - 1e-9) for row in rows)
    assert summary["effectivity_129"][1] > 1 and summary["effectivity_129"][2] <= summary[
        "factor"
    ] * (1 + 1e-9)
    assert 1e-4 < summary["worst relative error"] < 0.1 and found["finer"]["exceeded"] == 0
