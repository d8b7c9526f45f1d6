"""The hybrid hyper-reduced (HHR) model (1.61), (5.23): small arrays, one call per parameter.

Needs neither DOLFINx nor gmsh: a model read from a file answers on any machine with PETSc.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hhr_dolfinx.contact.condensed import CondensedContact, KnownStatuses, Responses
from hhr_dolfinx.contact.dense import Factorise, PetscLU
from hhr_dolfinx.parameters import Amplitudes, ParameterSpace
from hhr_dolfinx.trained import TrainedRange


@dataclass(frozen=True)
class ReducedProblem:
    """Find gamma and lambda >= 0 with K~ gamma + B~1^T lambda = loads θ, B~2 gamma <= gaps θ, thesis (5.23).

    A generalised saddle point (5.27): where conditions of the RID touch its interface B~1 and B~2 differ;
    elsewhere they are the same and it is (1.61).

    Attributes:
        stiffness: K~ = V[A]^T K[A, A u I] V[A u I], (1.63), (ell, ell), not symmetric.
        contact_test: B~1 = B[A_lambda, A_c] V[A_c], (5.26), (N_lambda_C, ell): how forces act.
        contact_trial: B~2 = B[A_lambda, A_c~] V[A_c~], (5.26), (N_lambda_C, ell): how gaps are read.
        loads: V[A]^T loads[A], (ell, 1 + T).
        gaps: gaps[A_lambda], (N_lambda_C, 1 + T).
    """

    stiffness: np.ndarray
    contact_test: np.ndarray
    contact_trial: np.ndarray
    loads: np.ndarray
    gaps: np.ndarray


class ReducedModel(CondensedContact):
    """HHR model: from a parameter to (gamma, lambda on A_lambda), (5.23) with gamma eliminated.

    Args:
        problem: the projected arrays.
        parameters: the box of the parameters.
        amplitudes: θ as a function of the parameters.
        known: statuses of the training points on A_lambda.
        factorise: what factors K~ and the active blocks.
        trained: the trained parameters.

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
        trained: TrainedRange | None = None,
    ):
        self.problem = problem
        contact = problem.contact_test, problem.contact_trial
        responses = Responses.eliminate(factorise(problem.stiffness), problem.loads, problem.gaps, *contact)
        super().__init__(parameters, amplitudes, responses, known, factorise, trained)
