"""Reductions over the Gauss points of all ranks, for the loop over the steps of a history."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np

from hhr_dolfinx.models.answer import Answer


class Points(Protocol):
    """Gauss points of a model: all of them local, or distributed over ranks that communicate."""

    def largest(self, value: float) -> float:
        """Largest value on all ranks."""

    def total(self, value: float) -> float:
        """Sum over all ranks."""

    def every(self, true: bool) -> bool:
        """True if ``true`` holds on all ranks."""

    def agreed(self, work: Callable[[], Any]) -> Any:
        """Result of ``work`` on the local points; an error on one rank is raised on all."""

    def gathered(self, values: np.ndarray) -> np.ndarray:
        """Values at the points of all ranks, from those at local points, (points, ...)."""

    def place(self, values: np.ndarray) -> int:
        """Number, among the points of all ranks, of the largest of values at local points, (points,)."""

    def worst(self, size: float, what: object) -> Any:
        """``what`` of the rank with the largest ``size``."""

    def own(self, answer: Answer) -> Answer:
        """An answer with stress and state at the local points."""

    def whole(self, answer: Answer) -> Answer:
        """An answer with stress and state at all points."""


class AllHere:
    """Serial case: all points are local."""

    def largest(self, value: float) -> float:
        """See :class:`Points`."""
        return value

    def total(self, value: float) -> float:
        """See :class:`Points`."""
        return value

    def every(self, true: bool) -> bool:
        """See :class:`Points`."""
        return true

    def agreed(self, work: Callable[[], Any]) -> Any:
        """See :class:`Points`."""
        return work()

    def gathered(self, values: np.ndarray) -> np.ndarray:
        """See :class:`Points`."""
        return values

    def place(self, values: np.ndarray) -> int:
        """See :class:`Points`."""
        return int(values.argmax())

    def worst(self, size: float, what: object) -> Any:
        """See :class:`Points`."""
        return what

    def own(self, answer: Answer) -> Answer:
        """See :class:`Points`."""
        return answer

    def whole(self, answer: Answer) -> Answer:
        """See :class:`Points`."""
        return answer


ALL_HERE: Points = AllHere()
