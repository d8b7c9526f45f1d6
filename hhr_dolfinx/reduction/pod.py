"""Proper orthogonal decomposition of snapshots, thesis (1.49)-(1.54)."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import linalg

from hhr_dolfinx.errors import ReductionError


def pod(snapshots: np.ndarray, tolerance: float, gram: Any = None) -> tuple[np.ndarray, np.ndarray]:
    """Leading left singular vectors that leave out less than ``tolerance`` of the squared sum, (1.53).

    Args:
        snapshots: (N, S), one column per snapshot.
        tolerance: epsilon, in (0, 1).
        gram: sparse Gram matrix of the norm in which the sum is measured, (N, N); None for the Euclidean one.

    Returns:
        ``(modes, singular_values)``: modes (N, ell) with orthonormal columns, and all singular values.

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
        raise ReductionError(f"{snapshots.shape[1]} snapshot cannot span a reduced basis: train on at least 2")
    if not np.isfinite(snapshots).all():
        raise ReductionError("the snapshots are not finite")
    modes, values, noise = _decomposed(snapshots, gram)
    if values[0] == 0:
        raise ReductionError("all snapshots are zero: the loads of the scene do nothing on the training points")
    left_out = np.append(np.cumsum((values**2)[::-1])[::-1], 0.0) / np.sum(values**2)
    # singular values below round-off are noise, however small the tolerance
    rank = int((values > values[0] * noise).sum())
    count = min(int(np.argmax(left_out < tolerance)), rank)
    chosen = modes[:, :count] if gram is None else linalg.qr(modes[:, :count], mode="economic")[0]
    return np.ascontiguousarray(chosen), values


def _decomposed(snapshots: np.ndarray, gram: Any) -> tuple[np.ndarray, np.ndarray, float]:
    """Left singular vectors, singular values, and the relative size below which these are round-off.

    In the norm of a Gram matrix by the method of snapshots, whose squares lose half of the digits.
    """
    if gram is None:
        modes, values, _ = linalg.svd(snapshots, full_matrices=False)
        return modes, values, np.finfo(float).eps * max(snapshots.shape)
    squares, weights = linalg.eigh(snapshots.T @ (gram @ snapshots))
    values = np.sqrt(np.maximum(squares[::-1], 0.0))
    return snapshots @ weights[:, ::-1], values, np.sqrt(np.finfo(float).eps * max(snapshots.shape))
