"""Other ways to answer the same question, each with the same ``solve(mu)``."""

from __future__ import annotations

import numpy as np
from scipy.sparse import bmat
from scipy.sparse.linalg import splu

from hhr_dolfinx.contact.active_set import active_set
from hhr_dolfinx.contact.condensed import CondensedContact, KnownStatuses, rejected
from hhr_dolfinx.contact.problem import ContactSolution
from hhr_dolfinx.full_order.elastic import FullOrderModel


class NaiveFullOrder:
    """The full problem as a first program would solve it: nothing is kept between queries.

    Each query assembles K anew, and each active-set iteration factors the saddle-point matrix
    ((K, B^T), (B, 0)) of its active contacts anew. Serial.

    Args:
        full_order: model whose scene is solved.
    """

    def __init__(self, full_order: FullOrderModel):
        if full_order.comm.size > 1:
            raise ValueError("the naive baseline is serial: run it on one rank")
        self._full = full_order

    def solve(self, mu, *, start=None, raise_on_failure: bool = True) -> ContactSolution:
        """Solve for one parameter; see :meth:`FullOrderModel.solve`."""
        problem = self._full.problem
        point = problem.parameters.point(mu)
        theta = problem.amplitudes(point)
        free = np.flatnonzero(problem.free)
        matrix = self._full.discretisation.assemble_stiffness()
        indptr, indices, data = matrix.getValuesCSR()
        matrix.destroy()
        stiffness = type(problem.stiffness)((data, indices, indptr))[free][:, free]
        # rows and forces scaled to the size of K: without it LU loses digits where E is large or small
        scale = stiffness.diagonal().mean()
        loads, gaps, contact = problem.loads[free] @ theta, problem.gaps @ theta, problem.contact[:, free]
        last = {}

        def saddle_point(active, _):
            rows = scale * contact[active]
            matrix = bmat([[stiffness, rows.T], [rows, None]], format="csc")
            solution = splu(matrix).solve(np.concatenate([loads, scale * gaps[active]]))
            forces = np.zeros(active.size)
            forces[active] = scale * solution[free.size :]
            last["free"] = solution[: free.size]
            slack = gaps - contact @ last["free"]
            slack[active] = 0.0
            return forces, slack

        if start is None:
            _, free_slack = saddle_point(np.zeros(gaps.size, dtype=bool), None)
            start = free_slack < 0
        found = active_set(saddle_point, gaps, start)
        primal = problem.lifts @ theta
        primal[free] += last["free"]
        solution = ContactSolution(primal, *found)
        return solution if solution.converged else rejected(solution, point, raise_on_failure)


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
    free = np.stack([full_order.solve_stiffness(column) for column in problem.loads.T], axis=1)
    return CondensedContact(
        problem.parameters,
        problem.amplitudes,
        free_primal=free if field else free[:0],
        primal_per_force=full_order.per_force if field else full_order.per_force[:0],
        free_slack=problem.gaps - problem.contact @ free,
        schur=full_order.schur,
        known=known,
    )
