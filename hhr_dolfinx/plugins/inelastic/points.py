"""Reductions over the Gauss points of all ranks, for the loop over the steps of a history."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import numpy as np

from hhr_dolfinx.models.answer import Answer

Result = TypeVar("Result")


class GaussPoints:
    """Gauss points of a model, all of them local.

    Other classes distribute them over ranks that communicate.
    """

    def largest(self, value: float) -> float:
        """Largest value on all ranks."""
        return value

    def total(self, value: float) -> float:
        """Sum over all ranks."""
        return value

    def every(self, true: bool) -> bool:
        """True if ``true`` holds on all ranks."""
        return true

    def agreed(self, work: Callable[[], Result]) -> Result:
        """Result of ``work`` on the local points; an error on one rank is raised on all."""
        return work()

    def gathered(self, values: np.ndarray) -> np.ndarray:
        """Values at the points of all ranks, from those at local points, (points, ...)."""
        return values

    def place(self, values: np.ndarray) -> int:
        """Number, among the points of all ranks, of the largest of values at local points,
        (points,).
        """
        return int(values.argmax())

    def worst(self, size: float, what: Result) -> Result:
        """``what`` of the rank with the largest ``size``."""
        return what

    def own(self, answer: Answer) -> Answer:
        """An answer with stress and state at the local points."""
        return answer

    def whole(self, answer: Answer) -> Answer:
        """An answer with stress and state at all points."""
        return answer


ALL_HERE = GaussPoints()
