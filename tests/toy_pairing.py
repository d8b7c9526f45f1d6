"""A pairing of a user's own, in one file: contact with a round rigid punch."""

from dataclasses import dataclass

import numpy as np

from hhr_dolfinx.pairings import (
    ContactRows,
    mean_normal,
    nodal_rows,
    tangential_order,
    warn_of_overlap,
)


@dataclass(frozen=True)
class RoundPunch:
    """Contact with a rigid disc or ball ``|x - centre| >= radius``, linearised: ``u·n <= |x -
    centre| - radius``.

    The centre is outside the body, on the axis in axisymmetry; ``surface`` is a facet tag of the
    body.
    """

    surface: int
    centre: tuple[float, ...]
    radius: float

    @property
    def tags(self) -> tuple[int, ...]:
        """The surface of the body."""
        return (self.surface,)

    def rows(self, surfaces, dofs: int) -> ContactRows:
        """One row for each node, with n from its place to the centre."""
        (surface,) = surfaces
        centre = np.asarray(self.centre, dtype=float)
        order = tangential_order(surface.points, mean_normal(surface))
        nodes, points = surface.nodes[order], surface.points[order]
        distance = np.linalg.norm(centre - points, axis=1)
        normals = (centre - points) / distance[:, None]
        matrix = nodal_rows(nodes[:, None], normals, np.ones((nodes.size, 1)), dofs)
        rows = ContactRows(matrix, distance - self.radius, nodes, points, surface.areas[order])
        warn_of_overlap(surface, rows)
        return rows
