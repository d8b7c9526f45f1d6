"""Strain and internal forces through Gauss points: arrays tabulated once, loops compiled by numba.

The arrays come from UFL, by :mod:`hhr_dolfinx.plugins.elasticity.gauss_points`; this module depends
on neither mesh nor physics. A reduced model uses the same operator with the cells of its RID.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Annotated, NamedTuple

import numpy as np
from scipy.sparse import csr_matrix

from hhr_dolfinx.declared import Floats, Integers, Size
from hhr_dolfinx.plugins.ufl_programs.compiled import compiled


@dataclass(frozen=True)
class StrainOperator:
    """Strain ε = G u at the Gauss points of some cells, Kelvin's notation."""

    gradients: Annotated[
        Floats, "cells", "per cell", "components", "dofs of a cell"
    ]  #: matrix G of each cell
    weights: Annotated[
        Floats, "cells", "per cell"
    ]  #: quadrature weight times volume of each Gauss point
    dofs: Annotated[Integers, "cells", "dofs of a cell", "< dofs"]  #: number of each dof of a cell
    size: Annotated[Size, "dofs"]  #: number of all dofs

    def faults(self, sizes: Mapping[str, int]) -> Iterator[str]:
        """Faults of the weights."""
        if not (self.weights > 0).all():
            yield f"a Gauss point has the weight {self.weights.min()}, not positive"

    @property
    def gauss_points(self) -> int:
        """Number of Gauss points."""
        return self.weights.size

    @property
    def per_cell(self) -> int:
        """Gauss points of a cell."""
        return self.weights.shape[1]

    def points_of(self, cells: np.ndarray) -> np.ndarray:
        """Numbers of the Gauss points of some cells, (cells * per_cell,)."""
        return (cells[:, None] * self.per_cell + np.arange(self.per_cell)).ravel()

    @property
    def components(self) -> int:
        """Components of a strain."""
        return self.gradients.shape[2]

    def restricted(self, cells: np.ndarray) -> tuple[StrainOperator, np.ndarray]:
        """Operator of some cells, with the dofs of these cells renumbered in order, and these
        dofs.
        """
        columns, dofs = np.unique(self.dofs[cells], return_inverse=True)
        operator = replace(
            self,
            gradients=np.ascontiguousarray(self.gradients[cells]),
            weights=self.weights[cells],
            dofs=dofs.reshape(len(cells), -1),
            size=columns.size,
        )
        return operator, columns

    def strain(self, field: np.ndarray) -> np.ndarray:
        """Strain of a field (size,) at all Gauss points, (gauss_points, components)."""
        out = np.empty((self.gauss_points, self.components))
        _strain(self.gradients, self.dofs, np.ascontiguousarray(field), out)
        return out

    def internal(self, stress: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Internal forces ∫ ε(v) : σ of a stress (gauss_points, components), (size,), and their
        scale, (size,).

        The scale is the sum of absolute contributions of the cells: in equilibrium the forces
        themselves cancel.
        """
        out = np.zeros(self.size)
        size = np.zeros(self.size)
        rows = np.ascontiguousarray(stress)  # another order would be compiled anew
        _internal(self.gradients, self.weights, self.dofs, rows, out, size)
        return out, size

    def pattern(self) -> SparsePattern:
        """Sparsity of the stiffness matrices of these cells."""
        d = self.dofs.shape[1]
        rows = np.repeat(self.dofs, d, axis=1)
        columns = np.tile(self.dofs, (1, d))
        keys, position = np.unique(rows.ravel() * self.size + columns.ravel(), return_inverse=True)
        indptr = np.searchsorted(keys, np.arange(self.size + 1) * self.size).astype(np.int32)
        return SparsePattern(
            indptr, (keys % self.size).astype(np.int32), position.reshape(-1, d, d)
        )

    def stiffness(
        self, tangents: np.ndarray, pattern: SparsePattern, elastic: ElasticPart | None = None
    ) -> csr_matrix:
        """Stiffness ∫ ε(v) : H : ε(u) of tangents H, (size, size).

        With an elastic part, cells whose tangents are elastic cost nothing.

        Args:
            tangents: H at the Gauss points, (gauss_points, components, components).
            pattern: sparsity of the stiffness.
            elastic: elastic tangents and the data of their stiffness; None for none.
        """
        if elastic is None:
            data = np.zeros(pattern.indices.size)
            reference = np.zeros_like(tangents)
        else:
            data = elastic.data.copy()
            reference = elastic.tangents
        _stiffness(self.gradients, self.weights, tangents, reference, pattern.position, data)
        return csr_matrix((data, pattern.indices, pattern.indptr), shape=(self.size, self.size))


class ElasticPart(NamedTuple):
    """Elastic tangents, (gauss_points, components, components), and the data of their stiffness in
    a pattern.
    """

    tangents: np.ndarray
    data: np.ndarray


@dataclass(frozen=True)
class SparsePattern:
    """Sparsity of a CSR matrix, and the index in its data of each entry of the matrices of cells,
    (cells, d, d).
    """

    indptr: np.ndarray
    indices: np.ndarray
    position: np.ndarray


@compiled(fastmath=True)
def _strain(gradients: np.ndarray, dofs: np.ndarray, field: np.ndarray, out: np.ndarray) -> None:
    cells, per_cell, components, d = gradients.shape
    local = np.empty(d)
    for cell in range(cells):
        for k in range(d):
            local[k] = field[dofs[cell, k]]
        for q in range(per_cell):
            for i in range(components):
                value = 0.0
                for k in range(d):
                    value += gradients[cell, q, i, k] * local[k]
                out[cell * per_cell + q, i] = value


@compiled(fastmath=True)
def _internal(
    gradients: np.ndarray,
    weights: np.ndarray,
    dofs: np.ndarray,
    stress: np.ndarray,
    out: np.ndarray,
    size: np.ndarray,
) -> None:
    cells, per_cell, components, d = gradients.shape
    local = np.empty(d)
    for cell in range(cells):
        local[:] = 0.0
        for q in range(per_cell):
            for i in range(components):
                value = weights[cell, q] * stress[cell * per_cell + q, i]
                for k in range(d):
                    local[k] += gradients[cell, q, i, k] * value
        for k in range(d):
            out[dofs[cell, k]] += local[k]
            size[dofs[cell, k]] += abs(local[k])


@compiled(fastmath=True)
def _stiffness(
    gradients: np.ndarray,
    weights: np.ndarray,
    tangents: np.ndarray,
    reference: np.ndarray,
    position: np.ndarray,
    data: np.ndarray,
) -> None:
    """Add the stiffness of ``tangents - reference``; points with equal tangents are skipped."""
    cells, per_cell, components, d = gradients.shape
    flux = np.empty((components, d))
    element = np.empty((d, d))
    change = np.empty((components, components))
    for cell in range(cells):
        changed = False
        for q in range(per_cell):
            n = cell * per_cell + q
            size = 0.0
            for i in range(components):
                for j in range(components):
                    change[i, j] = tangents[n, i, j] - reference[n, i, j]
                    size += abs(change[i, j])
            if size == 0.0:
                continue
            if not changed:
                element[:] = 0.0
                changed = True
            weight = weights[cell, q]
            g = gradients[cell, q]
            for i in range(components):
                for k in range(d):
                    value = 0.0
                    for j in range(components):
                        value += change[i, j] * g[j, k]
                    flux[i, k] = weight * value
            for i in range(components):
                for k in range(d):
                    for m in range(d):
                        element[k, m] += g[i, k] * flux[i, m]
        if changed:
            for k in range(d):
                for m in range(d):
                    data[position[cell, k, m]] += element[k, m]
