"""What scenes are made of: a geometry and a pairing, each in a few lines."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hhr_dolfinx.geometries import block
from hhr_dolfinx.pairings import ContactRows, nodal_rows, tangential_order

WIDTH, HEIGHT = 3.0, 1.0
BOTTOM, TOP, LEFT = block.side(1, False), block.side(1, True), block.side(0, False)


def slab(comm, cells=(6, 4)):
    """A slab of WIDTH x HEIGHT with its lower left corner in the origin."""
    return block.block(comm, lower=(0.0, 0.0), upper=(WIDTH, HEIGHT), cells=cells)


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
