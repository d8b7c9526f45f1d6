"""Displacements of all dofs by those of free ones, U = T V + L θ, and forces on all dofs by those
that act on V.

V is zero on imposed and on dependent dofs. Dependent dofs, those of multi-point constraints, are
eliminated by T; forces on them act on V by T^T. Imposed dofs keep their rows in K and in forces, as
reactions are read there, and factors leave them out. Without dependent dofs T is the identity, and
costs nothing. U0 = T V is a field of all dofs; bases of reduced models consist of such fields.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple, Protocol, TypeVar

import numpy as np
from scipy.sparse import csc_matrix, csr_matrix, diags, vstack

from hhr_dolfinx.group import ALONE, ProcessGroup

if TYPE_CHECKING:
    from hhr_dolfinx.linear.rows import Rows

ALL = slice(None)

Columns = TypeVar("Columns", np.ndarray, csc_matrix)
"""Columns of fields or forces, dense or sparse."""


class Product(Protocol):
    """Local rows of a matrix, for products with tables of local rows."""

    def __matmul__(self, table: np.ndarray, /) -> np.ndarray:
        """Local rows of the product, (own, k), with a table of local rows, (own, k). Collective."""

    def __abs__(self) -> Product:
        """Sizes of the entries."""


class OnRows(NamedTuple):
    """T and T^T for tables of which each process has local rows, (own, k), and T^T for sparse
    ones.
    """

    prolong: Product
    restrict: Product
    columns: Callable[[csc_matrix], csc_matrix]


@dataclass(frozen=True)
class Prolongation:
    """Displacements of N dofs by those of free ones and by 1 + T terms; the same on all processes.

    Attributes:
        free: dofs with an unknown, (N,) bool: neither imposed nor dependent on others.
        movable: dofs that are not imposed, (N,) bool: free and dependent ones.
        lifts: L, sparse, (N, 1 + T): imposed displacements, nonzero on the imposed dofs alone
            (section 2.6) or, for bodies whose stiffness depends on parameters, on whole bodies if
            they are rigid motions of these; dependent dofs follow.
        map: T, (N, N), with zero columns at dependent dofs; None for the identity.
        groups: nodes that act on each other through dependent dofs, (groups, nodes), non-zero where
            a node is in a group; None without dependent dofs.
    """

    free: np.ndarray
    movable: np.ndarray
    lifts: csc_matrix
    map: csr_matrix | None = None
    groups: csr_matrix | None = None

    @classmethod
    def of_free(cls, free: np.ndarray, lifts: csc_matrix | None = None) -> Prolongation:
        """Prolongation of free and imposed dofs, of which none depends on others.

        Args:
            free: dofs with an unknown, (N,) bool.
            lifts: displacements of imposed dofs, (N, 1 + T); None for none.
        """
        return cls(free, free, csc_matrix((free.size, 0)) if lifts is None else lifts)

    @property
    def dependent(self) -> np.ndarray:
        """Dofs that depend on others, (N,) bool."""
        return self.movable & ~self.free

    @cached_property
    def transposed(self) -> csr_matrix:
        """T^T, (N, N), where dofs depend on others."""
        assert self.map is not None
        return csr_matrix(self.map.T)

    def lifted(self, lifts: csc_matrix) -> Prolongation:
        """Copy with lifts of imposed dofs and values of equations. Dependent dofs follow the
        former.
        """
        if self.map is not None:
            independent = csc_matrix(diags((~self.dependent).astype(float)) @ lifts)
            lifts = csc_matrix(lifts - independent + self.map @ independent)
        return replace(self, lifts=lifts)

    def prolong(self, fields: np.ndarray) -> np.ndarray:
        """T V of fields that are zero on the dependent dofs, (N, ...)."""
        return fields if self.map is None else self.map @ fields

    def restrict(self, forces: Columns) -> Columns:
        """T^T F: forces, (N, ...), of which dependent dofs pass theirs on."""
        if self.map is None:
            return forces
        acting = self.transposed @ forces
        return acting if isinstance(forces, np.ndarray) else csc_matrix(acting)

    def restrict_sizes(self, sizes: np.ndarray) -> np.ndarray:
        """|T^T| |F|, the sizes of the terms of these sums, (N, ...)."""
        return sizes if self.map is None else abs(self.transposed) @ sizes

    def touched(self, dofs: np.ndarray) -> np.ndarray:
        """Dofs that move with some, (N, ...) bool."""
        return dofs if self.map is None else abs(self.map) @ dofs.astype(float) > 0

    def rows(self, rows: csr_matrix) -> csr_matrix:
        """B T of rows, (m, N)."""
        return rows if self.map is None else csr_matrix(rows @ self.map)

    def coupled(self, graph: csr_matrix) -> csr_matrix:
        """Couplings of dofs, (N, N), with those of dependent dofs and the dofs that they follow."""
        return graph if self.map is None else csr_matrix(graph + self.map)

    def broken(self, fields: np.ndarray) -> np.ndarray:
        """Left sides less right sides of the equations of dependent dofs for fields, (N, k):
        (dependent, k).
        """
        independent = np.where(self.dependent[:, None], 0.0, fields)
        return (fields - self.prolong(independent))[self.dependent]

    def on_rows(self, spread: Rows, group: ProcessGroup) -> OnRows | None:
        """Products with local rows; None for the identity.

        Args:
            spread: rows of this rank.
            group: processes that share the rows.
        """
        if self.map is None:
            return None
        rows = spread.own
        transposed = self._transposed_rows(rows)

        def columns(own: csc_matrix) -> csc_matrix:
            return csc_matrix(transposed @ self._with_dependent(csr_matrix(own), rows, group))

        return OnRows(spread.matrix(self.map[rows]), spread.matrix(transposed), columns)

    def stiffness(
        self, parts: Sequence[csr_matrix], rows: slice = ALL, group: ProcessGroup = ALONE
    ) -> tuple[csr_matrix, ...]:
        """T^T K T, (N, N), or local rows of it, (own, N), by those of the parts of K.

        Parts keep one pattern.

        Products of scipy have no zeros. Collective.

        Args:
            parts: parts of K, (N, N) or local rows.
            rows: rows of this rank.
            group: processes that share the rows.
        """
        if self.map is None:
            return tuple(parts)
        first = parts[0]
        ones = csr_matrix((np.ones(first.nnz), first.indices, first.indptr), shape=first.shape)
        transposed = self._transposed_rows(rows)
        reached = self._with_dependent(ones, rows, group) @ abs(self.map)
        pattern = csr_matrix(abs(transposed) @ reached)
        pattern.sort_indices()
        numbers = _numbers(pattern)
        projected = []
        for term in parts:
            product = transposed @ (self._with_dependent(term, rows, group) @ self.map)
            product = csr_matrix(product)
            data = np.zeros(pattern.nnz)
            data[np.searchsorted(numbers, _numbers(product))] = product.data
            entries = data, pattern.indices, pattern.indptr
            projected.append(csr_matrix(entries, shape=pattern.shape))
        return tuple(projected)

    def _transposed_rows(self, rows: slice) -> csr_matrix:
        """Local rows of T^T, (own, N)."""
        assert self.map is not None
        return csr_matrix(self.map[:, rows].T)

    def _with_dependent(self, own: csr_matrix, rows: slice, group: ProcessGroup) -> csr_matrix:
        """Local rows of a matrix, (own, k), and those of the dependent dofs on all processes, (N,
        k).
        """
        if group.size == 1:
            return own
        gathered = group.stacked(csr_matrix(diags(self.dependent[rows].astype(float)) @ own))
        return csr_matrix(vstack([gathered[: rows.start], own, gathered[rows.stop :]]))


def _numbers(matrix: csr_matrix) -> np.ndarray:
    """Numbers of the entries of a matrix, which grow with its rows and sorted columns."""
    rows = np.repeat(np.arange(matrix.shape[0], dtype=np.int64), np.diff(matrix.indptr))
    return rows * matrix.shape[1] + matrix.indices
