"""Operations on tables with a row for each dof, (N, k).

A plug-in has them for rows that several processes share.
"""

from __future__ import annotations

from typing import Any, TypeVar

import numpy as np
from scipy import linalg
from scipy.sparse import csr_matrix

from hhr_dolfinx.group import ProcessGroup

T = TypeVar("T")


class Rows:
    """All rows, ``count`` of them: the operations are those of numpy. Collective, except ``of``."""

    all_here = True  # whether all rows are local

    def __init__(self, own: slice, count: int) -> None:
        self.own = own  # range of the local rows
        self.count = count

    def sum(self, part: T) -> T:
        """Sum over the processes of a number or an array of real numbers, of the same shape on
        each.
        """
        return part

    def of(self, table: T) -> T:
        """Local rows of a table that has all rows."""
        return table

    def mine(self, places: np.ndarray) -> np.ndarray:
        """Select the local ones of some rows, (n,), as indices in the local rows."""
        return places

    def at(self, table: np.ndarray, places: np.ndarray) -> np.ndarray:
        """Some rows of a table, (n, ...).

        Args:
            table: table of local rows, (own, ...).
            places: indices of the rows, (n,).
        """
        return table[places]

    def whole(self, table: np.ndarray) -> np.ndarray:
        """A vector, (own,), or a table, (own, k), with all rows."""
        return table

    def largest(self, values: np.ndarray) -> tuple[int, float]:
        """Index of the largest of some values, one for each row, and this value.

        The first of equal values.
        """
        index = int(values.argmax()) if values.size else 0
        return index, float(values[index])

    def first(self, value: T) -> T:
        """Small value of the first process, on all: others may have other last digits."""
        return value

    def alike(self, value: int | bytes) -> bool:
        """True if a small value is the same on all processes."""
        return True

    def norms(self, table: np.ndarray) -> np.ndarray:
        """Euclidean norm of each column, (k,)."""
        return np.linalg.norm(table, axis=0)

    def orthonormal(self, table: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Decompose a table into Q R: local rows of Q, with orthonormal columns, and R, (k, k)."""
        factors: tuple[np.ndarray, np.ndarray] = linalg.qr(table, mode="economic")
        return factors

    def matrix(self, own: csr_matrix) -> Any:
        """Local rows of a sparse matrix, (own, N), for products with tables of local rows."""
        return own

    def columns(self, matrix: csr_matrix) -> csr_matrix:
        """Columns of a sparse matrix, (m, N), that belong to the local rows of tables."""
        return matrix

    def modes(self, problem: Any, basis: np.ndarray, sets: Any) -> Any:
        """Modes as test and trial functions of a reduction, see ``reduction.projection``.

        Args:
            problem: the contact problem.
            basis: local rows of the modes, (own, ell).
            sets: index sets of the RID.

        Raises:
            NotImplementedError: if all rows are local.
        """
        raise NotImplementedError  # all rows are here


def rows_of(own: slice, count: int, group: ProcessGroup) -> Rows:
    """Rows of a group of processes, each of which has a range of them after those of the ones
    before it.

    Args:
        own: range of rows of this process.
        count: number of all rows.
        group: processes that share the rows.
    """
    rows: Rows = Rows(own, count) if group.size == 1 else group.rows(own, count)
    return rows
