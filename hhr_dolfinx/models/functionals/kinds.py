"""Kinds of outputs: a class for each way in which a number depends on forces, displacement and point."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, ClassVar

import numpy as np
from scipy.sparse import csr_matrix

from hhr_dolfinx.declared import Floats, Integers
from hhr_dolfinx.formulas import Scalar
from hhr_dolfinx.materials.elasticity import von_mises
from hhr_dolfinx.models.functionals.functional import Functional, Slopes, State

TIE = 1e-9
"""Relative difference below which two values both count as the largest; the derivative is then one-sided."""
LOADED = 1e-3
"""Part of the largest pressure of a contact above which a condition is under load: smaller forces that a reduced
model completes outside its domain are noise."""
BLOCK = 1024
"""Cells whose stress is evaluated in one batch."""
_NOTHING = np.zeros(0)
_NOWHERE = np.zeros(0, dtype=np.int64)


@dataclass(frozen=True, eq=False)
class Linear(Functional):
    """Forces, displacement and amplitudes times weights.

    Attributes:
        conditions, weights: of the forces, (c,) each.
        along: weights of its rows, (k,).
        terms, coefficients: of the amplitudes, (t,) each.
    """

    conditions: Annotated[Integers, "conditions"]
    weights: Annotated[Floats, "conditions"]
    along: Annotated[Floats, "rows"]
    terms: Annotated[Integers, "terms of it"]
    coefficients: Annotated[Floats, "terms of it"]

    @classmethod
    def of(
        cls,
        name: str,
        unit: str,
        conditions: np.ndarray = _NOWHERE,
        weights: np.ndarray = _NOTHING,
        *,
        row: csr_matrix | None = None,
        terms: np.ndarray = _NOWHERE,
        coefficients: np.ndarray = _NOTHING,
    ) -> Linear:
        """Output from conditions and weights of their forces, one row of the displacement, (1, N), and amplitudes."""
        matrix = (0, _NOWHERE, _NOWHERE, _NOTHING)
        along = _NOTHING
        if row is not None:
            entries = row.tocoo()
            own = entries.row.astype(np.int64), entries.col.astype(np.int64), entries.data.astype(float)
            matrix = (1, *own)
            along = np.ones(1)
        forces = conditions.astype(np.int64), np.asarray(weights, dtype=float)
        return cls(name, unit, *matrix, *forces, along, terms.astype(np.int64), np.asarray(coefficients, dtype=float))

    @property
    def uses_forces(self) -> bool:  # type: ignore[override]
        """True if it depends on any force."""
        return self.conditions.size > 0

    def value(self, state: State) -> float:
        """The sum of all products."""
        value = state.measured @ self.along + state.theta[self.terms] @ self.coefficients
        return float(value + state.forces[self.conditions] @ self.weights if self.uses_forces else value)

    def slopes(self, state: State) -> Slopes:
        """The weights."""
        theta = np.zeros(state.theta.size)
        theta[self.terms] = self.coefficients
        return Slopes(self.conditions, self.weights, self.along, theta)

    def indices(self) -> dict[str, np.ndarray]:
        """Conditions and terms."""
        return {"conditions": self.conditions, "terms": self.terms}


@dataclass(frozen=True, eq=False)
class Largest(Functional):
    """Largest pressure, force over area.

    Attributes:
        conditions, areas: (c,) each.
    """

    uses_forces: ClassVar[bool] = True

    conditions: Annotated[Integers, "conditions"]
    areas: Annotated[Floats, "conditions"]

    def value(self, state: State) -> float:
        """Largest pressure of all conditions."""
        return float((state.forces[self.conditions] / self.areas).max())

    def slopes(self, state: State) -> Slopes:
        """Slopes of the condition where the maximum is attained."""
        pressures = state.forces[self.conditions] / self.areas
        place = pressures.argmax()
        return Slopes(self.conditions[[place]], 1 / self.areas[[place]], kink=_tied(pressures, place))

    def followed(self, state: State, there: Functional, shifted: State) -> float:
        """Pressure of the condition where the maximum is attained."""
        assert isinstance(there, Largest)
        place = (state.forces[self.conditions] / self.areas).argmax()
        return float(shifted.forces[self.conditions[place]] / there.areas[place])

    def indices(self) -> dict[str, np.ndarray]:
        """Conditions."""
        return {"conditions": self.conditions}


@dataclass(frozen=True, eq=False)
class Loaded(Functional):
    """Area under load times a factor and an offset; piecewise constant on one mesh, so that its derivatives are zero.

    It jumps when a condition comes under load.

    Attributes:
        conditions, areas: (c,) each.
        offset, factor: terms of its value.
    """

    uses_forces: ClassVar[bool] = True

    conditions: Annotated[Integers, "conditions"]
    areas: Annotated[Floats, "conditions"]
    offset: float
    factor: float

    def value(self, state: State) -> float:
        """Area whose pressure exceeds :data:`LOADED` of the largest pressure."""
        return float(self.offset + self.factor * self.areas[self._loaded(state)].sum())

    def slopes(self, state: State) -> Slopes:
        """Zero."""
        return Slopes()

    def followed(self, state: State, there: Functional, shifted: State) -> float:
        """Area on the other shape of the conditions under load."""
        assert isinstance(there, Loaded)
        return float(there.offset + there.factor * there.areas[self._loaded(state)].sum())

    def _loaded(self, state: State) -> np.ndarray:
        """Conditions under load, (c,) bool."""
        pressures = state.forces[self.conditions] / self.areas
        largest = pressures.max()
        return (pressures > LOADED * largest) & (largest > 0)

    def indices(self) -> dict[str, np.ndarray]:
        """Conditions."""
        return {"conditions": self.conditions}


@dataclass(frozen=True, eq=False)
class Mises(Functional):
    """Von Mises' stress of elastic cells: rows are the strain at their midpoints, Kelvin's notation, cell by cell.

    Attributes:
        names: of the parameters.
        volume, shape: λ' and μ' as formulas, see :func:`hhr_dolfinx.forms.elasticity.isotropic_parts`.
        plane_stress: whether the stress across the plane vanishes.
        grading: factor of the moduli of each cell, (cells,).
        shares: of each cell in the mean, (cells,); empty for the largest value.
    """

    names: tuple[str, ...]
    volume: str
    shape: str
    plane_stress: bool
    grading: Annotated[Floats, "cells"]
    shares: Annotated[Floats, "shares"]

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
            kink = _tied(values, int(values.argmax()))
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

    Attributes:
        names: of the parameters.
        moduli: of the parts of K, as formulas.
        terms: of θ by which each row is multiplied, (k,).
        parts: number of the modulus of each row, (k,); -1 for a load, which has none.
        lifted: terms that impose displacements, (l,).
        lifts: lift·K_q lift of each part, (Q, l, l).
        gap_terms: terms on which gaps depend, (g,).
        gaps: D, (m, g).
        own: rows times the lifts, (k, l): the part of the displacement that U0 lacks; zero if lifts are non-zero on the
            imposed dofs alone.
    """

    uses_forces: ClassVar[bool] = True

    names: tuple[str, ...]
    moduli: tuple[str, ...]
    terms: Annotated[Integers, "rows"]
    parts: Annotated[Integers, "rows"]
    lifted: Annotated[Integers, "lifted"]
    lifts: Annotated[Floats, "parts", "lifted", "lifted"]
    gap_terms: Annotated[Integers, "gap terms"]
    gaps: Annotated[Floats, "conditions", "gap terms"]
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


def _tied(values: np.ndarray, place: int) -> bool:
    """True if another value is as large as the largest, or all are zero."""
    largest = values[place]
    return bool(np.count_nonzero(values >= largest - TIE * abs(largest)) > 1)
