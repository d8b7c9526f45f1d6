"""Von Mises' stress and elastic energy of elastic bodies, as numbers."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, ClassVar

import numpy as np

from hhr_dolfinx.declared import Floats, Integers
from hhr_dolfinx.formulas import Scalar
from hhr_dolfinx.materials.elasticity import von_mises
from hhr_dolfinx.models.functionals.functional import Functional, Slopes, State
from hhr_dolfinx.models.functionals.kinds import TIE, tied


@dataclass(frozen=True, eq=False)
class Mises(Functional):
    """Von Mises' stress of elastic cells: rows are the strain at their midpoints, Kelvin's
    notation, cell by cell.
    """

    names: tuple[str, ...]  #: of the parameters
    volume: str  #: λ' as a formula, see forms.elasticity.isotropic_parts
    shape: str  #: μ' as a formula
    plane_stress: bool  #: whether the stress across the plane vanishes
    grading: Annotated[Floats, "cells"]  #: factor of the moduli of each cell, (cells,)
    shares: Annotated[
        Floats, "shares"
    ]  #: of each cell in the mean, (cells,); empty for the largest value

    def __post_init__(self) -> None:
        _ = self._moduli  # refuse unreadable formulas here

    @cached_property
    def _moduli(self) -> tuple[Scalar, Scalar]:
        return Scalar(self.volume, tuple(self.names)), Scalar(self.shape, tuple(self.names))

    def _stress(self, state: State) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Stress and its parts per λ' and μ', (cells, components) each, and the unit tensor,
        (components,).
        """
        strain = state.measured.reshape(self.grading.size, -1)
        if self.plane_stress:
            strain = strain * np.array([1.0, 1.0, 0.0, 1.0])
        unit = np.zeros(strain.shape[1])
        unit[: 2 if self.plane_stress else 3] = 1.0
        of_volume = self.grading[:, None] * np.outer(strain @ unit, unit)
        of_shape = 2 * self.grading[:, None] * strain
        volume, shape = (modulus.value(state.point) for modulus in self._moduli)
        return volume * of_volume + shape * of_shape, of_volume, of_shape, unit

    def tensors(self, state: State) -> np.ndarray:
        """Stress of each cell in Kelvin's notation, (cells, components).

        Args:
            state: the answer.
        """
        return self._stress(state)[0]

    def value(self, state: State) -> float:
        """The largest one, or their mean over the volume."""
        values = von_mises(self._stress(state)[0])
        return float(self.shares @ values if self.shares.size else values.max())

    def followed(self, state: State, there: Functional, shifted: State) -> float:
        """Stress of the cell where it is largest, or the mean.

        Args:
            state: state at which the cell is found.
            there: the output at another point.
            shifted: state at that point.
        """
        assert isinstance(there, Mises)
        if self.shares.size:
            return there.value(shifted)
        cell = von_mises(self._stress(state)[0]).argmax()
        return float(von_mises(there._stress(shifted)[0])[cell])

    def slopes(self, state: State) -> Slopes:
        """Slopes by the chain rule through the stress."""
        stress, of_volume, of_shape, unit = self._stress(state)
        along, kink = self._along_stress(stress)
        volume, shape = self._moduli
        measured = (
            volume.value(state.point) * np.outer(along @ unit, unit)
            + 2 * shape.value(state.point) * along
        )
        measured *= self.grading[:, None]
        if self.plane_stress:
            measured *= np.array([1.0, 1.0, 0.0, 1.0])
        point = np.sum(along * of_volume) * volume.derivative(state.point)
        point = point + np.sum(along * of_shape) * shape.derivative(state.point)
        return Slopes(measured=measured.ravel(), point=point, kink=kink)

    def _along_stress(self, stress: np.ndarray) -> tuple[np.ndarray, bool]:
        """Derivatives along the stress of each cell, (cells, components); True at a kink."""
        values = von_mises(stress)
        shares = self.shares
        kink = False
        if not shares.size:
            shares = np.zeros(values.size)
            shares[values.argmax()] = 1.0
            kink = tied(values, int(values.argmax()))
        deviator = stress.copy()
        deviator[:, :3] -= stress[:, :3].mean(axis=1, keepdims=True)
        scale = np.divide(1.5 * shares, values, out=np.zeros(values.size), where=values > 0)
        return scale[:, None] * deviator, kink or bool((values[shares > 0] == 0).any())


@dataclass(frozen=True, eq=False)
class StrainedMises(Mises):
    """Von Mises' stress of cells with strains ε0 that cause no stress, which are subtracted from
    the strain.
    """

    amplitudes: tuple[str, ...]  #: of the strains ε0 as formulas, (e,)
    rest: Annotated[
        Floats, "rows", "amplitudes"
    ]  #: what the rows would measure of ε0 for an amplitude 1, (k, e)

    def __post_init__(self) -> None:
        super().__post_init__()
        _ = self.strain_amplitudes

    @cached_property
    def strain_amplitudes(self) -> tuple[Scalar, ...]:
        """Amplitudes of the strains ε0 as functions of the parameters, (e,)."""
        return tuple(Scalar(text, tuple(self.names)) for text in self.amplitudes)

    def _stress(self, state: State) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        values = [amplitude.value(state.point) for amplitude in self.strain_amplitudes]
        return super()._stress(state._replace(measured=state.measured - self.rest @ values))

    def slopes(self, state: State) -> Slopes:
        """Slopes by the chain rule, also through the amplitudes."""
        of_strains = super().slopes(state)
        along = of_strains.measured @ self.rest
        changes = [amplitude.derivative(state.point) for amplitude in self.strain_amplitudes]
        return of_strains._replace(point=of_strains.point - along @ np.array(changes))


COMPONENTS = {
    "plane": ("xx", "yy", "zz", "xy"),
    "axisymmetric": ("rr", "zz", "tt", "rz"),
    "solid": ("xx", "yy", "zz", "xy", "xz", "yz"),
}
"""Components of a stress by hypothesis, in Kelvin's order; ``tt`` is the hoop stress."""
PRINCIPAL_VALUES = ("principal_1", "principal_2", "principal_3")
"""Principal values, from the largest to the smallest."""
SHEAR = 3
"""First shear in Kelvin's notation: xy, in space xz and yz too, each times the root of 2."""
PRINCIPAL = 10
"""Components from this number on are principal values, from the largest to the smallest."""


def component_of(stress: np.ndarray, component: int) -> tuple[float, np.ndarray, bool]:
    """Component or principal value of a stress in Kelvin's notation, (components,).

    Args:
        stress: the tensor, (4,) or (6,).
        component: index of a component, or from :data:`PRINCIPAL` on of a principal value.

    Returns:
        The value; its derivatives along the stress, (components,); True at a kink, where two
        principal values are equal.
    """
    slopes = np.zeros(stress.size)
    if component < PRINCIPAL:
        slopes[component] = 1.0 if component < SHEAR else np.sqrt(0.5)
        return float(slopes @ stress), slopes, False
    tensor = np.diag(stress[:3])
    pairs = [(0, 1), (0, 2), (1, 2)][: stress.size - 3]
    for index, (i, j) in enumerate(pairs, start=SHEAR):
        tensor[i, j] = tensor[j, i] = stress[index] * np.sqrt(0.5)
    values, vectors = np.linalg.eigh(tensor)
    place = 2 - (component - PRINCIPAL)
    normal = vectors[:, place]
    slopes[:3] = normal**2
    for index, (i, j) in enumerate(pairs, start=SHEAR):
        slopes[index] = np.sqrt(2) * normal[i] * normal[j]
    others = np.delete(values, place)
    size = float(np.abs(values).max())
    kink = bool((np.abs(others - values[place]) <= TIE * size).any())
    return float(values[place]), slopes, kink


@dataclass(frozen=True, eq=False)
class StressValue(StrainedMises):
    """Component or principal value of the mean stress of elastic cells, weighted by ``shares``."""

    #: see :func:`component_of`
    component: int

    def value(self, state: State) -> float:
        """The component of the mean."""
        return component_of(self.shares @ self._stress(state)[0], self.component)[0]

    def followed(self, state: State, there: Functional, shifted: State) -> float:
        """The same component on the other shape.

        Args:
            state: the answer, on its own shape.
            there: the functional of the other shape.
            shifted: the answer on the other shape.
        """
        return there.value(shifted)

    def _along_stress(self, stress: np.ndarray) -> tuple[np.ndarray, bool]:
        _, slopes, kink = component_of(self.shares @ stress, self.component)
        return np.outer(self.shares, slopes), kink


@dataclass(frozen=True, eq=False)
class FlowStressValue(Functional):
    """Component or principal value of the mean stress of Gauss points of bodies with laws.

    Derivatives of histories do not include the stress.
    """

    differentiable: ClassVar[bool] = False

    #: numbers of the Gauss points, (g,)
    points: Annotated[Integers, "points"]
    #: their weights in the mean, (g,)
    shares: Annotated[Floats, "points"]
    #: see :func:`component_of`
    component: int

    def value(self, state: State) -> float:
        """The component of the mean."""
        stress = self.shares @ state.stress()[self.points]
        if PRINCIPAL > self.component >= stress.size:  # sizes of files are tried in the plane
            return 0.0
        return component_of(stress, self.component)[0]

    def indices(self) -> dict[str, np.ndarray]:
        """Gauss points."""
        return {"points": self.points}


@dataclass(frozen=True, eq=False)
class Energy(Functional):
    """Elastic energy from the work of all forces: (U0·F θ + U0·K lift + lift·K lift - λ·D θ) / 2.

    In equilibrium it is u·K u / 2, since K U0 = F - K lift - B^T λ, and B U0 = D wherever λ is not
    zero: of unilateral contact, where no spring and no strain without stress takes part.
    :class:`StoredEnergy` is the general one.
    """

    uses_forces: ClassVar[bool] = True

    names: tuple[str, ...]  #: of the parameters
    moduli: tuple[str, ...]  #: of the parts of K, as formulas
    terms: Annotated[Integers, "rows"]  #: of θ by which each row is multiplied, (k,)
    parts: Annotated[
        Integers, "rows"
    ]  #: number of the modulus of each row, (k,); -1 for a load, which has none
    lifted: Annotated[Integers, "lifted"]  #: terms that impose displacements, (l,)
    lifts: Annotated[Floats, "parts", "lifted", "lifted"]  #: lift·K_q lift of each part, (Q, l, l)
    gap_terms: Annotated[Integers, "gap terms"]  #: terms on which gaps depend, (g,)
    gaps: Annotated[Floats, "conditions", "gap terms"]  #: D, (m, g)
    #: rows times the lifts, (k, l): the part of the displacement that U0 lacks; zero if lifts are
    #: non-zero on the imposed dofs alone
    own: Annotated[Floats, "rows", "lifted"]

    def __post_init__(self) -> None:
        _ = self._moduli

    @cached_property
    def _moduli(self) -> tuple[Scalar, ...]:
        return tuple(Scalar(text, tuple(self.names)) for text in self.moduli)

    @property
    def quadratic(self) -> bool:
        """True if it is a quadratic form of forces, rows and θ, whatever the point."""
        return not any(modulus.formula.variables for modulus in self._moduli)

    def value(self, state: State) -> float:
        """Half the work of all forces."""
        weights = np.array([*(modulus.value(state.point) for modulus in self._moduli), 1.0])
        theta = state.theta
        imposed = state.theta[self.lifted]
        work = (theta[self.terms] * weights[self.parts]) @ (state.measured - self.own @ imposed)
        work += weights[:-1] @ (self.lifts @ imposed @ imposed)
        return float(work - state.forces @ (self.gaps @ theta[self.gap_terms])) / 2

    def slopes(self, state: State) -> Slopes:
        """Slopes by the product rule."""
        weights = np.array([*(modulus.value(state.point) for modulus in self._moduli), 1.0])
        theta = state.theta
        imposed = state.theta[self.lifted]
        of_theta = np.zeros(theta.size)
        measured = state.measured - self.own @ imposed
        np.add.at(of_theta, self.terms, weights[self.parts] * measured)
        np.add.at(of_theta, self.lifted, -(theta[self.terms] * weights[self.parts]) @ self.own)
        np.add.at(of_theta, self.lifted, 2 * np.tensordot(weights[:-1], self.lifts, 1) @ imposed)
        np.add.at(of_theta, self.gap_terms, -(state.forces @ self.gaps))
        of_weights = self.lifts @ imposed @ imposed
        inner = self.parts >= 0
        np.add.at(of_weights, self.parts[inner], (theta[self.terms] * measured)[inner])
        point = np.zeros(state.point.size)
        for modulus, slope in zip(self._moduli, of_weights, strict=True):
            point += slope * modulus.derivative(state.point)
        of_forces = -(self.gaps @ theta[self.gap_terms]) / 2
        conditions = np.arange(state.forces.size)
        return Slopes(
            conditions,
            of_forces,
            theta[self.terms] * weights[self.parts] / 2,
            of_theta / 2,
            point / 2,
        )

    def indices(self) -> dict[str, np.ndarray]:
        """Terms."""
        return {"terms": np.concatenate([self.terms, self.lifted, self.gap_terms])}


@dataclass(frozen=True, eq=False)
class StoredEnergy(Energy):
    """Elastic energy of bodies beside springs, under any contact forces, and with strains ε0 that
    cause no stress.

    The work of :class:`Energy` has -λ·B U0 instead of -λ·D θ where laws of contact leave slack
    under a force. In equilibrium it is u·K u / 2 with the springs in K. From it follow, with the
    loads F0 that stand for ε0,

        ∫ (ε - ε0) : C (ε - ε0) / 2 = (u·K u - sum k u²) / 2 - u·F0 θ + ∫ ε0 : C ε0 / 2.

    Rows are those of Energy, then B, the dofs of springs, and F0, of which the last two read the
    displacement with its lift.
    """

    #: conditions of the rows of B, (b,); empty for -λ·D θ
    touching: Annotated[Integers, "touching"]
    own_touching: Annotated[Floats, "touching", "lifted"]  #: rows of B times the lifts
    springs: Annotated[Floats, "springs"]  #: stiffness k of each spring, (s,)
    strained: Annotated[Integers, "strained"]  #: terms of θ of the rows F0, (e,)
    factors: tuple[str, ...]  #: factors of the energies of strains ε0 as formulas, (f,)
    strains: Annotated[Floats, "factors"]  #: energies ∫ ε0 : C ε0 / 2 for these factors 1, (f,)

    def __post_init__(self) -> None:
        super().__post_init__()
        _ = self._factors

    @cached_property
    def _factors(self) -> tuple[Scalar, ...]:
        return tuple(Scalar(text, tuple(self.names)) for text in self.factors)

    @property
    def quadratic(self) -> bool:
        """See :class:`Energy`; a strain without stress leaves a rest."""
        return super().quadratic and not self.factors

    def _parts(self, state: State) -> tuple[State, np.ndarray, np.ndarray, np.ndarray]:
        """The state that Energy reads, B U0, displacements of springs, and F0·u."""
        ends = np.cumsum([self.terms.size, self.touching.size, self.springs.size])
        work, touched, sprung, strained = np.split(state.measured, ends)
        opening = touched - self.own_touching @ state.theta[self.lifted]
        return state._replace(measured=work), opening, sprung, strained

    def value(self, state: State) -> float:
        """Half the work of all forces, less what springs take, and less that of strains without
        stress.
        """
        work, opening, sprung, strained = self._parts(state)
        energy = super().value(work) - float(state.forces[self.touching] @ opening) / 2
        energy -= float(self.springs @ sprung**2) / 2 + float(state.theta[self.strained] @ strained)
        factors = np.array([factor.value(state.point) for factor in self._factors])
        return energy + float(factors @ self.strains)

    def slopes(self, state: State) -> Slopes:
        """Slopes by the product rule."""
        work, opening, sprung, strained = self._parts(state)
        of_work = super().slopes(work)
        forces = of_work.forces.copy()
        forces[self.touching] -= opening / 2
        pressed = state.forces[self.touching]
        theta = of_work.theta.copy()
        np.add.at(theta, self.lifted, pressed @ self.own_touching / 2)
        np.add.at(theta, self.strained, -strained)
        rows = of_work.measured, -pressed / 2, -self.springs * sprung, -state.theta[self.strained]
        point = of_work.point.copy()
        for factor, energy in zip(self._factors, self.strains, strict=True):
            point += energy * factor.derivative(state.point)
        return of_work._replace(
            forces=forces, theta=theta, measured=np.concatenate(rows), point=point
        )

    def indices(self) -> dict[str, np.ndarray]:
        """Terms and conditions."""
        terms = np.concatenate([super().indices()["terms"], self.strained])
        return {"terms": terms, "conditions": self.touching}
