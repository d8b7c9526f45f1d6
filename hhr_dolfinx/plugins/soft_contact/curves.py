"""Curves of pressure over overclosure, as numbers: what the law and its C kernel evaluate.

The overclosure h is positive where surfaces overlap, negative across a gap. A curve acts from h =
-reach on; its argument d = h + reach is not negative there.
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
    scalars: tuple[Scalar, ...]  #: constants that may depend on parameters

    @property
    @abstractmethod
    def reach(self) -> float:
        """Gap at which the pressure begins; negative if surfaces overlap freely at first."""

    @abstractmethod
    def value(self, d: np.ndarray, constants: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Pressures and their derivatives, (k,) each.

        Args:
            d: overclosure from where the curve begins, not negative, (k,).
            constants: values of the scalars.
        """

    @abstractmethod
    def per_constant(self, d: np.ndarray, constants: np.ndarray) -> np.ndarray:
        """Derivatives of the pressures along the constants, (k, c).

        Args:
            d: overclosure from where the curve begins, not negative, (k,).
            constants: values of the scalars.
        """

    @property
    def numbers(self) -> tuple[float, ...]:
        """Numbers of the curve for the C kernel."""
        return ()


@dataclass(frozen=True)
class LinearCurve(PressureCurve):
    """p = k h for overlaps."""

    kind: ClassVar[int] = 0

    scalars: tuple[Scalar, ...]

    @property
    def reach(self) -> float:
        """See :class:`PressureCurve`."""
        return 0.0

    def value(self, d: np.ndarray, constants: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See :class:`PressureCurve`."""
        return constants[0] * d, np.full_like(d, constants[0])

    def per_constant(self, d: np.ndarray, constants: np.ndarray) -> np.ndarray:
        """See :class:`PressureCurve`."""
        return d[:, None]


@dataclass(frozen=True)
class ExponentialCurve(PressureCurve):
    """p = p0 exp(ln(100) h / c0), p0 at touch and 1 % of it at the gap c0."""

    kind: ClassVar[int] = 1

    scalars: tuple[Scalar, ...]
    clearance: float

    @property
    def reach(self) -> float:
        """See :class:`PressureCurve`."""
        return REACH * self.clearance

    @property
    def numbers(self) -> tuple[float, ...]:
        """See :class:`PressureCurve`: the rate, and the gap where it begins."""
        return float(np.log(_PART_AT_CLEARANCE)) / self.clearance, self.reach

    def value(self, d: np.ndarray, constants: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See :class:`PressureCurve`."""
        rate, reach = self.numbers
        with np.errstate(over="ignore"):  # a trial far too deep: infinite, and brought back
            pressure = constants[0] * np.exp(rate * (d - reach))
        return pressure, rate * pressure

    def per_constant(self, d: np.ndarray, constants: np.ndarray) -> np.ndarray:
        """See :class:`PressureCurve`."""
        rate, reach = self.numbers
        return np.exp(rate * (d - reach))[:, None]


@dataclass(frozen=True, eq=False)
class TabularCurve(PressureCurve):
    """Pressures at overclosures, straight between them; beyond the last as the last segment."""

    kind: ClassVar[int] = 2

    scalars: tuple[Scalar, ...]
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

    def value(self, d: np.ndarray, constants: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See :class:`PressureCurve`."""
        begins = self.overclosures - self.overclosures[0]
        rises = np.diff(self.pressures) / np.diff(begins)
        segment = np.clip(np.searchsorted(begins, d, side="right") - 1, 0, len(rises) - 1)
        pressure = self.pressures[segment] + rises[segment] * (d - begins[segment])
        return constants[0] * pressure, constants[0] * rises[segment]

    def per_constant(self, d: np.ndarray, constants: np.ndarray) -> np.ndarray:
        """See :class:`PressureCurve`."""
        return self.value(d, np.ones(1))[0][:, None]
