"""Fields of condensed inelastic models on the whole mesh, exact up to the correction and the
completion of ε_p.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import numpy as np
from scipy.sparse import csc_matrix, csr_matrix, diags

from hhr_dolfinx.amplitudes import Amplitudes
from hhr_dolfinx.contact.law import UNILATERAL, ContactLaw
from hhr_dolfinx.declared import Floats, Integers
from hhr_dolfinx.formulas import Modulus, check_over_box
from hhr_dolfinx.linear.dense import lay_out
from hhr_dolfinx.models.answer import Answer, Meshed, ModelFields
from hhr_dolfinx.models.estimates import STRESS_INDICATOR, Estimate
from hhr_dolfinx.parameters import ParameterSpace
from hhr_dolfinx.plain import OF_THE_MESH, Rebuilt
from hhr_dolfinx.plugins.inelastic.completion import KNOWN_ERROR, GappyField
from hhr_dolfinx.plugins.inelastic.law import UNGRADED
from hhr_dolfinx.plugins.inelastic.state import state as gauss_of
from hhr_dolfinx.plugins.inelastic.strain import StrainOperator
from hhr_dolfinx.plugins.inelastic.trained import share_of_stress

if TYPE_CHECKING:
    from hhr_dolfinx.models.functionals.functional import Functionals


LEVERAGE_LIMIT = 0.05
"""Lower limit of 1 - h_ii (leverage) in the leave-one-out residual: below it a point is fitted by
itself, and the residual is round-off over round-off.
"""


@dataclass(frozen=True, eq=False)
class PlasticFields:
    """Completion of the fields at Gauss points.

    Gappy POD (thesis section 6.2.3) completes the plastic strain ε_p alone, from modes Φ a. The
    displacement and stress that balance each mode are computed in advance: K u = ∫ G^T C Φ, σ = C
    (ε(u) - Φ). So the stress is exact in elastic regions, and balances the loads for any a;
    completed from few points itself, its elastic part would be wrong.
    """

    kind: ClassVar[str] = STRESS_INDICATOR
    known_error: ClassVar[str] = KNOWN_ERROR

    points: Annotated[
        Integers, "points", "< gauss points"
    ]  #: numbers of the points Z where laws are evaluated
    #: those with plastic strain in training
    flowed: Annotated[Integers, "flowed", "< gauss points"]
    plastic: (
        GappyField  # completion of the plastic strain on these; components of a point are adjacent
    )
    cumulated: GappyField  #: completion of the cumulated plastic strain
    moved: Annotated[
        Floats, "N", "plastic modes"
    ]  #: K^-1 ∫ G^T C Φ of each mode of the plastic strain
    strain: StrainOperator  #: ε(u) at all Gauss points
    unstressed: Annotated[
        csc_matrix, "components * gauss points", "terms"
    ]  #: strains without stress
    elastic: Annotated[
        Floats, "kinds", "components", "components"
    ]  #: different C in the middle of the box
    kinds: Annotated[Integers, "gauss points", "< kinds"]  #: that of each Gauss point
    grading: Annotated[Floats, "graded"] = field(
        default_factory=lambda: UNGRADED
    )  #: factor of that, or empty for 1

    def __post_init__(self) -> None:
        """Convert the arrays to the layout of files."""
        lay_out(self)

    def faults(self, sizes: Mapping[str, int]) -> Iterator[str]:
        """Faults: points that do not increase, moduli that are not positive, strain and modes of
        other sizes.
        """
        if not (np.diff(self.flowed) > 0).all() or not np.isin(self.points, self.flowed).all():
            yield "the points that flowed must increase, those where laws are evaluated among them"
        stiffnesses = np.linalg.eigvalsh(self.elastic)
        # laws that state the elasticity in plane stress have none across
        semidefinite = (
            stiffnesses > -MODULI_ROUND_OFF * np.abs(stiffnesses).max(axis=1, keepdims=True)
        ).all()
        if not semidefinite or not (self.grading > 0).all():
            yield "the elasticity of a Gauss point is not positive definite"
        if self.grading.size not in (0, self.places):
            yield f"a grading of {self.grading.size} points is not one of {self.places} points"
        components = self.strain.components
        count = self.plastic.modes.shape[1]
        sizes_of_modes = (
            *self.plastic.modes.shape,
            *self.plastic.fit.shape,
            self.cumulated.modes.shape[0],
        )
        wanted = (
            self.flowed.size * components,
            count,
            count,
            self.points.size * components,
            self.flowed.size,
        )
        if (
            sizes_of_modes != wanted
            or self.moved.shape[1] != count
            or self.cumulated.fit.shape[1] != self.points.size
        ):
            yield f"modes of the plastic strain have sizes {sizes_of_modes}, and not {wanted}"
        if self.strain.weights.size != self.places or self.strain.size != len(self.moved):
            yield (
                f"strains at all Gauss points are not those of {len(self.moved)} dofs and "
                f"{self.places} points"
            )

    @property
    def places(self) -> int:
        """Number of Gauss points of the full model."""
        return len(self.kinds)

    @cached_property
    def shear(self) -> np.ndarray:
        """2 μ of each Gauss point, or of anisotropic ones that of the last component, (Gauss
        points,).
        """
        moduli = self.elastic[self.kinds, -1, -1]
        return moduli * self.grading if self.grading.size else moduli

    def stress_of(self, answer: Answer) -> np.ndarray:
        """Stress of an answer, which depends on its elastic part: that of its fields."""
        return answer.fields.stress(answer)

    def plastic_strain(self, answer: Answer) -> np.ndarray:
        """Cumulated plastic strain of an answer at all Gauss points, never negative, (Gauss
        points,).
        """
        evaluated = gauss_of(answer).state.cumulated
        field = np.zeros(self.places)
        field[self.flowed] = np.maximum(self.cumulated.everywhere(evaluated), 0.0)
        field[self.points] = evaluated
        return field

    def estimate(self, answer: Answer) -> Estimate | None:
        """Indicator of the error of an answer: that of its fields."""
        return answer.fields.estimate(answer)

    def stress(self, elastic: np.ndarray, theta: np.ndarray, plastic: np.ndarray) -> np.ndarray:
        """Stress at all Gauss points for the moduli of the middle, (Gauss points, components).

        Args:
            elastic: displacement of loads and forces with the lift, (N,).
            theta: amplitudes θ at its parameter.
            plastic: plastic strain where laws are evaluated, (n, c).
        """
        shares = self.plastic.fit @ plastic.ravel()
        field = self.strain.strain(elastic + self.moved @ shares)
        if self.unstressed.nnz:
            field -= (self.unstressed @ theta).reshape(field.shape)
        field[self.flowed] -= (self.plastic.modes @ shares).reshape(self.flowed.size, -1)
        for kind, elastic in enumerate(self.elastic):
            points = self.kinds == kind
            field[points] = field[points] @ elastic
        return field * self.grading[:, None] if self.grading.size else field

    def unforeseen(self, plastic: np.ndarray) -> np.ndarray:
        """Leave-one-out residual of the plastic strain at each point, times 2 μ, (n, components).

        The residual of the fit, (I - H) ε_p, is far less than elsewhere; (I - H_ii)^-1 predicts a
        point without itself.
        """
        values = plastic.ravel()
        residual = (values - self.spanned @ (self.spanned.T @ values)).reshape(plastic.shape)
        return np.einsum("nij,nj->ni", self.without, residual)

    @cached_property
    def shown(self) -> np.ndarray:
        """Modes of the plastic strain at the points where laws are evaluated, (n components,
        modes).
        """
        rows = np.searchsorted(self.flowed, self.points)
        modes = self.plastic.modes.reshape(self.flowed.size, self.strain.components, -1)
        return modes[rows].reshape(rows.size * self.strain.components, -1)

    @cached_property
    def spanned(self) -> np.ndarray:
        """Orthonormal basis of these modes: half of the memory that a product with the modes and
        their fit reads.
        """
        basis, sizes, _ = np.linalg.svd(self.shown, full_matrices=False)
        return np.ascontiguousarray(basis[:, sizes > np.finfo(float).eps * sizes.max(initial=0.0)])

    @cached_property
    def without(self) -> np.ndarray:
        """2 μ (I - H_ii)^-1 of each point, (n, components, components), with I - H_ii at least
        LEVERAGE_LIMIT.
        """
        count = self.points.size
        components = self.strain.components
        shown = self.shown.reshape(count, components, -1)
        leverage = np.einsum("nik,knj->nij", shown, self.plastic.fit.reshape(-1, count, components))
        open_, ways = np.linalg.eigh(np.eye(components) - (leverage + leverage.swapaxes(1, 2)) / 2)
        ways *= np.sqrt(self.shear[self.points, None] / np.maximum(open_, LEVERAGE_LIMIT))[:, None]
        return ways @ ways.swapaxes(1, 2)


@dataclass(frozen=True, eq=False)
class LooseBodies(Rebuilt):
    """Bodies that contact alone holds: their rigid motions are the last unknowns (r motions, m
    conditions, N dofs).
    """

    taken: Annotated[Floats, "m", "motions"]  #: change of the slack by the motions, B R, (m, r)
    driving: Annotated[Floats, "motions", "terms"]  #: loads along them, (r, 1 + T)
    modes: Annotated[
        Floats, "N", "motions"
    ]  #: R, orthonormal, which no other term of a displacement has, (N, r)

    def faults(self, sizes: Mapping[str, int]) -> Iterator[str]:
        """Faults: motions that are not orthonormal, by which the least ones would be others."""
        if not np.allclose(self.modes.T @ self.modes, np.eye(self.count), atol=MODULI_ROUND_OFF):
            yield "motions of loose bodies are not orthonormal"

    @property
    def count(self) -> int:
        """Number of motions."""
        return self.taken.shape[1]


@dataclass(frozen=True)
class CondensedFlowFields(Rebuilt, ModelFields):
    """Fields of condensed inelastic models, see :class:`hhr_dolfinx.models.answer.ModelFields`."""

    amplitudes: Amplitudes  #: θ as a function of the parameters
    factors: PartFactors  #: moduli of the parts of the stiffness
    parts: Annotated[Integers, "N"]  #: part that holds each dof, (N,)
    basis: Annotated[Floats, "N", "ell"]  #: V, (N, ell)
    per_force: Annotated[Floats, "N", "m"]  #: K^-1 B^T in the middle of the box, (N, m)
    forced: Annotated[Floats, "N", "terms"]  #: K^-1 F there, (N, 1 + T)
    given: Annotated[
        Floats, "N", "terms"
    ]  #: imposed displacements and the response to them, (N, 1 + T)
    dimension: int  #: components of the displacement at a node
    flow: PlasticFields  #: completes stress and plastic strain
    functionals: Functionals | None = None  #: outputs of the scene; None if it has none
    law: ContactLaw = UNILATERAL  #: law of the contact conditions
    loose: LooseBodies | None = None  #: bodies that contact alone holds
    #: see :class:`~hhr_dolfinx.models.answer.ModelFields`
    full: Meshed | None = field(default=None, metadata=OF_THE_MESH)

    @property
    def conditions(self) -> int:
        """Number of contact conditions; the model keeps all."""
        return self.per_force.shape[1]

    def displacement(self, answer: Answer) -> np.ndarray:
        """Displacement on the whole mesh, lift included, (N,)."""
        field = self._elastic(answer) + self.basis @ answer.unknown[: self.basis.shape[1]]
        return (
            field
            if self.loose is None
            else field + self.loose.modes @ self._motions_of(answer.unknown)
        )

    def _motions_of(self, unknown: np.ndarray) -> np.ndarray:
        """Amplitudes of the motions of an unknown, or their derivatives, (r, ...)."""
        return unknown[self.basis.shape[1] + self.conditions :]

    def _elastic(self, answer: Answer) -> np.ndarray:
        """Part of the displacement from loads, contact forces and imposed displacements, (N,)."""
        theta = self.amplitudes(answer.parameter)
        elastic = self.forced @ theta - self.per_force @ answer.multipliers
        if self.factors.moduli:
            elastic *= self.factors.compliances(answer.parameter)[self.parts]
        return elastic + self.given @ theta

    def forces(self, answer: Answer) -> np.ndarray:
        """The multipliers, (m,): the model keeps all conditions."""
        return answer.multipliers.copy()

    def stress(self, answer: Answer) -> np.ndarray:
        """Stress at all Gauss points, Kelvin's notation, (Gauss points, components)."""
        theta = self.amplitudes.dense(answer.parameter)
        plastic = gauss_of(answer).state.inelastic
        return self.flow.stress(self._elastic(answer), theta, plastic) / self._giving(
            answer.parameter
        )

    def estimate(self, answer: Answer) -> Estimate | None:
        """Indicator of the error, :meth:`unexplained` over the stress; None without a solution."""
        if not answer.converged:
            return None
        return Estimate.indicated(share_of_stress(*self.unexplained(answer)), STRESS_INDICATOR)

    def unexplained(self, answer: Answer) -> tuple[float, float]:
        """Norms of the leave-one-out residual, as a stress, and of σ, where laws are evaluated."""
        gauss = gauss_of(answer)
        points = self.flow.points
        residual = self.flow.unforeseen(gauss.state.inelastic) / self._giving(
            answer.parameter, points
        )
        return float(np.linalg.norm(residual)), float(np.linalg.norm(gauss.stress))

    def _giving(
        self, point: np.ndarray, places: slice | np.ndarray = slice(None)
    ) -> float | np.ndarray:
        """Compliance of some Gauss points relative to the middle of the box, (places, 1).

        1 for constant moduli.
        """
        if not self.factors.moduli:
            return 1.0
        return self.factors.compliances(point)[self._parts_of_points[places]][:, None]

    @cached_property
    def _parts_of_points(self) -> np.ndarray:
        """Part of the stiffness that holds each Gauss point."""
        strain = self.flow.strain
        return np.repeat(self.parts[strain.dofs[:, 0]], strain.per_cell)

    @cached_property
    def _measures(self) -> tuple[np.ndarray, ...]:
        """Rows of the outputs times the terms of the displacement.

        Elastic terms for each part, and motions last.
        """
        functionals: Any = self.functionals
        rows = csr_matrix(functionals.rows)
        count = max(len(self.factors.moduli), 1)
        masked = [rows @ diags((self.parts == mask).astype(float)) for mask in range(count)]
        per_force, forced = (
            np.array([mask @ responses for mask in masked])
            for responses in (self.per_force, self.forced)
        )
        motions = np.zeros((len(self.basis), 0)) if self.loose is None else self.loose.modes
        return rows @ self.basis, rows @ self.given, per_force, forced, rows @ motions

    def measured(self, answer: Answer, theta: np.ndarray) -> np.ndarray:
        """Rows of the outputs times the displacement, (K,).

        Args:
            answer: answer of the model.
            theta: amplitudes θ at its parameter.
        """
        per_mode, imposed, per_force, forced, motions = self._measures
        elastic = forced @ theta - per_force @ answer.multipliers
        products = imposed @ theta + per_mode @ answer.unknown[: per_mode.shape[1]]
        if self.loose is not None:
            products = products + motions @ self._motions_of(answer.unknown)
        return products + self.factors.compliances(answer.parameter) @ elastic

    def measured_changes(
        self, answer: Answer, changes: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of all forces and of the products of :meth:`measured`.

        See :class:`~models.displacement.LinearDisplacement`.

        Args:
            answer: answer with a gradient.
            changes: derivatives of θ, (1 + T, P).
        """
        assert answer.gradient is not None
        per_mode, imposed, per_force, forced, motions = self._measures
        theta = self.amplitudes.dense(answer.parameter)
        compliances = self.factors.compliances(answer.parameter)
        forces = answer.gradient.multipliers
        elastic = forced @ theta - per_force @ answer.multipliers
        slopes = imposed @ changes + per_mode @ answer.gradient.unknown[: per_mode.shape[1]]
        if self.loose is not None:
            slopes = slopes + motions @ self._motions_of(answer.gradient.unknown)
        slopes = slopes + np.tensordot(compliances, forced @ changes - per_force @ forces, 1)
        return forces, slopes + elastic.T @ self.factors.slopes(answer.parameter)


MODULI_ROUND_OFF = 1e-9
"""Relative difference of moduli, or of a stiffness, in the middle of the box that counts as
round-off.
"""


@dataclass(frozen=True)
class PartFactors:
    """Young's moduli as factors of the connected components of a scene (Q parts, one for constant
    elasticity).
    """

    moduli: tuple[Modulus, ...]  #: of each part; empty for constant elasticity
    middle: Annotated[
        Floats, "parts"
    ]  #: their values in the middle of the box, for which a model is made

    def faults_for(self, space: ParameterSpace) -> Iterator[str]:
        """Faults: moduli that are no formulas of these parameters, or other in the middle.

        SceneError if negative.
        """
        for modulus in self.moduli:
            if modulus.names != space.names or modulus.rest != "1":
                yield f"the modulus {modulus.factor[:60]!r} is no formula of {space.names}"
            else:
                remedy = "Young's modulus must be positive"
                check_over_box(modulus.factor_scalar, space, "young", 0.0, math.inf, remedy)
        middle = space.middle
        values = (
            np.array([modulus.value(middle) for modulus in self.moduli])
            if self.moduli
            else np.ones(1)
        )
        if self.middle.shape != values.shape or not np.allclose(
            self.middle, values, rtol=MODULI_ROUND_OFF, atol=0.0
        ):
            yield (
                f"the moduli are {values} in the middle of the box, and the arrays are made for "
                f"{self.middle}"
            )

    def compliances(self, point: np.ndarray) -> np.ndarray:
        """Compliance of each part at a point, (P,), relative to the middle of the box, (Q,)."""
        if not self.moduli:
            return np.ones(1)
        return self.middle / np.array([modulus.value(point) for modulus in self.moduli])

    def slopes(self, point: np.ndarray) -> np.ndarray:
        """Derivatives of the compliances along the parameters, (Q, P)."""
        if not self.moduli:
            return np.zeros((1, point.size))
        values = np.array([modulus.value(point) for modulus in self.moduli])
        derivatives = np.array([modulus.derivative(point) for modulus in self.moduli])
        return -(self.middle / values**2)[:, None] * derivatives
