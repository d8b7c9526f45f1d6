"""Dofs that loose equations determine: rigid and distributing couplings, of which others may imply
a part.

A rigid coupling with nodes on a plane of symmetry, or a rigid surface whose motion is imposed, has
equations that determine one dof of several, or that the others imply. Such dofs are found by
elimination with pivoting.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import qr
from scipy.sparse import csc_matrix, csr_matrix, identity
from scipy.sparse.linalg import SuperLU, splu

IMPLIED = 1e-9
"""Pivot, of equations with largest coefficients of 1, up to which an equation is implied by the
others.
"""
SAME_SIZE = 1e-9
"""Relative difference up to which two coefficients are as large as each other."""


def first_largest(sizes: np.ndarray) -> np.ndarray:
    """Number of the largest size of each row, (..., n): of equal ones the first.

    Round-off must not choose between them: on another shape, or processor, another dof would
    be determined.
    """
    return np.argmax(sizes >= (1 - SAME_SIZE) * sizes.max(axis=-1, keepdims=True), axis=-1)


def chosen(
    rows: csr_matrix, dependent: np.ndarray, loose: np.ndarray, free: np.ndarray
) -> tuple[np.ndarray, csr_matrix]:
    """Dofs that equations determine, (k,), with -1 for implied equations.

    Loose equations keep their dof if it is free and no other equation determines it.

    Args:
        rows: coefficients of the equations, (k, N).
        dependent: dof that each equation determines, (k,).
        loose: equations that may determine another one of their dofs, (k,) bool.
        free: True for dofs that are not imposed, (N,) bool.

    Returns:
        The dofs, and combinations of equations without free dofs, (implied, k).
    """
    order = np.argsort(loose, kind="stable")
    _, first = np.unique(dependent[order], return_index=True)
    keeps = np.zeros(dependent.size, dtype=bool)
    keeps[order[first]] = True
    undecided = loose & ~(keeps & (dependent >= 0))
    factors = _factors(rows, dependent, ~undecided)
    if factors is None:
        undecided = loose
        factors = _factors(rows, dependent, ~undecided)
    if factors is None or not undecided.any():
        return dependent, csr_matrix((0, dependent.size))
    return _eliminated(rows, dependent, undecided, free, factors)


def _factors(rows: csr_matrix, dependent: np.ndarray, fixed: np.ndarray) -> SuperLU | None:
    """Factors of equations in their dofs, of the identity if there are none.

    None if they depend on each other.
    """
    block = csc_matrix(rows[fixed][:, dependent[fixed]]) if fixed.any() else csc_matrix(identity(1))
    try:
        factors = splu(block)
    except RuntimeError:  # singular in structure
        return None
    return factors if np.abs(factors.U.diagonal()).min() > IMPLIED else None


def _eliminated(
    rows: csr_matrix,
    dependent: np.ndarray,
    undecided: np.ndarray,
    free: np.ndarray,
    factors: SuperLU,
) -> tuple[np.ndarray, csr_matrix]:
    """See :func:`chosen`; ``factors`` are those of the decided equations."""
    fixed = ~undecided
    numbers = np.flatnonzero(undecided)
    multipliers = np.zeros((numbers.size, int(fixed.sum())))
    if fixed.any():
        coefficients = rows[undecided][:, dependent[fixed]].toarray()
        multipliers = factors.solve(np.ascontiguousarray(coefficients.T), trans="T").T
    remaining = csc_matrix(rows[undecided] - csr_matrix(multipliers) @ rows[fixed])
    open_dofs = free.copy()
    open_dofs[dependent[fixed]] = False
    columns = np.flatnonzero((np.diff(remaining.indptr) > 0) & open_dofs)
    dense = remaining[:, columns].toarray() if columns.size else np.zeros((numbers.size, 1))
    _, triangle, order = qr(dense.T, mode="economic", pivoting=True)
    count = int((np.abs(np.diag(triangle)) > IMPLIED).sum())
    independent = order[:count]
    implied = order[count:]
    chosen_dofs = dependent.copy()
    chosen_dofs[numbers] = -1
    if count:
        _, _, pivots = qr(dense[independent], mode="economic", pivoting=True)
        chosen_dofs[numbers[independent]] = columns[pivots[:count]]
    shares = (
        np.linalg.lstsq(dense[independent].T, dense[implied].T, rcond=None)[0].T
        if count
        else np.zeros((implied.size, 0))
    )
    combined = np.zeros((implied.size, dependent.size))
    combined[np.arange(implied.size), numbers[implied]] = 1.0
    combined[:, numbers[independent]] -= shares
    combined[:, fixed] = shares @ multipliers[independent] - multipliers[implied]
    return chosen_dofs, csr_matrix(combined)
