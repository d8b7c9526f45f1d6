"""Sparse Cholesky factors by PETSc."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from threading import RLock
from typing import TYPE_CHECKING

import numpy as np
from petsc4py import PETSc
from scipy.sparse import csc_matrix, csr_matrix, hstack, spmatrix, triu

from hhr_dolfinx import registry
from hhr_dolfinx.errors import NotSolvableError
from hhr_dolfinx.linear.factors import Factors, Pattern

if TYPE_CHECKING:
    from mpi4py.MPI import Comm


RIGHT_SIDES = 128
"""Right-hand sides solved at once: the factors are read once for all of them, and they take little
memory.
"""
SOLVED_NUMBERS = 16e6
"""Largest count of numbers in a block of solutions, 128 MB."""
REFINED_NUMBERS = 8e6
"""Largest count of numbers in a block of solutions that is refined: it takes several arrays of
its size."""
MOST_LAST = 7000
"""Largest count of dofs that are eliminated last: K^-1 between them takes 0.4 GB, and three times
as much while it is made. With a million dofs, 7,786 of them last, a condensed model took about half
of the time and over 1 GB more.
"""
LOST = 1e-3
SURE = 1e-6
TRIES = 4
"""Part of a known solution from which on its loss shows a singular K, part up to which it shows a
regular one, and vectors that are tried between them.
"""
LOW_RANK = ((150_000, 1e-10), (600_000, 1e-8))
ANEW = 60_000
REFINED = 5
REFINED_RESIDUAL = 1e-13
HALF = 0.5
STALLED_RESIDUAL = 1e-9
"""Compression of factors by MUMPS in space, and iterative refinement of solutions by compressed
factors.

``LOW_RANK``: dofs from which on MUMPS compresses blocks, each with its tolerance. ``ANEW``: dofs
from which on it compresses factors that are made for every parameter. Refinement takes at most
``REFINED`` steps, down to the relative residual ``REFINED_RESIDUAL``, or until a step leaves
more than ``HALF`` of the residual, as round-off does from 2e-13 on with 285,186 dofs. A
residual above ``STALLED_RESIDUAL`` is a failure: round-off of stiff bodies next to soft ones is
far below.

Measured once on hexahedra. With 42,618 dofs forces differed by 8e-10 from those of whole factors,
and by 3e-7 with tolerance 1e-8; with 1,004,496 dofs tolerance 1e-10 took 19 GB. With 92,514 and
198,681 dofs whole factors took 10.8 and 58 s, compressed ones 8.1 and 26 s, a solution 0.3 and 0.8
s: models with many factors gain by compression early.
"""


def ordering_of(block_size: int, plane: str) -> str:
    """Ordering for :class:`FreeCholesky`: MUMPS in space, else the given one.

    ``nd`` replaces a missing MUMPS.

    Args:
        block_size: components of the displacement, 3 in space.
        plane: ordering for problems in the plane.
    """
    if not PETSc.Sys.hasExternalPackage("mumps"):
        return "nd" if plane == "mumps" else plane
    return "mumps" if block_size == 3 else plane


def low_rank_of(block_size: int, dofs: int, *, anew: bool = False) -> float | None:
    """Tolerance of MUMPS' compression, or None for whole factors.

    Args:
        block_size: components of the displacement, 3 in space.
        dofs: number of dofs.
        anew: True if factors are made for every parameter.
    """
    if ordering_of(block_size, "mumps") != "mumps" or block_size != 3:
        return None
    (first, usual), *_ = LOW_RANK
    tolerance = next((eps for least, eps in reversed(LOW_RANK) if dofs >= least), None)
    return usual if tolerance is None and anew and dofs >= min(ANEW, first) else tolerance


def singular_stiffness(scene: str) -> str:
    """Message for a singular stiffness.

    ``full_order.free_bodies`` has excluded bodies with rigid motions.
    """
    return (
        f"the stiffness of scene '{scene}' is singular to round-off, though every body is held as "
        "a whole: look for parts that are connected only at single nodes or edges, E many powers "
        "of ten apart, nu next to 0.5, needle-like cells"
    )


class FreeCholesky:
    """Factors of a stiffness on its free dofs, on any number of ranks, each with its rows.

    :meth:`refactor` replaces the factors for other values. If other users may do so meanwhile, hold
    the reentrant ``lock`` and call :meth:`refactor` before a solution. A singular K raises
    NotSolvableError.

    Args:
        stiffness: local rows of K, CSR, (own dofs, N).
        free: dofs that are not imposed, (N,) bool.
        rows: range of the dofs that this rank owns.
        scene: name of the scene, for messages and the prefix of PETSc options, ``hhr_<scene>_``.
        ordering, comm, low_rank: see :class:`Factors`. Solutions by compressed factors are refined,
            those of blocks of columns only on request.
        last: dofs between which K^-1 is needed, increasing, (n,), on several ranks by a plug-in; as
            an attribute None if that takes solutions.
    """

    def __init__(
        self,
        stiffness: csr_matrix,
        free: np.ndarray,
        rows: slice,
        scene: str,
        ordering: str,
        comm: Comm,
        *,
        low_rank: float | None = None,
        last: np.ndarray | None = None,
    ):
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
        if self.last is not None and self.last.size in (
            0,
            self._columns.size,
        ):  # no row is last, or every row
            self.last = None
        self.lock = RLock()
        self._factors: Factors | None = self._made(stiffness)
        self.low_rank = self._factors.low_rank
        if not (self._factors.factor() and self._regular(stiffness)):
            raise NotSolvableError(singular_stiffness(scene))
        self._factored: csr_matrix | None = stiffness

    def _made(self, stiffness: csr_matrix) -> Factors:
        """Factors of the pattern of a matrix.

        Substructures if several ranks need K^-1 between last dofs.
        """
        prefix = f"hhr_{self._scene}_"
        pattern = self._pattern_of(stiffness)
        substructures = registry.offered("substructures") if self._comm.size > 1 else None
        if (
            substructures is not None
            and self.last is not None
            and PETSc.Sys.hasExternalPackage("mumps")
        ):
            local_last = np.flatnonzero(np.isin(self._first + self._free, self.last))
            shared = substructures(
                pattern, stiffness.data, prefix, self._comm, local_last, low_rank=self.low_rank
            )
            if shared.possible:
                return shared
        last = None if self.last is None else np.searchsorted(self._columns, self.last)
        settings = prefix, self._ordering, self._comm
        factors = Factors(pattern, stiffness.data, *settings, low_rank=self.low_rank, last=last)
        self.last = self.last if factors.last is not None else None
        return factors

    def between_last(self, rows: csr_matrix) -> np.ndarray | None:
        """Product rows K^-1 rows^T, (m, m), of rows, (m, own dofs); None if they reach beyond
        ``last``. Collective.
        """
        comm = self._comm
        alone = comm.size == 1  # S is large, and messages are copies
        gathered = rows if alone else csr_matrix(hstack(comm.allgather(rows)))
        reached = gathered.indices[np.isin(gathered.indices, self._columns)]
        if self.last is None or not np.isin(reached, self.last).all():
            return None
        with self.lock:
            return self._there().between_last(csr_matrix(gathered[:, self.last]))

    def _pattern_of(self, stiffness: csr_matrix) -> Pattern:
        """Pattern of the entries between free dofs of a matrix.

        Only the upper triangle for MUMPS on one rank.
        """
        marks = np.arange(stiffness.nnz, dtype=stiffness.indices.dtype)
        entries = csr_matrix((marks, stiffness.indices, stiffness.indptr), shape=stiffness.shape)
        entries = entries[self._free][:, self._columns]
        half = self._ordering == "mumps" and self._comm.size == 1
        if half:
            entries.data += 1  # keeps the index 0
            entries = triu(entries, format="csr")
            entries.data -= 1
        entries.sort_indices()
        return Pattern(entries.indptr, entries.indices, entries.data)

    def _known_pattern(self, stiffness: csr_matrix) -> Pattern:
        if self._pattern is None:
            self._pattern = self._pattern_of(stiffness)
        return self._pattern

    def holds(self, stiffness: csr_matrix) -> bool:
        """True for the factored matrix."""
        return stiffness is self._factored

    def refactor(self, stiffness: csr_matrix) -> None:
        """Factor another matrix with the same pattern, unless it is the one factored last.

        Raises:
            NotSolvableError: if the matrix is singular.
        """
        with self.lock:
            if stiffness is self._factored:
                return
            self._factored = None
            if self._factors is None:
                self._factors = self._made(stiffness)
            else:
                self._factors.replace(stiffness.data, partial(self._known_pattern, stiffness))
            if not (self._factors.factor() and self._regular(stiffness)):
                self.release()  # after a failure it may refuse regular matrices too
                raise NotSolvableError(
                    f"the stiffness of the full model of scene '{self._scene}' is singular at "
                    "this parameter or state: a body has lost what holds it, as where the "
                    "parameter of a foundation is zero (narrow the box); or the load is beyond a "
                    "limit load (take smaller steps), or the slope of a law is wrong"
                )
            self._factored = stiffness

    def _regular(self, stiffness: csr_matrix) -> bool:
        """False for a K that is singular to round-off, which its factors show on some machines
        alone. Collective.

        Its last pivots are round-off of either sign, and only a negative one, or zero, ends a
        factorisation. Solving for a known vector loses about cond(K) times 1e-16 of it: up to 1e-5
        was seen with bodies a million times as stiff as others. With free rigid motions it loses a
        part of the order of 1, of one vector in a hundred by chance less than LOST: of several
        vectors one shows it.
        """
        if self._there().clearly_regular:
            return True
        vectors = np.random.default_rng(0)
        solution = np.zeros(stiffness.shape[1])
        local_rows = slice(self._first, self._first + self._own)
        for _ in range(TRIES):
            solution[self._columns] = vectors.standard_normal(self._columns.size)
            lost = self.solve(stiffness @ solution) - solution[local_rows]
            error, size = _norms(
                np.array([lost @ lost, solution[local_rows] @ solution[local_rows]]), self._comm
            )
            if not SURE * size < error <= LOST * size:  # also for NaN
                return bool(error <= SURE * size)
        return True

    def _there(self) -> Factors:
        if self._factors is None:
            raise NotSolvableError(
                f"the factors of scene '{self._scene}' were let go, or refused a stiffness: "
                "refactor() one, as solve() of a full model does"
            )
        return self._factors

    @property
    def negative(self) -> int:
        """See :class:`Factors`."""
        return self._there().negative

    def release(self) -> None:
        """Free the memory until the next :meth:`refactor`, which must precede further solutions.

        Collective.
        """
        with self.lock:
            if self._factors is not None:
                self._factors.destroy()
            self._factors = self._factored = self._pattern = None

    def solve(self, rhs: np.ndarray) -> np.ndarray:
        """Solution on local dofs, zero on imposed ones, for local rows of a right-hand side, (own
        dofs,).
        """
        if self.low_rank is not None:
            return self.solve_columns(csc_matrix(rhs[:, None]))[:, 0]
        solution = np.zeros(self._own)
        with self.lock:
            solution[self._free] = self._there().solve(rhs[self._free])
        return solution

    def _refine(self, factors: Factors, columns: csc_matrix, solutions: np.ndarray) -> None:
        """Refine solutions by compressed factors in place.

        NotSolvableError above STALLED_RESIDUAL.
        """
        sizes = _norms(columns.multiply(columns).sum(axis=0), self._comm)
        image, change = (np.empty(solutions.shape, order="F") for _ in range(2))
        before = np.full(sizes.shape, np.inf)
        for steps in range(REFINED + 1):
            factors.multiply(solutions, image)
            residual = np.asfortranarray(columns - image)
            lengths = _norms((residual * residual).sum(axis=0), self._comm)
            gains = (lengths > REFINED_RESIDUAL * sizes) & (lengths < HALF * before)
            if steps == REFINED or not gains.any():
                break
            before = lengths
            factors.solve_block(residual, change)
            solutions += change
        if not (lengths <= STALLED_RESIDUAL * sizes).all():
            raise NotSolvableError(
                f"solutions by compressed factors of scene '{self._scene}' stay "
                f"{(lengths / sizes).max():.1e} off: leave out less than {self.low_rank:g} by the "
                f"PETSc option -hhr_{self._scene}_mat_mumps_cntl_7"
            )

    def solve_columns(self, columns: spmatrix) -> np.ndarray:
        """Solutions for columns of a sparse matrix of local rows, zero on imposed dofs, (own dofs,
        m). Collective.
        """
        table = np.zeros((self._own, columns.shape[1]), order="F")
        for span, solutions in self.solved_blocks(columns, refined=True):
            table[:, span] = solutions
        return table

    def solved_blocks(
        self, columns: spmatrix, dofs: np.ndarray | None = None, *, refined: bool = False
    ) -> Iterator[tuple[slice, np.ndarray]]:
        """Solve for columns in blocks. Collective.

        Args:
            columns: local rows of the right-hand sides, (own dofs, m).
            dofs: local dofs of the solutions; None for all.
            refined: refine solutions by compressed factors.

        Yields:
            Slices of columns, and their solutions, (own dofs or ``dofs``, k).
        """
        columns = columns.tocsr()[self._free].tocsc()
        free_count, count = columns.shape
        wanted = np.arange(self._own) if dofs is None else dofs
        free_index = np.full(self._own, -1)
        free_index[self._free] = np.arange(free_count)
        moving = free_index[wanted] >= 0
        rows = free_index[wanted[moving]]
        refining = refined and self.low_rank is not None
        most = REFINED_NUMBERS if refining else SOLVED_NUMBERS
        each = self._columns.size / self._comm.size  # the same blocks on all ranks
        block_size = max(min(RIGHT_SIDES, int(most / max(each, 1)), count), 1)
        solutions = np.empty((free_count, block_size), order="F")
        for first in range(0, count, block_size):
            span = slice(first, min(first + block_size, count))
            width = span.stop - first
            block = columns[:, span]
            if not self._comm.allreduce(block.nnz):  # an error in MUMPS
                yield span, np.zeros((wanted.size, width), order="F")
                continue
            with self.lock:
                factors = self._there()
                factors.solve_block(block, solutions[:, :width])
                if refining:
                    self._refine(factors, block, solutions[:, :width])
            values = np.zeros((wanted.size, width), order="F")
            values[moving] = solutions[rows, :width]
            yield span, values


def _norms(squares: np.ndarray, comm: Comm) -> np.ndarray:
    own = np.asarray(squares).ravel()
    return np.sqrt(own if comm.size == 1 else comm.allreduce(own))
