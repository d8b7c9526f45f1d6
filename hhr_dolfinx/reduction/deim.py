"""Discrete empirical interpolation, thesis Alg. 1.2."""

from __future__ import annotations

import numpy as np

from hhr_dolfinx.errors import ReductionError


def deim(basis: np.ndarray) -> np.ndarray:
    """Interpolation points of an ordered basis, one per column.

    Args:
        basis: (N, ell) with independent columns, most important first.

    Returns:
        Row indices in the order they are found, (ell,); ``basis[indices]`` is invertible.

    Raises:
        ReductionError: if the columns are dependent.

    Example:
        >>> deim(np.array([[1.0, 0.0], [0.5, 1.0], [0.0, 0.2]]))
        array([0, 1])
    """
    points: list[int] = []
    for k, mode in enumerate(basis.T):
        residual = mode
        if points:
            weights = np.linalg.solve(basis[points, :k], mode[points])
            residual = mode - basis[:, :k] @ weights
        point = int(np.argmax(np.abs(residual)))
        if not abs(residual[point]) > 1e-13 * np.abs(mode).max():
            raise ReductionError(f"column {k} of the basis depends on the columns before it")
        points.append(point)
    return np.array(points, dtype=np.int64)
