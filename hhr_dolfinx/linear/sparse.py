"""Sparse Cholesky factors by PETSc."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import nullcontext
from threading import RLock
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from petsc4py import PETSc
from scipy.sparse import csc_matrix, csr_matrix, hstack, spmatrix, triu

from hhr_dolfinx.errors import NotSolvableError
from hhr_dolfinx.linear import schur
from hhr_dolfinx.linear.dense import factorised

if TYPE_CHECKING:
    from mpi4py.MPI import Comm


BLOCK = 128
"""Right-hand sides solved at once: the factors are read once for all of them, and they take little memory."""
BLOCK_NUMBERS = 16e6
REFINED_NUMBERS = 8e6
"""Numbers in a block of solutions, at most, 128 MB, and in one that is refined, which takes several of its size."""
MOST_LAST = 7000
"""Dofs that are eliminated last at most: K^-1 between them takes .4 GB, and three times as much while it is made. With
a million dofs and 7,786 of them a condensed model took 14 minutes in the place of 24, and 1.2 GB more."""
ROOMS = (100, 400, 1600)
NO_ROOM = (-8, -9, -14, -15)
"""Per cent by which the room that MUMPS reckons with is widened where that was too little, and how it says so: seen on
three ranks with few dofs."""
LOW_RANK = ((150_000, 1e-10), (600_000, 1e-8))
REFINED = 5
PRECISE = 1e-13
STALLED = 1e-9
"""Dofs in space from which on MUMPS compresses blocks of its factors, and up to what part of them; steps of iterative
refinement of a solution down to which residual, and above which one it is none: round-off of stiff bodies beside soft
ones is far below. Measured once on hexahedra: with 42,618 dofs forces differed by 8e-10
from those of whole factors, and by 3e-7 with blocks of 1e-8; with 1,004,496 dofs blocks of 1e-10 took 19 GB."""


def ordering_of(block_size: int, plane: str) -> str:
    """Ordering for :class:`FreeCholesky`: MUMPS in space, if PETSc has it, and the given one in the plane.

    Where MUMPS is wanted in the plane too and missing, nested dissection takes its place, the fastest to factor.
    """
    if not PETSc.Sys.hasExternalPackage("mumps"):
        return "nd" if plane == "mumps" else plane
    return "mumps" if block_size == 3 else plane


def low_rank_of(block_size: int, dofs: int) -> float | None:
    """Part of the factors of a problem that their compression may leave out; None for whole factors."""
    if ordering_of(block_size, "mumps") != "mumps" or block_size != 3:
        return None
    return next((part for least, part in reversed(LOW_RANK) if dofs >= least), None)


def singular_stiffness(scene: str) -> str:
    """Message for a stiffness that is singular; ``full_order.motions`` has seen bodies that move as a whole."""
    return (
        f"the stiffness of scene '{scene}' is singular to round-off, though every body is held as a whole: look for "
        "parts that hang together at single nodes or edges, E many powers of ten apart, nu next to 0.5, needle-like "
        "cells"
    )


class _Pattern(NamedTuple):
    """Rows and columns of kept entries, CSR, and their places in the data of the whole matrix."""

    rows: np.ndarray
    columns: np.ndarray
    places: np.ndarray


class FreeCholesky:
    """Factors of a stiffness on its free dofs, on any number of ranks, each with its own rows.

    On one rank they can be made anew for other values; who solves with factors that others may replace meanwhile holds
    ``lock`` and calls :meth:`refactor` before.

    Args:
        stiffness: own rows of K, CSR, (own dofs, N).
        free: dofs that are not imposed, (N,) bool.
        rows: range of the dofs that this rank owns.
        scene: its name, for messages and the prefix of PETSc options, ``hhr_<scene>_``.
        ordering: of PETSc's own Cholesky; ``mumps`` takes MUMPS, which several ranks always need.
        comm: ranks that share the rows.
        low_rank: part of its factors that MUMPS may leave out where it compresses them; None for none. Solutions are
            refined then, those of blocks of columns are not.
        last: dofs between which K^-1 is going to be asked for, increasing, (n,). On several ranks a solution takes two
            with such factors.

    Attributes:
        low_rank: the same; None too where it is not MUMPS that factors.
        last: the same, as far as they are free; None where K^-1 between them takes solutions.
        lock: held while the factors are replaced or used; a thread may take it twice.

    Raises:
        NotSolvableError: if K is singular.
    """

    def __init__(
        self, stiffness: csr_matrix, free: np.ndarray, rows: slice, scene: str, ordering: str, comm: Comm,
        *, low_rank: float | None = None, last: np.ndarray | None = None,
    ):  # fmt: skip
        self._free = np.flatnonzero(free[rows])
        self._own = rows.stop - rows.start
        self._scene = scene
        self._columns = np.flatnonzero(free)
        by_mumps = ordering == "mumps" or comm.size > 1
        self._half = by_mumps and comm.size == 1
        self._pattern: _Pattern | None = None
        self._matrix = self._made(stiffness, comm)
        self._ksp = PETSc.KSP().create(comm)
        self._ksp.setOptionsPrefix(f"hhr_{scene}_")
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
            low_rank = None
        self._ksp.setFromOptions()
        self.low_rank = low_rank
        self.last = None
        if last is not None and by_mumps and last.size <= MOST_LAST:
            self.last = last[free[last]]
        self._inverse: np.ndarray | None = None  # between them, of several ranks
        self._prepare()
        if not self._factor():
            raise NotSolvableError(singular_stiffness(scene))
        self._rhs, self._x = self._matrix.createVecs()
        # own free dofs that are eliminated last, by their places
        self._ends = np.flatnonzero(np.isin(rows.start + self._free, [] if self.last is None else self.last))
        self._factored = stiffness
        self.lock = RLock()

    def _factor(self) -> bool:
        """Factor the matrix, with more room where MUMPS had too little of it; False for a singular one."""
        pc = self._ksp.getPC()
        if self._inverse is not None:
            schur.ask_again(pc.getFactorMatrix())
        for room in ROOMS:
            if factorised(self._ksp):
                return self._has_inverse()
            if pc.getFactorSolverType() != "mumps" or pc.getFactorMatrix().getMumpsInfog(1) not in NO_ROOM:
                return False
            pc.reset()  # or nothing would be factored anew
            self._ksp.setOperators(self._matrix)
            self._prepare(room)
        return factorised(self._ksp) and self._has_inverse()

    def _has_inverse(self) -> bool:
        """Make K^-1 between the last dofs, where there are any; False where it is not definite."""
        if self.last is None:
            return True
        factor = self._ksp.getPC().getFactorMatrix()
        if factor.comm.size == 1:
            return schur.invert_last(factor)
        self._inverse = schur.take_inverse(factor, self.last.size)
        return self._inverse is not None

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
        if self.last is not None:
            places = np.searchsorted(self._columns, self.last)
            if not schur.eliminate_last(pc.getFactorMatrix(), places):
                self.last = None

    def between_last(self, rows: csr_matrix) -> np.ndarray | None:
        """Some rows, (m, own dofs), as rows K^-1 rows^T, (m, m); None where they reach beyond the last dofs.

        Collective.
        """
        comm = self._matrix.comm.tompi4py()
        alone = comm.size == 1  # S is large, and messages are copies
        whole = rows if alone else csr_matrix(hstack(comm.allgather(rows)))
        reached = whole.indices[np.isin(whole.indices, self._columns)]
        if self.last is None or not np.isin(reached, self.last).all():
            return None
        used = np.unique(reached)
        places = np.searchsorted(self.last, used)
        own = csr_matrix(whole[:, used])
        found = None
        factor = self._ksp.getPC().getFactorMatrix()
        known = self._inverse
        made = schur.inverse_of_last(factor, self.last.size) if known is None else nullcontext(known)
        with self.lock, made as inverse:
            if comm.rank == 0:
                found = own @ (own @ inverse[np.ix_(places, places)]).T
        return found if alone else comm.bcast(found)

    def _made(self, stiffness: csr_matrix, comm: Comm) -> PETSc.Mat:
        """The matrix of the free dofs; half of it where it goes to MUMPS alone, which takes no more."""
        rows, columns, places = self._pattern_of(stiffness)
        sizes = (self._free.size, self._columns.size)
        entries = rows, columns, stiffness.data[places]
        if self._half:
            matrix = PETSc.Mat().createSBAIJ((sizes, sizes), 1, csr=entries, comm=comm)
        else:
            matrix = PETSc.Mat().createAIJ((sizes, sizes), csr=entries, comm=comm)
        matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        return matrix

    def _pattern_of(self, stiffness: csr_matrix) -> _Pattern:
        """Where the kept entries of a matrix of this pattern are."""
        marks = np.arange(stiffness.nnz, dtype=stiffness.indices.dtype)
        inside = csr_matrix((marks, stiffness.indices, stiffness.indptr), shape=stiffness.shape)
        inside = inside[self._free][:, self._columns]
        if self._half:
            inside.data += 1  # a place 0 is kept
            inside = triu(inside, format="csr")
            inside.data -= 1
        inside.sort_indices()
        return _Pattern(inside.indptr, inside.indices, inside.data)

    def refactor(self, stiffness: csr_matrix) -> None:
        """Take the values of another matrix with the same pattern; no work if its factors are those at hand."""
        with self.lock:
            if stiffness is self._factored:
                return
            self._factored = None
            if self._pattern is None:
                self._pattern = self._pattern_of(stiffness)
            rows, columns, places = self._pattern
            self._matrix.setValuesCSR(rows, columns, stiffness.data[places])
            self._matrix.assemble()
            self._ksp.setOperators(self._matrix)
            if not self._factor():
                raise NotSolvableError(
                    f"the stiffness of the full model of scene '{self._scene}' is singular at this parameter or state: "
                    "where it flows, freely beyond its limit load, or the slope of a law is wrong. Take smaller steps, "
                    "or compare the slope with differences of the flow"
                )
            self._factored = stiffness

    def destroy(self) -> None:
        """Give the memory back, at once and on all ranks; nothing is solved from then on. Collective."""
        with self.lock:
            self._ksp.destroy()
            for item in (self._matrix, self._rhs, self._x):
                item.destroy()

    def solve(self, rhs: np.ndarray) -> np.ndarray:
        """Solution on own dofs, zero on imposed ones, for own rows of a right-hand side, (own dofs,)."""
        if self.low_rank is not None or self._inverse is not None:
            return self.solve_columns(csc_matrix(rhs[:, None]))[:, 0]
        solution = np.zeros(self._own)
        with self.lock:
            self._rhs.array[:] = rhs[self._free]
            self._ksp.solve(self._rhs, self._x)
            solution[self._free] = self._x.array_r
        return solution

    def _refine(self, columns: csc_matrix, solutions: np.ndarray) -> None:
        """Take what solutions by compressed factors leave of their right-hand sides to them again, in place.

        Raises:
            NotSolvableError: if that does not bring them nearer.
        """
        sizes = _norms(columns.multiply(columns).sum(axis=0), self._matrix.comm)
        image, change = (np.empty(solutions.shape, order="F") for _ in range(2))
        for steps in range(REFINED + 1):
            self._matrix.matMult(self._dense(solutions), self._dense(image))
            left = np.asfortranarray(columns - image)
            lengths = _norms((left * left).sum(axis=0), self._matrix.comm)
            if (lengths <= PRECISE * sizes).all():
                return
            if steps < REFINED:
                self._ksp.matSolve(self._dense(left), self._dense(change))
                self._complete(left[self._ends], change)
                solutions += change
        if not (lengths <= STALLED * sizes).all():
            raise NotSolvableError(
                f"solutions by compressed factors of scene '{self._scene}' stay {(lengths / sizes).max():.1e} off: "
                f"leave out less than {self.low_rank:g} by the PETSc option -hhr_{self._scene}_mat_mumps_cntl_7"
            )

    def solve_columns(self, columns: spmatrix) -> np.ndarray:
        """Solutions for the columns of a sparse matrix of own rows, zero on imposed dofs, (own dofs, m); collective."""
        found = np.zeros((self._own, columns.shape[1]), order="F")
        for part, solutions in self.solved_blocks(columns, refined=True):
            found[:, part] = solutions
        return found

    def solved_blocks(
        self, columns: spmatrix, dofs: np.ndarray | None = None, *, refined: bool = False
    ) -> Iterator[tuple[slice, np.ndarray]]:
        """The same some columns after another, with the places of each block; collective.

        Args:
            columns: see :meth:`solve_columns`.
            dofs: own dofs at which solutions are wanted; None for all.
            refined: whether solutions by compressed factors are refined.

        Yields:
            Places of columns, and solutions there, (own dofs or those wanted, k).
        """
        columns = columns.tocsr()[self._free].tocsc()
        own, count = columns.shape
        wanted = np.arange(self._own) if dofs is None else dofs
        place = np.full(self._own, -1)
        place[self._free] = np.arange(own)
        moving = place[wanted] >= 0
        rows = place[wanted[moving]]
        refining = refined and self.low_rank is not None
        most = REFINED_NUMBERS if refining else BLOCK_NUMBERS
        each = self._matrix.getSize()[0] / self._matrix.comm.size  # all ranks cut the same blocks
        block_size = max(min(BLOCK, int(most / each), count), 1)
        solutions = np.empty((own, block_size), order="F")
        for first in range(0, count, block_size):
            part = slice(first, min(first + block_size, count))
            width = part.stop - first
            some = columns[:, part]
            if not self._matrix.comm.tompi4py().allreduce(some.nnz):  # which MUMPS calls an error
                yield part, np.zeros((wanted.size, width), order="F")
                continue
            with self.lock:
                block = self._dense(solutions[:, :width])
                if self._takes_sparse:
                    self._ksp.getPC().getFactorMatrix().matSolve(self._sparse(some), block)
                else:
                    self._ksp.matSolve(self._dense(some.toarray(order="F")), block)
                if self._inverse is not None:
                    self._complete(some[self._ends].toarray(), solutions[:, :width])
                if refining:
                    self._refine(some, solutions[:, :width])
            found = np.zeros((wanted.size, width), order="F")
            found[moving] = solutions[rows, :width]
            yield part, found

    def _complete(self, loads: np.ndarray, solutions: np.ndarray) -> None:
        """Move the dofs that were eliminated last too, on several ranks, in place.

        Solutions, (own free dofs, k), are those with these dofs at rest so far. What that leaves of the loads there,
        (own last dofs, k), moves them by K^-1 between them, and the others follow.
        """
        if self._inverse is None:
            return
        comm = self._matrix.comm.tompi4py()
        image = np.empty(solutions.shape, order="F")
        self._matrix.matMult(self._dense(solutions), self._dense(image))
        left = comm.gather(loads - image[self._ends])
        moved = comm.bcast(None if left is None else self._inverse @ np.vstack(left))
        first = sum(comm.allgather(self._ends.size)[: comm.rank])
        change = np.zeros(solutions.shape, order="F")
        change[self._ends] = moved[first : first + self._ends.size]
        self._matrix.matMult(self._dense(change), self._dense(image))
        image *= -1.0
        solutions += change
        self._ksp.matSolve(self._dense(image), self._dense(change))
        change[self._ends] = 0.0
        solutions += change

    @property
    def _takes_sparse(self) -> bool:
        """Whether the solver in use takes sparse right-hand sides, which skip what of the factors they do not reach.

        Measured in space at 18,400 dofs: 1.1 ms for a condition of the contact in the place of 2.1 ms.
        """
        by_mumps = self._ksp.getPC().getFactorSolverType() == "mumps"
        return by_mumps and self._ksp.getType() == PETSc.KSP.Type.PREONLY

    def _sparse(self, columns: csc_matrix) -> PETSc.Mat:
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
        return PETSc.Mat().createTranspose(PETSc.Mat().createAIJ(sizes, csr=entries, comm=self._matrix.comm))

    def _dense(self, array: np.ndarray) -> PETSc.Mat:
        """Own rows of some columns, (own free dofs, k), by columns in memory, which PETSc takes as they lie there."""
        sizes = (self._matrix.getSizes()[0], (PETSc.DECIDE, array.shape[1]))
        matrix = PETSc.Mat().createDense(sizes, array=array, comm=self._matrix.comm)
        matrix.assemble()
        return matrix


def _norms(squares: np.ndarray, comm: PETSc.Comm) -> np.ndarray:
    """Roots of sums over the ranks of what each has of them, (k,)."""
    return np.sqrt(comm.tompi4py().allreduce(np.asarray(squares).ravel()))
