"""A kind of output of a user's own, in one file: the smooth largest pressure, (sum of
p^n)^(1/n).
"""

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np

from hhr_dolfinx.declared import Floats, Integers
from hhr_dolfinx.models.functionals.functional import Functional, Slopes

NOWHERE = np.zeros(0, dtype=np.int64)


@dataclass(frozen=True, eq=False)
class PressureNorm(Functional):
    """The n-norm of the pressures of some conditions; no rows of the displacement."""

    uses_forces: ClassVar[bool] = True

    conditions: Annotated[Integers, "conditions"]
    areas: Annotated[Floats, "conditions"]
    power: float

    def value(self, state):
        pressures = np.maximum(state.forces[self.conditions], 0.0) / self.areas
        return float((pressures**self.power).sum() ** (1 / self.power))

    def slopes(self, state):
        pressures = np.maximum(state.forces[self.conditions], 0.0) / self.areas
        size = self.value(state)
        return Slopes(self.conditions, (pressures / (size or 1.0)) ** (self.power - 1) / self.areas)

    def indices(self):
        return {"conditions": self.conditions}


@dataclass(frozen=True)
class SmoothPeak:
    """The output of a scene that is made of it."""

    name: str
    contact: int
    power: float = 8.0
    unit: str = "MPa"

    def prepared(self, probe):
        conditions, areas = probe.loaded(self)
        return PressureNorm(
            self.name, self.unit, 0, NOWHERE, NOWHERE, np.zeros(0), conditions, areas, self.power
        )
