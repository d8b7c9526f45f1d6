"""Outputs of inelastic bodies as arrays."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from hhr_dolfinx.declared import Floats, Integers
from hhr_dolfinx.materials.elasticity import von_mises
from hhr_dolfinx.models.functionals.functional import Functional, State
from hhr_dolfinx.models.histories.equilibrium import StressOutput
from hhr_dolfinx.plugins.inelastic.strain import StrainOperator


@dataclass(frozen=True, eq=False)
class FlowMises(Functional):
    """Von Mises' stress at Gauss points of inelastic bodies; derivatives of histories do not include the stress."""

    differentiable = False

    points: Annotated[Integers, "points"]  # numbers of the Gauss points, (g,)
    shares: Annotated[Floats, "shares"]  # of each in the mean, (g,); empty for the largest value

    def value(self, state: State) -> float:
        """The largest one, or their mean over the volume."""
        values = von_mises(state.stress()[self.points])
        return float(self.shares @ values if self.shares.size else values.max())

    def indices(self) -> dict[str, np.ndarray]:
        """Gauss points."""
        return {"points": self.points}


def mises(operator: StrainOperator, output: StressOutput, cells: np.ndarray) -> FlowMises:
    """Von Mises' stress of an output at the Gauss points of some cells."""
    points = operator.points_of(cells)
    shares = operator.weights.ravel()[points]
    nothing = 0, np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64), np.zeros(0)
    of_points = points.astype(np.int64), shares / shares.sum() if output.kind == "mean" else np.zeros(0)
    return FlowMises(output.name, output.unit, *nothing, *of_points)
