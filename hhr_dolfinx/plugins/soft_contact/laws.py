"""Soft contact of all conditions, and its increments."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Annotated, ClassVar

import numpy as np

from hhr_dolfinx.contact.law import ContactLaw
from hhr_dolfinx.declared import Floats, Integers
from hhr_dolfinx.memory import Memory
from hhr_dolfinx.plugins.contact_laws.ranges import CurveStep, RangeSolver
from hhr_dolfinx.plugins.soft_contact.curves import ExponentialCurve, LinearCurve, TabularCurve


@dataclass(frozen=True, eq=False)
class SoftContacts(ContactLaw):
    """Curves of the conditions, (m,), of which no parameter is ``fixed``."""

    plugin: ClassVar[str] = "soft_contact"
    name: ClassVar[str] = "soft contact"
    remembers: ClassVar[bool] = False
    floats: ClassVar[bool] = True
    fixed: ClassVar[np.ndarray] = np.zeros(0, dtype=np.int64)  # type: ignore[misc]

    area: Annotated[Floats, "m"]
    number: Annotated[Integers, "m"]  #: index of the curve of each condition
    curves: tuple[LinearCurve | ExponentialCurve | TabularCurve, ...]

    def within(self, conditions: np.ndarray) -> SoftContacts:
        """See :class:`~hhr_dolfinx.contact.law.ContactLaw`."""
        return replace(self, area=self.area[conditions], number=self.number[conditions])

    @property
    def reach(self) -> np.ndarray:
        """Gap at which the pressure of each condition begins, (m,)."""
        return np.array([curve.reach for curve in self.curves])[self.number]

    def parts(self) -> list[str | np.ndarray]:
        """See :class:`~hhr_dolfinx.contact.law.ContactLaw`."""
        told: list[str | np.ndarray] = [self.area, self.number]
        for curve in self.curves:
            told += [str(curve.kind), np.array(curve.numbers), curve.factor.text]
        return told

    def opened(self, memory: Memory) -> np.ndarray:
        """See :class:`~hhr_dolfinx.contact.law.ContactLaw`: surfaces that press overlap, or act
        across a gap.
        """
        d = memory["overclosure"]
        return np.where(d > 0, d - self.reach, 0.0)

    @property
    def layout(self) -> dict[str, tuple[str, ...]]:
        """See :class:`~hhr_dolfinx.contact.law.ContactLaw`."""
        return {"overclosure": ("float", "N_lambda")}

    def stored(self, memory: Memory) -> dict[str, np.ndarray]:
        """See :class:`~hhr_dolfinx.contact.law.ContactLaw`."""
        return {"overclosure": memory["overclosure"]}

    def restored(self, arrays: Mapping[str, np.ndarray]) -> Memory:
        """See :class:`~hhr_dolfinx.contact.law.ContactLaw`."""
        return Memory(overclosure=arrays["overclosure"])


class SoftRange(RangeSolver[SoftContacts, Memory]):
    """Facet ``range``, by which models solve."""

    def at_rest(self) -> Memory:
        """Nothing presses."""
        return Memory(overclosure=np.zeros(self.law.area.size))

    def step(self, before: Memory, point: np.ndarray, seconds: float) -> SoftStep:
        """See :class:`~hhr_dolfinx.plugins.contact_laws.ranges.RangeSolver`."""
        return SoftStep(self.law, point)


class SoftStep(CurveStep):
    """Soft contact at a point, (P,)."""

    def __init__(self, law: SoftContacts, point: np.ndarray):
        self.shift = -law.reach
        self._law = law
        self._point = point
        self._rows = [np.flatnonzero(law.number == k) for k in range(len(law.curves))]
        self._factors = [
            law.area[rows] * curve.factor.value(point)
            for curve, rows in zip(law.curves, self._rows, strict=True)
        ]

    def curve(self, closure: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See :class:`~hhr_dolfinx.plugins.contact_laws.ranges.CurveStep`."""
        force = np.empty_like(closure)
        slope = np.empty_like(closure)
        for curve, rows, factor in zip(self._law.curves, self._rows, self._factors, strict=True):
            pressure, rise = curve.shape(closure[rows])
            force[rows] = factor * pressure
            slope[rows] = factor * rise
        return force, slope

    def curve_slopes(self, closure: np.ndarray) -> np.ndarray:
        """See :class:`~hhr_dolfinx.plugins.contact_laws.ranges.CurveStep`."""
        slopes = np.zeros((closure.size, self._point.size))
        for curve, rows in zip(self._law.curves, self._rows, strict=True):
            pressure, _ = curve.shape(closure[rows])
            along = curve.factor.derivative(self._point)
            slopes[rows] = np.outer(self._law.area[rows] * pressure, along)
        return slopes

    def after(self, forces: np.ndarray, slack: np.ndarray, active: np.ndarray) -> Memory:
        """The overclosure from where curves begin, for outputs of gaps; no increment reads it."""
        return Memory(overclosure=np.maximum(-slack, 0.0))
