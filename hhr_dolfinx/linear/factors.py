"""Cholesky factors of a symmetric matrix by PETSc, and K^-1 among the rows that they eliminate last."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from petsc4py import PETSc
from scipy.sparse import csc_matrix, csr_matrix

from hhr_dolfinx.linear import schur
from hhr_dolfinx.linear.border import add_between
from hhr_dolfinx.linear.dense import factorised

if TYPE_CHECKING:
    from mpi4py.MPI import Comm

ROOMS = (100, 400, 1600)
NO_ROOM = (-8, -9, -14, -15)
"""Per cent by which the room that MUMPS reckons with is widened where that was too little, and how it says so: seen on
three ranks with few dofs."""
_WRONG_ARGUMENT = 62  # PETSC_ERR_ARG_WRONG


class Pattern(NamedTuple):
    """Rows and columns of kept entries, CSR, and their places among the data of the matrix that they are taken from."""

    rows: np.ndarray
    columns: np.ndarray
    places: np.ndarray


class Factors:
    """Factors of a matrix whose rows are spread over the ranks of a communicator, made by :meth:`factor`.

    Args:
        pattern: own rows, (own, n); of one rank by MUMPS the upper triangle alone, which takes no more.
        values: data that the places of the pattern point into.
        prefix: of PETSc options.
        ordering: of PETSc's own Cholesky; ``mumps`` takes MUMPS, which several ranks always need.
        comm: the ranks.
        low_rank: part of its factors that MUMPS may leave out where it compresses them; None for none.
        last: rows that are eliminated last, increasing; on one rank.
        inverted: whether their Schur complement is inverted behind factors, as solutions of all rows need it; without
            that the solutions are those of the other rows by themselves, see MUMPS' users' guide on ICNTL(26).

    Attributes:
        low_rank: the same; None too where it is not MUMPS that factors.
        last: the same; None where that cannot be asked for.
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
            # no pivots: three quarters of the time and less memory in space, measured once at 62,138 dofs
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
        """Factor the matrix, with more room where MUMPS had too little of it; False for a singular one."""
        pc = self._ksp.getPC()
        for room in ROOMS:
            if factorised(self._ksp):
                return self._closed()
            if pc.getFactorSolverType() != "mumps" or pc.getFactorMatrix().getMumpsInfog(1) not in NO_ROOM:
                return False
            pc.reset()  # or nothing would be factored anew
            self._ksp.setOperators(self._matrix)
            self._prepare(room)
        return factorised(self._ksp) and self._closed()

    def _closed(self) -> bool:
        """What is left to do behind factors; False where what is left of the matrix is not definite."""
        if self.last is None:
            return True
        factor = self._ksp.getPC().getFactorMatrix()
        if self._inverted:
            return schur.invert_last(factor)
        factor.setMumpsIcntl(26, 0)
        return True

    def _prepare(self, room: int | None = None) -> None:
        """Tell MUMPS how to compress its factors, how much room to reckon with, and what to eliminate last.

        Behind the options, whose prefix it takes, and which count more.
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
            if not self._inverted:  # others are made beside it: what MUMPS worked in is given back, as a smaller copy
                gives_back(pc.getFactorMatrix())
        if self.last is not None and not schur.eliminate_last(pc.getFactorMatrix(), self.last):
            self.last = None

    def replace(self, values: np.ndarray, pattern: Callable[[], Pattern]) -> None:
        """Take other values of the same pattern, which is asked for, and which are factored next."""
        rows, columns, places = pattern()
        self._matrix.setValuesCSR(rows, columns, values[places])
        self._matrix.assemble()
        self._ksp.setOperators(self._matrix)

    def between_last(self, rows: csr_matrix) -> np.ndarray:
        """Some rows on the last ones, (m, n), as rows K^-1 rows^T, (m, m), where K^-1 is made."""
        assert self._inverted
        used = np.unique(rows.indices)
        own = csr_matrix(rows[:, used])
        found = np.zeros((rows.shape[0], rows.shape[0]))
        with self._left() as inverse:
            every = used.size == len(inverse)  # no copy then, which may be large
            add_between(own, inverse if every else inverse[np.ix_(used, used)], found)
        return found

    def left(self) -> AbstractContextManager[np.ndarray]:
        """What is left of the matrix between the last rows, (n, n), where it is not inverted: its upper triangle."""
        assert not self._inverted
        return self._left()

    def _left(self) -> AbstractContextManager[np.ndarray]:
        assert self.last is not None
        return schur.left_of(self._ksp.getPC().getFactorMatrix(), self.last.size)

    def destroy(self) -> None:
        """Give the memory back, at once and on all ranks. Collective."""
        self._ksp.destroy()
        for item in (self._matrix, self._rhs, self._x):
            item.destroy()

    def solve(self, rhs: np.ndarray) -> np.ndarray:
        """Own rows of a solution, for those of a right-hand side, (own,)."""
        self._rhs.array[:] = rhs
        self._ksp.solve(self._rhs, self._x)
        return self._x.array_r

    def solve_block(self, columns: csc_matrix | np.ndarray, solutions: np.ndarray) -> None:
        """Write solutions for some columns, (own, k), sparse or dense, into an array by columns. Collective."""
        with self._dense(solutions) as found:
            if not isinstance(columns, np.ndarray) and self._takes_sparse:
                with self._sparse(columns) as given:
                    self._ksp.getPC().getFactorMatrix().matSolve(given, found)
            else:
                whole = columns if isinstance(columns, np.ndarray) else columns.toarray(order="F")
                with self._dense(whole) as given:
                    self._ksp.matSolve(given, found)

    def multiply(self, block: np.ndarray, image: np.ndarray) -> None:
        """Write the matrix times some columns, (own, k), into an array; both lie by columns. Collective."""
        with self._dense(block) as given, self._dense(image) as found:
            self._matrix.matMult(given, found)

    @property
    def _takes_sparse(self) -> bool:
        """Whether the solver in use takes sparse right-hand sides, which skip what of the factors they do not reach.

        Measured in space at 18,400 dofs: 1.1 ms for a condition of the contact in the place of 2.1 ms. Where rows are
        eliminated last it skips them too if no right-hand side reaches them, and PETSc goes on with what they held
        before: seen with MUMPS 5.8.2 where nothing couples these rows with others.
        """
        if self.last is not None:
            return False
        by_mumps = self._ksp.getPC().getFactorSolverType() == "mumps"
        return by_mumps and self._ksp.getType() == PETSc.KSP.Type.PREONLY

    @contextmanager
    def _sparse(self, columns: csc_matrix) -> Iterator[PETSc.Mat]:
        """Sparse right-hand sides as MUMPS takes them: a transpose that is not carried out, all of it on rank 0."""
        comm = self._matrix.comm.tompi4py()
        size = self._matrix.getSize()[0]
        count = columns.shape[1]
        if comm.size > 1:
            first = self._matrix.getOwnershipRange()[0]
            own = columns.tocoo()
            told = comm.gather((own.data, own.row + first, own.col))
            columns = csc_matrix((size, 0))
            if told is not None:
                data, rows, places = (np.concatenate(part) for part in zip(*told, strict=True))
                columns = csc_matrix((data, (rows, places)), shape=(size, count))
        sizes = ((columns.shape[1], count), (size if comm.rank == 0 else 0, size))
        entries = columns.indptr, columns.indices, columns.data
        rows = PETSc.Mat().createAIJ(sizes, csr=entries, comm=self._matrix.comm)
        transposed = PETSc.Mat().createTranspose(rows)
        yield transposed
        transposed.destroy()
        rows.destroy()

    @contextmanager
    def _dense(self, array: np.ndarray) -> Iterator[PETSc.Mat]:
        """Own rows of some columns, (own, k), by columns in memory, which PETSc takes as they lie there."""
        sizes = (self._matrix.getSizes()[0], (PETSc.DECIDE, array.shape[1]))
        matrix = PETSc.Mat().createDense(sizes, array=array, comm=self._matrix.comm)
        matrix.assemble()
        yield matrix
        matrix.destroy()


def gives_back(factor: PETSc.Mat) -> bool:
    """Have MUMPS give back what it worked in, ICNTL(49); False where PETSc does not know that, before 3.23.

    Solutions are the same without: factors take more memory.
    """
    try:
        factor.setMumpsIcntl(49, 1)
    except PETSc.Error as error:
        if error.ierr != _WRONG_ARGUMENT:
            raise
        return False
    return True


def _matrix(pattern: Pattern, values: np.ndarray, half: bool, comm: Comm) -> PETSc.Mat:
    """A matrix of own rows, of which half may be given where it goes to MUMPS alone."""
    own = len(pattern.rows) - 1
    sizes = (own, comm.allreduce(own))
    entries = pattern.rows, pattern.columns, values[pattern.places]
    if half:
        matrix = PETSc.Mat().createSBAIJ((sizes, sizes), 1, csr=entries, comm=comm)
    else:
        matrix = PETSc.Mat().createAIJ((sizes, sizes), csr=entries, comm=comm)
    matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)
    return matrix
