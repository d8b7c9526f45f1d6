"""Petrov-Galerkin projection of the contact problem on a RID, thesis (1.61), (5.23)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.sparse import csc_matrix, csr_matrix

from hhr_dolfinx.contact.problem import ContactProblem, IndexSets
from hhr_dolfinx.errors import ReductionError
from hhr_dolfinx.models.projected import ReducedProblem, ReducedTerms
from hhr_dolfinx.reduction.rid import open_conditions


def project(problem: ContactProblem, basis: np.ndarray, sets: IndexSets) -> ReducedProblem:
    """Petrov-Galerkin projection of (1.21) on a basis V, (N, ell), and a closed RID, thesis (1.61), (5.23).

    The test functions are the modes cut off outside A; the trial functions are the whole modes. A
    Galerkin projection of K with restricted multipliers would be inconsistent.
    """
    opened = open_conditions(problem, sets)
    if opened.size:
        raise ReductionError(
            f"the RID is not closed: {opened.size} contact conditions outside it act on its inner nodes, e.g. the one "
            f"at {problem.contact_points[opened[0]].tolist()}; build it with reduced_domain"
        )
    rows = problem.contact[sets.A_lambda]
    support = np.union1d(sets.A, sets.I)
    test = basis[sets.A]

    def projected(stiffness: csr_matrix) -> np.ndarray:
        return test.T @ (stiffness[sets.A][:, support] @ basis[support])

    return ReducedProblem(
        stiffness=projected(problem.stiffness),
        contact_test=rows[:, sets.A_c] @ basis[sets.A_c],
        contact_trial=rows[:, sets.A_c_tilde] @ basis[sets.A_c_tilde],
        loads=test.T @ problem.loads[sets.A],
        gaps=problem.gaps[sets.A_lambda],
        pairs=problem.contact_pairs[sets.A_lambda],
        terms=_terms(problem, projected, lambda columns: test.T @ columns[sets.A]) if problem.moduli else None,
    )


def _terms(
    problem: ContactProblem,
    projected: Callable[[csr_matrix], np.ndarray],
    tested: Callable[[csc_matrix], np.ndarray],
) -> ReducedTerms:
    """Parts of K~ and of its loads, from what projects a stiffness and what tests columns of dofs."""
    weights = problem.weights(problem.middle)
    lifts = np.stack([tested(term) for term in problem.lift_terms])
    forces = tested(problem.loads) + np.tensordot(weights, lifts, 1)
    stiffness = np.stack([projected(term) for term in problem.stiffness_terms])
    return ReducedTerms(stiffness, lifts, forces, problem.moduli)
