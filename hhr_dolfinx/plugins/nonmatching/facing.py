"""Partners of the nodes of one surface on another: the closest points on facets that look against
one of their sides.

The nearest facet alone would not do: for a node on an edge it may look the same way as the node.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial.distance import cdist

from hhr_dolfinx.pairings.surface import Surface, looking, normalised
from hhr_dolfinx.plugins.nonmatching.projection import (
    BOX_ENLARGEMENT,
    ClosestPoints,
    closest_of,
    closest_points,
)

FACING_DIRECTIONS = 0.1
"""Cosine between two directions found from the meshes below which surfaces do not face each
other.
"""
FACING_PAIRS = 2_000_000
"""Pairs of a node and a facet in one batch: 16 MB for each array, a few times that for sides."""
EDGE_OVERHANG = 1e-6
"""Part of a facet by which a slave node may lie beyond the edge of the master surface: round-off of
meshers.
"""


class Opposed(NamedTuple):
    """Partners of the n nodes of one surface on another; masks are (n,) bool."""

    #: closest points on the facets that look against a side of the node; on any facet if none does
    closest: ClosestPoints
    #: unit normals from the node to its partner, smoothed over the facets of the other surface, (n,
    #: dim)
    normals: np.ndarray
    facing: np.ndarray  #: nodes with a side that looks along the normal
    back_side: np.ndarray  #: nodes of a back side: more than a cell behind their partner
    beyond: (
        np.ndarray
    )  #: nodes that lie beyond the edge on which their partner lies, and not below or above it
    overhanging: np.ndarray  #: nodes beyond the edge that look at the other body, past its edge
    depth: np.ndarray  #: overlap of each node with its partner, negative of a gap, (n,)

    @property
    def meets(self) -> np.ndarray:
        """Nodes that face their partner and can touch it, (n,) bool."""
        return self.facing & ~self.back_side & ~self.beyond


def opposed(slave: Surface, master: Surface, overlap: float) -> Opposed:
    """Partners of the slave nodes on the master surface.

    Args:
        slave: the slave surface.
        master: the master surface.
        overlap: length by which bodies may overlap beyond a cell.
    """
    closest = closest_points(slave.points, master.corners)
    normals = _towards(master, closest)
    facing = looking(slave, normals, FACING_DIRECTIONS)[0]
    averted = np.flatnonzero(~facing)
    if averted.size:
        closest = _of_opposed(slave, master, averted, closest)
        normals = _towards(master, closest)
        facing = looking(slave, normals, FACING_DIRECTIONS)[0]
    depth = np.einsum("md,md->m", closest.offsets, normals)
    # a back side lies behind its partner by the thickness of both bodies, and no body is thinner
    # than a cell
    smallest = np.full(len(slave.nodes), np.inf)  # depth of the facets at each node
    np.minimum.at(smallest, slave.facets, slave.depths[:, None])
    deepest = np.maximum(smallest, master.depths[closest.facets]) * (1 - BOX_ENLARGEMENT)
    back_side = depth > deepest + overlap
    beyond = _beyond(master, closest)
    overhanging = facing & ~back_side & beyond
    # back sides of bodies of one cell are no deeper than a cell, but farther behind the partner
    # than beyond the edge
    deeper = depth[averted] > FACING_DIRECTIONS * np.linalg.norm(closest.offsets[averted], axis=1)
    overhanging[averted[deeper]] = False
    return Opposed(closest, normals, facing, back_side, beyond, overhanging, depth)


def _beyond(master: Surface, closest: ClosestPoints) -> np.ndarray:
    """Points that lie beyond an edge of the master, so that the closest point is not below them,
    (m,) bool.

    On a curved surface the normal of a facet is off by at most twice the angle to the averages over
    its neighbours.
    """
    outward = master.outward[closest.facets]
    height = np.einsum("md,md->m", closest.offsets, outward)
    sideways = np.linalg.norm(closest.offsets - outward * height[:, None], axis=1)
    cosines = np.einsum("mkd,md->mk", master.corner_normals[closest.facets], outward).min(axis=1)
    turned = np.tan(np.minimum(2 * np.arccos(np.clip(cosines, -1.0, 1.0)), 1.0)) * np.abs(height)
    return sideways > EDGE_OVERHANG * master.lengths()[closest.facets] + 1.001 * turned


def _towards(master: Surface, closest: ClosestPoints) -> np.ndarray:
    """Unit normals against the smoothed outer normal of the master at its closest points, (m,
    dim).
    """
    return -normalised(
        np.einsum("mk,mkd->md", closest.weights, master.corner_normals[closest.facets])
    )


def _of_opposed(
    slave: Surface, master: Surface, nodes: np.ndarray, closest: ClosestPoints
) -> ClosestPoints:
    """Closest points for some nodes, (l,), on facets that look against one of their sides.

    Unchanged without any.
    """
    sides, of_node = _sides_of(slave, nodes)
    middles = master.corners.mean(axis=1)
    reach = np.linalg.norm(master.corners - middles[:, None], axis=2).max(axis=1)
    opposed_points = ClosestPoints(*(values.copy() for values in closest))
    # all sides of a node are in one batch
    count = max(1, FACING_PAIRS // len(middles))
    for first in range(0, nodes.size, count):
        batch = nodes[first : first + count]
        in_batch = (of_node >= first) & (of_node < first + count)
        starts = np.searchsorted(of_node[in_batch] - first, np.arange(batch.size))
        against = np.logical_or.reduceat(
            sides[in_batch] @ master.outward.T < -FACING_DIRECTIONS, starts, axis=0
        )
        distance = np.where(against, cdist(slave.points[batch], middles), np.inf)
        # a facet is at least as far as its middle less its radius, and the nearest one at most as
        # far as a middle
        bound = distance.min(axis=1)
        point, facet = np.nonzero(
            against & (distance - reach <= bound[:, None] * (1 + BOX_ENLARGEMENT))
        )
        having = np.unique(point)
        if not having.size:
            continue
        nearest = closest_of(
            slave.points[batch[having]],
            master.corners,
            bound[having],
            np.searchsorted(having, point),
            facet,
        )
        for values, nearer in zip(opposed_points, nearest, strict=True):
            values[batch[having]] = nearer
    return opposed_points


def _sides_of(surface: Surface, nodes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Unit normals of the sides of some nodes, (s, dim), and the index of each side's node among
    (l,), sorted, (s,).
    """
    index = np.full(len(surface.nodes), -1)
    index[nodes] = np.arange(nodes.size)
    of_corner = index[surface.facets].ravel()
    selected = of_corner >= 0
    normals = surface.corner_normals.reshape(-1, surface.points.shape[1])[selected]
    # all facets of one side have the same corner normal
    _, first = np.unique(
        np.column_stack([of_corner[selected], np.round(normals, 9)]), axis=0, return_index=True
    )
    return normals[first], of_corner[selected][first]
