"""Factors that several ranks share of a matrix of which each has all rows, as where bodies flow."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
from scipy.sparse import csr_matrix, spmatrix

from hhr_dolfinx import ranks
from hhr_dolfinx.linear.sparse import FreeCholesky

if TYPE_CHECKING:
    from mpi4py.MPI import Comm


class SharedCholesky:
    """A :class:`FreeCholesky` whose ranks give and get whole vectors; all of them ask together, for the same.

    Args:
        stiffness: K, CSR, (N, N), the same on all ranks.
        free: dofs that are not imposed, (N,) bool.
        scene: its name, for messages and the prefix of PETSc options.
        comm: ranks that share the factors.
        low_rank: see :class:`FreeCholesky`.

    Attributes:
        lock, low_rank: see there.

    Raises:
        NotSolvableError: if K is singular.
    """

    def __init__(self, stiffness: csr_matrix, free: np.ndarray, scene: str, comm: Comm, low_rank: float | None = None):
        shares = [ranks.share(len(free), rank, comm.size) for rank in range(comm.size)]
        own = shares[comm.rank]
        self._comm = comm
        self._counts = np.array([len(share) for share in shares])
        self._rows = slice(own.start, own.stop)
        given = stiffness[self._rows], free, self._rows, scene, "mumps", comm
        self._factors = FreeCholesky(*given, low_rank=low_rank)
        self._factored: csr_matrix | None = stiffness
        self.lock = self._factors.lock
        self.low_rank = low_rank

    def refactor(self, stiffness: csr_matrix) -> None:
        """Take the values of another matrix with the same pattern; no work if its factors are those at hand."""
        if stiffness is self._factored:
            return
        self._factored = None
        self._factors.refactor(stiffness[self._rows])
        self._factored = stiffness

    def between_last(self, rows: csr_matrix) -> None:
        """See :class:`FreeCholesky`: takes solutions."""

    def solve(self, rhs: np.ndarray) -> np.ndarray:
        """Solution for a right-hand side, (N,)."""
        return self._whole(self._factors.solve(rhs[self._rows]))

    def solve_columns(self, columns: spmatrix) -> np.ndarray:
        """Solutions for the columns of a sparse matrix, (N, m)."""
        return self._whole(self._factors.solve_columns(columns.tocsr()[self._rows]))

    def solved_blocks(
        self, columns: spmatrix, dofs: np.ndarray | None = None, *, refined: bool = False
    ) -> Iterator[tuple[slice, np.ndarray]]:
        """The same some columns after another; see :meth:`FreeCholesky.solved_blocks`."""
        for part, block in self._factors.solved_blocks(columns.tocsr()[self._rows], refined=refined):
            whole = self._whole(block)
            yield part, whole if dofs is None else whole[dofs]

    def _whole(self, own: np.ndarray) -> np.ndarray:
        """Rows of all ranks from own ones, (own, ...): (N, ...)."""
        width = own.shape[1:]
        found = np.empty((int(self._counts.sum()), *width))
        each = self._counts * int(np.prod(width))
        self._comm.Allgatherv(np.ascontiguousarray(own), (found, each))
        return found
