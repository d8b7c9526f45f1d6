"""Gaskets of all conditions, and their increments."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np

from hhr_dolfinx.declared import Floats, Integers
from hhr_dolfinx.memory import Memory
from hhr_dolfinx.plugins.contact_laws.curve_pairs import CurveConditions, CurvesStep, straight
from hhr_dolfinx.plugins.contact_laws.ranges import Linearised, RangeSolver, closing, resolvent
from hhr_dolfinx.plugins.gaskets.behaviour import GasketCurve

CLOSURE = "gasket_closure"
"""Name of the closure in the memory, a length."""
LARGEST_CLOSURE = "largest_closure"
"""Name of the largest closure so far in the memory, a length."""
RETURNING = 1e-9
"""Part of the largest closure by which a closure may differ from it at a point of return, where
derivatives are one-sided."""


@dataclass(frozen=True, eq=False)
class GasketLayers(CurveConditions):
    """Gaskets of the conditions, (m,)."""

    plugin: ClassVar[str] = "gaskets"
    name: ClassVar[str] = "gaskets"

    area: Annotated[Floats, "m"]
    number: Annotated[Integers, "m"]  #: index of the curve of each condition
    curves: tuple[GasketCurve, ...]

    def opened(self, memory: Memory) -> np.ndarray:
        """See :class:`~hhr_dolfinx.contact.law.ContactLaw`: gaps are those to the gasket, as its
        set leaves it.
        """
        left = np.zeros(self.number.size)
        for number, curve in enumerate(self.curves):
            rows = self.number == number
            left[rows] = straight(memory[LARGEST_CLOSURE][rows], curve.closures, curve.sets)[0]
        return np.maximum(memory[CLOSURE], left) - self.reach

    @property
    def layout(self) -> dict[str, tuple[str, ...]]:
        """See :class:`~hhr_dolfinx.contact.law.ContactLaw`."""
        return {name: ("float", "N_lambda") for name in (CLOSURE, LARGEST_CLOSURE)}

    def stored(self, memory: Memory) -> dict[str, np.ndarray]:
        """See :class:`~hhr_dolfinx.contact.law.ContactLaw`."""
        return {name: memory[name] for name in self.layout}

    def restored(self, arrays: Mapping[str, np.ndarray]) -> Memory:
        """See :class:`~hhr_dolfinx.contact.law.ContactLaw`."""
        return Memory(**{name: arrays[name] for name in self.layout})


class GasketRange(RangeSolver[GasketLayers, Memory]):
    """Facet ``range``, by which models solve."""

    def at_rest(self) -> Memory:
        """Nothing has been closed."""
        nothing = np.zeros(self.law.area.size)
        return Memory(**{CLOSURE: nothing, LARGEST_CLOSURE: nothing})

    def step(self, before: Memory, point: np.ndarray, seconds: float) -> GasketStep:
        """One increment.

        Args:
            before: memory at its start.
            point: parameter at its end, (P,).
            seconds: not read.
        """
        return GasketStep(self.law, point, before[LARGEST_CLOSURE])


class GasketStep(CurvesStep[GasketCurve]):
    """Gaskets at a point, (P,), from the largest closures before, (k,)."""

    def __init__(self, law: GasketLayers, point: np.ndarray, largest: np.ndarray):
        super().__init__(law, point)
        self._largest = largest
        # of the last linearisation
        self._closure = np.zeros(largest.size)
        self._loads = np.zeros(largest.size, dtype=bool)  # rows that are closed as never before

    def shape(
        self, curve: GasketCurve, rows: np.ndarray, closure: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """See :class:`~hhr_dolfinx.plugins.contact_laws.curve_pairs.CurvesStep`.

        Args:
            curve: curve of the rows.
            rows: their numbers, (k,).
            closure: closures, not negative, (k,).
        """
        largest = self._largest[rows]
        pressure, rise = curve.loading(closure)
        back = curve.unloading(closure, largest)
        loads = closure >= largest
        return np.where(loads, pressure, back.pressure), np.where(loads, rise, back.slope)

    def linearised(
        self, forces: np.ndarray, slack: np.ndarray, stiffness: np.ndarray, attempt: int
    ) -> Linearised:
        """See :class:`~hhr_dolfinx.plugins.contact_laws.ranges.RangeStep`.

        Args:
            forces: forces of the rows, (k,).
            slack: slacks of the rows, (k,).
            stiffness: c, force per slack of each row, (k,).
            attempt: not read.
        """
        force, slope, closure = resolvent(self.curve, forces - stiffness * slack, stiffness)
        self._closure = closure
        self._loads = (-slack >= self._largest) & (slack < 0)
        return closing(forces, slack, stiffness, force, slope)

    def after(self, forces: np.ndarray, slack: np.ndarray, active: np.ndarray) -> Memory:
        """Closures and the largest so far, see
        :class:`~hhr_dolfinx.plugins.contact_laws.ranges.RangeStep`.

        Args:
            forces: not read.
            slack: slacks of the rows, (k,).
            active: not read.
        """
        closure = np.maximum(-slack, 0.0)
        largest = np.maximum(self._largest, closure)
        return Memory(**{CLOSURE: closure, LARGEST_CLOSURE: largest})

    def shifted(self, before: np.ndarray) -> np.ndarray:
        """On the way back p(c, m) moves with m as with the slack; on new ways m has no part.

        Args:
            before: derivatives of the largest closures, (k, P).
        """
        changes = np.zeros_like(before)
        for curve, rows in zip(self._curves, self._rows, strict=True):
            back = curve.unloading(self._closure[rows], self._largest[rows])
            bears = (back.slope > 0) & (self._closure[rows] < self._largest[rows])
            share = back.by_largest[bears] / back.slope[bears]
            changes[rows[bears]] = -share[:, None] * before[rows[bears]]
        return changes

    def carried(
        self, before: np.ndarray, forces: np.ndarray, slack: np.ndarray, active: np.ndarray
    ) -> np.ndarray:
        """Derivatives of the largest closures, (k, P).

        Args:
            before: those at the start, (k, P).
            forces: derivatives of the forces, (k, P).
            slack: derivatives of the slacks, (k, P).
            active: rows that bear a force, (k,) bool.
        """
        return np.where(self._loads[:, None], -slack, before)

    def grazing(
        self, forces: np.ndarray, slack: np.ndarray, stiffness: np.ndarray, near: float
    ) -> np.ndarray:
        """Rows that touch, or return, just now, (k,) bool.

        Args:
            forces: forces of the rows, (k,).
            slack: slacks of the rows, (k,).
            stiffness: c, force per slack of each row, (k,).
            near: force below which a row counts as at a kink.
        """
        returns = np.abs(slack + self._largest) <= RETURNING * self._largest
        return super().grazing(forces, slack, stiffness, near) | (returns & (self._largest > 0))
