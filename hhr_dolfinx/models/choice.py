"""Which of several models answers a parameter: cuts through the box, followed from one to the next.

A region where one model answers is made of boxes. Partitions of a grid, decision trees and boxes that were split one
after another are all of this kind, and a query follows some five cuts, in a microsecond or two.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any

import numpy as np

from hhr_dolfinx.declared import Floats, Integers
from hhr_dolfinx.errors import ReductionError

LEAF = -1
"""In the place of an axis where nothing is cut."""


@dataclass(frozen=True, eq=False)
class Choice:
    """A binary tree of cuts across the axes (n nodes, the first one is the whole box; P parameters).

    Attributes:
        axis: which parameter is cut, (n,) int; -1 where a region is reached.
        cut: where, (n,); what is not above goes low.
        low, high: the nodes behind, (n,) int, each after the one that leads to it.
        label: number of the model of a region, (n,) int.
        reach: half the width, along each parameter, of the strip along a cut in which both sides are candidates, (P,).

    Raises:
        ReductionError: for what is no tree.
    """

    axis: Annotated[Integers, "nodes"]
    cut: Annotated[Floats, "nodes"]
    low: Annotated[Integers, "nodes"]
    high: Annotated[Integers, "nodes"]
    label: Annotated[Integers, "nodes"]
    reach: Annotated[Floats, "P"]

    def __post_init__(self) -> None:
        """Refuse what is no tree: a query would not end, or end nowhere."""
        count = len(self.axis)
        sizes = {len(part) for part in (self.axis, self.cut, self.low, self.high, self.label)}
        inner = np.flatnonzero(self.axis != LEAF)
        if sizes != {count} or count == 0 or not (np.isfinite(self.cut).all() and np.isfinite(self.reach).all()):
            raise ReductionError("a choice between models needs as many finite cuts as nodes, at least one")
        behind = np.concatenate([self.low[inner], self.high[inner]])
        if (self.axis < LEAF).any() or (self.axis >= len(self.reach)).any() or (self.reach < 0).any():
            raise ReductionError(f"a choice between models cuts axes {np.unique(self.axis)} of {len(self.reach)}")
        if not np.array_equal(np.sort(behind), np.arange(1, count)) or (behind <= np.tile(inner, 2)).any():
            raise ReductionError("the cuts of a choice between models are no tree")
        if (self.label[self.axis == LEAF] < 0).any():
            raise ReductionError("a region of a choice between models has no model")

    @classmethod
    def whole(cls, parameters: int) -> Choice:
        """One model for the whole box."""
        none = np.zeros(1, dtype=np.int64)
        return cls(none - 1, np.zeros(1), none, none, none, np.zeros(parameters))

    @cached_property
    def _nodes(self) -> list[tuple[int, float, int, int]]:
        """As plain numbers, which Python follows ten times as fast."""
        parts = (self.axis, self.cut, self.low, self.high)
        return list(zip(*(part.tolist() for part in parts), strict=True))

    @cached_property
    def _plain(self) -> tuple[list[int], list[float]]:
        return self.label.tolist(), self.reach.tolist()

    def candidates(self, point: Sequence[float]) -> tuple[int, int]:
        """The model of a point, P numbers, and where it lies by a border the one behind, else -1.

        Of several borders the nearest one counts, in parts of their reach: points on both sides of it have the same
        two candidates, so that the answer does not jump there.
        """
        nodes, (labels, reach) = self._nodes, self._plain
        node, near = 0, []
        axis, cut, low, high = nodes[0]
        while axis >= 0:
            off, width = point[axis] - cut, reach[axis]
            if -width <= off <= width:
                near.append((abs(off) / width if width else 0.0, high if off <= 0 else low))
            node = low if off <= 0 else high
            axis, cut, low, high = nodes[node]
        label = labels[node]
        for _, behind in sorted(near):
            other = self._followed(behind, point)
            # both sides of a cut may belong to one model
            if other != label:
                return label, other
        return label, LEAF

    def _followed(self, node: int, point: Sequence[float]) -> int:
        """The model of a point behind a node."""
        axis, cut, low, high = self._nodes[node]
        while axis >= 0:
            axis, cut, low, high = self._nodes[node := low if point[axis] <= cut else high]
        return self._plain[0][node]

    def many(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The same for many points, (n, P): two arrays of numbers of models, (n,)."""
        rows = points.tolist()
        found = np.array([self.candidates(row) for row in rows], dtype=np.int64).reshape(len(rows), 2)
        return found[:, 0], found[:, 1]

    def boxes(self, lower: Any, upper: Any) -> list[tuple[int, np.ndarray, np.ndarray]]:
        """Regions inside a box: number of the model, and corners, (P,) each, in the order of the nodes."""
        corners = {0: (np.array(lower, dtype=float), np.array(upper, dtype=float))}
        found = []
        for node, (axis, cut, low, high) in enumerate(self._nodes):
            least, most = corners.pop(node)
            if axis == LEAF:
                found.append((int(self.label[node]), least, most))
                continue
            # a cut may lie outside of the box
            below, above = most.copy(), least.copy()
            below[axis] = above[axis] = min(max(cut, least[axis]), most[axis])
            corners[low], corners[high] = (least, below), (above, most)
        return found

    def reaching(self, reach: np.ndarray) -> Choice:
        """The same cuts with strips of another width, (P,)."""
        return Choice(self.axis, self.cut, self.low, self.high, self.label, np.asarray(reach, dtype=float))
