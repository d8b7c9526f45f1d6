"""Factors of a matrix whose rows are spread over ranks, of which each eliminates what lies inside of its own.

What is left meets in a border: rows that have those of one rank coupled with those of others, and those between which
K^-1 is asked for. Each rank leaves a Schur complement there, and their sum is dense (Smith, Bjorstad and Gropp, Domain
Decomposition, 1996, chapter 4). MUMPS shares factors of ranks too, but a Schur complement of several is made by one:
measured with 285,186 dofs on two ranks it took 54 s and 6.7 GB, where one rank by itself takes 33 s and 4.1 GB.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from typing import TYPE_CHECKING

import numpy as np
from mpi4py import MPI
from scipy.sparse import csc_matrix, csr_matrix, triu

from hhr_dolfinx.linear.border import DenseFactors, Part, border_of, gathered
from hhr_dolfinx.linear.factors import Factors, Pattern

if TYPE_CHECKING:
    from mpi4py.MPI import Comm

MOST_AT_BORDER = 20_000
"""Rows of a part of the border at most: what is left there takes 3.2 GB of its owner then."""


class Substructures:
    """Factors by what each rank eliminates of its own rows; see :class:`Factors`, whose place it takes.

    Args:
        pattern: own rows, whole, (own, n), numbered from rank to rank.
        values: data that the places of the pattern point into.
        prefix: of PETSc options, for the factors of each rank.
        comm: the ranks.
        last: own rows, increasing, between which K^-1 is going to be asked for.
        low_rank: see :class:`Factors`.

    Attributes:
        low_rank: the same.
        possible: whether MUMPS gives Schur complements here, and the border is not too large; nothing else is to be
            called where it is not.
    """

    def __init__(
        self, pattern: Pattern, values: np.ndarray, prefix: str, comm: Comm, last: np.ndarray,
        *, low_rank: float | None,
    ):  # fmt: skip
        self._comm = comm
        self.low_rank = low_rank
        own = len(pattern.rows) - 1
        first = int(comm.exscan(own) or 0)
        entries = np.arange(1, pattern.columns.size + 1)  # their places, of which none is zero
        marks = csr_matrix((entries, pattern.columns, pattern.rows), shape=(own, comm.allreduce(own)))
        self._border = border_of(marks, first, last, comm)
        at = self._border.place[first : first + own]
        self._inside = np.flatnonzero(at < 0)
        self._edge = np.flatnonzero(at >= 0)
        self._at = at[self._edge]
        largest = max((part.size for part in self._border.parts), default=0)
        self.possible = largest <= MOST_AT_BORDER and comm.allreduce(self._inside.size > 0, MPI.LAND)
        if not self.possible:
            return
        self._separate(marks, pattern, first)
        ends = self._inside.size + np.arange(self._reach.size) if self._reach.size else None
        self._own = Factors(
            self._pattern, values, prefix, "mumps", MPI.COMM_SELF, low_rank=low_rank, last=ends, inverted=False
        )
        self.possible = comm.allreduce(ends is None or self._own.last is not None, MPI.LAND)
        self._values = values[self._among.places]
        self._dense: dict[Part, DenseFactors] = {}
        self._inverse: np.ndarray | None = None

    def _separate(self, marks: csr_matrix, pattern: Pattern, first: int) -> None:
        """Part entries into those that this rank eliminates, half of them, and those between rows of the border."""
        place = self._border.place
        inside = marks[self._inside]
        reached = np.zeros(len(place), dtype=bool)
        reached[inside.indices] = True
        self._reach = np.sort(place[reached & (place >= 0)])
        count = self._inside.size + self._reach.size
        columns = np.full(len(place), -1)
        columns[first + self._inside] = np.arange(self._inside.size)
        columns[self._border.numbers[self._reach]] = np.arange(self._inside.size, count)
        starts = np.append(inside.indptr, np.full(self._reach.size, inside.nnz, dtype=inside.indptr.dtype))
        local = triu(csr_matrix((inside.data, columns[inside.indices], starts), shape=(count, count)), format="csr")
        local.sort_indices()
        self._pattern = Pattern(local.indptr, local.indices, pattern.places[local.data - 1])
        edges = marks[self._edge]
        kept = place[edges.indices] >= 0
        starts = np.append(0, np.cumsum(kept))[edges.indptr]
        self._among = Pattern(starts, place[edges.indices[kept]], pattern.places[edges.data[kept] - 1])

    def replace(self, pattern: Pattern, values: np.ndarray) -> None:
        """Take other values of the same pattern, which are factored next."""
        self._own.replace(self._pattern, values)
        self._values = values[self._among.places]

    def factor(self) -> bool:
        """Factor what each rank has inside, and what that leaves of the border; False for a singular matrix."""
        self._inverse = None
        self._dense = {}
        if not self._comm.allreduce(self._own.factor(), MPI.LAND):
            return False
        definite = True
        with self._own.left() if self._reach.size else nullcontext(np.zeros((0, 0))) as left:
            for part in self._border.parts:
                here = slice(*np.searchsorted(self._reach, (part.rows.start, part.rows.stop)))
                total = gathered(part, self._reach[here] - part.rows.start, left[here, here], self._comm)
                total = self._with_own_entries(part, total)
                if total is not None:
                    self._dense[part] = DenseFactors(total, part.common)
                    definite &= self._dense[part].definite
        return self._comm.allreduce(definite, MPI.LAND)

    def _with_own_entries(self, part: Part, total: np.ndarray | None) -> np.ndarray | None:
        """Add entries between rows of a part, in place, on its owner. Collective."""
        rows = np.repeat(self._at, np.diff(self._among.rows)) - part.rows.start
        columns = self._among.columns - part.rows.start
        upper = (rows >= 0) & (rows < part.size) & (rows <= columns)
        for own in self._comm.gather((rows[upper], columns[upper], self._values[upper]), part.owner) or ():
            assert total is not None
            total[own[0], own[1]] += own[2]  # each entry once
        return total

    @contextmanager
    def inverse(self) -> Iterator[np.ndarray]:
        """K^-1 between the last rows of all ranks, (n, n), on the first one, and nothing on others. Collective."""
        if self._inverse is None:
            asked = self._border.asked
            found = np.zeros((asked.size, asked.size) if self._comm.rank == 0 else (0, 0))
            for part in self._border.parts:
                block = self._dense[part].inverse() if part in self._dense else None
                if part.owner > 0 and self._comm.rank == part.owner:
                    self._comm.Send(block, 0)
                if self._comm.rank == 0:
                    here = np.flatnonzero((asked >= part.rows.start) & (asked < part.rows.stop))
                    if block is None:
                        block = np.empty((here.size, here.size))
                        self._comm.Recv(block, part.owner)
                    found[np.ix_(here, here)] = block
            self._inverse = found
        yield self._inverse

    def destroy(self) -> None:
        """Give the memory back, at once. Collective."""
        self._own.destroy()
        self._dense = {}
        self._inverse = None

    def solve(self, rhs: np.ndarray) -> np.ndarray:
        """Own rows of a solution, for those of a right-hand side, (own,). Collective."""
        found = np.empty((rhs.size, 1), order="F")
        self.solve_block(np.asfortranarray(rhs[:, None]), found)
        return found[:, 0]

    def solve_block(self, columns: csc_matrix | np.ndarray, solutions: np.ndarray) -> None:
        """Write solutions for some columns, (own, k), sparse or dense, into an array by columns. Collective.

        First with the border at rest; what that leaves of its loads moves it, and what is inside follows.
        """
        inside = columns[self._inside]
        edge = columns[self._edge]
        loads = edge if isinstance(edge, np.ndarray) else edge.toarray()
        still = np.zeros((self._inside.size + self._reach.size, loads.shape[1]), order="F")
        image = np.empty_like(still)
        if isinstance(inside, np.ndarray) or inside.nnz:
            self._solve_inside(inside, still)
        self._own.multiply(still, image)
        moved = self._moved(self._summed(loads, -image[self._inside.size :]))
        drawn = np.zeros_like(still)
        drawn[self._inside.size :] = moved[self._reach]
        self._own.multiply(drawn, image)
        self._solve_inside(image[: self._inside.size], drawn)
        solutions[self._inside] = still[: self._inside.size] - drawn[: self._inside.size]
        solutions[self._edge] = moved[self._at]

    def _solve_inside(self, columns: csc_matrix | np.ndarray, solutions: np.ndarray) -> None:
        """Write K^-1 of the rows inside times columns, (inside, k), into an array, (inside and reach, k)."""
        if isinstance(columns, np.ndarray):
            given = np.zeros_like(solutions)
            given[: self._inside.size] = columns
        else:
            given = csc_matrix(columns)
            given.resize(solutions.shape)
        self._own.solve_block(given, solutions)
        solutions[self._inside.size :] = 0.0

    def _moved(self, loads: np.ndarray) -> np.ndarray:
        """Displacements of the border, (border, k), under loads there. Collective."""
        found = np.zeros_like(loads)
        for part, factors in self._dense.items():
            found[part.rows] = factors.solve(loads[part.rows])
        self._comm.Allreduce(MPI.IN_PLACE, found)
        return found

    def _summed(self, own: np.ndarray, reached: np.ndarray) -> np.ndarray:
        """Rows of the border, (border, k), alike on all ranks: of own ones, and those within reach, all added."""
        total = np.zeros((self._border.numbers.size, own.shape[1]))
        total[self._at] = own
        total[self._reach] += reached
        self._comm.Allreduce(MPI.IN_PLACE, total)
        return total

    def multiply(self, block: np.ndarray, image: np.ndarray) -> None:
        """Write the matrix times some columns, (own, k), into an array; both lie by columns. Collective."""
        border = self._summed(block[self._edge], np.zeros((self._reach.size, block.shape[1])))
        given = np.asfortranarray(np.vstack([block[self._inside], border[self._reach]]))
        found = np.empty_like(given)
        self._own.multiply(given, found)
        image[self._inside] = found[: self._inside.size]
        shape = self._edge.size, self._border.numbers.size
        among = csr_matrix((self._values, self._among.columns, self._among.rows), shape=shape)
        image[self._edge] = self._summed(among @ border, found[self._inside.size :])[self._at]
