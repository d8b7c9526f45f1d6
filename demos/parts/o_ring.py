"""Section of an O-ring and of the lid above it; the groove is rigid, and is no mesh."""

from typing import Any

import gmsh

from hhr_dolfinx.geometries.gmsh_model import mesh_of

MIDDLE, THICKNESS, LID = 20.0, 4.0, 1.5
"""Radius of the middle of the ring, thickness of the ring, height of the lid, in mm."""


def o_ring_and_lid(comm: Any, *, fine: float) -> Any:
    """The mesh, with cells of a length at the quarters of the ring that touch something."""

    def make() -> None:
        occ, half = gmsh.model.occ, THICKNESS / 2
        middle = occ.addPoint(MIDDLE, half, 0)
        # quarters of the circle that look down, out, up and in
        turn, signs = half / 2**0.5, ((-1, -1), (1, -1), (1, 1), (-1, 1))
        corners = [occ.addPoint(MIDDLE + x * turn, half + y * turn, 0) for x, y in signs]
        ends = zip(corners, corners[1:] + corners[:1], strict=True)
        quarters = [occ.addCircleArc(one, middle, two) for one, two in ends]
        ring = occ.addPlaneSurface([occ.addCurveLoop(quarters)])
        lid = occ.addRectangle(MIDDLE - 3, THICKNESS, 0, 6, LID)
        occ.synchronize()
        face, _, top, _ = (
            abs(tag) for _, tag in gmsh.model.getBoundary([(2, lid)], oriented=False)
        )
        for name, surface in (("ring", ring), ("lid", lid)):
            gmsh.model.addPhysicalGroup(2, [surface], name=name)
        named = dict(zip(("bottom", "outside", "top", "inside"), quarters, strict=True))
        named |= {"lid_face": face, "lid_top": top}
        for name, curve in named.items():
            gmsh.model.addPhysicalGroup(1, [curve], name=name)
        for curve in quarters[:3]:
            gmsh.model.mesh.setTransfiniteCurve(curve, int(0.5 * 1.5708 * half / fine) + 1)
        gmsh.model.mesh.setTransfiniteCurve(face, int(0.5 * 6 / fine) + 1)
        gmsh.model.mesh.generate(2)

    # each cell is cut into quadrilaterals: triangles of rubber lock
    quads = {
        "Mesh.RecombineAll": 1.0,
        "Mesh.SubdivisionAlgorithm": 1.0,
        "Mesh.MeshSizeMax": 8 * fine,
    }
    return mesh_of(make, comm, dim=2, options=quads)
