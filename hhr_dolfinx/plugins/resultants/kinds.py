"""Reactions and centres of pressure as numbers."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, ClassVar

import numpy as np

from hhr_dolfinx.declared import Floats, Integers
from hhr_dolfinx.formulas import Scalar
from hhr_dolfinx.models.functionals.functional import Functional, Slopes, State


@dataclass(frozen=True, eq=False)
class Centre(Functional):
    """Mean position of forces, Σ w λ x / Σ w λ."""

    uses_forces: ClassVar[bool] = True

    #: conditions of pressures, (c,)
    conditions: Annotated[Integers, "conditions"]
    #: share w of the contact in each
    shares: Annotated[Floats, "conditions"]
    #: position x of each, in the unit of length
    positions: Annotated[Floats, "conditions"]

    def value(self, state: State) -> float:
        """The mean; NaN without forces."""
        forces = self.shares * state.forces[self.conditions]
        total = float(forces.sum())
        return float(forces @ self.positions) / total if total > 0 else float("nan")

    def slopes(self, state: State) -> Slopes:
        """Slopes along the forces; none without forces, where the centre is not defined."""
        total = float(self.shares @ state.forces[self.conditions])
        if not total > 0:
            return Slopes(kink=True)
        along = self.shares * (self.positions - self.value(state)) / total
        return Slopes(self.conditions, along)

    def indices(self) -> dict[str, np.ndarray]:
        """Conditions."""
        return {"conditions": self.conditions}


@dataclass(frozen=True, eq=False)
class ReactionTerms(Functional):
    """Σ_j f_j (Σ_q m_q(mu) (r_jq · u + l_jq · θ) + w_j · λ - e_j · θ), f_j = 1 or an amplitude.

    r_jq are sums of rows of the part q of K, w_j of B^T and e_j of the loads over the dofs of a
    support; one j for a force or moment, and one for each imposed displacement of a work.
    """

    uses_forces: ClassVar[bool] = True

    #: names of the parameters
    names: tuple[str, ...]
    #: amplitudes m_q of the parts of K as formulas, (q,)
    moduli: tuple[str, ...]
    #: conditions of the forces λ, (c,)
    conditions: Annotated[Integers, "conditions"]
    #: w_j, (j, c)
    weights: Annotated[Floats, "directions", "conditions"]
    #: amplitude f_j by its index in θ; -1 for 1
    factors: Annotated[Integers, "directions"]
    #: amplitudes θ that act, (t,)
    terms: Annotated[Integers, "terms of it"]
    #: l_jq, (j q, t)
    lifted: Annotated[Floats, "rows", "terms of it"]
    #: e_j, (j, t)
    external: Annotated[Floats, "directions", "terms of it"]

    def __post_init__(self) -> None:
        _ = self._moduli  # refuse unreadable formulas here

    @cached_property
    def _moduli(self) -> tuple[Scalar, ...]:
        return tuple(Scalar(text, tuple(self.names)) for text in self.moduli)

    def _parts(self, state: State) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Moduli, (q,), rows of K times the displacement, (j, q), and reactions along each j."""
        moduli = np.array([modulus.value(state.point) for modulus in self._moduli])
        theta = state.theta[self.terms]
        rows = (state.measured + self.lifted @ theta).reshape(len(self.factors), -1)
        of_forces = self.weights @ state.forces[self.conditions]
        return moduli, rows, rows @ moduli + of_forces - self.external @ theta

    def _factors(self, state: State) -> np.ndarray:
        return np.where(self.factors < 0, 1.0, state.theta[np.maximum(self.factors, 0)])

    def value(self, state: State) -> float:
        """The sum."""
        return float(self._factors(state) @ self._parts(state)[2])

    def slopes(self, state: State) -> Slopes:
        """Slopes by the product rule."""
        moduli, rows, reactions = self._parts(state)
        factors = self._factors(state)
        measured = np.outer(factors, moduli).ravel()
        theta = np.zeros(state.theta.size)
        np.add.at(theta, self.terms, self.lifted.T @ measured - self.external.T @ factors)
        driven = self.factors >= 0
        np.add.at(theta, self.factors[driven], reactions[driven])
        point = np.zeros(state.point.size)
        for weight, modulus in zip(factors @ rows, self._moduli, strict=True):
            point += weight * modulus.derivative(state.point)
        return Slopes(self.conditions, self.weights.T @ factors, measured, theta, point)

    def indices(self) -> dict[str, np.ndarray]:
        """Conditions and terms."""
        driven = self.factors[self.factors >= 0]
        return {"conditions": self.conditions, "terms": np.concatenate([self.terms, driven])}
