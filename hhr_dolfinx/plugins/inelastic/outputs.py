"""Outputs of inelastic bodies as arrays: von Mises' stress, elastic energy."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Annotated

import numpy as np

from hhr_dolfinx.declared import Floats, Integers
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.formulas import Scalar
from hhr_dolfinx.materials.elasticity import von_mises
from hhr_dolfinx.models.functionals.functional import Functional, State
from hhr_dolfinx.models.histories.equilibrium import StressOutput
from hhr_dolfinx.parameters import ParameterSpace
from hhr_dolfinx.plugins.inelastic.outside import LawCode
from hhr_dolfinx.plugins.inelastic.strain import StrainOperator
from hhr_dolfinx.plugins.inelastic.update import Group, Material

if TYPE_CHECKING:
    from hhr_dolfinx.outputs import NamedOutput


@dataclass(frozen=True, eq=False)
class FlowMises(Functional):
    """Von Mises' stress at Gauss points of inelastic bodies.

    Derivatives of histories do not include the stress.
    """

    differentiable = False

    points: Annotated[Integers, "points"]  #: numbers of the Gauss points, (g,)
    shares: Annotated[Floats, "shares"]  #: of each in the mean, (g,); empty for the largest value

    def value(self, state: State) -> float:
        """The largest one, or their mean over the volume."""
        values = von_mises(state.stress()[self.points])
        return float(self.shares @ values if self.shares.size else values.max())

    def indices(self) -> dict[str, np.ndarray]:
        """Gauss points."""
        return {"points": self.points}


def mises(operator: StrainOperator, output: StressOutput, cells: np.ndarray) -> FlowMises:
    """Von Mises' stress of an output at the Gauss points of some cells.

    Args:
        operator: strain at the Gauss points.
        output: output of the scene.
        cells: numbers of the cells.
    """
    from hhr_dolfinx.outputs import no_rows  # scenes without outputs do without it

    points = operator.points_of(cells)
    shares = operator.weights.ravel()[points]
    of_points = (
        points.astype(np.int64),
        shares / shares.sum() if output.kind == "mean" else np.zeros(0),
    )
    return FlowMises(output.name, output.unit, *no_rows(), *of_points)


REST_ROUND_OFF = 1e-9
"""Part of the elasticity by which that at rest differs by round-off."""


@dataclass(frozen=True, eq=False)
class FlowEnergy(Functional):
    """Elastic energy ∫ σ : C^-1 σ / 2 at all Gauss points.

    Derivatives of histories do not include the stress.

    C^-1 is a sum of parts with factors of the parameters: of an isotropic body, (1 + ν) / E of the
    identity and -ν / E of the trace.
    """

    differentiable = False

    names: tuple[str, ...]  #: of the parameters
    factors: tuple[str, ...]  #: of the parts of C^-1 of all bodies as formulas, (k,)
    owners: Annotated[Integers, "parts"]  #: body of each part, (k,)
    compliances: Annotated[
        Floats, "parts", "components", "components"
    ]  #: each part for its factor 1
    bodies: Annotated[Integers, "points"]  #: body of each Gauss point
    weights: Annotated[
        Floats, "points"
    ]  #: quadrature weight times volume of each, over the grading of C

    def __post_init__(self) -> None:
        _ = self._factors

    @cached_property
    def _factors(self) -> tuple[Scalar, ...]:
        return tuple(Scalar(text, tuple(self.names)) for text in self.factors)

    def value(self, state: State) -> float:
        """Sum over all Gauss points."""
        stress = state.stress()
        total = 0.0
        for factor, owner, compliance in zip(
            self._factors, self.owners, self.compliances, strict=True
        ):
            points = self.bodies == owner
            # sizes of files are tried with stresses of four components
            few = compliance[: stress.shape[1], : stress.shape[1]]
            energies = np.einsum("pi,ij,pj->p", stress[points], few, stress[points])
            total += float(self.weights[points] @ energies) * factor.value(state.point) / 2
        return total


def energy(operator: StrainOperator, material: Material, output: NamedOutput) -> FlowEnergy:
    """Elastic energy of an output at all Gauss points.

    Args:
        operator: strain at the Gauss points.
        material: laws at the Gauss points.
        output: output of the scene.
    """
    from hhr_dolfinx.outputs import no_rows  # scenes without outputs do without it

    bodies = np.empty(material.gauss_points, dtype=np.int64)
    weights = operator.weights.flatten()
    factors: list[str] = []
    compliances: list[np.ndarray] = []
    owners: list[int] = []
    for body, group in enumerate(material.groups):
        bodies[group.indices] = body
        if group.grading.size:
            weights[group.indices] /= group.grading
        for factor, compliance in _compliances(group, material.components):
            factors.append(factor)
            compliances.append(compliance)
            owners.append(body)
    arrays = np.array(owners, dtype=np.int64), np.array(compliances), bodies, weights
    return FlowEnergy(
        output.name, output.unit, *no_rows(), tuple(material.names), tuple(factors), *arrays
    )


def _compliances(group: Group, components: int) -> Iterator[tuple[str, np.ndarray]]:
    """Parts of C^-1 of a group for the grading 1: a factor as a formula, and what it multiplies,
    (c, c).
    """
    if not group.texts or (group.law is not None and group.law.elastic):
        yield "1", group.elasticity(components)[1]
        return
    # in plane stress too, where no stress is across
    unit = np.where(np.arange(components) < 3, 1.0, 0.0)
    yield f"(1 + ({group.poisson})) / ({group.young})", np.eye(components)
    yield f"-({group.poisson}) / ({group.young})", np.outer(unit, unit)


def check_elasticity(material: Material, space: ParameterSpace, output: NamedOutput) -> None:
    """Refuse a law, not of plane stress, whose slope at rest is not C of its body.

    The corners and the middle of a box are tried.

    Args:
        material: laws at the Gauss points.
        space: box of the parameters.
        output: output of the scene.

    Raises:
        SceneError: for such a law.
    """
    for point in (space.lower, space.middle, space.upper):
        local = material.at(np.array(point, dtype=float))
        for group, numbers in zip(local.groups, local.given, strict=True):
            if group.law is None or isinstance(group.law, LawCode):  # code states none at rest
                continue
            elastic = local.elastic[group.indices]
            if (
                np.abs(group.law.tangents_at_rest(numbers.constants) - elastic).max()
                > REST_ROUND_OFF * np.abs(elastic).max()
            ):
                raise SceneError(
                    f"output '{output.name}': the law {group.law.name} changes the elasticity of "
                    "its body, and ∫ σ : C^-1 σ / 2 needs that of the current point, of which "
                    "outputs know E, ν and the grading alone: leave it out"
                )
