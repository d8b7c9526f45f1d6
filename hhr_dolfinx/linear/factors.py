"""Cholesky factors of a symmetric matrix by PETSc, and K^-1 between the rows that are eliminated
last.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from petsc4py import PETSc
from scipy.sparse import csc_matrix, csr_matrix

from hhr_dolfinx.linear import schur
from hhr_dolfinx.linear.dense import factorised

if TYPE_CHECKING:
    from mpi4py.MPI import Comm

ROOMS = (100, 400, 1600)
NO_ROOM = (-8, -9, -14, -15)
"""Increases of MUMPS' workspace, ICNTL(14), in per cent, and its error codes for too little
workspace: seen on three ranks with few dofs.
"""
PRODUCT_NUMBERS = 2_000_000
"""Numbers in one block of a product, 16 MB."""
FAR_FROM_ROUND_OFF = 1e-9
"""Smallest pivot over the largest above which a matrix is regular: a singular one of a million rows
leaves less than 1e-10, in its Schur complement too.
"""
_WRONG_ARGUMENT = 62  # PETSC_ERR_ARG_WRONG


class Pattern(NamedTuple):
    """Rows and columns of selected entries of a matrix, CSR, and their indices in the data of this
    matrix.
    """

    rows: np.ndarray
    columns: np.ndarray
    places: np.ndarray


class Factors:
    """Factors of a matrix whose rows are distributed over the ranks of a communicator, made by
    :meth:`factor`.

    Args:
        pattern: local rows, (own, n); with MUMPS on one rank only the upper triangle, which is all
            that it reads.
        values: data to which the indices of the pattern refer.
        prefix: prefix of PETSc options.
        ordering: ordering of PETSc's Cholesky; ``mumps`` selects MUMPS, which several ranks always
            need.
        comm: communicator of the ranks.
        low_rank: tolerance of MUMPS' compression of factors; None for whole factors, and in other
            solvers.
        last: rows that are eliminated last, increasing; on one rank only. None if the solver cannot
            do so.
        inverted: invert the Schur complement of these rows after factoring, as solutions of all
            rows need it. Without, solutions are those of the other rows alone, see MUMPS' users'
            guide on ICNTL(26).
    """

    def __init__(
        self, pattern: Pattern, values: np.ndarray, prefix: str, ordering: str, comm: Comm, *,
        low_rank: float | None = None, last: np.ndarray | None = None, inverted: bool = True,
    ):  # fmt: skip
        by_mumps = ordering == "mumps" or comm.size > 1
        self._own = len(pattern.rows) - 1
        self._inverted = inverted
        self._matrix = _matrix(pattern, values, by_mumps and comm.size == 1, comm)
        self._ksp = PETSc.KSP().create(comm)
        self._ksp.setOptionsPrefix(prefix)
        self._ksp.setOperators(self._matrix)
        self._ksp.setType(PETSc.KSP.Type.PREONLY)
        pc = self._ksp.getPC()
        pc.setType(PETSc.PC.Type.CHOLESKY)
        if by_mumps:
            # no pivots: three quarters of the time and less memory in space, measured once at
            # 62,138 dofs
            self._matrix.setOption(PETSc.Mat.Option.SPD, True)
            pc.setFactorSolverType("mumps")
        else:
            pc.setFactorOrdering(ordering)
        self._ksp.setFromOptions()
        self.low_rank = low_rank if by_mumps else None
        self.last = last if by_mumps and comm.size == 1 else None
        self._prepare()
        self._rhs, self._x = self._matrix.createVecs()

    def factor(self) -> bool:
        """Factor the matrix, with more workspace if MUMPS had too little.

        False for a singular matrix.
        """
        pc = self._ksp.getPC()
        for room in ROOMS:
            if factorised(self._ksp):
                return self._closed()
            if (
                pc.getFactorSolverType() != "mumps"
                or pc.getFactorMatrix().getMumpsInfog(1) not in NO_ROOM
            ):
                return False
            pc.reset()  # otherwise PETSc would reuse the factors
            self._ksp.setOperators(self._matrix)
            self._prepare(room)
        return factorised(self._ksp) and self._closed()

    @property
    def clearly_regular(self) -> bool:
        """True if pivots of MUMPS are far from round-off, of one rank.

        False also where pivots are not known: other solvers, MUMPS before 5.5.
        """
        if self._matrix.comm.size > 1 or self._ksp.getPC().getFactorSolverType() != "mumps":
            return False
        factor = self._ksp.getPC().getFactorMatrix()
        smallest = factor.getMumpsRinfog(19)
        largest = factor.getMumpsRinfog(21)
        if self.last is not None:
            if not self._inverted:
                return False
            with self.left() as inverse:  # its last pivot is one over its last entry or larger
                # np.minimum, unlike min, keeps NaN, which is not regular
                smallest = np.minimum(smallest, 1 / np.diagonal(inverse).max())
        return bool(smallest > FAR_FROM_ROUND_OFF * largest > 0)

    @property
    def negative(self) -> int:
        """Negative pivots of MUMPS; 0 of other solvers, which end at one."""
        pc = self._ksp.getPC()
        by_mumps = pc.getFactorSolverType() == "mumps"
        return pc.getFactorMatrix().getMumpsInfog(12) if by_mumps else 0

    def _closed(self) -> bool:
        """Invert the Schur complement, or set up solutions without it.

        False if it is not positive definite.
        """
        if self.last is None:
            return True
        factor = self._ksp.getPC().getFactorMatrix()
        if self._inverted:
            return schur.invert_last(factor)
        factor.setMumpsIcntl(26, 0)
        return True

    def _prepare(self, room: int | None = None) -> None:
        """Set MUMPS' compression, its workspace, and the rows to eliminate last, after PETSc's
        options are read.
        """
        pc = self._ksp.getPC()
        usual = self.low_rank is None and room is None and self.last is None
        if usual or pc.getFactorSolverType() != "mumps":
            self.last = None
            return
        pc.setFactorSetUpSolverType()
        if room is not None:
            pc.getFactorMatrix().setMumpsIcntl(14, room)
        if self.low_rank is not None:
            pc.getFactorMatrix().setMumpsIcntl(35, 2)
            pc.getFactorMatrix().setMumpsCntl(7, self.low_rank)
            if not self._inverted:  # other factors exist meanwhile: free the workspace
                gives_back(pc.getFactorMatrix())
        if self.last is not None and not schur.eliminate_last(pc.getFactorMatrix(), self.last):
            self.last = None

    def replace(self, values: np.ndarray, pattern: Callable[[], Pattern]) -> None:
        """Set the values that are factored next.

        Args:
            values: data of the matrix of which the pattern selects entries.
            pattern: function that returns the unchanged pattern.
        """
        rows, columns, indices = pattern()
        self._matrix.setValuesCSR(rows, columns, values[indices])
        self._matrix.assemble()
        self._ksp.setOperators(self._matrix)

    def between_last(self, rows: csr_matrix) -> np.ndarray:
        """Product rows K^-1 rows^T, (m, m), of rows, (m, n), on the ``last`` rows.

        Needs ``inverted``.
        """
        assert self._inverted
        used = np.unique(rows.indices)
        used_rows = csr_matrix(rows[:, used])
        product = np.zeros((rows.shape[0], rows.shape[0]))
        with self.left() as inverse:
            all_used = used.size == len(inverse)  # no copy then, which may be large
            add_between(used_rows, inverse if all_used else inverse[np.ix_(used, used)], product)
        return product

    def left(self) -> AbstractContextManager[np.ndarray]:
        """Schur complement on the ``last`` rows, (n, n): its upper triangle, or its inverse if it
        is ``inverted``.
        """
        assert self.last is not None
        return schur.left_of(self._ksp.getPC().getFactorMatrix(), self.last.size)

    def destroy(self) -> None:
        """Free the memory at once, on all ranks. Collective."""
        self._ksp.destroy()
        for petsc_object in (self._matrix, self._rhs, self._x):
            petsc_object.destroy()

    def solve(self, rhs: np.ndarray) -> np.ndarray:
        """Local rows of the solution for the local rows of a right-hand side, (own,)."""
        self._rhs.array[:] = rhs
        self._ksp.solve(self._rhs, self._x)
        return self._x.array_r

    def solve_block(self, columns: csc_matrix | np.ndarray, solutions: np.ndarray) -> None:
        """Write solutions for some columns into an array. Collective.

        Args:
            columns: right-hand sides, (own, k), sparse or dense.
            solutions: array for the solutions, (own, k), in Fortran order.
        """
        with self._dense(solutions) as target:
            if not isinstance(columns, np.ndarray) and self._takes_sparse:
                with self._sparse(columns) as rhs:
                    self._ksp.getPC().getFactorMatrix().matSolve(rhs, target)
            else:
                dense = columns if isinstance(columns, np.ndarray) else columns.toarray(order="F")
                with self._dense(dense) as rhs:
                    self._ksp.matSolve(rhs, target)

    def multiply(self, block: np.ndarray, image: np.ndarray) -> None:
        """Write the matrix times some columns into an array. Collective.

        Args:
            block: the columns, (own, k), in Fortran order.
            image: array for the product, (own, k), in Fortran order.
        """
        with self._dense(block) as source, self._dense(image) as target:
            self._matrix.matMult(source, target)

    @property
    def _takes_sparse(self) -> bool:
        """The solver takes sparse right-hand sides, which halve the time: 1.1 ms for a condition at
        18,400 dofs.

        With rows that are eliminated last, MUMPS skips these too if no right-hand side reaches
        them, and PETSc then uses their previous values: seen with MUMPS 5.8.2 and last rows that
        nothing couples with others.
        """
        if self.last is not None:
            return False
        by_mumps = self._ksp.getPC().getFactorSolverType() == "mumps"
        return by_mumps and self._ksp.getType() == PETSc.KSP.Type.PREONLY

    @contextmanager
    def _sparse(self, columns: csc_matrix) -> Iterator[PETSc.Mat]:
        """Sparse right-hand sides in the form that MUMPS takes: an implicit transpose with all
        entries on rank 0.
        """
        comm = self._matrix.comm.tompi4py()
        size = self._matrix.getSize()[0]
        count = columns.shape[1]
        if comm.size > 1:
            first = self._matrix.getOwnershipRange()[0]
            local = columns.tocoo()
            received = comm.gather((local.data, local.row + first, local.col))
            columns = csc_matrix((size, 0))
            if received is not None:
                data, rows, indices = (
                    np.concatenate(arrays) for arrays in zip(*received, strict=True)
                )
                columns = csc_matrix((data, (rows, indices)), shape=(size, count))
        sizes = ((columns.shape[1], count), (size if comm.rank == 0 else 0, size))
        entries = columns.indptr, columns.indices, columns.data
        rows = PETSc.Mat().createAIJ(sizes, csr=entries, comm=self._matrix.comm)
        transposed = PETSc.Mat().createTranspose(rows)
        yield transposed
        transposed.destroy()
        rows.destroy()

    @contextmanager
    def _dense(self, array: np.ndarray) -> Iterator[PETSc.Mat]:
        """PETSc matrix of the local rows of some columns, (own, k), in Fortran order, without a
        copy.
        """
        sizes = (self._matrix.getSizes()[0], (PETSc.DECIDE, array.shape[1]))
        matrix = PETSc.Mat().createDense(sizes, array=array, comm=self._matrix.comm)
        matrix.assemble()
        yield matrix
        matrix.destroy()


def gives_back(factor: PETSc.Mat) -> bool:
    """Make MUMPS free its workspace, ICNTL(49), to save memory; False if PETSc is older than
    3.23.
    """
    try:
        factor.setMumpsIcntl(49, 1)
    except PETSc.Error as error:
        if error.ierr != _WRONG_ARGUMENT:
            raise
        return False
    return True


def _matrix(pattern: Pattern, values: np.ndarray, half: bool, comm: Comm) -> PETSc.Mat:
    """PETSc matrix of the local rows; ``half``: of their upper triangle, for MUMPS on one rank."""
    local_rows = len(pattern.rows) - 1
    sizes = (local_rows, comm.allreduce(local_rows))
    options = {"csr": (pattern.rows, pattern.columns, values[pattern.places]), "comm": comm}
    matrix_of_rows = PETSc.Mat()
    matrix = (
        matrix_of_rows.createSBAIJ((sizes, sizes), 1, **options)
        if half
        else matrix_of_rows.createAIJ((sizes, sizes), **options)
    )
    matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)
    return matrix


def add_between(rows: csr_matrix, inverse: np.ndarray, found: np.ndarray) -> None:
    """Add rows K^-1 rows^T to an array in blocks, since the product needs as much memory.

    Args:
        rows: the rows, (m, n).
        inverse: K^-1, (n, n).
        found: array to add to, (m, m).
    """
    used = np.flatnonzero(np.diff(rows.indptr))
    block_rows = csr_matrix(rows[used])
    height = max(PRODUCT_NUMBERS // max(inverse.shape[0], 1), 1)
    for first in range(0, used.size, height):
        block = slice(first, first + height)
        found[np.ix_(used[block], used)] += (block_rows @ (block_rows[block] @ inverse).T).T
