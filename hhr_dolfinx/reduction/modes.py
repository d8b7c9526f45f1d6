"""Modes of snapshots.

Proper orthogonal decomposition, thesis (1.49)-(1.54), and empirical interpolation, Alg. 1.2.
"""

from __future__ import annotations

import numpy as np
from scipy import linalg
from scipy.sparse import csr_matrix

from hhr_dolfinx.errors import ReductionError
from hhr_dolfinx.linear.rows import Rows


def pod(
    snapshots: np.ndarray,
    tolerance: float,
    gram: csr_matrix | None = None,
    rows: Rows | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Leading left singular vectors, (1.53).

    They leave out less than ``tolerance`` of the squared sum.

    Args:
        snapshots: (N, S), one column per snapshot.
        tolerance: epsilon, in (0, 1).
        gram: sparse Gram matrix of the norm in which the sum is measured, (N, N); None for the
            Euclidean one.
        rows: local rows of the snapshots and modes, if these are distributed over ranks; None for
            all.

    Returns:
        ``(modes, singular_values)``: modes (N, ell) with orthonormal columns, and all singular
        values.

    Raises:
        ReductionError: for a tolerance outside (0, 1), fewer than two snapshots, or snapshots that
            are not finite or all zero.

    Example:
        >>> modes, values = pod(np.array([[3.0, 0.0], [0.0, 4.0], [0.0, 0.0]]), 0.5)
        >>> np.abs(modes).T, values
        (array([[0., 1., 0.]]), array([4., 3.]))
    """
    if not 0 < tolerance < 1:
        raise ReductionError(f"the POD tolerance {tolerance} must lie in (0, 1)")
    if snapshots.shape[1] < 2:
        raise ReductionError(
            f"{snapshots.shape[1]} snapshot cannot span a reduced basis: train on at least 2"
        )
    rows = Rows(slice(0, len(snapshots)), len(snapshots)) if rows is None else rows
    if rows.sum(float(not np.isfinite(snapshots).all())):
        raise ReductionError("the snapshots are not finite")
    modes, values, noise = _decomposed(snapshots, gram, rows)
    if values[0] == 0:
        raise ReductionError(
            "all snapshots are zero: the loads of the scene do nothing on the training points"
        )
    left_out = np.append(np.cumsum((values**2)[::-1])[::-1], 0.0) / np.sum(values**2)
    # singular values below round-off are noise, however small the tolerance
    count = min(int(np.argmax(left_out < tolerance)), int((values > values[0] * noise).sum()))
    chosen = modes[:, :count] if gram is None else rows.orthonormal(modes[:, :count])[0]
    return np.ascontiguousarray(chosen), values


def _decomposed(
    snapshots: np.ndarray, gram: csr_matrix | None, rows: Rows
) -> tuple[np.ndarray, np.ndarray, float]:
    """Left singular vectors, singular values, and their round-off.

    The latter is the relative size below which values are round-off.

    With a Gram matrix by the method of snapshots, whose squares lose half of the digits.
    """
    noise = np.finfo(float).eps * max(rows.count, snapshots.shape[1])
    if gram is None and rows.all_here:
        modes, values, _ = linalg.svd(snapshots, full_matrices=False)
        return modes, values, noise
    if gram is None:
        modes, triangle = rows.orthonormal(snapshots)
        turns, values, _ = rows.first(linalg.svd(triangle, full_matrices=False))
        return modes @ turns, values, noise
    squares, weights = rows.first(linalg.eigh(rows.sum(snapshots.T @ (gram @ snapshots))))
    values = np.sqrt(np.maximum(squares[::-1], 0.0))
    return snapshots @ weights[:, ::-1], values, np.sqrt(noise)


def deim(basis: np.ndarray, rows: Rows | None = None) -> np.ndarray:
    """Interpolation points of an ordered basis, one per column.

    Args:
        basis: (N, ell) with independent columns, most important first.
        rows: local rows of the basis, if it is distributed over ranks; None for all.

    Returns:
        Row indices in the order they are found, (ell,); ``basis[indices]`` is invertible.

    Raises:
        ReductionError: if the columns are dependent.

    Example:
        >>> deim(np.array([[1.0, 0.0], [0.5, 1.0], [0.0, 0.2]]))
        array([0, 1])
    """
    rows = Rows(slice(0, len(basis)), len(basis)) if rows is None else rows
    points: list[int] = []
    picked = np.zeros((0, basis.shape[1]))  # the basis at these points
    for k, mode in enumerate(basis.T):
        residual = mode
        if points:
            residual = mode - basis[:, :k] @ np.linalg.solve(picked[:, :k], picked[:, k])
        point, size = rows.largest(np.abs(residual))
        if not size > 1e-13 * rows.largest(np.abs(mode))[1]:
            raise ReductionError(f"column {k} of the basis depends on the columns before it")
        points.append(point)
        picked = np.vstack([picked, rows.at(basis, np.array([point]))])
    return np.array(points, dtype=np.int64)
