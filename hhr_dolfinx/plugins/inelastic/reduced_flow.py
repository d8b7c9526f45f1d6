"""Equilibrium of inelastic bodies on all Gauss points of an RID, thesis (6.17), Alg. 6.2."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import nullcontext
from copy import copy
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, Self

import numpy as np
from scipy.sparse import csc_matrix, csr_matrix

from hhr_dolfinx.amplitudes import Theta
from hhr_dolfinx.compat import compiled
from hhr_dolfinx.contact.active_set import Pairs, SchurEqualities
from hhr_dolfinx.contact.law import UNILATERAL, UNILATERAL_STEP, ContactLaw, StepContact
from hhr_dolfinx.declared import Floats, Integers
from hhr_dolfinx.linear.dense import LapackLU
from hhr_dolfinx.materials.strain import ElasticPart, StrainOperator
from hhr_dolfinx.models.answer import Answer
from hhr_dolfinx.models.eliminations.projected import ReducedProblem
from hhr_dolfinx.models.histories.equilibrium import MarchSettings
from hhr_dolfinx.models.reconstruct import Reconstruction
from hhr_dolfinx.parameters import ParameterSpace
from hhr_dolfinx.plugins.inelastic.equilibrium import Correction
from hhr_dolfinx.plugins.inelastic.linearised_step import LinearisedStepper
from hhr_dolfinx.plugins.inelastic.march import Histories
from hhr_dolfinx.plugins.inelastic.points import ALL_HERE, Points
from hhr_dolfinx.plugins.inelastic.state import GaussState
from hhr_dolfinx.plugins.inelastic.state import state as gauss_of
from hhr_dolfinx.plugins.inelastic.trained import Signs, TrainedPaths
from hhr_dolfinx.plugins.inelastic.update import Material, Update
from hhr_dolfinx.trained import Trained

if TYPE_CHECKING:
    from hhr_dolfinx.models.reduced import ReducedModel
    from hhr_dolfinx.plugins.inelastic.completion import FlowFields

SAME = 1e-9
"""Relative difference of a stiffness in the middle of the box that counts as round-off."""


@dataclass(frozen=True)
class ReducedFlow:
    """Arrays of the inelastic bodies on a RID (n dofs of its cells, a of them in A)."""

    operator: StrainOperator  # strain at the Gauss points of the cells that act on A, in local numbers of dofs
    material: Material  # laws at these points
    cells: Annotated[Integers, "cells"]  # numbers of these cells in the full model
    modes: Annotated[Floats, "dofs", "ell"]  # V on these dofs, (n, ell)
    lifts: Annotated[csc_matrix, "dofs", "terms"]  # imposed displacements there, sparse, (n, 1 + T)
    inner: Annotated[Integers, "inner", "< dofs"]  # indices of the dofs that belong to A, (a,)
    loads: Annotated[csc_matrix, "inner", "terms"]  # external loads on A, sparse, (a, 1 + T)
    contact: Annotated[csr_matrix, "inner", "m"]  # maps the forces of the RID to loads on A, sparse, (a, N_lambda_C)
    # strains without stress for each term of θ, sparse, (Gauss points * components, 1 + T)
    eigenstrains: Annotated[csc_matrix, "strains", "terms"]

    def faults(self, sizes: Mapping[str, int]) -> Iterator[str]:
        """Faults: repeated dofs of A, and cells, points or dofs that do not fit its strain."""
        operator = self.operator
        points = self.operator.weights.size
        found = len(self.modes), self.cells.size, self.material.gauss_points, self.eigenstrains.shape[0]
        wanted = operator.size, len(operator.weights), points, points * operator.components
        if found != wanted:
            yield f"dofs, cells, Gauss points and strains {found} are not those of its strain, {wanted}"
        if np.unique(self.inner).size < self.inner.size:
            yield "a dof of A is there twice"

    @property
    def points(self) -> np.ndarray:
        """Numbers of the Gauss points in the full model."""
        return self.operator.points_of(self.cells)

    def equilibrium(
        self, problem: ReducedProblem, parameters: ParameterSpace, fields: Reconstruction, trained: Trained | None
    ) -> ReducedEquilibrium:
        """Equilibrium of gamma on all Gauss points of the RID."""
        found = ReducedEquilibrium(problem, self, parameters, fields)
        found.trained = trained if isinstance(trained, TrainedPaths) else None
        return found

    def faults_of(self, model: ReducedModel) -> Iterator[str]:
        """Faults: parts of the stiffness that do not add up to that of the middle of the box or do not fit bodies."""
        yield from self.material.faults_for(model.parameters, model.dimension)
        young = {group.young for group in self.material.groups if isinstance(group.young, str)}
        problem = model.problem
        terms = problem.terms
        names = model.parameters.names
        moduli = () if terms is None else terms.moduli
        if {item.factor for item in moduli} - {"1"} != young or any(
            item.names != names or item.rest != "1" for item in moduli
        ):
            yield "the parts of the stiffness are not those of the moduli of its bodies"
        elif terms is not None:
            middle = model.parameters.middle
            there = np.tensordot(terms.weights(middle), terms.stiffness, 1)
            if not np.abs(there - problem.stiffness).max() <= SAME * np.abs(problem.stiffness).max():
                yield "the parts of the stiffness do not make that of the middle of the box"


class ReducedEquilibrium(Histories):
    """Equilibrium of gamma, see :class:`hhr_dolfinx.models.histories.equilibrium.Equilibrium`.

    Args:
        problem: the elastic projection, (5.23).
        flow: Gauss points and laws of the RID.
        parameters: the box of the parameters.
        fields: completes its answers.
    """

    trained: TrainedPaths | None = None  # training range of the model; None until it is known
    together: Points = ALL_HERE
    elastic: DenseLinearisation

    def __init__(self, problem: ReducedProblem, flow: ReducedFlow, parameters: ParameterSpace, fields: Reconstruction):
        self.problem = problem
        self.material = flow.material
        self.young = () if problem.terms is None else tuple(modulus.factor for modulus in problem.terms.moduli)
        self.parameters = parameters
        self.fields = fields
        self.lock = nullcontext()  # histories share no factors here
        self.conditions, self.size = problem.contact_test.shape
        self.law: ContactLaw = UNILATERAL if fields.interface is None else fields.interface.inside
        self.amplitudes = fields.amplitudes
        self._middle: Any = self
        self._last: tuple[np.ndarray, Any] | None = None
        self.flow = flow
        self.operator = flow.operator
        self.points = flow.points
        self.per_cell = flow.operator.per_cell
        self._lifted = bool(flow.lifts.nnz)
        self._pattern = self.operator.pattern()
        self._test = np.ascontiguousarray(flow.modes[flow.inner].T)
        self._external = np.asfortranarray((flow.loads.T @ self._test.T).T)
        self._set_middle()

    def _set_elasticity(self, material: Material, problem: ReducedProblem) -> None:
        self.material = material
        self.problem = problem
        self._sizes = abs(self.operator.stiffness(material.elastic, self._pattern))
        self.elastic = DenseLinearisation(problem, problem.stiffness, material.elastic)
        # the elastic part of K~ is known: online only the inelastic change is projected
        self._unchanged = ElasticPart(material.elastic, np.zeros(self._pattern.indices.size))

    def _set_middle(self) -> None:
        """Set the elasticity of the middle of the box; the material keeps its formulas."""
        formulas = self.material
        space = self.parameters
        self._set_elasticity(formulas.moduli_at(space.middle), self.problem)
        self.material = formulas

    def at(self, point: np.ndarray) -> Self:
        """Equilibrium with the elasticity of a point, (P,); itself for constant elasticity.

        K~ is the sum of its projected parts. The one of the last elasticity is kept.

        Raises:
            SceneError: for a modulus that is impossible there.
            NotSolvableError: if K~ is singular there.
        """
        middle = self._middle
        if middle.problem.terms is None:
            return self
        weights = middle.problem.terms.weights(point)
        last = middle._last
        if last is not None and np.array_equal(last[0], weights):
            return last[1]
        found = copy(middle)
        found._last = None
        found._set_elasticity(middle.material.moduli_at(point), middle.problem.weighted(weights))
        # one assignment, so that threads see a complete value
        middle._last = weights, found
        return found

    def responding_at(self, point: np.ndarray) -> Self:
        """Itself: strain, gaps and F at a given displacement do not depend on moduli."""
        return self

    def gaps(self, theta: Theta) -> np.ndarray:
        """Gaps of the RID minus the lift, (N_lambda_C,)."""
        return self.problem.gaps @ theta

    def gaps_at(self, x: np.ndarray, theta: Theta) -> np.ndarray:
        """The gaps, (conditions,): they do not depend on the unknown."""
        return self.gaps(theta)

    def norms(self, residual: np.ndarray) -> np.ndarray:
        """Norm of a residual; modes span all bodies, (1,)."""
        return np.array([np.sqrt(residual @ residual)])

    def depth(self, answer: Answer, theta: Theta) -> float:
        """Deepest violation of a gap anywhere on the contact surface, 0 if none."""
        over = self.fields.contact_basis @ answer.unknown - self.fields.gaps @ theta
        if self.fields.interface is not None:  # other rows have no gap
            over = over[self.fields.interface.whole.pressing(len(over))]
        return max(float(over.max()), 0.0)

    def contact_load(self, forces: np.ndarray) -> np.ndarray:
        """B~1^T λ."""
        return forces @ self.problem.contact_test

    def linearised(self, tangents: np.ndarray) -> DenseLinearisation:
        """Project and factor the tangent."""
        return DenseLinearisation(self.problem, self.tangent(tangents), tangents)

    def strain(self, x: np.ndarray, theta: Theta) -> np.ndarray:
        """Strain at the Gauss points of the RID, lift included, minus strains without stress."""
        field = self.flow.modes @ x
        free = self.flow.eigenstrains
        found = self.operator.strain(field + self.flow.lifts @ theta if self._lifted else field)
        return found - (free @ theta).reshape(found.shape) if free.nnz else found

    def strain_of(self, change: np.ndarray) -> np.ndarray:
        """Strain of a change of gamma at the Gauss points of the RID."""
        return self.operator.strain(self.flow.modes @ change)

    def residual(self, x: np.ndarray, gauss: GaussState | Update, theta: Theta) -> tuple[np.ndarray, np.ndarray]:
        """V[A]^T times loads minus internal forces, and the norm of its terms on A, (1,)."""
        loads = self._external @ theta
        internal, size = self.operator.internal(gauss.stress)
        inner = self.flow.inner
        return loads - self._test @ internal[inner], self.norms(loads) + self.norms(size[inner])

    def round_off(self, x: np.ndarray, theta: Theta) -> np.ndarray:
        """Size of round-off in the sum of stiffness times displacement in double precision, (1,)."""
        return 1e-13 * self.norms(self._sizes @ np.abs(self.flow.modes @ x + self.flow.lifts @ theta))

    def signs(self, answer: Answer) -> Signs:
        """Residual on A before it is projected, and gaps on the whole contact surface.

        In the reduced space the residual vanishes for any path, and no gap of the RID is violated. On A, and outside
        the RID, both show the error of the modes.
        """
        theta = self.amplitudes(answer.parameter)
        inner = self.flow.inner
        loads = self.flow.loads @ theta
        internal, sizes = self.operator.internal(gauss_of(answer).stress)
        contact = self.flow.contact @ answer.multipliers
        size = np.linalg.norm(loads) + np.linalg.norm(sizes[inner]) + np.linalg.norm(contact)
        depth = self.depth(answer, theta)
        left = float(np.linalg.norm(loads - internal[inner] - contact))
        flow: FlowFields | None = self.fields.flow  # type: ignore[assignment]
        misfit, stress = (0.0, 0.0) if flow is None else flow.unexplained(gauss_of(answer).stress)
        return Signs(left, float(size), depth, misfit=misfit, stress=stress)

    def tangent(self, tangents: np.ndarray) -> np.ndarray:
        """Projected consistent tangent V[A]^T K_T V, (ell, ell)."""
        change = self.operator.stiffness(tangents, self._pattern, self._unchanged)
        return self.problem.stiffness + self._test @ _product(change, self.flow.inner, self.flow.modes)

    def stepper(self, settings: MarchSettings) -> LinearisedStepper:
        """Solver of the steps of a history."""
        return LinearisedStepper(self, settings)


class DenseLinearisation:
    """Linearisation on dense blocks, see :class:`hhr_dolfinx.models.histories.equilibrium.Linearisation`."""

    def __init__(self, problem: ReducedProblem, stiffness: np.ndarray, moduli: np.ndarray):
        self.moduli = moduli
        self._problem = problem
        self._factor = LapackLU(stiffness)
        self._pairs = Pairs.of(problem.pairs)
        self._per_force = self._factor.solve(problem.contact_test.T)
        self._equalities = SchurEqualities.of(problem.contact_trial @ self._per_force, LapackLU)

    def correct(
        self,
        residual: np.ndarray,
        x: np.ndarray,
        theta: Theta,
        active: np.ndarray,
        contact: StepContact = UNILATERAL_STEP,
    ) -> Correction:
        """Solve K~ δ + B~1^T λ = residual, B~2 (x + δ) <= gaps."""
        free = self._factor.solve(residual)
        problem = self._problem
        slack = problem.gaps @ theta - problem.contact_trial @ (x + free)
        found = contact.solved(self._equalities, slack, active, self._pairs)
        return Correction(free - self._per_force @ found.forces, found)

    def changed(self, residual: np.ndarray, gaps: np.ndarray, active: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Solve K~ δ + B~1^T λ = residual, B~2 δ = gaps where active, λ = 0 elsewhere."""
        free = self._factor.solve(residual)
        forces, _ = self._equalities(active, gaps - self._problem.contact_trial @ free)
        return free - self._per_force @ forces, forces


def _product(matrix: csr_matrix, rows: np.ndarray, dense: np.ndarray) -> np.ndarray:
    """Some rows of a sparse matrix, many of which are zero, times a dense one."""
    out = np.zeros((rows.size, dense.shape[1]))
    _rows_times(matrix.indptr, matrix.indices, matrix.data, rows, dense, out)
    return out


@compiled()
def _rows_times(indptr, indices, data, rows, dense, out):
    for r in range(rows.size):
        for position in range(indptr[rows[r]], indptr[rows[r] + 1]):
            value = data[position]
            if value != 0.0:
                column = indices[position]
                for k in range(dense.shape[1]):
                    out[r, k] += value * dense[column, k]
