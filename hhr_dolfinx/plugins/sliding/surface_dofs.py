"""All dofs of two surfaces as rows. If bodies slide far, the rows of each new pairing are combinations of these."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_matrix

from hhr_dolfinx.contact.rows import ContactRows
from hhr_dolfinx.pairings.surface import Surface, area_vectors
from hhr_dolfinx.parameters import Tag


@dataclass(frozen=True)
class SurfaceDofs:
    """Rows of the identity at the nodes of two surfaces, component by component, which span all contact conditions.

    Attributes:
        slave, master: facet tags.
    """

    slave: Tag
    master: Tag

    @property
    def tags(self) -> tuple[Tag, ...]:
        """Slave and master."""
        return (self.slave, self.master)

    def rows(self, surfaces: Sequence[Surface], dofs: int) -> ContactRows:
        """One row for each component of the displacement of each node, in the order of the nodes."""
        nodes, points = nodes_of(surfaces)
        dim = points.shape[1]
        own = (nodes[:, None] * dim + np.arange(dim)).ravel()
        matrix = csr_matrix((np.ones(own.size), (np.arange(own.size), own)), shape=(own.size, dofs))
        nothing = np.zeros(own.size)
        return ContactRows(matrix, nothing, np.repeat(nodes, dim), np.repeat(points, dim, axis=0), nothing)


def nodes_of(surfaces: Sequence[Surface]) -> tuple[np.ndarray, np.ndarray]:
    """Sorted nodes of some surfaces, (n,), each once, and their coordinates, (n, dim)."""
    every = np.concatenate([surface.nodes for surface in surfaces])
    points = np.concatenate([surface.points for surface in surfaces])
    nodes, first = np.unique(every, return_index=True)
    return nodes, points[first]


def renumbered(surface: Surface, nodes: np.ndarray) -> Surface:
    """A surface with node numbers relative to some sorted nodes, (n,)."""
    return replace(surface, nodes=np.searchsorted(nodes, surface.nodes))


def deformed(surface: Surface, displacement: np.ndarray) -> Surface:
    """A surface in its deformed position, from the displacement of all nodes that its numbers refer to, (n, dim)."""
    points = surface.points + displacement[surface.nodes]
    vectors = area_vectors(points[surface.facets])
    sizes = np.linalg.norm(vectors, axis=1)
    outward = vectors / sizes[:, None]
    outward[np.einsum("ij,ij->i", outward, surface.outward) < 0] *= -1
    return replace(surface, points=points, outward=outward, sizes=sizes)
