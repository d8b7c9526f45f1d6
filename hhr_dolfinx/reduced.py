"""The hybrid hyper-reduced (HHR) model (1.61): small arrays, one call per parameter.

Needs neither DOLFINx nor gmsh: a model read from a file answers on any machine with PETSc.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hhr_dolfinx.condensed import CondensedContact, KnownStatuses
from hhr_dolfinx.dense import Factorise, PetscLU, solve_columns
from hhr_dolfinx.parameters import Amplitudes, ParameterSpace
from hhr_dolfinx.problem import ContactProblem, ContactSolution
from hhr_dolfinx.rid import IndexSets


@dataclass(frozen=True)
class ReducedProblem:
    """Find gamma and lambda >= 0 with K~ gamma + B~^T lambda = loads θ, B~ gamma <= gaps θ, thesis (1.61).

    Attributes:
        stiffness: K~ = V[A]^T K[A, A u I] V[A u I], (1.63), (ell, ell), not symmetric.
        contact: B~ = B[A_lambda, A_c] V[A_c], (1.63), (N_lambda_C, ell).
        loads: V[A]^T loads[A], (ell, 1 + T).
        gaps: gaps[A_lambda], (N_lambda_C, 1 + T).
    """

    stiffness: np.ndarray
    contact: np.ndarray
    loads: np.ndarray
    gaps: np.ndarray


def project(problem: ContactProblem, basis: np.ndarray, sets: IndexSets) -> ReducedProblem:
    """Petrov-Galerkin projection of (1.21) on the RID, thesis (1.61).

    The test functions are the modes cut off outside A; the trial functions are the whole modes. A
    Galerkin projection of K with restricted multipliers would be inconsistent.

    Args:
        problem: the full problem.
        basis: V, (N, ell), zero on imposed dofs.
        sets: index sets of the RID.
    """
    support = np.union1d(sets.A, sets.I)
    test = basis[sets.A]
    return ReducedProblem(
        stiffness=test.T @ (problem.stiffness[sets.A][:, support] @ basis[support]),
        contact=problem.contact[sets.A_lambda][:, sets.A_c] @ basis[sets.A_c],
        loads=test.T @ problem.loads[sets.A],
        gaps=problem.gaps[sets.A_lambda],
    )


class ReducedModel:
    """HHR model: from a parameter to (gamma, lambda on A_lambda).

    Args:
        problem: the projected arrays.
        parameters: the box of the parameters.
        amplitudes: θ as a function of the parameters.
        known: statuses of the training points on A_lambda.
        factorise: what factors K~ and the active blocks.

    Raises:
        NotSolvableError: if K~ is singular.
    """

    def __init__(
        self,
        problem: ReducedProblem,
        parameters: ParameterSpace,
        amplitudes: Amplitudes,
        known: KnownStatuses,
        factorise: Factorise = PetscLU,
    ):
        self.problem, self.known = problem, known
        factor = factorise(problem.stiffness)
        per_force, free = solve_columns(factor, problem.contact.T), solve_columns(factor, problem.loads)
        self._online = CondensedContact(
            parameters,
            amplitudes,
            free_primal=free,
            primal_per_force=per_force,
            free_slack=problem.gaps - problem.contact @ free,
            schur=problem.contact @ per_force,
            known=known,
            factorise=factorise,
        )
        self.parameters, self.amplitudes = parameters, amplitudes

    def solve(self, mu, *, warm: bool = True, raise_on_failure: bool = True) -> ContactSolution:
        """Coordinates gamma (ell,) and contact forces on A_lambda; see :meth:`CondensedContact.solve`."""
        return self._online.solve(mu, warm=warm, raise_on_failure=raise_on_failure)
