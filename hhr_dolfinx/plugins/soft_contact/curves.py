"""Curves of pressure over overclosure, as numbers: what the law and its C kernel evaluate.

See :mod:`hhr_dolfinx.plugins.contact_laws.curve_pairs`.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np

from hhr_dolfinx.declared import Floats
from hhr_dolfinx.formulas import Scalar
from hhr_dolfinx.plugins.contact_laws.curve_pairs import PressureCurve, straight

REACH = 5.0
"""Clearances c0 at which an exponential curve begins: its pressure there is 1e-10 of that at touch,
the relative error of leaving out what is farther.
"""
_PART_AT_CLEARANCE = 100.0
"""The pressure at touch over that at the clearance c0, by the manuals of CalculiX."""


class SoftCurve(PressureCurve):
    """A curve without memory."""

    kind: ClassVar[int]  #: number of its formula in the C kernel

    @abstractmethod
    def shape(self, d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Pressures over the factor, and their derivatives, (k,) each.

        Args:
            d: closure, not negative, (k,).
        """

    @property
    def numbers(self) -> tuple[float, ...]:
        """Numbers of the curve for the C kernel."""
        return ()

    def parts(self) -> list[str | np.ndarray]:
        """See :class:`~hhr_dolfinx.plugins.contact_laws.curve_pairs.PressureCurve`."""
        return [str(self.kind), np.array(self.numbers)]


@dataclass(frozen=True)
class LinearCurve(SoftCurve):
    """p = k h for overlaps."""

    kind: ClassVar[int] = 0

    factor: Scalar

    @property
    def reach(self) -> float:
        """See :class:`SoftCurve`."""
        return 0.0

    def shape(self, d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See :class:`SoftCurve`."""
        return d, np.ones_like(d)


@dataclass(frozen=True)
class ExponentialCurve(SoftCurve):
    """p = p0 exp(ln(100) h / c0), p0 at touch and 1 % of it at the gap c0."""

    kind: ClassVar[int] = 1

    factor: Scalar
    clearance: float

    @property
    def reach(self) -> float:
        """See :class:`SoftCurve`."""
        return REACH * self.clearance

    @property
    def numbers(self) -> tuple[float, ...]:
        """See :class:`SoftCurve`: the rate, and the gap where it begins."""
        return float(np.log(_PART_AT_CLEARANCE)) / self.clearance, self.reach

    def shape(self, d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See :class:`SoftCurve`."""
        rate, reach = self.numbers
        with np.errstate(over="ignore"):  # a trial far too deep: infinite, and brought back
            pressure = np.exp(rate * (d - reach))
        return pressure, rate * pressure


@dataclass(frozen=True, eq=False)
class TabularCurve(SoftCurve):
    """Pressures at overclosures, straight between them; beyond the last as the last segment."""

    kind: ClassVar[int] = 2

    factor: Scalar
    overclosures: Annotated[Floats, "points of the curve"]
    pressures: Annotated[Floats, "points of the curve"]

    @property
    def reach(self) -> float:
        """See :class:`SoftCurve`."""
        return -float(self.overclosures[0])

    @property
    def numbers(self) -> tuple[float, ...]:
        """See :class:`SoftCurve`: how many points, their arguments, their pressures."""
        begins = self.overclosures - self.overclosures[0]
        return (float(begins.size), *begins.tolist(), *self.pressures.tolist())

    def shape(self, d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See :class:`SoftCurve`."""
        return straight(d, self.overclosures - self.overclosures[0], self.pressures)
