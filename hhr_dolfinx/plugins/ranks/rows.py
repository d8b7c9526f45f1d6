"""Operations on tables with a row for each dof, (N, k), of which each rank stores the rows of its
dofs.

Ranks exchange only a few small arrays: products of tables, (k, k), rows at some dofs, and the rows
of neighbours that a sparse matrix needs.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from scipy import linalg
from scipy.sparse import csr_matrix, spmatrix

from hhr_dolfinx.errors import RankError
from hhr_dolfinx.linear.rows import Rows, T

if TYPE_CHECKING:
    from mpi4py.MPI import Comm

    from hhr_dolfinx.contact.problem import ContactProblem, IndexSets

EXCHANGED_COLUMNS = 32
"""Columns in one exchange of rows between neighbours."""


class RowsOfRanks(Rows):
    """Rows of which each rank has those of its dofs, after the ones of the ranks before it.

    Raises:
        RankError: for a table that does not have the local rows, before it is read or sent.
    """

    all_here = False

    def __init__(self, own: slice, count: int, comm: Comm) -> None:
        super().__init__(own, count)
        self.comm = comm

    def sum(self, part: Any) -> Any:
        """See :class:`Rows`."""
        local = np.ascontiguousarray(part, dtype=float)
        total = np.empty_like(local)
        self.comm.Allreduce(local, total)
        return total.reshape(np.shape(part)) if np.ndim(part) else float(total[0])

    def of(self, table: Any) -> Any:
        """See :class:`Rows`."""
        return table[self.own]

    def mine(self, places: np.ndarray) -> np.ndarray:
        """See :class:`Rows`."""
        return places[(places >= self.own.start) & (places < self.own.stop)] - self.own.start

    def at(self, table: np.ndarray, places: np.ndarray) -> np.ndarray:
        """See :class:`Rows`.

        Args:
            table: local rows of the table, (own, ...).
            places: indices of the rows, (n,).
        """
        self.check(table)
        values = np.zeros((len(places), *table.shape[1:]))
        is_local = (places >= self.own.start) & (places < self.own.stop)
        values[is_local] = table[places[is_local] - self.own.start]
        return self.sum(values)

    def whole(self, table: np.ndarray) -> np.ndarray:
        """See :class:`Rows`; in Fortran order."""
        if table.ndim == 1:
            return self.whole(table[:, None])[:, 0]
        ends = self._ends(table)
        gathered = np.empty((self.count, table.shape[1]), order="F")
        for first in range(0, table.shape[1], EXCHANGED_COLUMNS):
            panel = gathered[:, first : first + EXCHANGED_COLUMNS]
            local = np.ascontiguousarray(table[:, first : first + EXCHANGED_COLUMNS].T, dtype=float)
            received = np.empty(panel.size)
            self.comm.Allgatherv(local, (received, np.diff(ends) * panel.shape[1]))
            blocks = np.split(received, ends[1:-1] * panel.shape[1])
            for start, end, block in zip(ends[:-1], ends[1:], blocks, strict=True):
                panel[start:end] = block.reshape(panel.shape[1], -1).T
        return gathered

    def largest(self, values: np.ndarray) -> tuple[int, float]:
        """See :class:`Rows`."""
        index = int(values.argmax()) if values.size else 0
        best = (float(values[index]), -(index + self.own.start)) if values.size else (-np.inf, 0)
        value, index = max(self.comm.allgather(best))
        return -index, value

    def first(self, value: T) -> T:
        """See :class:`Rows`."""
        return self.comm.bcast(value)

    def alike(self, value: object) -> bool:
        """See :class:`Rows`."""
        return len(set(self.comm.allgather(value))) == 1

    def norms(self, table: np.ndarray) -> np.ndarray:
        """See :class:`Rows`."""
        return np.sqrt(self.sum(np.einsum("nk,nk->k", table, table)))

    def orthonormal(self, table: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See :class:`Rows`.

        Each rank decomposes its rows, then all decompose the stacked triangles: exact to round-off,
        unlike a Gram matrix (J. Demmel et al., Communication-optimal parallel and sequential QR and
        LU factorizations, 2012).
        """
        self.check(table)
        local, triangle = super().orthonormal(table)
        triangles = self.comm.allgather(triangle)
        ends = np.cumsum([0, *map(len, triangles)])
        turns, triangle_of_all = self.first(linalg.qr(np.vstack(triangles), mode="economic"))
        rank = self.comm.rank
        return local @ turns[ends[rank] : ends[rank + 1]], triangle_of_all

    def matrix(self, own: csr_matrix) -> MatrixOfRows:
        """See :class:`Rows`."""
        return MatrixOfRows(own, self)

    def columns(self, matrix: csr_matrix) -> csr_matrix:
        """See :class:`Rows`."""
        return csr_matrix(matrix[:, self.own])

    def modes(self, problem: ContactProblem, basis: np.ndarray, sets: IndexSets) -> ModesOfRows:
        """See :class:`Rows`.

        Args:
            problem: the contact problem.
            basis: local rows of the modes, (own, ell).
            sets: index sets of the reduction, whose A has the rows of tests.
        """
        return ModesOfRows(problem, basis, sets)

    def check(self, table: np.ndarray) -> None:
        """Check that a table, (n, ...), has the local rows. Not collective.

        Raises:
            RankError: for a table of another length.
        """
        count = self.own.stop - self.own.start
        if len(table) != count:
            raise RankError(
                f"rank {self.comm.rank} passes a table of {len(table)} rows, and has {count} of "
                f"{self.count} rows: pass the local rows, problem.spread.of(table)"
            )

    def _ends(self, table: np.ndarray) -> np.ndarray:
        """Ends of the rows of each rank, (ranks + 1,).

        All ranks raise if a table, (n, k), is wrong on one.
        """
        shapes = self.comm.allgather((*table.shape, self.own.stop - self.own.start))
        wrong = [
            f"rank {rank} passes {rows} rows and {columns} columns and has {held} of {self.count} "
            "rows"
            for rank, (rows, columns, held) in enumerate(shapes)
            if rows != held or columns != shapes[0][1]
        ]
        if wrong:
            raise RankError(
                f"a table cannot be gathered: {', '.join(wrong)}. Pass the local rows, "
                "problem.spread.of(table), with the same columns on each rank"
            )
        return np.cumsum([0, *(rows for rows, *_ in shapes)])


class MatrixOfRows:
    """Local rows of a sparse matrix, (own, N), for products with distributed tables, (own, k).

    Collective.
    """

    def __init__(self, matrix: csr_matrix, rows: RowsOfRanks) -> None:
        self._comm = rows.comm
        self._rows = rows
        first = rows.own.start
        if not matrix.has_canonical_format:  # scipy would sort the entries of the argument in place
            matrix = matrix.copy()
            matrix.sum_duplicates()
        columns = np.unique(matrix.indices)
        needed = columns[(columns < first) | (columns >= rows.own.stop)]
        self._before = np.searchsorted(needed, first)
        # sorted by number, so that columns remain sorted
        near = np.insert(needed, self._before, np.arange(first, rows.own.stop))
        indices = np.searchsorted(near, matrix.indices).astype(matrix.indices.dtype)
        self._matrix = csr_matrix(
            (matrix.data, indices, matrix.indptr), shape=(matrix.shape[0], near.size)
        )
        starts = np.array(self._comm.allgather(first))
        owner = np.searchsorted(starts, needed, side="right") - 1
        wanted = [needed[owner == rank] for rank in range(self._comm.size)]
        self._received = np.array([columns_of.size for columns_of in wanted])
        requested = self._comm.alltoall(wanted)
        self._sent = np.array([columns_of.size for columns_of in requested])
        self._given = np.concatenate(requested).astype(np.int64) - first

    def alike(self, matrix: csr_matrix) -> MatrixOfRows:
        """Local rows of another matrix, with entries at the same positions in the same order."""
        pattern = self._matrix.indices, self._matrix.indptr
        return self._with(csr_matrix((matrix.data, *pattern), shape=self._matrix.shape))

    def cut(self, indices: np.ndarray) -> MatrixOfRows:
        """Select local rows by their ``indices``: products are then (n, k).

        Neighbours send the same rows as before.
        """
        return self._with(csr_matrix(self._matrix[indices]))

    def __abs__(self) -> MatrixOfRows:
        """Matrix with the absolute values of the entries."""
        return self._with(abs(self._matrix))

    def _with(self, matrix: csr_matrix) -> MatrixOfRows:
        matrix_of_rows = object.__new__(MatrixOfRows)
        vars(matrix_of_rows).update(vars(self) | {"_matrix": matrix})
        return matrix_of_rows

    def __matmul__(self, table: np.ndarray) -> np.ndarray:
        """Multiply a table, (own, k), or the local entries of a vector, (own,)."""
        if table.ndim == 1:
            return self._times(table[:, None])[:, 0]
        if table.shape[1] <= EXCHANGED_COLUMNS:
            return self._times(table)
        product = np.empty(table.shape, order="F")
        for first in range(0, table.shape[1], EXCHANGED_COLUMNS):
            panel = slice(first, first + EXCHANGED_COLUMNS)
            product[:, panel] = self._times(table[:, panel])
        return product

    def _times(self, table: np.ndarray) -> np.ndarray:
        self._rows.check(table)
        width = table.shape[1]
        beside = np.empty((self._received.sum(), width))
        sent = np.ascontiguousarray(table[self._given], dtype=float)
        self._comm.Alltoallv((sent, width * self._sent), (beside, width * self._received))
        return self._matrix @ np.concatenate(
            [beside[: self._before], table, beside[self._before :]]
        )


class ModesOfRows:
    """Distributed modes, (own, ell): each rank tests with the rows of its dofs in A."""

    def __init__(self, problem: ContactProblem, basis: np.ndarray, sets: IndexSets):
        self._rows = problem.spread
        self._stiffness: Any = problem.stiffness_of_rows
        self._basis = basis
        self._inside = self._rows.mine(sets.A)
        self._test = basis[self._inside]

    def projected(self, stiffness: csr_matrix) -> np.ndarray:
        """V^T K V, tested on A, (ell, ell)."""
        matrix = self._stiffness.alike(stiffness).cut(self._inside)
        product = np.empty((self._basis.shape[1],) * 2)
        for first in range(0, len(product), EXCHANGED_COLUMNS):
            panel = slice(first, first + EXCHANGED_COLUMNS)
            product[:, panel] = self._test.T @ (matrix @ self._basis[:, panel])
        return self._rows.sum(product)

    def tested(self, columns: np.ndarray | spmatrix) -> np.ndarray:
        """Columns of dofs, dense or sparse, (N, k), tested by the modes: (ell, k)."""
        local = csr_matrix(columns)[self._rows.own][self._inside]
        return self._rows.sum(np.ascontiguousarray((local.T @ self._test).T))
