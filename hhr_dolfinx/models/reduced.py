"""The hybrid hyper-reduced (HHR) model (1.61), (5.23): small arrays, one call per parameter.

Needs neither DOLFINx nor gmsh nor PETSc: a model read from a file answers on any machine with NumPy and SciPy.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from hhr_dolfinx.contact.problem import Status
from hhr_dolfinx.errors import SingularError
from hhr_dolfinx.linear.dense import Factorise, dense_factors
from hhr_dolfinx.models.condensed import CondensedContact, KnownStatuses, Responses
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
        pairs: number of the contact pair of each condition, (N_lambda_C,).
    """

    stiffness: np.ndarray
    contact_test: np.ndarray
    contact_trial: np.ndarray
    loads: np.ndarray
    gaps: np.ndarray
    pairs: np.ndarray


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
        SingularError: if K~ is singular.
    """

    advice: ClassVar[Mapping[Status, str]] = {
        Status.SINGULAR: "add modes or use fewer contact points in the RID",
        Status.CYCLING: "the reduced model is not trustworthy here, add RID layers or change the basis",
    }

    def __init__(
        self,
        problem: ReducedProblem,
        parameters: ParameterSpace,
        amplitudes: Amplitudes,
        known: KnownStatuses,
        factorise: Factorise = dense_factors,
        trained: TrainedRange | None = None,
    ):
        self.problem = problem
        try:
            factor = factorise(problem.stiffness)
        except SingularError as error:
            raise SingularError(f"K~ cannot be eliminated, {error}: add RID layers or use fewer modes") from error
        contact = problem.contact_test, problem.contact_trial
        responses = Responses.eliminate(factor, problem.loads, problem.gaps, *contact)
        super().__init__(parameters, amplitudes, responses, known, factorise, problem.pairs, trained)

    def __reduce__(self):
        """Copy and pickle by the projected arrays."""
        return type(self), (self.problem, self.parameters, self.amplitudes, self.known, self._factorise, self.trained)
