"""What the loop over the steps of a history asks of all Gauss points together, whoever has them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np

from hhr_dolfinx.models.answer import Answer


class Points(Protocol):
    """Gauss points of a model: all of them here, or some of them on each rank of several, that ask together."""

    def largest(self, value: float) -> float:
        """The largest of a number of all ranks."""

    def total(self, value: float) -> float:
        """The sum of it."""

    def every(self, true: bool) -> bool:
        """Whether something is true on all ranks."""

    def agreed(self, work: Callable[[], Any]) -> Any:
        """What a rank makes of its own points by itself; what fails on one of them fails on all."""

    def gathered(self, values: np.ndarray) -> np.ndarray:
        """Values at the points of all ranks, from those at own ones, (points, ...)."""

    def place(self, values: np.ndarray) -> int:
        """The number, among the points of all ranks, of the largest of values at own ones, (points,)."""

    def worst(self, size: float, what: Any) -> Any:
        """What the rank says that has the largest of a number."""

    def own(self, answer: Answer) -> Answer:
        """An answer with stress and state at the points that are here."""

    def whole(self, answer: Answer) -> Answer:
        """The same at all points."""


class AllHere:
    """All points are here."""

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

    def worst(self, size: float, what: Any) -> Any:
        """See :class:`Points`."""
        return what

    def own(self, answer: Answer) -> Answer:
        """See :class:`Points`."""
        return answer

    def whole(self, answer: Answer) -> Answer:
        """See :class:`Points`."""
        return answer


ALL_HERE: Points = AllHere()
