"""Dofs that follow others by linear constraints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csc_matrix, csr_matrix, diags, identity, vstack

from hhr_dolfinx.group import ALONE, Group

ALL = slice(None)


@dataclass(frozen=True)
class Followers:
    """Dofs that follow others: U = T V, where V is zero on them; each process has all of T.

    Attributes:
        own: followers, (N,) bool.
        map: T, (N, N), with zero columns at the followers; None if no dof follows.
        cells: nodes that act on each other through followers, (groups, nodes), non-zero where a node is in a group.
        middle: positive shares of dofs whose contact conditions are parts of those at other nodes, (N, N); None for
            none.
    """

    own: np.ndarray
    map: csr_matrix | None = None
    cells: csr_matrix | None = None
    middle: csr_matrix | None = None

    @classmethod
    def nobody(cls, size: int) -> Followers:
        """Independent dofs, N of them."""
        return cls(np.zeros(size, dtype=bool))

    def expanded(self, fields: np.ndarray) -> np.ndarray:
        """T V of fields that are zero on the followers, (N, ...)."""
        return fields if self.map is None else self.map @ fields

    def forces(self, columns: csc_matrix, rows: slice = ALL, group: Group = ALONE) -> csc_matrix:
        """T^T F of forces, (N, k), or local rows of it, (own, k), by those of F. Collective."""
        if self.map is None:
            return columns
        return csc_matrix(self.transposed(rows) @ self._with_followers(csr_matrix(columns), rows, group))

    @property
    def everywhere(self) -> csr_matrix:
        """T, (N, N)."""
        return csr_matrix(identity(self.own.size)) if self.map is None else self.map

    def transposed(self, rows: slice = ALL) -> csr_matrix:
        """T^T, (N, N), or local rows of it, (own, N)."""
        return csr_matrix(self.everywhere[:, rows].T)

    def _with_followers(self, own: csr_matrix, rows: slice, group: Group) -> csr_matrix:
        """Local rows of a matrix, (own, k), and those of the followers on all processes, (N, k)."""
        if group.size == 1:
            return own
        every = group.stacked(csr_matrix(diags(self.own[rows].astype(float)) @ own))
        return csr_matrix(vstack([every[: rows.start], own, every[rows.stop :]]))

    def acting(self, rows: csr_matrix) -> csr_matrix:
        """B T of rows, (m, N)."""
        return rows if self.map is None else csr_matrix(rows @ self.map)

    def lifted(self, lifts: csc_matrix) -> csc_matrix:
        """Lifts, (N, 1 + T), with the followers of the dofs that these move."""
        if self.map is None:
            return lifts
        others = csc_matrix(diags((~self.own).astype(float)) @ lifts)
        return csc_matrix(lifts - others + self.map @ others)

    def of_stiffness(
        self, parts: Sequence[csr_matrix], rows: slice = ALL, group: Group = ALONE
    ) -> tuple[csr_matrix, ...]:
        """T^T K T, (N, N), or local rows of it, (own, N), by those of the parts of K; parts keep one pattern.

        Products of scipy have no zeros. Collective.
        """
        if self.map is None:
            return tuple(parts)
        known = parts[0]
        ones = csr_matrix((np.ones(known.nnz), known.indices, known.indptr), shape=known.shape)
        given = self.transposed(rows)
        pattern = csr_matrix(abs(given) @ (self._with_followers(ones, rows, group) @ abs(self.map)))
        pattern.sort_indices()
        keys = _keys(pattern)
        found = []
        for part in parts:
            made = csr_matrix(given @ (self._with_followers(part, rows, group) @ self.map))
            data = np.zeros(pattern.nnz)
            data[np.searchsorted(keys, _keys(made))] = made.data
            found.append(csr_matrix((data, pattern.indices, pattern.indptr), shape=pattern.shape))
        return tuple(found)

    def broken(self, fields: np.ndarray) -> np.ndarray:
        """Left sides less right sides of the equations for fields, (N, k): (followers, k)."""
        return fields[self.own] - self.expanded(np.where(self.own[:, None], 0.0, fields))[self.own]


def _keys(matrix: csr_matrix) -> np.ndarray:
    """Numbers of the entries of a matrix, which grow with its rows and sorted columns."""
    rows = np.repeat(np.arange(matrix.shape[0], dtype=np.int64), np.diff(matrix.indptr))
    return rows * matrix.shape[1] + matrix.indices
