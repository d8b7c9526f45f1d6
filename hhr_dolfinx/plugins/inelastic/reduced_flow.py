"""Equilibrium of inelastic bodies on all Gauss points of an RID, thesis (6.17), Alg. 6.2."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Annotated

import numpy as np
from scipy.sparse import csc_matrix, csr_matrix

from hhr_dolfinx.amplitudes import Theta
from hhr_dolfinx.contact.active_set import Pairs, SchurEqualities
from hhr_dolfinx.contact.kernel import kernels
from hhr_dolfinx.contact.law import UNILATERAL, ContactLaw
from hhr_dolfinx.declared import Floats, Integers
from hhr_dolfinx.linear.dense import LapackLU
from hhr_dolfinx.models.answer import Answer
from hhr_dolfinx.models.eliminations.projected import ReducedProblem
from hhr_dolfinx.models.reconstruct import Reconstruction
from hhr_dolfinx.parameters import ParameterSpace
from hhr_dolfinx.plugins.inelastic.condensed_fields import MODULI_ROUND_OFF
from hhr_dolfinx.plugins.inelastic.equilibrium import Linearisation, texts_of
from hhr_dolfinx.plugins.inelastic.law import Update
from hhr_dolfinx.plugins.inelastic.linearised_step import MeshEquilibrium
from hhr_dolfinx.plugins.inelastic.state import GaussState
from hhr_dolfinx.plugins.inelastic.state import state as gauss_of
from hhr_dolfinx.plugins.inelastic.strain import ElasticPart, StrainOperator
from hhr_dolfinx.plugins.inelastic.trained import Signs, TrainedPaths
from hhr_dolfinx.plugins.inelastic.update import Material
from hhr_dolfinx.plugins.ufl_programs.compiled import compiled
from hhr_dolfinx.trained import Trained

if TYPE_CHECKING:
    from hhr_dolfinx.models.reduced import ReducedModel
    from hhr_dolfinx.plugins.inelastic.completion import FlowFields


@dataclass(frozen=True)
class ReducedFlow:
    """Arrays of the inelastic bodies on a RID (n dofs of its cells, a of them in A)."""

    #: strain at the Gauss points of the cells that act on A, in local numbers of dofs
    operator: StrainOperator
    material: Material  #: laws at these points
    cells: Annotated[Integers, "cells"]  #: numbers of these cells in the full model
    modes: Annotated[Floats, "dofs", "ell"]  #: V on these dofs, (n, ell)
    #: imposed displacements there, sparse, (n, 1 + T)
    lifts: Annotated[csc_matrix, "dofs", "terms"]
    inner: Annotated[
        Integers, "inner", "< dofs"
    ]  #: indices of the dofs of A, and of those that follow them, (a,)
    loads: Annotated[csc_matrix, "inner", "terms"]  #: external loads on A, sparse, (a, 1 + T)
    contact: Annotated[
        csr_matrix, "inner", "m"
    ]  #: maps the forces of the RID to loads on A, sparse, (a, N_lambda_C)
    eigenstrains: Annotated[csc_matrix, "strains", "terms"]  #: strains without stress as terms of θ
    follow: Annotated[csr_matrix, "inner", "inner"] | None = (
        None  # T on the inner dofs, (a, a); None for the identity
    )
    springs: Annotated[Floats, "inner"] | None = (
        None  # stiffness to ground of the inner dofs, (a,); None without
    )

    def faults(self, sizes: Mapping[str, int]) -> Iterator[str]:
        """Faults: repeated dofs of A, and cells, points or dofs that do not fit its strain."""
        operator = self.operator
        points = self.operator.weights.size
        sizes_of_arrays = (
            len(self.modes),
            self.cells.size,
            self.material.gauss_points,
            self.eigenstrains.shape[0],
        )
        wanted = operator.size, len(operator.weights), points, points * operator.components
        if sizes_of_arrays != wanted:
            yield (
                f"dofs, cells, Gauss points and strains {sizes_of_arrays} are not those of its "
                f"strain, {wanted}"
            )
        if np.unique(self.inner).size < self.inner.size:
            yield "a dof of A is there twice"

    @property
    def points(self) -> np.ndarray:
        """Numbers of the Gauss points in the full model."""
        return self.operator.points_of(self.cells)

    def equilibrium(
        self,
        problem: ReducedProblem,
        parameters: ParameterSpace,
        fields: Reconstruction,
        trained: Trained | None,
    ) -> ReducedEquilibrium:
        """Equilibrium of gamma on all Gauss points of the RID.

        Args:
            problem: projected problem.
            parameters: box of the parameters.
            fields: fields that complete answers.
            trained: training range; None without one.
        """
        equilibrium = ReducedEquilibrium(problem, self, parameters, fields)
        equilibrium.trained = trained if isinstance(trained, TrainedPaths) else None
        return equilibrium

    def faults_of(self, model: ReducedModel) -> Iterator[str]:
        """Faults: parts of the stiffness that do not add up to that of the middle of the box or do
        not fit bodies.
        """
        yield from self.material.faults_for(model.parameters, model.dimension)
        problem = model.problem
        terms = problem.terms
        names = model.parameters.names
        moduli = () if terms is None else terms.moduli
        points = (model.parameters.middle, *model.parameters.random(2, seed=1))
        if any(modulus.names != names for modulus in moduli) or any(
            not _alike(
                [modulus.value(point) for modulus in moduli if modulus.factor != "1"],
                self.material.weights(point),
            )
            for point in points
        ):
            yield "the parts of the stiffness are not those of the moduli of its bodies"
        elif terms is not None:
            middle = model.parameters.middle
            summed = np.tensordot(terms.weights(middle), terms.stiffness, 1)
            if (
                not np.abs(summed - problem.stiffness).max()
                <= MODULI_ROUND_OFF * np.abs(problem.stiffness).max()
            ):
                yield "the parts of the stiffness do not make that of the middle of the box"


def _alike(found: list[float], wanted: list[float]) -> bool:
    """True for the same numbers in another order."""
    return len(found) == len(wanted) and np.allclose(
        sorted(found), sorted(wanted), rtol=MODULI_ROUND_OFF, atol=0.0
    )


class ReducedEquilibrium(MeshEquilibrium):
    """Equilibrium of gamma, from the elastic projection (5.23) and the Gauss points and laws of the
    RID.
    """

    problem: ReducedProblem

    def __init__(
        self,
        problem: ReducedProblem,
        flow: ReducedFlow,
        parameters: ParameterSpace,
        fields: Reconstruction,
    ):
        super().__init__()
        self.problem = problem
        self.moduli = () if problem.terms is None else texts_of(problem.terms.moduli)
        self.parameters = parameters
        self.fields = fields
        self.conditions, self.size = problem.contact_test.shape
        self.law: ContactLaw = UNILATERAL if fields.interface is None else fields.interface.inside
        self.amplitudes = fields.amplitudes
        self.flow = flow
        self.operator = flow.operator
        self.eigenstrains = flow.eigenstrains
        self.lifts = flow.lifts
        self.points = flow.points
        self.per_cell = flow.operator.per_cell
        self._pattern = self.operator.pattern()
        self._test = np.ascontiguousarray(flow.modes[flow.inner].T)
        self._given = None if flow.follow is None else csr_matrix(flow.follow.T)
        self._external = np.asfortranarray((flow.loads.T @ self._test.T).T)
        if problem.motions:  # balance of whole bodies, on which no stress does work
            self._external[: problem.motions] = problem.loads[: problem.motions]
            self._test[: problem.motions] = 0.0
        self.material = flow.material.moduli_at(parameters.middle)
        self._set_problem(problem)
        self.material = flow.material

    def _weights(self, point: np.ndarray) -> np.ndarray:
        assert self.problem.terms is not None
        return self.problem.terms.weights(point)

    def _set_elasticity(self, weights: np.ndarray, point: np.ndarray) -> None:
        self._set_problem(self.problem.weighted(weights))

    def _set_problem(self, problem: ReducedProblem) -> None:
        """Set K~, the sum of its projected parts, and all that depends on it."""
        elastic = self.material.elastic
        self.problem = problem
        self._sizes = abs(self.operator.stiffness(elastic, self._pattern))
        self.elastic = _dense_linearisation(problem, problem.stiffness, elastic)
        # the elastic part of K~ is known: online only the inelastic change is projected
        self._unchanged = ElasticPart(elastic, np.zeros(self._pattern.indices.size))

    def field(self, x: np.ndarray) -> np.ndarray:
        """V gamma on the dofs of the RID."""
        return self.flow.modes @ x

    def norms(self, residual: np.ndarray) -> np.ndarray:
        """Norm of a residual; modes span all bodies, (1,)."""
        return np.array([np.sqrt(residual @ residual)])

    def depth(self, answer: Answer, theta: Theta) -> float:
        """Deepest violation of a gap anywhere on the contact surface, 0 if none.

        Args:
            answer: answer of the model.
            theta: amplitudes θ at the parameter.
        """
        over = self.fields.contact_basis @ answer.unknown - self.fields.gaps @ theta
        if self.fields.interface is not None:  # other rows have no gap
            over = over[self.fields.interface.whole.pressing(len(over))]
        return max(float(over.max()), 0.0)

    def contact_load(self, forces: np.ndarray) -> np.ndarray:
        """B~1^T λ."""
        return forces @ self.problem.contact_test

    def linearised(self, tangents: np.ndarray) -> Linearisation:
        """Project and factor the tangent."""
        return _dense_linearisation(self.problem, self.tangent(tangents), tangents)

    def residual(
        self, x: np.ndarray, gauss: GaussState | Update, theta: Theta
    ) -> tuple[np.ndarray, np.ndarray]:
        """V[A]^T times loads minus internal forces, and the norm of its terms on A, (1,).

        Args:
            x: unknown, (n,).
            gauss: stress and state at the Gauss points.
            theta: amplitudes θ at the parameter.
        """
        loads = self._external @ theta
        internal, size = self._internal(x, gauss.stress, theta)
        return loads - self._test @ internal, self.norms(loads) + self.norms(size)

    def _internal(
        self, x: np.ndarray, stress: np.ndarray, theta: Theta
    ) -> tuple[np.ndarray, np.ndarray]:
        """Forces of a stress and of springs on A, (a,), with those on dependent dofs.

        The size of their terms.
        """
        flow = self.flow
        internal, size = (array[flow.inner] for array in self.operator.internal(stress))
        if flow.springs is not None:
            grounded = flow.springs * (self.field(x) + flow.lifts @ theta)[flow.inner]
            internal = internal + grounded
            size = size + np.abs(grounded)
        if self._given is None:
            return internal, size
        return self._given @ internal, abs(self._given) @ size

    def signs(self, answer: Answer) -> Signs:
        """Residual on A before it is projected, and gaps on the whole contact surface.

        In the reduced space the residual vanishes for any path; on A, and outside the RID, both
        show the error of the modes.
        """
        theta = self.amplitudes(answer.parameter)
        loads = self.flow.loads @ theta
        internal, sizes = self._internal(answer.unknown, gauss_of(answer).stress, theta)
        contact = self.flow.contact @ answer.multipliers
        size = np.linalg.norm(loads) + np.linalg.norm(sizes) + np.linalg.norm(contact)
        depth = self.depth(answer, theta)
        imbalance = float(np.linalg.norm(loads - internal - contact))
        flow: FlowFields | None = self.fields.flow
        misfit, stress = (0.0, 0.0) if flow is None else flow.unexplained(gauss_of(answer).stress)
        return Signs(imbalance, float(size), depth, misfit=misfit, stress=stress)

    def tangent(self, tangents: np.ndarray) -> np.ndarray:
        """Projected consistent tangent V[A]^T K_T V, (ell, ell)."""
        change = self.operator.stiffness(tangents, self._pattern, self._unchanged)
        rows = np.zeros((self.flow.inner.size, self.size))
        _rows_times(
            change.indptr, change.indices, change.data, self.flow.inner, self.flow.modes, rows
        )
        return self.problem.stiffness + self._test @ (
            rows if self._given is None else self._given @ rows
        )


def _dense_linearisation(
    problem: ReducedProblem, stiffness: np.ndarray, moduli: np.ndarray
) -> Linearisation:
    """Linearisation with the dense blocks K~, B~1 and B~2."""
    arrays = problem.contact_trial, problem.gaps, Pairs.of(problem.pairs), moduli
    if problem.motions:
        return _with_motions(problem, stiffness, moduli)
    factor = LapackLU(stiffness)
    per_force = factor.solve(problem.contact_test.T)
    equalities = SchurEqualities.of(problem.contact_trial @ per_force, LapackLU)
    return Linearisation(*arrays, factor.solve, partial(np.matmul, per_force), equalities)


def _with_motions(
    problem: ReducedProblem, stiffness: np.ndarray, moduli: np.ndarray
) -> Linearisation:
    """Linearisation whose first modes are motions of bodies that contact alone holds.

    K~ is zero on them.
    """
    r = problem.motions
    factor = LapackLU(np.ascontiguousarray(stiffness[r:, r:]))

    def solve(residual: np.ndarray) -> np.ndarray:
        return np.concatenate([np.zeros(r), factor.solve(residual[r:])])

    columns = factor.solve(np.ascontiguousarray(problem.contact_test[:, r:].T))
    per_force = np.concatenate([np.zeros((r, columns.shape[1])), columns])
    equalities = SchurEqualities.of(problem.contact_trial @ per_force, LapackLU)
    effect = np.ascontiguousarray(problem.contact_trial[:, :r])
    motions = kernels().linearised(equalities, effect, np.eye(len(stiffness), r))
    arrays = problem.contact_trial, problem.gaps, Pairs.of(problem.pairs), moduli
    return Linearisation(*arrays, solve, partial(np.matmul, per_force), equalities, motions=motions)


@compiled()
def _rows_times(
    indptr: np.ndarray,
    indices: np.ndarray,
    data: np.ndarray,
    rows: np.ndarray,
    dense: np.ndarray,
    out: np.ndarray,
) -> None:
    """Add some rows of a sparse matrix, many of which are zero, times a dense one."""
    for r in range(rows.size):
        for position in range(indptr[rows[r]], indptr[rows[r] + 1]):
            value = data[position]
            if value != 0.0:
                column = indices[position]
                for k in range(dense.shape[1]):
                    out[r, k] += value * dense[column, k]
