"""Cells of grids, their local bases, and clusters: whatever the order, every label used, what is
refused.
"""

import numpy as np
import pytest
from scipy import linalg

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import ReductionError
from hhr_dolfinx.plugins.local_models.clusters import cell_bases, cell_labels, grid_cells, medoids
from hhr_dolfinx.plugins.local_models.subspaces import snapshot_distances


def families(rng, sizes=(7, 5, 9), spread=0.05, rows=50):
    """Snapshots around some directions, and whose each is."""
    axes = linalg.qr(rng.standard_normal((rows, len(sizes))), mode="economic")[0]
    whose = np.repeat(np.arange(len(sizes)), sizes)
    columns = axes[:, whose] + spread * rng.standard_normal((rows, whose.size)) / np.sqrt(rows)
    return columns * rng.uniform(-5, 5, whose.size), whose


# ---------------------------------------------------------------- grids


@pytest.mark.parametrize("counts", [(5,), (3, 4), (4, 2, 3), (2, 3, 2, 2)])
def test_cells_of_a_grid_fill_its_box(counts):
    space = hhr.ParameterSpace(
        tuple("abcd"[: len(counts)]), (-1.0,) * len(counts), (3.0,) * len(counts)
    )
    points = space.grid(counts) ** 3  # spaced irregularly
    cells, corners = grid_cells(points)
    assert len(cells) == np.prod(np.array(counts) - 1) and corners.shape == (
        len(cells),
        2 ** len(counts),
    )
    assert np.prod(cells[:, 1] - cells[:, 0], axis=1).sum() == pytest.approx(28.0 ** len(counts))
    for cell, own in zip(cells, corners, strict=True):
        found = points[own]
        assert (found.min(axis=0) == cell[0]).all() and (found.max(axis=0) == cell[1]).all()
        assert len({tuple(point) for point in found}) == len(own)
        inside = (points > cell[0]).all(axis=1) & (points < cell[1]).all(axis=1)
        assert not inside.any()


def test_points_of_a_grid_may_come_in_any_order_with_round_off():
    rng = np.random.default_rng(1)
    points = hhr.ParameterSpace(("a", "b"), (0.0, 1e3), (1.0, 2e3)).grid((4, 3))
    order = rng.permutation(12)
    cells, corners = grid_cells(points)
    other_cells, other = grid_cells(points[order] * (1 + 1e-15 * rng.standard_normal((12, 2))))
    assert (order[other] == corners).all() and other_cells == pytest.approx(cells, rel=1e-12)


def test_a_grid_may_be_flat():
    cells, corners = grid_cells(np.array([[1.0, 5.0], [2.0, 5.0], [4.0, 5.0]]))
    assert (corners == [[0, 1], [1, 2]]).all() and (cells[:, :, 1] == 5).all()


@pytest.mark.parametrize(
    "points, why",
    [
        (np.random.default_rng(0).uniform(size=(9, 2)), "9 points with 9 x 9 values"),
        (
            np.array([[0.0, 0], [0, 1], [1, 0]]),
            "3 points with 2 x 2 values of their parameters are no grid",
        ),
        (np.array([[0.0, 0], [0, 1], [1, 0], [1, 0]]), "are no grid"),
        (np.array([[0.0], [1.0], [1.0]]), "are no grid"),
        (np.array([[0.0, 1.0]]), "a grid of one point"),
        (np.array([[0.0], [np.nan]]), "finite"),
        (np.zeros((0, 2)), "table"),
        (np.arange(3.0), "table"),
    ],
)
def test_what_is_no_grid_is_refused(points, why):
    with pytest.raises(ReductionError, match=why):
        grid_cells(points)


# ---------------------------------------------------------------- cells


def moving(points, rows=80):
    """A bump that moves with the second parameter and grows with the first."""
    places = np.linspace(0, 1, rows)[:, None]
    return points[:, 0] * np.exp(-(((places - points[:, 1]) / 0.08) ** 2))


def grid(*counts, lowest=1.0):
    """Points of a grid of the first parameter and the second."""
    return hhr.ParameterSpace(("P1", "h1"), (lowest, 0.1), (5.0, 0.9)).grid(counts)


def test_a_cell_spans_its_corners():
    points = grid(2, 9)
    columns = moving(points)
    corners = grid_cells(points).corners
    bases = cell_bases(columns, corners)
    assert {basis.shape[1] for basis in bases} == {2}  # answers at one h1 are parallel
    for basis, own in zip(bases, corners, strict=True):
        assert columns[:, own] == pytest.approx(basis @ (basis.T @ columns[:, own]), abs=1e-12)


def test_cells_without_load_are_refused_and_corners_without_are_not():
    points = grid(3, 5, lowest=0.0)
    columns = moving(points)
    cells = grid_cells(points)
    assert cell_labels(cells, columns, 2).max() == 1
    columns[:, :10] = 0
    with pytest.raises(
        ReductionError, match=r"corners of cells \[0, 1, 2, 3\] are zero.*parameters without load"
    ):
        cell_labels(cells, columns, 2)
    columns[3, 3] = np.nan
    with pytest.raises(ReductionError, match=r"columns \[3\] of columns are not finite"):
        cell_labels(cells, columns, 2)


# ---------------------------------------------------------------- snapshots


def labels_of(columns, count, seed=1):
    return medoids(snapshot_distances(columns), count, seed)


@pytest.mark.parametrize("seed", range(5))
def test_clusters_of_snapshots_do_not_depend_on_their_order_sign_and_length(seed):
    """Labels come in the order in which they occur."""
    rng = np.random.default_rng(seed)
    columns, whose = families(rng)
    assert (labels_of(columns, 3, seed) == whose).all()
    order = rng.permutation(whose.size)
    _, at, places = np.unique(whose[order], return_index=True, return_inverse=True)
    assert (labels_of(columns[:, order], 3, seed + 7) == np.argsort(np.argsort(at))[places]).all()


@pytest.mark.parametrize("count", [1, 2, 4, 20, 21])
def test_every_label_is_used(count):
    columns, _ = families(np.random.default_rng(2))
    assert set(labels_of(columns, count)) == set(range(count))
    alike = np.zeros((21, 21))  # all of them equal
    assert set(medoids(alike, count)) == set(range(count))


def test_the_sum_of_distances_is_the_least():
    """All choices of medoids of a few items tried."""
    from itertools import combinations

    rng = np.random.default_rng(5)
    for _ in range(10):
        places = rng.uniform(size=(14, 2))
        matrix = np.linalg.norm(places[:, None] - places, axis=2)
        labels = medoids(matrix, 3)
        own = sum(matrix[labels == k][:, labels == k].sum(axis=0).min() for k in range(3))
        least = min(
            matrix[:, list(chosen)].min(axis=1).sum() for chosen in combinations(range(14), 3)
        )
        assert own == pytest.approx(least, rel=1e-12)


def test_what_cannot_be_clustered_is_refused():
    columns, _ = families(np.random.default_rng(3))
    with pytest.raises(ReductionError, match="22 clusters of 21 items"):
        labels_of(columns, 22)
    columns[:, 4] = 0
    with pytest.raises(ReductionError, match=r"snapshots \[4\] are zero"):
        labels_of(columns, 3)
