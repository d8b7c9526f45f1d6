"""Curves of pressure over overclosure, as numbers: what the law and its C kernel evaluate.

The overclosure h is positive where surfaces overlap, negative across a gap. A curve acts from h =
-reach on; its argument d = h + reach is not negative there. Each is a factor, which may depend on
parameters, times a shape, which does not.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np

from hhr_dolfinx.declared import Floats
from hhr_dolfinx.formulas import Scalar

REACH = 5.0
"""Clearances c0 at which an exponential curve begins: its pressure there is 1e-10 of that at touch,
the relative error of leaving out what is farther.
"""
_PART_AT_CLEARANCE = 100.0
"""The pressure at touch over that at the clearance c0, by the manuals of CalculiX."""


class PressureCurve(ABC):
    """A monotone curve of the pressure."""

    kind: ClassVar[int]  #: number of its formula in the C kernel
    factor: Scalar  #: of the shape

    @property
    @abstractmethod
    def reach(self) -> float:
        """Gap at which the pressure begins; negative if surfaces overlap freely at first."""

    @abstractmethod
    def shape(self, d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Pressures over the factor, and their derivatives, (k,) each.

        Args:
            d: overclosure from where the curve begins, not negative, (k,).
        """

    @property
    def numbers(self) -> tuple[float, ...]:
        """Numbers of the curve for the C kernel."""
        return ()


@dataclass(frozen=True)
class LinearCurve(PressureCurve):
    """p = k h for overlaps."""

    kind: ClassVar[int] = 0

    factor: Scalar

    @property
    def reach(self) -> float:
        """See :class:`PressureCurve`."""
        return 0.0

    def shape(self, d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See :class:`PressureCurve`."""
        return d, np.ones_like(d)


@dataclass(frozen=True)
class ExponentialCurve(PressureCurve):
    """p = p0 exp(ln(100) h / c0), p0 at touch and 1 % of it at the gap c0."""

    kind: ClassVar[int] = 1

    factor: Scalar
    clearance: float

    @property
    def reach(self) -> float:
        """See :class:`PressureCurve`."""
        return REACH * self.clearance

    @property
    def numbers(self) -> tuple[float, ...]:
        """See :class:`PressureCurve`: the rate, and the gap where it begins."""
        return float(np.log(_PART_AT_CLEARANCE)) / self.clearance, self.reach

    def shape(self, d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See :class:`PressureCurve`."""
        rate, reach = self.numbers
        with np.errstate(over="ignore"):  # a trial far too deep: infinite, and brought back
            pressure = np.exp(rate * (d - reach))
        return pressure, rate * pressure


@dataclass(frozen=True, eq=False)
class TabularCurve(PressureCurve):
    """Pressures at overclosures, straight between them; beyond the last as the last segment."""

    kind: ClassVar[int] = 2

    factor: Scalar
    overclosures: Annotated[Floats, "points of the curve"]
    pressures: Annotated[Floats, "points of the curve"]

    @property
    def reach(self) -> float:
        """See :class:`PressureCurve`."""
        return -float(self.overclosures[0])

    @property
    def numbers(self) -> tuple[float, ...]:
        """See :class:`PressureCurve`: how many points, their arguments, their pressures."""
        begins = self.overclosures - self.overclosures[0]
        return (float(begins.size), *begins.tolist(), *self.pressures.tolist())

    def shape(self, d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See :class:`PressureCurve`."""
        begins = self.overclosures - self.overclosures[0]
        rises = np.diff(self.pressures) / np.diff(begins)
        segment = np.clip(np.searchsorted(begins, d, side="right") - 1, 0, len(rises) - 1)
        pressure = self.pressures[segment] + rises[segment] * (d - begins[segment])
        return pressure, rises[segment]
