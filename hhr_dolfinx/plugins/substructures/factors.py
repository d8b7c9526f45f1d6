"""Factors of a matrix whose rows are distributed over ranks, each of which eliminates its interior
rows.

The rest is the border: rows that couple those of one rank with those of others, and rows between
which K^-1 is needed. Each rank contributes a Schur complement there, and their sum is dense (Smith,
Bjorstad and Gropp, Domain Decomposition, 1996, chapter 4). MUMPS distributes factors too, but makes
the Schur complement on one rank: with 285,186 dofs it took 54 s and 6.7 GB on two ranks, and 33 s
and 4.1 GB on one.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from mpi4py import MPI
from scipy.sparse import csc_matrix, csr_matrix, triu

from hhr_dolfinx.linear.factors import Factors, Pattern, add_between
from hhr_dolfinx.plugins.substructures.border import (
    Border,
    BorderPart,
    DenseFactors,
    border_of,
    gathered,
)

if TYPE_CHECKING:
    from mpi4py.MPI import Comm

MOST_AT_BORDER = 20_000
"""Largest count of rows of a part of the border: its Schur complement then takes 3.2 GB on the
owner.
"""
SMALL_PART = 1000
"""Rows of parts below which the interior rows connected to several parts are factored as one."""


class Substructures:
    """Factors by substructuring, with the interface of :class:`Factors`.

    The pattern has whole local rows, (own, n), numbered from rank to rank, and ``last`` local ones.
    Unless they are ``possible``, by MUMPS and the size of the border, no method may be called.
    """

    clearly_regular = False  #: pivots are in factors of several kinds, and are not read

    def __init__(
        self, pattern: Pattern, values: np.ndarray, prefix: str, comm: Comm, last: np.ndarray,
        *, low_rank: float | None,
    ):  # fmt: skip
        self._comm = comm
        self.low_rank = low_rank
        row_count = len(pattern.rows) - 1
        first = int(comm.exscan(row_count) or 0)
        entries = np.arange(
            1, pattern.columns.size + 1, dtype=pattern.places.dtype
        )  # indices plus one: none is zero
        marks = csr_matrix(
            (entries, pattern.columns, pattern.rows), shape=(row_count, comm.allreduce(row_count))
        )
        self._border = border_of(marks, first, last, comm)
        at = self._border.place[first : first + row_count]
        self._edge = np.flatnonzero(at >= 0)
        self._at = at[self._edge]
        largest = max((component.size for component in self._border.parts), default=0)
        self.possible = largest <= MOST_AT_BORDER
        if not self.possible:
            return
        self._among = _between(marks[self._edge], self._border.place, pattern.places)
        # interior rows by the part of the border that they are connected to, which avoids Schur
        # complements with zeros; small parts form one group
        interior = np.flatnonzero(at < 0)
        sizes = np.array([component.size for component in self._border.parts] + [0])
        label = np.where(sizes[self._border.part_of] < SMALL_PART, -1, self._border.part_of)
        self._insides = [
            _InteriorFactors(
                marks,
                pattern.places,
                values,
                first,
                interior[label == number],
                self._border,
                prefix,
                low_rank,
            )
            for number in np.unique(label)
        ]
        self.possible = comm.allreduce(
            all(interior.possible for interior in self._insides), MPI.LAND
        )
        self._values = values[self._among.places]
        self._dense: dict[BorderPart, DenseFactors] = {}

    def replace(self, values: np.ndarray, _: Callable[[], Pattern]) -> None:
        """Set the values of the first pattern that are factored next.

        Args:
            values: values of the entries, in the order of the first pattern.
            _: not used: the pattern does not change.
        """
        for interior in self._insides:
            interior.replace(values)
        self._values = values[self._among.places]

    def factor(self) -> bool:
        """Factor the interior rows of each rank and the Schur complement of the border.

        False for a singular matrix.
        """
        self._dense = {}
        if not self._comm.allreduce(
            all([interior.factors.factor() for interior in self._insides]), MPI.LAND
        ):
            return False
        complements = {}
        for component in self._border.parts:
            total = self._left(component)
            if total is not None:
                complements[component] = total
        definite = True
        for component in list(complements):  # all ranks at the same time
            self._dense[component] = DenseFactors(complements.pop(component), component.common)
            definite &= self._dense[component].definite
        return self._comm.allreduce(definite, MPI.LAND)

    def _left(self, part: BorderPart) -> np.ndarray | None:
        """Schur complement on a part of the border, on and above the diagonal; None off its owner.

        Collective.
        """
        for interior in self._insides:
            span = slice(*np.searchsorted(interior.reach, (part.rows.start, part.rows.stop)))
            if span.start < span.stop:
                with interior.factors.left() as complement:
                    total = gathered(
                        part,
                        interior.reach[span] - part.rows.start,
                        complement[span, span],
                        self._comm,
                    )
                break
        else:
            total = gathered(part, np.zeros(0, dtype=np.int64), np.zeros((0, 0)), self._comm)
        rows = np.repeat(self._at, np.diff(self._among.rows)) - part.rows.start
        columns = self._among.columns - part.rows.start
        upper = (rows >= 0) & (rows < part.size) & (rows <= columns)
        for entries in (
            self._comm.gather((rows[upper], columns[upper], self._values[upper]), part.owner) or ()
        ):
            assert total is not None
            total[entries[0], entries[1]] += entries[2]  # each entry once
        return total

    def between_last(self, rows: csr_matrix) -> np.ndarray:
        """Product rows K^-1 rows^T, (m, m), of rows, (m, n), on the last rows of all ranks.

        Collective.
        """
        product = np.zeros((rows.shape[0], rows.shape[0]))
        for component, factors in self._dense.items():
            inverted = self._border.inverted
            local_rows = csr_matrix(
                rows[:, (inverted >= component.rows.start) & (inverted < component.rows.stop)]
            )
            if local_rows.nnz:
                add_between(local_rows, factors.inverse(), product)
        self._comm.Allreduce(MPI.IN_PLACE, product)
        return product

    def destroy(self) -> None:
        """Free the memory at once. Collective."""
        for interior in self._insides:
            interior.factors.destroy()
        self._dense = {}

    def solve(self, rhs: np.ndarray) -> np.ndarray:
        """Local rows of the solution for those of a right-hand side, (own,). Collective."""
        solution = np.empty((rhs.size, 1), order="F")
        self.solve_block(np.asfortranarray(rhs[:, None]), solution)
        return solution[:, 0]

    def solve_block(self, columns: csc_matrix | np.ndarray, solutions: np.ndarray) -> None:
        """Write solutions for some columns into an array. Collective.

        The interior is solved with a fixed border, whose displacement by the remaining loads then
        corrects it.

        Args:
            columns: local rows of the right-hand sides, (own, k), sparse or dense.
            solutions: array for the local rows of the solutions, (own, k), in Fortran order.
        """
        edge = columns[self._edge]
        loads = self._on_border(edge if isinstance(edge, np.ndarray) else edge.toarray())
        for interior in self._insides:
            loads_of_interior = columns[interior.rows]
            still = (
                interior.solved(loads_of_interior)
                if isinstance(loads_of_interior, np.ndarray) or loads_of_interior.nnz
                else None
            )
            solutions[interior.rows] = 0.0 if still is None else still[: interior.rows.size]
            if still is not None:
                loads[interior.reach] -= interior.times(still)[interior.rows.size :]
        self._comm.Allreduce(MPI.IN_PLACE, loads)
        on_border = np.zeros_like(loads)
        for component, factors in self._dense.items():
            on_border[component.rows] = factors.solve(loads[component.rows])
        self._comm.Allreduce(MPI.IN_PLACE, on_border)
        for interior in self._insides:
            drawn = np.zeros(
                (interior.rows.size + interior.reach.size, on_border.shape[1]), order="F"
            )
            drawn[interior.rows.size :] = on_border[interior.reach]
            solutions[interior.rows] -= interior.solved(
                interior.times(drawn)[: interior.rows.size]
            )[: interior.rows.size]
        solutions[self._edge] = on_border[self._at]

    def multiply(self, block: np.ndarray, image: np.ndarray) -> None:
        """Write the matrix times some columns into an array.

        Collective.

        Args:
            block: local rows of the columns, (own, k), in Fortran order.
            image: array for the local rows of the product, (own, k), in Fortran order.
        """
        border = self._on_border(block[self._edge])
        self._comm.Allreduce(MPI.IN_PLACE, border)
        shape = self._edge.size, self._border.numbers.size
        among = csr_matrix((self._values, self._among.columns, self._among.rows), shape=shape)
        total = self._on_border(among @ border)
        for interior in self._insides:
            displacements = np.asfortranarray(
                np.vstack([block[interior.rows], border[interior.reach]])
            )
            products = interior.times(displacements)
            image[interior.rows] = products[: interior.rows.size]
            total[interior.reach] += products[interior.rows.size :]
        self._comm.Allreduce(MPI.IN_PLACE, total)
        image[self._edge] = total[self._at]

    def _on_border(self, own: np.ndarray) -> np.ndarray:
        total = np.zeros((self._border.numbers.size, own.shape[1]))
        total[self._at] = own
        return total


class _InteriorFactors:
    """Factors of interior rows of this rank, (k,).

    They have their Schur complement on the border, if that is ``possible``.

    ``marks`` holds the index of each entry in the pattern plus one, CSR, (own, n), and ``places``
    their indices in the values. ``reach`` are the indices in the border of the rows that the
    interior is coupled with, increasing, (r,).
    """

    def __init__(
        self,
        marks: csr_matrix,
        places: np.ndarray,
        values: np.ndarray,
        first: int,
        rows: np.ndarray,
        border: Border,
        prefix: str,
        low_rank: float | None,
    ):
        self.rows = rows
        interior_rows = marks[rows]
        met = np.zeros(marks.shape[1], dtype=bool)
        met[interior_rows.indices] = True
        self.reach = np.sort(border.place[met & (border.place >= 0)])
        count = rows.size + self.reach.size
        columns = np.full(marks.shape[1], -1, dtype=interior_rows.indices.dtype)
        columns[first + rows] = np.arange(rows.size)
        columns[border.numbers[self.reach]] = np.arange(rows.size, count)
        starts = np.append(
            interior_rows.indptr,
            np.full(self.reach.size, interior_rows.nnz, dtype=interior_rows.indptr.dtype),
        )
        local = triu(
            csr_matrix(
                (interior_rows.data, columns[interior_rows.indices], starts), shape=(count, count)
            ),
            format="csr",
        )
        local.sort_indices()
        self._pattern = Pattern(local.indptr, local.indices, places[local.data - 1])
        last = np.arange(rows.size, count) if self.reach.size else None
        self.factors = Factors(
            self._pattern,
            values,
            prefix,
            "mumps",
            MPI.COMM_SELF,
            low_rank=low_rank,
            last=last,
            inverted=False,
        )
        self.possible = last is None or self.factors.last is not None

    def replace(self, values: np.ndarray) -> None:
        """Set the values that are factored next."""
        self.factors.replace(values, lambda: self._pattern)

    def solved(self, columns: csc_matrix | np.ndarray) -> np.ndarray:
        """K^-1 of the interior times columns, (k, c), then zeros for the border: (k + r, c)."""
        solutions = np.empty((self.rows.size + self.reach.size, columns.shape[1]), order="F")
        loads = np.zeros_like(solutions)
        loads[: self.rows.size] = columns if isinstance(columns, np.ndarray) else columns.toarray()
        self.factors.solve_block(loads, solutions)
        solutions[self.rows.size :] = 0.0
        return solutions

    def times(self, block: np.ndarray) -> np.ndarray:
        """Entries of the interior rows and their transposes times displacements, (k + r, c)."""
        product = np.empty_like(block)
        self.factors.multiply(block, product)
        return product


def _between(edges: csr_matrix, place: np.ndarray, places: np.ndarray) -> Pattern:
    """Entries of local rows of the border in columns of the border, by indices there."""
    on_border = place[edges.indices] >= 0
    starts = np.append(0, np.cumsum(on_border))[edges.indptr]
    return Pattern(starts, place[edges.indices[on_border]], places[edges.data[on_border] - 1])
