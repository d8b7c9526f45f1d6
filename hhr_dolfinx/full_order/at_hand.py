"""The stiffness whose factors a full model holds, where it depends on parameters."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_matrix


class AtHand(NamedTuple):
    """A stiffness that was factored, and what it leaves of contact.

    Attributes:
        weights: of the parts of K, (Q,).
        stiffness: own rows of it, (own dofs, N).
        per_force: K^-1 B^T, (own dofs, m); None where it takes solutions.
        schur: S, (m, m).
    """

    weights: np.ndarray
    stiffness: csr_matrix
    per_force: np.ndarray | None
    schur: np.ndarray
