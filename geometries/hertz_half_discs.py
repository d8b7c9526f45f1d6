"""Two elastic half-discs that face each other across a gap, thesis section 1.5.1.

Gmsh meshes the lower body, which is mirrored at y = 0, so that every node of one arc faces a node
of the other along e_y. With 56 arc and 14 flat segments per body the two meshes have 2 x 339 nodes
and 55 facing pairs away from the flat edges.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from hhr_dolfinx.geometries.gmsh_model import gmsh, mesh_of

if TYPE_CHECKING:
    from mpi4py.MPI import Comm

    from hhr_dolfinx.compat import TaggedMesh

LOWER = 1
UPPER = 2
"""Cell tags of the two bodies."""
LOWER_ARC = 11
UPPER_ARC = 12
LOWER_FLAT = 21
UPPER_FLAT = 22
"""Facet tags of the arcs (contact) and of the flat edges (imposed displacement)."""

_LINE, _TRIANGLE, _DELAUNAY = 1, 2, 5  # gmsh's numbers of element types and algorithm


def half_discs(
    comm: Comm,
    *,
    radius: float = 1.0,
    gap: float = 0.1,
    arc_segments: int = 56,
    flat_segments: int = 14,
    pole_ratio: float = 1.0,
) -> TaggedMesh:
    """Build the mesh of the two half-discs on all ranks of ``comm``.

    Args:
        comm: MPI communicator.
        radius: radius R of both discs, in the unit of length of the scene.
        gap: distance d of the poles, which lie at (0, ±d/2).
        arc_segments: number of segments of each arc, even.
        flat_segments: number of segments of each flat edge.
        pole_ratio: length of each arc segment over the length of its neighbour towards the pole;
            above 1 the mesh is refined where contact begins.

    Raises:
        ValueError: for numbers of segments, a radius or a ratio out of their ranges.
    """
    if arc_segments < 2 or arc_segments % 2 or flat_segments < 1:
        raise ValueError(
            f"arc_segments = {arc_segments} must be even and positive, flat_segments = "
            f"{flat_segments} positive"
        )
    if radius <= 0 or pole_ratio < 1:
        raise ValueError(
            f"radius = {radius} must be positive and pole_ratio = {pole_ratio} at least 1"
        )

    def make() -> None:
        _mesh_lower_half(radius, gap, arc_segments, flat_segments, pole_ratio)
        _mirror()

    return mesh_of(make, comm, dim=2, options={"Mesh.Algorithm": _DELAUNAY})


def _mesh_lower_half(
    radius: float, gap: float, arc_segments: int, flat_segments: int, pole_ratio: float
) -> None:
    """Mesh the lower body in the current gmsh model: two quarter arcs that meet at the pole."""
    geo = gmsh.model.geo
    y = -radius - gap / 2
    center = geo.addPoint(0, y, 0)
    pole = geo.addPoint(0, y + radius, 0)
    left_end = geo.addPoint(-radius, y, 0)
    right_end = geo.addPoint(radius, y, 0)
    arcs = [geo.addCircleArc(right_end, center, pole), geo.addCircleArc(pole, center, left_end)]
    flat = geo.addLine(left_end, right_end)
    geo.mesh.setTransfiniteCurve(arcs[0], arc_segments // 2 + 1, "Progression", 1 / pole_ratio)
    geo.mesh.setTransfiniteCurve(arcs[1], arc_segments // 2 + 1, "Progression", pole_ratio)
    geo.mesh.setTransfiniteCurve(flat, flat_segments + 1)
    body = geo.addPlaneSurface([geo.addCurveLoop([*arcs, flat])])
    geo.synchronize()
    gmsh.model.mesh.generate(2)
    gmsh.model.addPhysicalGroup(2, [body], LOWER)
    gmsh.model.addPhysicalGroup(1, arcs, LOWER_ARC)
    gmsh.model.addPhysicalGroup(1, [flat], LOWER_FLAT)


def _mirror() -> None:
    """Replace the model by one with the current mesh and its mirror image at y = 0."""
    tags, points, _ = gmsh.model.mesh.getNodes()
    cells = {
        name: _connectivity(dim, name)
        for dim, name in ((2, LOWER), (1, LOWER_ARC), (1, LOWER_FLAT))
    }
    used = np.unique(cells[LOWER])  # gmsh also lists the centre of the arcs
    points = points.reshape(-1, 3)[np.searchsorted(tags, used)]
    cells = {name: np.searchsorted(used, nodes) for name, nodes in cells.items()}
    gmsh.model.add("half_discs")
    _add_body((LOWER, LOWER_ARC, LOWER_FLAT), points, cells, first_node=1)
    # mirroring changes the orientation of elements: reverse their nodes
    flipped = {name: nodes[:, ::-1] for name, nodes in cells.items()}
    _add_body(
        (UPPER, UPPER_ARC, UPPER_FLAT), points * [1, -1, 1], flipped, first_node=1 + used.size
    )


def _connectivity(dim: int, physical: int) -> np.ndarray:
    """Nodes of the elements of a physical group, (elements, dim + 1)."""
    blocks = [
        nodes
        for entity in gmsh.model.getEntitiesForPhysicalGroup(dim, physical)
        for nodes in gmsh.model.mesh.getElements(dim, entity)[2]
    ]
    return np.concatenate(blocks).reshape(-1, dim + 1)


def _add_body(
    names: tuple[int, int, int],
    points: np.ndarray,
    cells: Mapping[int, np.ndarray],
    first_node: int,
) -> None:
    """Add one body as discrete entities ``names`` (body, arc, flat) with a physical group each."""
    body, arc, flat = names
    gmsh.model.addDiscreteEntity(1, arc)
    gmsh.model.addDiscreteEntity(1, flat)
    gmsh.model.addDiscreteEntity(2, body, [arc, flat])
    gmsh.model.mesh.addNodes(2, body, first_node + np.arange(len(points)), points.ravel())
    for dim, entity, nodes in zip((2, 1, 1), names, cells.values(), strict=True):
        kind = _TRIANGLE if dim == 2 else _LINE
        gmsh.model.mesh.addElementsByType(entity, kind, [], (first_node + nodes).ravel())
        gmsh.model.addPhysicalGroup(dim, [entity], entity)
