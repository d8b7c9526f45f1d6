"""Soft contact of all conditions, and its increments."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np

from hhr_dolfinx.declared import Floats, Integers
from hhr_dolfinx.memory import Memory
from hhr_dolfinx.plugins.contact_laws.curve_pairs import CurveConditions, CurvesStep
from hhr_dolfinx.plugins.contact_laws.ranges import RangeSolver
from hhr_dolfinx.plugins.soft_contact.curves import (
    ExponentialCurve,
    LinearCurve,
    SoftCurve,
    TabularCurve,
)


@dataclass(frozen=True, eq=False)
class SoftContacts(CurveConditions):
    """Soft contact of the conditions, (m,)."""

    plugin: ClassVar[str] = "soft_contact"
    name: ClassVar[str] = "soft contact"
    remembers: ClassVar[bool] = False

    area: Annotated[Floats, "m"]
    number: Annotated[Integers, "m"]  #: index of the curve of each condition
    curves: tuple[LinearCurve | ExponentialCurve | TabularCurve, ...]

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


class SoftStep(CurvesStep[SoftCurve]):
    """Soft contact at a point, (P,)."""

    def shape(
        self, curve: SoftCurve, rows: np.ndarray, closure: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """See :class:`~hhr_dolfinx.plugins.contact_laws.curve_pairs.CurvesStep`.

        Args:
            curve: curve of the rows.
            rows: their numbers, (k,).
            closure: closures, not negative, (k,).
        """
        return curve.shape(closure)

    def after(self, forces: np.ndarray, slack: np.ndarray, active: np.ndarray) -> Memory:
        """The closure, for outputs of gaps; no increment reads it.

        Args:
            forces: not read.
            slack: slacks of the rows, (k,).
            active: not read.
        """
        return Memory(overclosure=np.maximum(-slack, 0.0))
