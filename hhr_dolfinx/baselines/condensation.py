"""Exact condensation on the contact conditions: the rival without reduction error while the stiffness is constant."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from hhr_dolfinx.contact.problem import ContactProblem
from hhr_dolfinx.errors import HHRError, SceneError
from hhr_dolfinx.full_order.full import FullOrderModel
from hhr_dolfinx.models.answer import Answer, ElasticFields
from hhr_dolfinx.models.condensed import CondensedModel, KnownStatuses, Responses
from hhr_dolfinx.models.estimates import Estimate

if TYPE_CHECKING:
    from hhr_dolfinx.models.functionals import Functionals
    from hhr_dolfinx.models.varying import VaryingModel


@dataclass(frozen=True)
class ExactFields(ElasticFields):
    """What completes answers of exact condensation, see :class:`hhr_dolfinx.models.answer.Fields`.

    Attributes:
        problem: the full problem.
        per_force: K^-1 B^T, (N, N_lambda).
        unloaded: K^-1 loads, (N, 1 + T).
        stress_of: stress of a displacement; None of a copy, since a mesh belongs to one process.
        functionals: outputs of the scene; None where it has none.
    """

    problem: ContactProblem
    per_force: np.ndarray
    unloaded: np.ndarray
    stress_of: Callable[[np.ndarray, np.ndarray], np.ndarray] | None
    functionals: Functionals | None = None
    unbounded = "exact condensation has no reduction error"

    def __reduce__(self) -> tuple:
        """Copy and pickle by the arrays."""
        return ExactFields, (self.problem, self.per_force, self.unloaded, None, self.functionals)

    def estimate(self, answer: Answer) -> Estimate | None:
        """Exact, as the full model is."""
        return Estimate.exact(self.functionals) if answer.converged else None

    def displacement(self, answer: Answer) -> np.ndarray:
        """K^-1 (loads - B^T λ) and the lift, (N,); a model that answers with fields has it at hand."""
        theta, unknown = self.problem.amplitudes(answer.parameter), answer.unknown
        if unknown.size == 0:
            unknown = self.unloaded @ theta - self.per_force @ answer.multipliers
        return unknown + self.problem.lifts @ theta

    def stress(self, answer: Answer) -> np.ndarray:
        """Stress in the middle of each cell, Kelvin's notation.

        Raises:
            HHRError: for a copy.
        """
        if self.stress_of is None:
            raise HHRError("a copied model has no mesh, and stress needs one: ask the model it was copied from")
        return self.stress_of(self.displacement(answer), answer.parameter)

    @cached_property
    def _measures(self) -> tuple[np.ndarray, np.ndarray]:
        """Rows of the outputs times what each amplitude and each force does to the displacement."""
        assert self.functionals is not None
        rows = self.functionals.rows
        return np.asarray(rows @ self.unloaded + (rows @ self.problem.lifts).toarray()), rows @ self.per_force

    def measured(self, answer: Answer, theta: np.ndarray) -> np.ndarray:
        """Rows of the outputs times the displacement, (K,)."""
        if self.problem.rigid is not None:
            assert self.functionals is not None
            return self.functionals.rows @ self.displacement(answer)
        per_term, per_force = self._measures
        return per_term @ theta - per_force @ answer.multipliers

    def measured_changes(self, answer: Answer, changes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of all forces and of these products, see :class:`~models.functionals.MeasuredFields`."""
        assert answer.gradient is not None
        if self.problem.rigid is not None:
            assert self.functionals is not None
            moved = answer.gradient.unknown + self.problem.lifts @ changes
            return answer.gradient.multipliers, self.functionals.rows @ moved
        per_term, per_force = self._measures
        forces = answer.gradient.multipliers
        return forces, per_term @ changes - per_force @ forces


def exact_condensation(
    full: FullOrderModel, known: KnownStatuses, *, field: bool = True
) -> CondensedModel | VaryingModel:
    """Eliminate everything but the contact forces exactly; for constant stiffness only.

    The answer is that of the full model, to round-off. Serial, since it keeps whole columns of K^-1.

    Args:
        full: the full model on one rank.
        known: statuses of the training points, (S, N_lambda).
        field: compute the displacement with each answer; without it only when it is asked for, and a query costs less.
    """
    if full.comm.size > 1:
        raise SceneError("exact condensation is serial: give a full model on MPI.COMM_SELF")
    if full.equilibrium is not None:
        raise SceneError(
            f"bodies of scene '{full.scene.name}' flow: their stiffness changes, and no condensation is exact"
        )
    if full.problem.varies:
        raise SceneError(
            f"the stiffness of scene '{full.scene.name}' depends on parameters, and no condensation is exact then: "
            "interpolate it, training.condense()"
        )
    problem = full.problem
    conditions = len(problem.gaps)
    if not isinstance(known, KnownStatuses) or known.active.shape[1:] != (conditions,) or not known.active.size:
        raise SceneError(
            f"known, a {type(known).__name__}, must hold statuses of the {conditions} conditions of this scene at one "
            "point or more: snapshots.known_statuses()"
        )
    free = np.stack([full.solve_stiffness(column) for column in problem.loads.T.toarray()], axis=1)
    # only with the field is it known how far bodies moved that contact holds
    field = field or problem.rigid is not None
    responses = Responses(
        free_primal=free if field else free[:0],
        primal_per_force=full.per_force if field else full.per_force[:0],
        free_slack=problem.gaps - problem.contact @ free,
        schur=full.schur,
    )
    outputs: Any = full.functionals  # of one mesh: a scene with shapes was refused above
    fields = ExactFields(problem, full.per_force, free, full.stress_of, outputs)
    if problem.rigid is not None:
        return _floating(problem, problem.rigid, responses, known, fields)
    given = problem.parameters, problem.amplitudes, responses, known, fields
    return CondensedModel(*given, pairs=problem.contact_pairs)


def _floating(
    problem: ContactProblem, rigid: np.ndarray, responses: Responses, known: KnownStatuses, fields: ExactFields
) -> VaryingModel:
    """The same with rigid motions, (N, r), that nothing but contact holds."""
    from hhr_dolfinx.models.floating import FloatingResponses
    from hhr_dolfinx.models.varying import VaryingModel

    taken, driving = problem.contact @ rigid, rigid.T @ problem.loads
    left = FloatingResponses(responses, taken, driving, rigid, problem.amplitudes)
    return VaryingModel(problem.parameters, left, known, fields, problem.contact_pairs)
