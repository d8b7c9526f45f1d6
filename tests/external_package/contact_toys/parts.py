"""What scenes are made of: a geometry, a pairing and a law, each in a few lines."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from dolfinx import mesh as dmesh

from hhr_dolfinx.pairings import ContactRows, nodal_rows, tangential_order

BODY, BOTTOM, TOP, LEFT = 1, 2, 3, 4
WIDTH, HEIGHT = 3.0, 1.0


def slab(comm, cells=(6, 4)):
    """A slab of WIDTH x HEIGHT with its lower left corner in the origin."""
    mesh = dmesh.create_rectangle(
        comm, [np.zeros(2), np.array([WIDTH, HEIGHT])], list(cells), cell_type=dmesh.CellType.quadrilateral
    )
    count = mesh.topology.index_map(2).size_local + mesh.topology.index_map(2).num_ghosts
    bodies = dmesh.meshtags(mesh, 2, np.arange(count, dtype=np.int32), np.full(count, BODY, dtype=np.int32))
    sides = {BOTTOM: (1, 0.0), TOP: (1, HEIGHT), LEFT: (0, 0.0)}
    found = {
        tag: dmesh.locate_entities_boundary(mesh, 1, lambda x, axis=axis, at=at: np.isclose(x[axis], at))
        for tag, (axis, at) in sides.items()
    }
    facets = np.concatenate(list(found.values())).astype(np.int32)
    tags = np.concatenate([np.full(len(part), tag, dtype=np.int32) for tag, part in found.items()])
    order = np.argsort(facets)
    return mesh, bodies, dmesh.meshtags(mesh, 1, facets[order], tags[order])


@dataclass(frozen=True)
class Ramp:
    """A rigid ramp below a surface, ``gap + slope x`` away from it: contact along the vertical."""

    surface: int
    gap: float
    slope: float = 0.0

    @property
    def tags(self):
        """The surface of the body."""
        return (self.surface,)

    def rows(self, surfaces, dofs):
        """One row for each node."""
        (surface,) = surfaces
        order = tangential_order(surface.points, np.array([0.0, -1.0]))
        nodes, points = surface.nodes[order], surface.points[order]
        normals = np.tile([0.0, -1.0], (nodes.size, 1))
        matrix = nodal_rows(nodes[:, None], normals, np.ones((nodes.size, 1)), dofs)
        gaps = self.gap + self.slope * points[:, 0]
        return ContactRows(matrix, gaps, nodes, points, surface.areas[order])


@dataclass(frozen=True)
class Newtonian:
    """A law of flow without a threshold: rate of p = σ_eq / η, implicit Euler."""

    viscosity: float

    def flow(self, trial, plastic_strain, shear, dt):
        """Closed form of η Δp = dt (q_tr - 3 mu Δp)."""
        slope = dt / (self.viscosity + 3 * shear * dt)
        return trial * slope, np.full_like(trial, slope)
