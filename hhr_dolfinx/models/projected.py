"""What a projection on a RID leaves of the contact problem: small arrays, thesis (1.61), (5.23)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


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
