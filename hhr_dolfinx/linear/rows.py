"""Operations on tables with a row for each dof, (N, k), of which each rank stores the rows of its dofs.

Ranks exchange small arrays: products of tables, (k, k), rows at some dofs, and rows that a sparse matrix needs.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from scipy import linalg
from scipy.sparse import csr_matrix

if TYPE_CHECKING:
    from mpi4py.MPI import Comm

PANEL = 32
"""Columns in one exchange of rows between neighbours."""


class Rows:
    """Local rows of a rank, and operations on tables of them as if all rows were local. Collective, except ``of``.

    The range ``own`` of this rank follows that of the rank before it; ``count`` is N, that of all rows.
    """

    def __init__(self, own: slice, count: int, comm: Comm | None = None) -> None:
        self.own = own
        self.count = count
        self.comm = None if comm is None or comm.size == 1 else comm

    def sum(self, part: Any) -> Any:
        """Sum over the ranks of a number or an array of real numbers, of the same shape on each rank."""
        if self.comm is None:
            return part
        given = np.ascontiguousarray(part, dtype=float)
        found = np.empty_like(given)
        self.comm.Allreduce(given, found)
        return found.reshape(np.shape(part)) if np.ndim(part) else float(found[0])

    def of(self, table: Any) -> Any:
        """Local rows of a table that has all rows."""
        return table if self.comm is None else table[self.own]

    def mine(self, places: np.ndarray) -> np.ndarray:
        """Select the local ones of some rows, (n,), as indices in the local rows."""
        if self.comm is None:
            return places
        return places[(places >= self.own.start) & (places < self.own.stop)] - self.own.start

    def at(self, table: np.ndarray, places: np.ndarray) -> np.ndarray:
        """Some rows of a table, (n, ...), on all ranks."""
        if self.comm is None:
            return table[places]
        found = np.zeros((len(places), *table.shape[1:]))
        here = (places >= self.own.start) & (places < self.own.stop)
        found[here] = table[places[here] - self.own.start]
        return self.sum(found)

    def whole(self, table: np.ndarray) -> np.ndarray:
        """Gather a vector, (own,), or a table, (own, k), with the rows of all ranks, in Fortran order."""
        if self.comm is None:
            return table
        if table.ndim == 1:
            return self.whole(table[:, None])[:, 0]
        ends = np.cumsum([0, *self.comm.allgather(len(table))])
        found = np.empty((self.count, table.shape[1]), order="F")
        for first in range(0, table.shape[1], PANEL):
            panel = found[:, first : first + PANEL]
            own = np.ascontiguousarray(table[:, first : first + PANEL].T, dtype=float)
            every = np.empty(panel.size)
            self.comm.Allgatherv(own, (every, np.diff(ends) * panel.shape[1]))
            parts = np.split(every, ends[1:-1] * panel.shape[1])
            for start, end, part in zip(ends[:-1], ends[1:], parts, strict=True):
                panel[start:end] = part.reshape(panel.shape[1], -1).T
        return found

    def largest(self, values: np.ndarray) -> tuple[int, float]:
        """Index of the largest of some values, one for each row, and this value; the first of equal values."""
        place = int(values.argmax()) if values.size else 0
        if self.comm is None:
            return place, float(values[place])
        best = (float(values[place]), -(place + self.own.start)) if values.size else (-np.inf, 0)
        value, place = max(self.comm.allgather(best))
        return -place, value

    def first(self, value: object) -> Any:
        """Small value of the first rank, broadcast to all: other ranks may have other last digits."""
        return value if self.comm is None else self.comm.bcast(value)

    def alike(self, value: object) -> bool:
        """True if a small value is the same on all ranks."""
        return self.comm is None or len(set(self.comm.allgather(value))) == 1

    def norms(self, table: np.ndarray) -> np.ndarray:
        """Euclidean norm of each column, (k,)."""
        if self.comm is None:
            return np.linalg.norm(table, axis=0)
        return np.sqrt(self.sum(np.einsum("nk,nk->k", table, table)))

    def orthonormal(self, table: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Decompose a table into Q R: local rows of Q, with orthonormal columns, and R, (k, k), the same on all ranks.

        Each rank decomposes its rows, then all decompose the stacked triangles: exact to round-off, unlike a Gram
        matrix (J. Demmel et al., Communication-optimal parallel and sequential QR and LU factorizations, 2012).
        """
        own, triangle = linalg.qr(table, mode="economic")
        if self.comm is None:
            return own, triangle
        triangles = self.comm.allgather(triangle)
        ends = np.cumsum([0, *map(len, triangles)])
        turns, found = self.first(linalg.qr(np.vstack(triangles), mode="economic"))
        rank = self.comm.rank
        return own @ turns[ends[rank] : ends[rank + 1]], found


class MatrixOfRows:
    """Local rows of a sparse matrix, (own, N), for products with distributed tables, (own, k). Collective."""

    def __init__(self, matrix: csr_matrix, rows: Rows) -> None:
        assert rows.comm is not None
        self._comm = rows.comm
        first = rows.own.start
        if not matrix.has_canonical_format:  # scipy would sort the entries of the argument in place
            matrix = matrix.copy()
            matrix.sum_duplicates()
        columns = np.unique(matrix.indices)
        needed = columns[(columns < first) | (columns >= rows.own.stop)]
        self._before = np.searchsorted(needed, first)
        # sorted by number, so that columns remain sorted
        near = np.insert(needed, self._before, np.arange(first, rows.own.stop))
        places = np.searchsorted(near, matrix.indices).astype(matrix.indices.dtype)
        self._matrix = csr_matrix((matrix.data, places, matrix.indptr), shape=(matrix.shape[0], near.size))
        starts = np.array(self._comm.allgather(first))
        owner = np.searchsorted(starts, needed, side="right") - 1
        wanted = [needed[owner == rank] for rank in range(self._comm.size)]
        self._received = np.array([part.size for part in wanted])
        requested = self._comm.alltoall(wanted)
        self._sent = np.array([part.size for part in requested])
        self._given = np.concatenate(requested).astype(np.int64) - first

    def alike(self, matrix: csr_matrix) -> MatrixOfRows:
        """Local rows of another matrix, with entries at the same positions in the same order."""
        places = self._matrix.indices, self._matrix.indptr
        return self._with(csr_matrix((matrix.data, *places), shape=self._matrix.shape))

    def cut(self, places: np.ndarray) -> MatrixOfRows:
        """Select local rows by their indices: products are then (n, k); neighbours send the same rows as before."""
        return self._with(csr_matrix(self._matrix[places]))

    def __abs__(self) -> MatrixOfRows:
        """Matrix with the absolute values of the entries."""
        return self._with(abs(self._matrix))

    def _with(self, matrix: csr_matrix) -> MatrixOfRows:
        found = object.__new__(MatrixOfRows)
        vars(found).update(vars(self) | {"_matrix": matrix})
        return found

    def __matmul__(self, table: np.ndarray) -> np.ndarray:
        """Multiply a table, (own, k), or the local entries of a vector, (own,)."""
        if table.ndim == 1:
            return self._times(table[:, None])[:, 0]
        if table.shape[1] <= PANEL:
            return self._times(table)
        found = np.empty(table.shape, order="F")
        for first in range(0, table.shape[1], PANEL):
            part = slice(first, first + PANEL)
            found[:, part] = self._times(table[:, part])
        return found

    def _times(self, table: np.ndarray) -> np.ndarray:
        width = table.shape[1]
        beside = np.empty((self._received.sum(), width))
        given = np.ascontiguousarray(table[self._given], dtype=float)
        self._comm.Alltoallv((given, width * self._sent), (beside, width * self._received))
        return self._matrix @ np.concatenate([beside[: self._before], table, beside[self._before :]])
