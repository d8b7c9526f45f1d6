"""Factors that several ranks share of a matrix of which each has all rows: for bodies with laws,
and for reduction.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
from scipy.sparse import csr_matrix, spmatrix

from hhr_dolfinx.group import share
from hhr_dolfinx.linear.sparse import FreeCholesky
from hhr_dolfinx.plugins.ranks.rows import RowsOfRanks

if TYPE_CHECKING:
    from mpi4py.MPI import Comm


class SharedCholesky:
    """A :class:`FreeCholesky` with whole vectors on all ranks.

    Calls are collective, with the same values on each rank.

    The rows of each rank, ``rows``, are those of its factored ones, ``own``, (own dofs, N), of K,
    CSR, (N, N). Other objects may use the factors too.
    """

    def __init__(
        self, factors: FreeCholesky, rows: slice, own: csr_matrix, stiffness: csr_matrix, comm: Comm
    ):
        self._factors = factors
        self.rows = rows
        self._own = own
        self._whole = RowsOfRanks(rows, stiffness.shape[0], comm).whole
        self._factored: csr_matrix | None = stiffness
        self.lock = factors.lock
        self.low_rank = factors.low_rank

    @classmethod
    def of(
        cls,
        stiffness: csr_matrix,
        free: np.ndarray,
        scene: str,
        comm: Comm,
        *,
        low_rank: float | None = None,
        last: np.ndarray | None = None,
        rows: slice | None = None,
    ) -> SharedCholesky:
        """Factor K, CSR, (N, N), see :class:`FreeCholesky`.

        Args:
            stiffness: K, with all rows on each rank.
            free: dofs that are not imposed, (N,) bool.
            scene: name of the scene, for messages.
            comm: MPI communicator.
            low_rank: precision of compressed blocks; None for exact factors.
            last: dofs between which K^-1 is needed, increasing, (n,); None for none.
            rows: range of the local rows; None for equal shares.
        """
        if rows is None:
            local = share(len(free), comm.rank, comm.size)
            rows = slice(local.start, local.stop)
        held = stiffness[rows]
        factors = FreeCholesky(held, free, rows, scene, "mumps", comm, low_rank=low_rank, last=last)
        return cls(factors, rows, held, stiffness, comm)

    def release(self) -> None:
        """Free the memory, see :meth:`FreeCholesky.release`."""
        self._factors.release()

    def holds(self, stiffness: csr_matrix) -> bool:
        """True for the factored matrix, (N, N).

        False if other users have replaced the shared factors.
        """
        return stiffness is self._factored and self._factors.holds(self._own)

    def refactor(self, stiffness: csr_matrix) -> None:
        """Factor another matrix with the same pattern, unless it is the one factored last."""
        if stiffness is not self._factored:
            self._factored = None
            self._own = stiffness[self.rows]
        self._factors.refactor(self._own)
        self._factored = stiffness

    def between_last(self, rows: csr_matrix) -> np.ndarray | None:
        """Product rows K^-1 rows^T, (m, m), of rows, (m, N).

        See :meth:`FreeCholesky.between_last`.
        """
        return self._factors.between_last(rows[:, self.rows])

    def solve(self, rhs: np.ndarray) -> np.ndarray:
        """Solution for a right-hand side, (N,)."""
        return self._whole(self._factors.solve(rhs[self.rows]))

    def solve_columns(self, columns: spmatrix) -> np.ndarray:
        """Solutions for the columns of a sparse matrix, (N, m)."""
        return self._whole(self._factors.solve_columns(columns.tocsr()[self.rows]))

    def solved_blocks(
        self, columns: spmatrix, dofs: np.ndarray | None = None, *, refined: bool = False
    ) -> Iterator[tuple[slice, np.ndarray]]:
        """Solutions in blocks of columns; see :meth:`FreeCholesky.solved_blocks`.

        Args:
            columns: right-hand sides, sparse, (N, m).
            dofs: dofs of the solutions; None for all.
            refined: True for iterative refinement.
        """
        for panel, block in self._factors.solved_blocks(
            columns.tocsr()[self.rows], refined=refined
        ):
            gathered = self._whole(block)
            yield panel, gathered if dofs is None else gathered[dofs]
