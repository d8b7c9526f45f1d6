"""Effectivity from above: the most by which a bound of forces may exceed their error.

For forces λ' >= 0 with the slack s in equilibrium with them |λ' - λ|_S <= |r|_{S^-1}, r = s where a
force is positive or s negative (docs/bounds_proofs.md). If λ and λ' are positive on conditions A
and zero on the others, where s >= 0,

    |λ' - λ|_S² = r·S_AA^-1 r,    |r|_{S^-1}² = r·(S^-1)_AA r,

so that the ratio is at most (1 - γ²)^(-1/2), with γ < 1 the cosine in the scalar product of S
between forces on A and on the other conditions I,

    γ² = λ_max(S_AA^-1 S_AI S_II^-1 S_IA).
"""

from __future__ import annotations

import numpy as np
from scipy import linalg


def largest_effectivity(schur: np.ndarray, closed: np.ndarray) -> float:
    """(1 - γ²)^(-1/2), which some r attains; 1 if all conditions are closed, or none.

    Args:
        schur: S, symmetric and positive definite, (m, m).
        closed: the statuses, (m,) bool.
    """
    if closed.all() or not closed.any():
        return 1.0
    across = schur[np.ix_(~closed, closed)]
    rows = linalg.solve_triangular(
        linalg.cholesky(schur[np.ix_(~closed, ~closed)], lower=True), across, lower=True
    )
    rows = linalg.solve_triangular(
        linalg.cholesky(schur[np.ix_(closed, closed)], lower=True), rows.T, lower=True
    )
    cosine = float(np.linalg.norm(rows, 2))
    return (1 - cosine**2) ** -0.5
