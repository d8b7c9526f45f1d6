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
from hhr_dolfinx.models.functionals.kinds import tied


@dataclass(frozen=True, eq=False)
class Mises(Functional):
    """Von Mises' stress of elastic cells: rows are the strain at their midpoints, Kelvin's notation, cell by cell."""

    names: tuple[str, ...]  # of the parameters
    volume: str  # λ' as a formula, see forms.elasticity.isotropic_parts
    shape: str  # μ' as a formula
    plane_stress: bool  # whether the stress across the plane vanishes
    grading: Annotated[Floats, "cells"]  # factor of the moduli of each cell, (cells,)
    shares: Annotated[Floats, "shares"]  # of each cell in the mean, (cells,); empty for the largest value

    def __post_init__(self) -> None:
        _ = self._moduli  # refuse unreadable formulas here

    @cached_property
    def _moduli(self) -> tuple[Scalar, Scalar]:
        return Scalar(self.volume, tuple(self.names)), Scalar(self.shape, tuple(self.names))

    def _stress(self, state: State) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Stress and its parts per λ' and μ', (cells, components) each, and the unit tensor, (components,)."""
        strain = state.measured.reshape(self.grading.size, -1)
        if self.plane_stress:
            strain = strain * np.array([1.0, 1.0, 0.0, 1.0])
        unit = np.zeros(strain.shape[1])
        unit[: 2 if self.plane_stress else 3] = 1.0
        of_volume = self.grading[:, None] * np.outer(strain @ unit, unit)
        of_shape = 2 * self.grading[:, None] * strain
        volume, shape = (modulus.value(state.point) for modulus in self._moduli)
        return volume * of_volume + shape * of_shape, of_volume, of_shape, unit

    def value(self, state: State) -> float:
        """The largest one, or their mean over the volume."""
        values = von_mises(self._stress(state)[0])
        return float(self.shares @ values if self.shares.size else values.max())

    def followed(self, state: State, there: Functional, shifted: State) -> float:
        """Stress of the cell where it is largest, or the mean."""
        assert isinstance(there, Mises)
        if self.shares.size:
            return there.value(shifted)
        place = von_mises(self._stress(state)[0]).argmax()
        return float(von_mises(there._stress(shifted)[0])[place])

    def slopes(self, state: State) -> Slopes:
        """Slopes by the chain rule through the stress."""
        stress, of_volume, of_shape, unit = self._stress(state)
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
        along = scale[:, None] * deviator
        volume, shape = self._moduli
        found = volume.value(state.point) * np.outer(along @ unit, unit) + 2 * shape.value(state.point) * along
        found *= self.grading[:, None]
        if self.plane_stress:
            found *= np.array([1.0, 1.0, 0.0, 1.0])
        point = np.sum(along * of_volume) * volume.derivative(state.point)
        point = point + np.sum(along * of_shape) * shape.derivative(state.point)
        return Slopes(measured=found.ravel(), point=point, kink=kink or bool((values[shares > 0] == 0).any()))


@dataclass(frozen=True, eq=False)
class Energy(Functional):
    """Elastic energy from the work of all forces: (U0·F θ + U0·K lift + lift·K lift - λ·D θ) / 2.

    In equilibrium it is u·K u / 2, since K U0 = F - K lift - B^T λ, and B U0 = D wherever λ is not zero.
    """

    uses_forces: ClassVar[bool] = True

    names: tuple[str, ...]  # of the parameters
    moduli: tuple[str, ...]  # of the parts of K, as formulas
    terms: Annotated[Integers, "rows"]  # of θ by which each row is multiplied, (k,)
    parts: Annotated[Integers, "rows"]  # number of the modulus of each row, (k,); -1 for a load, which has none
    lifted: Annotated[Integers, "lifted"]  # terms that impose displacements, (l,)
    lifts: Annotated[Floats, "parts", "lifted", "lifted"]  # lift·K_q lift of each part, (Q, l, l)
    gap_terms: Annotated[Integers, "gap terms"]  # terms on which gaps depend, (g,)
    gaps: Annotated[Floats, "conditions", "gap terms"]  # D, (m, g)
    # rows times the lifts, (k, l): the part of the displacement that U0 lacks; zero if lifts are non-zero on the
    # imposed dofs alone
    own: Annotated[Floats, "rows", "lifted"]

    def __post_init__(self) -> None:
        _ = self._moduli

    @cached_property
    def _moduli(self) -> tuple[Scalar, ...]:
        return tuple(Scalar(text, tuple(self.names)) for text in self.moduli)

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
        every = np.arange(state.forces.size)
        return Slopes(every, of_forces, theta[self.terms] * weights[self.parts] / 2, of_theta / 2, point / 2)

    def indices(self) -> dict[str, np.ndarray]:
        """Terms."""
        return {"terms": np.concatenate([self.terms, self.lifted, self.gap_terms])}


@dataclass(frozen=True, eq=False)
class EnergyOfHistories(Functional):
    """Elastic energy where forces act on conditions that are open or slip: λ·B U0 in the place of λ·D θ.

    Its rows are those of ``energy``, followed by the conditions, B.
    """

    uses_forces: ClassVar[bool] = True

    energy: Energy  # without gaps
    lifts: Annotated[Floats, "conditions", "lifted"]  # B times the lifts, (m, l)

    def value(self, state: State) -> float:
        """Half the work of all forces."""
        energy, motions = self._parted(state)
        return self.energy.value(energy) - float(state.forces @ motions) / 2

    def slopes(self, state: State) -> Slopes:
        """Slopes by the product rule."""
        energy, motions = self._parted(state)
        found = self.energy.slopes(energy)
        of_theta = found.theta.copy()
        np.add.at(of_theta, self.energy.lifted, state.forces @ self.lifts / 2)
        measured = np.concatenate([found.measured, -state.forces / 2])
        return found._replace(forces=-motions / 2, measured=measured, theta=of_theta)

    def _parted(self, state: State) -> tuple[State, np.ndarray]:
        """The state for the rows of ``energy``, and B U0, (m,)."""
        own, moved = np.split(state.measured, [self.energy.count])
        return state._replace(measured=own), moved - self.lifts @ state.theta[self.energy.lifted]

    def indices(self) -> dict[str, np.ndarray]:
        """Terms."""
        return self.energy.indices()
