"""Training range of a reduced model, as numbers, and the check of queries against it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Annotated, Protocol

import numpy as np

from hhr_dolfinx.declared import Floats
from hhr_dolfinx.errors import OutsideTrainingError, OutsideTrainingWarning, ParameterError
from hhr_dolfinx.parameters import ParameterSpace
from hhr_dolfinx.warn import warn

USUAL = "usual"
"""Default of ``outside``: each kind of model has its reaction to queries outside the training
range.
"""
OUTSIDE = ("warn", "refuse", "ignore")
"""Reactions to a query outside the training range."""

RANGE_MARGIN = 0.05
"""Fraction of the range of a parameter by which a query may lie outside it: slight extrapolation
was found harmless.
"""


def check_outside(outside: str) -> None:
    """Check the policy ``outside`` before it is needed.

    Raises:
        ParameterError: if it is not one of :data:`OUTSIDE`.
    """
    if outside not in OUTSIDE:
        raise ParameterError(f"outside = {outside!r} is unknown, one of {', '.join(OUTSIDE)}")


def announce(message: str, outside: str) -> None:
    """Warn of a query outside the training range, refuse it, or ignore it.

    Args:
        message: text of the warning or error.
        outside: one of :data:`OUTSIDE`.

    Raises:
        OutsideTrainingError: if ``outside`` is ``refuse``.

    Warns:
        OutsideTrainingWarning: if it is ``warn``.
    """
    check_outside(outside)
    if outside == "refuse":
        raise OutsideTrainingError(message)
    if outside == "warn":
        warn(message, OutsideTrainingWarning)


class Trained(Protocol):
    """Training range of a reduced model: of points, or of paths, which a plug-in checks."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""


@dataclass(frozen=True)
class TrainedRange:
    """Smallest and largest trained value of each parameter, with a margin."""

    names: Annotated[tuple[str, ...], "P"]  #: names of the parameters
    lower: Annotated[Floats, "P"]  #: bounds of the range, (P,)
    upper: Annotated[Floats, "P"]

    def faults(self, sizes: Mapping[str, int]) -> Iterator[str]:
        """Faults of a range that ends below its start."""
        if not (self.lower <= self.upper).all():
            yield "the trained range ends below its start"

    @classmethod
    def of(cls, points: np.ndarray, space: ParameterSpace) -> TrainedRange:
        """The range of training points, (S, P); round-off of the box counts as inside.

        Args:
            points: training points, (S, P).
            space: the box of the parameters.
        """
        lower = points.min(axis=0)
        upper = points.max(axis=0)
        margin = RANGE_MARGIN * (upper - lower) + 1e-9 * (
            np.array(space.upper) - np.array(space.lower)
        )
        return cls(tuple(space.names), lower - margin, upper + margin)

    def covers(self, space: ParameterSpace) -> bool:
        """True if the range contains the whole box."""
        return bool((self.lower <= space.lower).all() and (self.upper >= space.upper).all())

    def complaint(self, point: np.ndarray) -> str:
        """Report of the values of a point, (P,), outside the range; empty if all are inside."""
        if ((self.lower <= point) & (point <= self.upper)).all():  # nearly always, and quick
            return ""
        return ", ".join(
            f"{name} = {value:g} (trained {low:g} to {high:g})"
            for name, value, low, high in zip(
                self.names, point, self.lower, self.upper, strict=True
            )
            if not low <= value <= high
        )

    def check(self, point: np.ndarray, outside: str) -> None:
        """Check a point against the range; see :func:`announce`.

        Args:
            point: parameter, (P,).
            outside: one of :data:`OUTSIDE`.

        Raises:
            OutsideTrainingError: if the point is outside and ``outside`` is ``refuse``.
        """
        complaint = self.complaint(point)
        if complaint:
            announce(
                f"outside what was trained: {complaint}. Train there, or take the full model",
                outside,
            )
