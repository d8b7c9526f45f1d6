"""Outputs of inelastic bodies as arrays: von Mises' stress, elastic energy."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Annotated

import numpy as np

from hhr_dolfinx.declared import Floats, Integers
from hhr_dolfinx.formulas import Scalar
from hhr_dolfinx.materials.elasticity import von_mises
from hhr_dolfinx.models.functionals.functional import Functional, State
from hhr_dolfinx.models.histories.equilibrium import StressOutput
from hhr_dolfinx.outputs import no_rows
from hhr_dolfinx.plugins.inelastic.strain import StrainOperator
from hhr_dolfinx.plugins.inelastic.update import Material

if TYPE_CHECKING:
    from hhr_dolfinx.outputs import NamedOutput


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
    of_points = points.astype(np.int64), shares / shares.sum() if output.kind == "mean" else np.zeros(0)
    return FlowMises(output.name, output.unit, *no_rows(), *of_points)


@dataclass(frozen=True, eq=False)
class FlowEnergy(Functional):
    """Elastic energy ∫ σ : C^-1 σ / 2 at all Gauss points; derivatives of histories do not include the stress."""

    differentiable = False

    names: tuple[str, ...]  # of the parameters
    young: tuple[str, ...]  # factor of C of each body as a formula
    compliances: Annotated[Floats, "bodies", "components", "components"]  # C^-1 of each body for this factor 1
    bodies: Annotated[Integers, "points", "< bodies"]  # body of each Gauss point
    weights: Annotated[Floats, "points"]  # quadrature weight times volume of each

    def __post_init__(self) -> None:
        _ = self._young

    @cached_property
    def _young(self) -> tuple[Scalar, ...]:
        return tuple(Scalar(text, tuple(self.names)) for text in self.young)

    def value(self, state: State) -> float:
        """Sum over all Gauss points."""
        stress = state.stress()
        found = 0.0
        for body, (young, compliance) in enumerate(zip(self._young, self.compliances, strict=True)):
            own = self.bodies == body
            # sizes of files are tried with stresses of four components
            few = compliance[: stress.shape[1], : stress.shape[1]]
            energies = np.einsum("pi,ij,pj->p", stress[own], few, stress[own])
            found += float(self.weights[own] @ energies) / (2 * young.value(state.point))
        return found


def energy(operator: StrainOperator, material: Material, output: NamedOutput) -> FlowEnergy:
    """Elastic energy of an output at all Gauss points, with E as a factor of C where it is a formula."""
    bodies = np.empty(material.gauss_points, dtype=np.int64)
    young = []
    compliances = []
    for body, group in enumerate(material.groups):
        bodies[group.indices] = body
        varies = isinstance(group.young, str)
        young.append(str(group.young) if varies else "1")
        unit = replace(group, young=1.0) if varies else group
        compliances.append(unit.elasticity(material.components)[1])
    arrays = np.array(compliances), bodies, operator.weights.ravel()
    return FlowEnergy(output.name, output.unit, *no_rows(), tuple(material.names), tuple(young), *arrays)
