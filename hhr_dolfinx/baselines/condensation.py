"""Exact condensation on the contact conditions: the rival without reduction error while the stiffness is constant."""

from __future__ import annotations

import numpy as np

from hhr_dolfinx.full_order.elastic import FullOrderModel
from hhr_dolfinx.models.condensed import CondensedContact, KnownStatuses, Responses


def exact_condensation(full_order: FullOrderModel, known: KnownStatuses, *, field: bool = True) -> CondensedContact:
    """Eliminate everything but the contact forces exactly; for constant stiffness only.

    The answer is that of the full model, to round-off: ``primal`` is U0 in the order of the dofs.
    Serial, since it keeps whole columns of K^-1.

    Args:
        full_order: the full model on one rank.
        known: statuses of the training points, (S, N_lambda).
        field: answer with the displacement; without it ``primal`` is empty and a query costs less.
    """
    if full_order.comm.size > 1:
        raise ValueError("exact condensation is serial: run it on one rank")
    problem = full_order.problem
    free = np.stack([full_order.solve_stiffness(column) for column in problem.loads.toarray().T], axis=1)
    responses = Responses(
        free_primal=free if field else free[:0],
        primal_per_force=full_order.per_force if field else full_order.per_force[:0],
        free_slack=problem.gaps - problem.contact @ free,
        schur=full_order.schur,
    )
    return CondensedContact(problem.parameters, problem.amplitudes, responses, known, pairs=problem.contact_pairs)
