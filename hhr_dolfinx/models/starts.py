"""Starts of the active set: training statuses, extrapolated along their derivatives."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated

import numpy as np

from hhr_dolfinx.declared import Booleans, Floats
from hhr_dolfinx.models.answer import Answer
from hhr_dolfinx.plain import Rebuilt

SLOPES_AT_ONCE = 1024
"""Points whose slopes are gathered at once."""


@dataclass(frozen=True)
class KnownStatuses(Rebuilt):
    """Statuses at training parameters, from which the active set starts near its end."""

    points: Annotated[Floats, "statuses", "P"]  #: (S, P)
    active: Annotated[Booleans, "statuses", "m"]  #: (S, m) bool

    def __post_init__(self) -> None:
        active = self.active.view()  # answers share it; the array of the caller stays as it is
        active.setflags(write=False)
        object.__setattr__(self, "active", active)

    @classmethod
    def of_answers(cls, answers: Iterable[Answer]) -> KnownStatuses | None:
        """Statuses of the answers that converged; None without any."""
        converged = [answer for answer in answers if answer.converged]
        if not converged:
            return None
        return cls(
            *(
                np.array([getattr(answer, name) for answer in converged])
                for name in ("parameter", "active")
            )
        )

    @classmethod
    def solved(
        cls, solve: Callable[[np.ndarray, np.ndarray | None], Answer], points: np.ndarray
    ) -> KnownStatuses | None:
        """Statuses at points that are solved one after the other, each from those of the nearest
        one before.

        Neighbours mostly have the same statuses, whose factors are kept.

        Args:
            solve: answers a point, (P,), from statuses, (m,) bool, or None for none.
            points: the points, (n, P).

        Returns:
            Statuses of the answers that converged; None without any.
        """
        known = None
        answers: list[Answer] = []
        for point in points:
            answers.append(solve(point, None if known is None else known.start(point)))
            known = cls.of_answers(answers)
        return known

    def faults(self, sizes: Mapping[str, int]) -> Iterator[str]:
        """Fault: no status to start from."""
        if not len(self.points):
            yield "no statuses are known: there must be at least one"

    @cached_property
    def distances(self) -> tuple[np.ndarray, np.ndarray]:
        """Offsets and directions of |x - p|^2 / 2, without the part equal for all candidates x.

        The parameters, whose units differ, are scaled by their widths.
        """
        widths = np.ptp(self.points, axis=0)
        widths[widths == 0] = 1.0
        return 0.5 * np.sum((self.points / widths) ** 2, axis=1), self.points / widths**2

    def nearest(self, point: np.ndarray) -> int:
        """Index of the nearest training parameter."""
        offsets, directions = self.distances
        return (offsets - directions @ point).argmin()

    def start(self, point: np.ndarray) -> np.ndarray:
        """Statuses to start from at a point, (m,) bool: those of the nearest training parameter."""
        return self.active[self.nearest(point)]

    def starts(self, points: np.ndarray) -> np.ndarray:
        """Statuses to start from at many points, (n, P): (n, m) bool.

        A copy, which the caller may change.
        """
        offsets, directions = self.distances
        return self.active[(offsets - points @ directions.T).argmin(axis=1)]


@dataclass(frozen=True)
class LinearStarts(KnownStatuses):
    """Statuses at training parameters, with the distance of each condition from a change.

    With many parameters the nearest training point is far; extrapolated along its derivatives, its
    statuses still hold.
    """

    margins: Annotated[
        Floats, "statuses", "m"
    ]  #: force of closed conditions, and minus the slack of open ones, (S, m)
    slopes: Annotated[
        Floats, "statuses", "m", "P"
    ]  #: their derivatives along the parameters, (S, m, P)

    @cached_property
    def distances(self) -> tuple[np.ndarray, np.ndarray]:
        """See :class:`KnownStatuses`; each parameter is scaled by its effect on the margins.

        On the pellet with six parameters and 1000 points this takes 1.8 iterations of the active
        set. Scaling by the widths takes 3.0, and starts without derivatives 5.
        """
        sizes = np.sqrt(np.mean(self.margins**2, axis=0))
        sizes[sizes == 0] = 1.0
        squares = np.mean((self.slopes / sizes[:, None]) ** 2, axis=(0, 1))
        return 0.5 * self.points**2 @ squares, self.points * squares

    def start(self, point: np.ndarray) -> np.ndarray:
        """Statuses to start from at a point, (m,) bool."""
        near = self.nearest(point)
        return self.margins[near] + self.slopes[near] @ (point - self.points[near]) > 0

    def starts(self, points: np.ndarray) -> np.ndarray:
        """Statuses to start from at many points, (n, P): (n, m) bool.

        A copy, which the caller may change.
        """
        offsets, directions = self.distances
        active = np.empty((len(points), self.margins.shape[1]), dtype=bool)
        for first in range(0, len(points), SLOPES_AT_ONCE):
            block = points[first : first + SLOPES_AT_ONCE]
            near = (offsets - block @ directions.T).argmin(axis=1)
            change = np.einsum("nmp,np->nm", self.slopes[near], block - self.points[near])
            active[first : first + SLOPES_AT_ONCE] = self.margins[near] + change > 0
        return active
