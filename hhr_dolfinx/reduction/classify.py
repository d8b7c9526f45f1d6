"""Cuts through the box that keep labelled points apart: which local model answers a parameter, thesis section 4.2.2."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hhr_dolfinx import compat
from hhr_dolfinx.models.local import LEAF, Choice
from hhr_dolfinx.parameters import ParameterSpace

with compat.extra("local", "a classifier of parameters"):
    from sklearn.ensemble import RandomForestClassifier
    from sklearn.tree import DecisionTreeClassifier

DRAWN = 20_000
"""Points at which one tree learns what a forest says."""
TREES = 100
"""Trees of a forest."""


def separating_cut(unit: np.ndarray, labels: np.ndarray, least: float) -> tuple[int, float] | None:
    """The axis and the place of the cut that keeps two labels apart best; None where there is none.

    Args:
        unit: points in the unit box, (n, P).
        labels: 0 or 1, (n,).
        least: part of the points that each side has at least.
    """
    stump = DecisionTreeClassifier(max_depth=1, min_samples_leaf=max(int(least * len(unit)), 1), random_state=0)
    tree = stump.fit(unit, labels).tree_
    return None if tree.feature[0] < 0 else (int(tree.feature[0]), float(tree.threshold[0]))


def tree_of_cells(cells: np.ndarray, labels: np.ndarray) -> Choice:
    """The tree whose cuts run along the lines of a grid, from its cells, (C, 2, P), and their labels.

    It is told the numbers of cells along each axis: a classifier does not tell narrow ones of a wide box apart.
    """
    lines, ranks = [], []
    for ends in cells[:, 1].T:
        values, rank = np.unique(ends, return_inverse=True)
        lines.append(values)
        ranks.append(rank)
    places = np.column_stack(ranks).astype(float)
    space = ParameterSpace(tuple(f"axis_{k}" for k in range(len(lines))), (0.0,) * len(lines), (1.0,) * len(lines))
    found = _choice(DecisionTreeClassifier(random_state=0).fit(places, labels), space)
    cut = found.cut.copy()
    for node in np.flatnonzero(found.axis != LEAF):
        cut[node] = lines[found.axis[node]][int(cut[node])]
    return replace(found, cut=cut)


def forest_tree(points: np.ndarray, labels: np.ndarray, space: ParameterSpace, seed: int = 0) -> Choice:
    """What a random forest trained on labelled points, (n, P), says, as one tree.

    The forest of the thesis asks a hundred trees for each query, which takes longer than the answer of a local model.
    One tree that learns from many points labelled by the forest says the same but along the borders.
    """
    forest = RandomForestClassifier(TREES, random_state=seed).fit(_unit(points, space), labels)
    drawn = np.vstack([_unit(points, space), np.random.default_rng(seed).random((DRAWN, len(space.names)))])
    return _choice(DecisionTreeClassifier(random_state=0).fit(drawn, forest.predict(drawn)), space)


def _unit(points: np.ndarray, space: ParameterSpace) -> np.ndarray:
    """Points of the box in the unit box."""
    lower, upper = np.array(space.lower), np.array(space.upper)
    return (points - lower) / np.where(upper > lower, upper - lower, 1.0)


def _choice(classifier: DecisionTreeClassifier, space: ParameterSpace) -> Choice:
    """A fitted tree as cuts through the box."""
    tree, lower, upper = classifier.tree_, np.array(space.lower), np.array(space.upper)
    inner = tree.feature >= 0
    axis = np.where(inner, tree.feature, LEAF)
    cut = np.where(inner, lower[axis] + tree.threshold * (upper - lower)[axis], 0.0)
    label = classifier.classes_[tree.value[:, 0].argmax(axis=1)].astype(np.int64)
    low, high = (np.where(inner, part, 0).astype(np.int64) for part in (tree.children_left, tree.children_right))
    reach = np.zeros(len(space.names))
    return Choice(axis.astype(np.int64), cut, low, high, np.where(inner, LEAF, label), reach)
