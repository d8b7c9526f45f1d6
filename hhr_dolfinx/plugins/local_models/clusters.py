"""Parts of the box with answers near one small space, thesis section 4.2: k-medoids of cells, or of
snapshots.

On a regular grid its cells are clustered, by the spaces of the snapshots at their corners; a
snapshot at a border belongs to both sides. Without a grid, snapshots are clustered. Cuts through
the box then separate the labelled points: they select the local model that answers, section 4.2.2.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from hhr_dolfinx.compat import extra
from hhr_dolfinx.errors import ReductionError
from hhr_dolfinx.parameters import ParameterSpace
from hhr_dolfinx.plugins.local_models.models import LEAF, Choice
from hhr_dolfinx.plugins.local_models.subspaces import basis_distances, coordinates
from hhr_dolfinx.reduction.modes import pod

with extra("local", "a classifier of parameters"):
    from sklearn.ensemble import RandomForestClassifier
    from sklearn.tree import DecisionTreeClassifier

LABELLED_POINTS = 20_000
"""Points at which one tree learns the labels of a forest."""
TREES = 100
"""Trees of a forest."""
MEDOID_STARTS = 5
"""Random starts of k-medoids, in addition to a greedy one; the best result counts."""
CELL_TOLERANCE = 1e-8
"""Of the POD of each cell.

An additional mode counts as a right angle in (4.2), so that a loose one clusters cells by their
number of modes: the pellet's by pressure at 1e-4, and by height, as in figure 4.2b, at 1e-6 and
below.
"""
EQUAL_GRID_VALUES = 1e-9
"""Difference of two values of a parameter over its range, below which they are one value of a
grid.
"""


class GridCells(NamedTuple):
    """Cells of a regular grid, in the order of its points."""

    cells: (
        np.ndarray
    )  #: lower and upper corner, (C, 2, P); flat along a parameter of which the grid has one value
    corners: (
        np.ndarray
    )  #: numbers of the points at the corners of each, (C, 2^Q) with Q parameters that vary


def grid_cells(points: np.ndarray) -> GridCells:
    """Cells of a regular grid of any number of parameters, with any spacing.

    The points, (S, P), may be in any order.

    Raises:
        ReductionError: for points that are no grid, or a single one.
    """
    points = np.asarray(points, dtype=float)
    if points.ndim != 2 or 0 in points.shape or not np.isfinite(points).all():
        raise ReductionError(
            f"points of the shape {points.shape} must be a table of finite numbers, (S, P)"
        )
    values, indices = zip(*(_axis(column) for column in points.T), strict=True)
    shape = tuple(axis.size for axis in values)
    flat = (
        np.ravel_multi_index(indices, shape)
        if np.prod(shape, dtype=float) <= len(points)
        else np.zeros(0)
    )
    if np.unique(flat).size != len(points):
        size = " x ".join(map(str, shape))
        raise ReductionError(
            f"{len(points)} points with {size} values of their parameters are no grid, each point "
            "of it once: label snapshots instead of cells"
        )
    if len(points) == 1:
        raise ReductionError(
            "a grid of one point has no cell: train on at least two values of a parameter"
        )
    numbers = np.argsort(flat).reshape(shape)
    lowest = np.indices([max(size - 1, 1) for size in shape]).reshape(len(shape), -1).T
    steps = np.array([size > 1 for size in shape], dtype=int)
    highest = lowest + steps
    ways = np.indices(tuple(steps + 1)).reshape(len(shape), -1).T
    corners = numbers[tuple(np.moveaxis(lowest[:, None] + ways, -1, 0))]
    cells = [[axis[end[:, k]] for k, axis in enumerate(values)] for end in (lowest, highest)]
    return GridCells(np.array(cells).transpose(2, 0, 1), corners)


def cell_bases(columns: np.ndarray, corners: np.ndarray) -> list[np.ndarray]:
    """Orthonormal bases of cells, (N, a_j <= k) each, by POD, section 4.2.1.

    Args:
        columns: snapshots, (N, S), or their
            :func:`~hhr_dolfinx.plugins.local_models.subspaces.coordinates`.
        corners: indices of the snapshots at the corners of each cell, (C, k).

    Raises:
        ReductionError: for a cell whose snapshots are all zero, and for errors of POD.
    """
    sizes = np.abs(columns).max(axis=0, initial=0.0)
    empty = np.flatnonzero(~sizes[corners].any(axis=1))
    if empty.size:
        raise ReductionError(
            f"all snapshots at the corners of cells {empty[:10].tolist()} are zero, and span no "
            "space: leave out parameters without load"
        )
    return [pod(columns[:, corner_columns], CELL_TOLERANCE)[0] for corner_columns in corners]


def cell_labels(grid: GridCells, columns: np.ndarray, count: int, seed: int = 1) -> np.ndarray:
    """Labels from 0, (C,), of cells of a grid whose snapshots span similar spaces, section 4.2.1.

    Args:
        grid: the cells.
        columns: snapshots, (N, S).
        count: number of clusters, K.
        seed: of the random starts of k-medoids.

    Raises:
        ReductionError: for more clusters than cells, or snapshots that are not finite.
    """
    return medoids(basis_distances(cell_bases(coordinates(columns), grid.corners)), count, seed)


def medoids(dissimilarity: np.ndarray, count: int, seed: int = 1) -> np.ndarray:
    """Clusters by k-medoids: each item belongs to the nearest of K items, chosen for the least sum.

    The best of several random starts and a greedy one counts.

    Args:
        dissimilarity: symmetric, not negative and with a zero diagonal, (n, n).
        count: number of clusters, K.
        seed: of the random starts.

    Returns:
        Labels 0 to K - 1, (n,), all of them used, in the order in which they first occur.

    Raises:
        ReductionError: for more clusters than items.
        MissingPackageError: without the package kmedoids.
    """
    if count > len(dissimilarity):
        raise ReductionError(
            f"{count} clusters of {len(dissimilarity)} items: the number must be an integer from "
            "1 to as many"
        )
    chosen = _chosen(dissimilarity, count, seed)
    labels = np.argmin(dissimilarity[:, chosen], axis=1)
    labels[chosen] = np.arange(
        chosen.size
    )  # two equal ones would share a label, and leave another without items
    _, first, inverse = np.unique(labels, return_index=True, return_inverse=True)
    return np.argsort(np.argsort(first))[inverse]


def _chosen(matrix: np.ndarray, count: int, seed: int) -> np.ndarray:
    """Numbers of the medoids, (K,)."""
    with extra("local", "clustering for local models"):
        from kmedoids import fasterpam
    if count == len(matrix):
        return np.arange(count)
    # one thread: with several the order in which swaps are found may differ from run to run
    ends = [fasterpam(matrix, count, init="build", random_state=seed, n_cpu=1)]
    ends += [
        fasterpam(matrix, count, init="random", random_state=seed + k, n_cpu=1)
        for k in range(MEDOID_STARTS)
    ]
    chosen = np.unique(np.asarray(min(ends, key=lambda end: end.loss).medoids, dtype=np.int64))
    while chosen.size < count:  # one of several equal items may have been chosen twice
        candidates = np.setdiff1d(np.arange(len(matrix)), chosen)
        chosen = np.append(chosen, candidates[np.argmax(matrix[candidates][:, chosen].min(axis=1))])
    return np.sort(chosen)


def _axis(column: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Values of a parameter, ascending, and the index of the value of each point, (S,).

    Equal up to round-off.
    """
    rising = np.unique(column)
    first = np.append(True, np.diff(rising) > EQUAL_GRID_VALUES * (rising[-1] - rising[0]))
    return rising[first], (np.cumsum(first) - 1)[np.searchsorted(rising, column)]


def separating_cut(unit: np.ndarray, labels: np.ndarray, least: float) -> tuple[int, float] | None:
    """Axis and position of the cut that separates labels 0 and 1.

    None without one.

    Args:
        unit: points in the unit box, (n, P).
        labels: labels of the points, (n,).
        least: part of the points that is at least on each side.
    """
    stump = DecisionTreeClassifier(
        max_depth=1, min_samples_leaf=max(int(least * len(unit)), 1), random_state=0
    )
    tree = stump.fit(unit, labels).tree_
    return None if tree.feature[0] < 0 else (int(tree.feature[0]), float(tree.threshold[0]))


def tree_of_cells(cells: np.ndarray, labels: np.ndarray) -> Choice:
    """Tree whose cuts run along the lines of a grid.

    Its classifier uses the numbers of cells along each axis: in a wide box it cannot separate
    narrow ones.

    Args:
        cells: corners of the cells, (C, 2, P).
        labels: labels of the cells, (C,).
    """
    lines = []
    ranks = []
    for ends in cells[:, 1].T:
        values, rank = np.unique(ends, return_inverse=True)
        lines.append(values)
        ranks.append(rank)
    cell_numbers = np.column_stack(ranks).astype(float)
    space = ParameterSpace(
        tuple(f"axis_{k}" for k in range(len(lines))), (0.0,) * len(lines), (1.0,) * len(lines)
    )
    choice = _choice(DecisionTreeClassifier(random_state=0).fit(cell_numbers, labels), space)
    cut = choice.cut.copy()
    for node in np.flatnonzero(choice.axis != LEAF):
        cut[node] = lines[choice.axis[node]][int(cut[node])]
    return replace(choice, cut=cut)


def forest_tree(
    points: np.ndarray, labels: np.ndarray, space: ParameterSpace, seed: int = 0
) -> Choice:
    """One tree that approximates a random forest trained on labelled points.

    The forest of the thesis evaluates a hundred trees for each query, which takes longer than the
    answer of a local model. A tree trained on many points labelled by the forest agrees with it
    except along the borders.

    Args:
        points: labelled points, (n, P).
        labels: their labels, (n,).
        space: the box.
        seed: of the forest, and of the random points.
    """
    forest = RandomForestClassifier(TREES, random_state=seed).fit(_unit(points, space), labels)
    drawn = np.vstack(
        [
            _unit(points, space),
            np.random.default_rng(seed).random((LABELLED_POINTS, len(space.names))),
        ]
    )
    return _choice(DecisionTreeClassifier(random_state=0).fit(drawn, forest.predict(drawn)), space)


def _unit(points: np.ndarray, space: ParameterSpace) -> np.ndarray:
    lower = np.array(space.lower)
    return (points - lower) / (np.array(space.upper) - lower)


def _choice(classifier: DecisionTreeClassifier, space: ParameterSpace) -> Choice:
    """A fitted tree as cuts through the box."""
    tree = classifier.tree_
    lower = np.array(space.lower)
    upper = np.array(space.upper)
    inner = tree.feature >= 0
    axis = np.where(inner, tree.feature, LEAF)
    cut = np.where(inner, lower[axis] + tree.threshold * (upper - lower)[axis], 0.0)
    label = classifier.classes_[tree.value[:, 0].argmax(axis=1)].astype(np.int64)
    low, high = (
        np.where(inner, children, 0).astype(np.int64)
        for children in (tree.children_left, tree.children_right)
    )
    reach = np.zeros(len(space.names))
    return Choice(axis.astype(np.int64), cut, low, high, np.where(inner, LEAF, label), reach)
