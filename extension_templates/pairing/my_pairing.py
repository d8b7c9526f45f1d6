"""A contact pairing of your own, and the manifest by which scenes find it."""

from dataclasses import dataclass

import numpy as np

from hhr_dolfinx.pairings import ContactRows, nodal_rows, tangential_order
from hhr_dolfinx.registry import Plugin

PLUGIN = Plugin(name="my_pairing", parts={"pairings": {"MyPairing": "my_pairing:MyPairing"}})


@dataclass(frozen=True)
class MyPairing:
    """Contact of a surface with a rigid line above it: u_y <= height - y.

    Attributes:
        surface: facet tag of the surface.
        height: of the line.
    """

    surface: int
    height: float  # TODO: the fields that your contact needs

    @property
    def tags(self):
        """Facet tags of all surfaces that it needs."""
        return (self.surface,)

    def rows(self, surfaces, dofs):
        """One condition for each node, B u <= gap; see hhr_dolfinx.contact.problem.ContactRows."""
        (surface,) = surfaces
        normal = np.array([0.0, 1.0])
        order = tangential_order(surface.points, normal)
        nodes, points = surface.nodes[order], surface.points[order]
        # TODO: normals out of the body, and the gaps along them
        normals, gaps = np.tile(normal, (nodes.size, 1)), self.height - points[:, 1]
        matrix = nodal_rows(nodes[:, None], normals, np.ones((nodes.size, 1)), dofs)
        return ContactRows(matrix, gaps, nodes, points, surface.areas[order])
