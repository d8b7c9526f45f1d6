"""Petrov-Galerkin projection of the contact problem on a RID, thesis (1.61), (5.23)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.sparse import csc_matrix, csr_matrix

from hhr_dolfinx.contact.problem import ContactProblem, IndexSets
from hhr_dolfinx.errors import ReductionError
from hhr_dolfinx.models.projected import ReducedProblem, ReducedTerms
from hhr_dolfinx.reduction.rid import open_conditions

NO_WORK = 1e-9
"""Part of the largest work of a unit force along a rigid motion below which a condition has nothing to do with it."""


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

    reduced = ReducedProblem(
        stiffness=projected(problem.stiffness),
        contact_test=rows[:, sets.A_c] @ basis[sets.A_c],
        contact_trial=rows[:, sets.A_c_tilde] @ basis[sets.A_c_tilde],
        loads=test.T @ problem.loads[sets.A],
        gaps=problem.gaps[sets.A_lambda] + 0.0,  # files keep zeros with a sign
        pairs=problem.contact_pairs[sets.A_lambda],
        motions=0 if problem.rigid is None else problem.rigid.shape[1],
        terms=_terms(problem, projected, lambda columns: test.T @ columns[sets.A]) if problem.moduli else None,
    )
    return reduced if problem.rigid is None else _balanced(problem, basis, sets, reduced)


def _balanced(problem: ContactProblem, basis: np.ndarray, sets: IndexSets, reduced: ReducedProblem) -> ReducedProblem:
    """The same with the balance of whole bodies in the place of tests by their motions, the first modes, on A alone.

    All conditions that hold the bodies are in the RID, so that none of their forces is left out; along a rigid motion K
    does no work. Cut off outside A a motion would strain cells there, and forces would balance what projection leaves.
    """
    r, motions = reduced.motions, basis[:, : reduced.motions]
    acting = np.setdiff1d(holding(problem), sets.A_lambda)
    if acting.size:
        raise ReductionError(
            f"{acting.size} contact conditions that hold a body are outside the RID, e.g. the one at "
            f"{problem.contact_points[acting[0]].tolist()}: nothing else holds it, so that all must be in it"
        )
    loads = motions.T @ problem.loads
    stiffness, test, forces = reduced.stiffness.copy(), reduced.contact_test.copy(), reduced.loads.copy()
    stiffness[:r], stiffness[:, :r] = 0.0, 0.0
    test[:, :r], forces[:r] = reduced.contact_trial[:, :r], loads
    terms = reduced.terms
    if terms is not None:
        parts, lifts, sums = terms.stiffness.copy(), terms.lifts.copy(), terms.forces.copy()
        parts[:, :r], parts[:, :, :r], lifts[:, :r], sums[:r] = 0.0, 0.0, 0.0, loads
        terms = replace(terms, stiffness=parts, lifts=lifts, forces=sums)
    return replace(reduced, stiffness=stiffness, contact_test=test, loads=forces, terms=terms)


def holding(problem: ContactProblem) -> np.ndarray:
    """Numbers of the conditions that hold bodies which nothing else holds."""
    if problem.rigid is None:
        return np.zeros(0, dtype=np.int64)
    work = np.abs(problem.contact @ problem.rigid)
    return np.flatnonzero(work.max(axis=1) > NO_WORK * work.max())


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
