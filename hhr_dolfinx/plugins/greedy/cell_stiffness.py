"""Stiffness of some cells alone, as of a RID: on its interface K includes that of the cells outside too."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import ufl
from dolfinx.mesh import meshtags
from scipy.sparse import csr_matrix

from hhr_dolfinx.formulas import Modulus

if TYPE_CHECKING:
    from hhr_dolfinx.full_order.discretisation import Discretisation
    from hhr_dolfinx.full_order.full import FullOrderModel


@dataclass(frozen=True)
class CellStiffness:
    """K of some cells at any point, without boundary conditions, (N, N)."""

    part: Discretisation  # the discretisation with the bodies of these cells
    terms: tuple[csr_matrix, ...]  # parts of K on the mesh of the scene
    moduli: tuple[Modulus, ...]  # of the parts; empty if K is constant

    @classmethod
    def of(cls, full: FullOrderModel, cells: np.ndarray) -> CellStiffness:
        """K of some cells of a full model, in the order of ``ContactProblem.cell_nodes``. Collective."""
        part = _of_cells(full.discretisation, cells)
        return cls(part, *_terms(part))

    def at(self, point: np.ndarray) -> csr_matrix:
        """K of the cells at a point, (P,)."""
        terms = self.terms
        if self.part.reshaped is not None:
            with self.part.lying_at(point):
                terms, _ = _terms(self.part)
        if not self.moduli:
            return terms[0]
        return sum(modulus.value(point) * term for modulus, term in zip(self.moduli, terms, strict=True))


def _terms(part: Discretisation) -> tuple[tuple[csr_matrix, ...], tuple[Modulus, ...]]:
    """All rows of the parts of K."""
    terms, moduli = part.stiffness_terms()
    if part.group.size > 1:
        terms = tuple(part.group.stacked(term) for term in terms)
    return terms, moduli


def _of_cells(discretisation: Discretisation, cells: np.ndarray) -> Discretisation:
    """The same discretisation, without bodies in all other cells."""
    mesh = discretisation.mesh
    tags = discretisation._cell_tags
    owned = mesh.topology.index_map(mesh.topology.dim).size_local
    first = sum(discretisation.group.gathered(owned)[: discretisation.group.number])
    kept = np.isin(tags.indices, cells - first) & (tags.indices < owned)
    part = copy(discretisation)
    vars(part).pop("_stiffness_form", None)
    part._cell_tags = meshtags(mesh, mesh.topology.dim, tags.indices[kept], tags.values[kept])
    part._dx = ufl.Measure("dx", domain=mesh, subdomain_data=part._cell_tags)
    part.common_pattern = None
    return part
