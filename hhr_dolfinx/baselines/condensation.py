"""Exact condensation on the contact conditions: the rival without reduction error while the stiffness is constant."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.full_order.full import FullOrderModel
from hhr_dolfinx.models.answer import Answer, ElasticFields
from hhr_dolfinx.models.condensed import CondensedModel, KnownStatuses, Responses


@dataclass(frozen=True)
class ExactFields(ElasticFields):
    """What completes answers of exact condensation, see :class:`hhr_dolfinx.models.answer.Fields`.

    Attributes:
        full: the full model.
        unloaded: K^-1 loads, (N, 1 + T).
    """

    full: FullOrderModel
    unloaded: np.ndarray

    def displacement(self, answer: Answer) -> np.ndarray:
        """K^-1 (loads - B^T λ) and the lift, (N,); a model that answers with fields has it at hand."""
        problem, unknown = self.full.problem, answer.unknown
        theta = problem.amplitudes(answer.parameter)
        if unknown.size == 0:
            unknown = self.unloaded @ theta - self.full.per_force @ answer.multipliers
        return unknown + problem.lifts @ theta

    def stress(self, answer: Answer) -> np.ndarray:
        """Stress in the middle of each cell, Kelvin's notation."""
        return self.full.stress_of(self.displacement(answer))


def exact_condensation(full: FullOrderModel, known: KnownStatuses, *, field: bool = True) -> CondensedModel:
    """Eliminate everything but the contact forces exactly; for constant stiffness only.

    The answer is that of the full model, to round-off. Serial, since it keeps whole columns of K^-1.

    Args:
        full: the full model on one rank.
        known: statuses of the training points, (S, N_lambda).
        field: compute the displacement with each answer; without it only when it is asked for, and a query costs less.

    Raises:
        SceneError: on several ranks, or where bodies flow.
    """
    if full.comm.size > 1:
        raise SceneError("exact condensation is serial: give a full model on MPI.COMM_SELF")
    if full.equilibrium is not None:
        raise SceneError(
            f"bodies of scene '{full.scene.name}' flow: their stiffness changes, and no condensation is exact"
        )
    problem = full.problem
    free = np.stack([full.solve_stiffness(column) for column in problem.loads.T.toarray()], axis=1)
    responses = Responses(
        free_primal=free if field else free[:0],
        primal_per_force=full.per_force if field else full.per_force[:0],
        free_slack=problem.gaps - problem.contact @ free,
        schur=full.schur,
    )
    fields = ExactFields(full, free)
    given = problem.parameters, problem.amplitudes, responses, known, fields
    return CondensedModel(*given, pairs=problem.contact_pairs)
