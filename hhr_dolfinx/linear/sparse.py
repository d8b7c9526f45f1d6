"""Sparse Cholesky factors by PETSc."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from threading import RLock
from typing import TYPE_CHECKING

import numpy as np
from petsc4py import PETSc
from scipy.sparse import csc_matrix, csr_matrix, hstack, spmatrix, triu

from hhr_dolfinx.errors import NotSolvableError
from hhr_dolfinx.linear.factors import Factors, Pattern
from hhr_dolfinx.linear.substructures import Substructures

if TYPE_CHECKING:
    from mpi4py.MPI import Comm


BLOCK = 128
"""Right-hand sides solved at once: the factors are read once for all of them, and they take little memory."""
BLOCK_NUMBERS = 16e6
REFINED_NUMBERS = 8e6
"""Numbers in a block of solutions, at most, 128 MB, and in one that is refined, which takes several of its size."""
MOST_LAST = 7000
"""Dofs that are eliminated last at most: K^-1 between them takes .4 GB, and three times as much while it is made. With
a million dofs and 7,786 of them a condensed model took about half of the time, and more than a gigabyte more."""
LOW_RANK = ((150_000, 1e-10), (600_000, 1e-8))
ANEW = 60_000
REFINED = 5
PRECISE = 1e-13
HALF = 0.5
STALLED = 1e-9
"""Dofs in space from which on MUMPS compresses blocks of its factors, and up to what part of them; from which on it
compresses those that are made for every parameter; steps of iterative refinement of a solution down to which residual,
or until one leaves more than half of what there was, which round-off does from 2e-13 on with 285,186 dofs; and above
which residual it is none: round-off of stiff bodies beside soft ones is far below. Measured once on hexahedra: with
42,618 dofs forces differed by 8e-10 from those of whole factors, and by 3e-7 with blocks of 1e-8; with 1,004,496 dofs
blocks of 1e-10 took 19 GB. With 92,514 and 198,681 dofs factors took 10.8 and 58 s, compressed ones 8.1 and 26; a
solution .3 and .8 s: whoever asks for many factors gains by them early."""


def ordering_of(block_size: int, plane: str) -> str:
    """Ordering for :class:`FreeCholesky`: MUMPS in space, if PETSc has it, and the given one in the plane.

    Where MUMPS is wanted in the plane too and missing, nested dissection takes its place, the fastest to factor.
    """
    if not PETSc.Sys.hasExternalPackage("mumps"):
        return "nd" if plane == "mumps" else plane
    return "mumps" if block_size == 3 else plane


def low_rank_of(block_size: int, dofs: int, *, anew: bool = False) -> float | None:
    """Part of the factors of a problem that their compression may leave out; None for whole factors.

    Args:
        block_size: dofs of a node.
        dofs: of the problem.
        anew: whether factors are made for every parameter.
    """
    if ordering_of(block_size, "mumps") != "mumps" or block_size != 3:
        return None
    (first, usual), *_ = LOW_RANK
    found = next((part for least, part in reversed(LOW_RANK) if dofs >= least), None)
    return usual if found is None and anew and dofs >= min(ANEW, first) else found


def singular_stiffness(scene: str) -> str:
    """Message for a stiffness that is singular; ``full_order.motions`` has seen bodies that move as a whole."""
    return (
        f"the stiffness of scene '{scene}' is singular to round-off, though every body is held as a whole: look for "
        "parts that hang together at single nodes or edges, E many powers of ten apart, nu next to 0.5, needle-like "
        "cells"
    )


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
        last: dofs between which K^-1 is going to be asked for, increasing, (n,). On several ranks each eliminates what
            it has of the others by itself then, see :class:`Substructures`.

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
        self._first = rows.start
        self._scene = scene
        self._columns = np.flatnonzero(free)
        self._comm = comm
        self._ordering = ordering
        self._pattern: Pattern | None = None
        self.low_rank = low_rank
        self.last = None if last is None or last.size > MOST_LAST else last[free[last]]
        if self.last is not None and self.last.size in (0, self._columns.size):  # nothing is last, or all is
            self.last = None
        self.lock = RLock()
        self._released = False
        self._factors: Factors | Substructures = self._made(stiffness)
        self.low_rank = self._factors.low_rank
        if not self._factors.factor():
            raise NotSolvableError(singular_stiffness(scene))
        self._factored: csr_matrix | None = stiffness

    def _made(self, stiffness: csr_matrix) -> Factors | Substructures:
        """What factors the values of a matrix: each rank what it has by itself, where several are asked for K^-1."""
        prefix = f"hhr_{self._scene}_"
        pattern = self._pattern_of(stiffness)
        if self._comm.size > 1 and self.last is not None and PETSc.Sys.hasExternalPackage("mumps"):
            here = np.flatnonzero(np.isin(self._first + self._free, self.last))
            shared = Substructures(pattern, stiffness.data, prefix, self._comm, here, low_rank=self.low_rank)
            if shared.possible:
                return shared
        last = None if self.last is None else np.searchsorted(self._columns, self.last)
        how = prefix, self._ordering, self._comm
        whole = Factors(pattern, stiffness.data, *how, low_rank=self.low_rank, last=last)
        self.last = self.last if whole.last is not None else None
        return whole

    def between_last(self, rows: csr_matrix) -> np.ndarray | None:
        """Some rows, (m, own dofs), as rows K^-1 rows^T, (m, m); None where they reach beyond the last dofs.

        Collective.
        """
        comm = self._comm
        alone = comm.size == 1  # S is large, and messages are copies
        whole = rows if alone else csr_matrix(hstack(comm.allgather(rows)))
        reached = whole.indices[np.isin(whole.indices, self._columns)]
        if self.last is None or not np.isin(reached, self.last).all():
            return None
        with self.lock:
            self._check_there()
            return self._factors.between_last(csr_matrix(whole[:, self.last]))

    def _pattern_of(self, stiffness: csr_matrix) -> Pattern:
        """Where the kept entries of a matrix of this pattern are: half of them for MUMPS alone."""
        marks = np.arange(stiffness.nnz, dtype=stiffness.indices.dtype)
        inside = csr_matrix((marks, stiffness.indices, stiffness.indptr), shape=stiffness.shape)
        inside = inside[self._free][:, self._columns]
        half = self._ordering == "mumps" and self._comm.size == 1
        if half:
            inside.data += 1  # a place 0 is kept
            inside = triu(inside, format="csr")
            inside.data -= 1
        inside.sort_indices()
        return Pattern(inside.indptr, inside.indices, inside.data)

    def _known_pattern(self, stiffness: csr_matrix) -> Pattern:
        """The same, kept for the next time."""
        if self._pattern is None:
            self._pattern = self._pattern_of(stiffness)
        return self._pattern

    def holds(self, stiffness: csr_matrix) -> bool:
        """Whether these are the factors of a matrix."""
        return stiffness is self._factored

    def refactor(self, stiffness: csr_matrix) -> None:
        """Take the values of another matrix with the same pattern; no work if its factors are those at hand."""
        with self.lock:
            if stiffness is self._factored:
                return
            if self._released:
                self._factors = self._made(stiffness)
                self._released = False
            else:
                self._factored = None
                self._factors.replace(stiffness.data, partial(self._known_pattern, stiffness))
            if not self._factors.factor():
                self.release()  # what refused once may refuse what is fine too
                raise NotSolvableError(
                    f"the stiffness of the full model of scene '{self._scene}' is singular at this parameter or state: "
                    "where it flows, freely beyond its limit load, or the slope of a law is wrong. Take smaller steps, "
                    "or compare the slope with differences of the flow"
                )
            self._factored = stiffness

    def _check_there(self) -> None:
        """Raise NotSolvableError where there are no factors."""
        if self._released:
            raise NotSolvableError(
                f"the factors of scene '{self._scene}' were let go, or refused a stiffness: refactor() one, as "
                "solve() of a full model does"
            )

    def release(self) -> None:
        """Give the memory back until the next :meth:`refactor`; nothing is solved before. Collective."""
        with self.lock:
            if not self._released:
                self._factors.destroy()
            self._factored = None
            self._released = True
            self._pattern = None

    def solve(self, rhs: np.ndarray) -> np.ndarray:
        """Solution on own dofs, zero on imposed ones, for own rows of a right-hand side, (own dofs,)."""
        if self.low_rank is not None:
            return self.solve_columns(csc_matrix(rhs[:, None]))[:, 0]
        solution = np.zeros(self._own)
        with self.lock:
            self._check_there()
            solution[self._free] = self._factors.solve(rhs[self._free])
        return solution

    def _refine(self, columns: csc_matrix, solutions: np.ndarray) -> None:
        """Take what solutions by compressed factors leave of their right-hand sides to them again, in place.

        Raises:
            NotSolvableError: if that does not bring them nearer.
        """
        sizes = _norms(columns.multiply(columns).sum(axis=0), self._comm)
        image, change = (np.empty(solutions.shape, order="F") for _ in range(2))
        before = np.full(sizes.shape, np.inf)
        for steps in range(REFINED + 1):
            self._factors.multiply(solutions, image)
            left = np.asfortranarray(columns - image)
            lengths = _norms((left * left).sum(axis=0), self._comm)
            gains = (lengths > PRECISE * sizes) & (lengths < HALF * before)
            if steps == REFINED or not gains.any():
                break
            before = lengths
            self._factors.solve_block(left, change)
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
        each = self._columns.size / self._comm.size  # all ranks cut the same blocks
        block_size = max(min(BLOCK, int(most / each), count), 1)
        solutions = np.empty((own, block_size), order="F")
        for first in range(0, count, block_size):
            part = slice(first, min(first + block_size, count))
            width = part.stop - first
            some = columns[:, part]
            if not self._comm.allreduce(some.nnz):  # which MUMPS calls an error
                yield part, np.zeros((wanted.size, width), order="F")
                continue
            with self.lock:
                self._check_there()
                self._factors.solve_block(some, solutions[:, :width])
                if refining:
                    self._refine(some, solutions[:, :width])
            found = np.zeros((wanted.size, width), order="F")
            found[moving] = solutions[rows, :width]
            yield part, found


def _norms(squares: np.ndarray, comm: Comm) -> np.ndarray:
    """Roots of sums over the ranks of what each has of them, (k,)."""
    return np.sqrt(comm.allreduce(np.asarray(squares).ravel()))
