"""Dofs that follow others by linear constraints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csc_matrix, csr_matrix, diags


def _keys(matrix: csr_matrix) -> np.ndarray:
    """Numbers that grow along the entries of a matrix with sorted indices."""
    rows = np.repeat(np.arange(matrix.shape[0], dtype=np.int64), np.diff(matrix.indptr))
    return rows * matrix.shape[1] + matrix.indices


@dataclass(frozen=True)
class Followers:
    """Dofs that follow others: U = T V, where V is zero on them.

    Attributes:
        map: T, (N, N), with zero columns at the followers.
        own: followers, (N,) bool.
        cells: nodes that act on each other through followers, (groups, nodes), non-zero where a node is in a group.
    """

    map: csr_matrix
    own: np.ndarray
    cells: csr_matrix

    def lifted(self, lifts: csc_matrix) -> csc_matrix:
        """Lifts, (N, 1 + T), with the followers of the dofs that these move."""
        others = csc_matrix(diags((~self.own).astype(float)) @ lifts)
        return csc_matrix(lifts - others + self.map @ others)

    def of_stiffness(self, parts: Sequence[csr_matrix]) -> tuple[csr_matrix, ...]:
        """T^T K T of the parts of K, which keep one pattern: products of scipy have no zeros."""
        known = parts[0]
        ones = csr_matrix((np.ones(known.nnz), known.indices, known.indptr), shape=known.shape)
        pattern = csr_matrix(abs(self.map).T @ (ones @ abs(self.map)))
        pattern.sort_indices()
        keys = _keys(pattern)
        found = []
        for part in parts:
            made = csr_matrix(self.map.T @ (part @ self.map))
            data = np.zeros(pattern.nnz)
            data[np.searchsorted(keys, _keys(made))] = made.data
            found.append(csr_matrix((data, pattern.indices, pattern.indptr), shape=pattern.shape))
        return tuple(found)

    def broken(self, motions: np.ndarray) -> np.ndarray:
        """How far fields, (N, k), break the equations, (followers, k)."""
        return motions[self.own] - (self.map @ np.where(self.own[:, None], 0.0, motions))[self.own]
