"""Pressure of a gasket over its closure c, and the largest closure m before.

It loads along points (c, p), the first (0, 0), the second where it yields, beyond the last as the
last segment. Below m it goes back, and comes again, straight between (m, p(m)) and (z, 0), z the
set that m leaves; up to the second point z is 0, and the way back the way there.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from hhr_dolfinx.declared import Floats
from hhr_dolfinx.formulas import Scalar
from hhr_dolfinx.plugins.contact_laws.curve_pairs import PressureCurve, straight


@dataclass(frozen=True, eq=False)
class GasketCurve(PressureCurve):
    """A factor times pressures at closures, and the set that each of them leaves."""

    factor: Scalar
    begins: float  #: gap at which the gasket is touched
    closures: Annotated[Floats, "points of the gasket"]
    pressures: Annotated[Floats, "points of the gasket"]
    sets: Annotated[Floats, "points of the gasket"]

    @property
    def reach(self) -> float:
        """See :class:`~hhr_dolfinx.plugins.contact_laws.curve_pairs.PressureCurve`."""
        return self.begins

    def parts(self) -> list[str | np.ndarray]:
        """See :class:`~hhr_dolfinx.plugins.contact_laws.curve_pairs.PressureCurve`."""
        return [np.array([self.begins]), self.closures, self.pressures, self.sets]

    def loading(self, closure: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Pressures over the factor while the closure is the largest so far, and derivatives, (k,).

        Args:
            closure: closures, not negative, (k,).
        """
        return straight(closure, self.closures, self.pressures)

    def unloading(self, closure: np.ndarray, largest: np.ndarray) -> Unloading:
        """The way back from the largest closure.

        Args:
            closure: closures up to the largest, (k,).
            largest: largest closures before, (k,).
        """
        top, rise = self.loading(largest)
        left, leaves = straight(largest, self.closures, self.sets)
        width = np.where(largest > 0, largest - left, 1.0)
        part = np.maximum(closure - left, 0.0) / width
        bears = closure > left
        return Unloading(
            top * part,
            bears * top / width,
            bears * (rise * part - top / width * (leaves + part * (1.0 - leaves))),
        )


@dataclass(frozen=True)
class Unloading:
    """Pressures over the factor, and derivatives by closure and largest closure, (k,) each."""

    pressure: np.ndarray
    slope: np.ndarray
    by_largest: np.ndarray
