"""Solids of a bolted flange as a STEP file, such as a CAD program writes, and their mesh, as made
in gmsh.

A quarter of a hydraulic line with a bore of 60 mm: its flange, a cover, and one of four bolts M16,
in tapped holes.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import gmsh
import numpy as np

BORE, PIPE, FACE, RIM, CIRCLE = 30.0, 42.0, 48.0, 80.0, 60.0
"""Radii of the bore, of the pipe, of the raised faces, of both flanges, and of the circle of the
bolts, in mm.
"""
SHANK, HOLE, HEAD, SPOT = 8.0, 9.0, 14.0, 15.5
"""Radii of the bolt and of its tapped hole, of the hole in the cover, of the head, and of the spot
face under it.
"""
END, FLANGE, COVER, RAISED, DEEP, HIGH = -65.0, -25.0, 28.0, 2.0, 4.0, 12.0
"""Heights of the end of the pipe, of the underside of the flange and of the top of the cover; of
the raised faces, which meet at 0, of the recess of the cover and of its spot face, and of the head.
"""
SECTION = 10.0
"""Height of the section of the bolt at which it is preloaded."""
MIDDLE = CIRCLE / np.sqrt(2), CIRCLE / np.sqrt(2)
"""Axis of the bolt in the plane."""


def write_step(file: Path) -> None:
    """Write the solids in this order: flange, cover, bolt."""
    gmsh.clear()
    occ = gmsh.model.occ

    def cylinder(
        low: float, high: float, radius: float, place: tuple[float, float] = (0.0, 0.0)
    ) -> tuple[int, int]:
        return 3, occ.addCylinder(*place, low, 0, 0, high - low, radius)

    def cut(whole: list, holes: list) -> list:
        return list(occ.cut(whole, holes)[0])

    parts, _ = occ.fuse(
        [cylinder(FLANGE, -RAISED, RIM)], [cylinder(END, 0, PIPE), cylinder(FLANGE, 0, FACE)]
    )
    flange = cut(parts, [cylinder(END, 0, BORE), cylinder(FLANGE, 0, SHANK, MIDDLE)])
    parts, _ = occ.fuse([cylinder(RAISED, COVER, RIM)], [cylinder(0, COVER, FACE)])
    spot = cylinder(COVER - DEEP, COVER, SPOT, MIDDLE)
    cover = cut(parts, [cylinder(0, DEEP, BORE), cylinder(0, COVER, HOLE, MIDDLE), spot])
    top = COVER - DEEP
    # the shank widens to the radius of the hole below the head, so that all of the head's face lies
    # on the spot face
    neck = 3, occ.addCone(*MIDDLE, top - 2, 0, 0, 2, SHANK, HOLE)
    occ.fuse(
        [cylinder(FLANGE, top, SHANK, MIDDLE)], [neck, cylinder(top, top + HIGH, HEAD, MIDDLE)]
    )
    for whole in (flange, cover):
        occ.intersect(whole, [(3, occ.addBox(0, 0, 2 * END, RIM, RIM, -4 * END))])
    occ.synchronize()
    gmsh.write(str(file))


def mesh_step(step: Path, mesh: Path, fine: float, coarse: float) -> None:
    """Import the solids, join the thread to the flange, cut the bolt, name parts, and mesh by
    10-node tetrahedra.
    """
    gmsh.clear()
    occ = gmsh.model.occ
    flange, cover, bolt = occ.importShapes(str(step))
    disk = 2, occ.addDisk(*MIDDLE, SECTION, SHANK, SHANK)
    _, of = occ.fragment([flange, bolt], [disk])
    occ.synchronize()
    for name, parts in {"flange": of[0], "bolt": of[1], "cover": [cover]}.items():
        gmsh.model.addPhysicalGroup(3, [tag for _, tag in parts], name=name)
    named = {
        "fixed": _faces(of[0], lambda x: abs(x[2] - END) < 1e-6),
        "symmetry_x": _faces([*of[0], cover], lambda x: abs(x[0]) < 1e-6),
        "symmetry_y": _faces([*of[0], cover], lambda x: abs(x[1]) < 1e-6),
        "flange_face": _faces(of[0], lambda x: abs(x[2]) < 1e-6),
        "cover_face": _faces([cover], lambda x: abs(x[2]) < 1e-6),
        "spot_face": _faces([cover], lambda x: abs(x[2] - COVER + DEEP) < 1e-6),
        "head": _faces(of[1], lambda x: abs(x[2] - COVER + DEEP) < 1e-6),
        "pressure": _faces(
            [*of[0], cover],
            lambda x: np.hypot(x[0], x[1]) < BORE + 1e-6 and END - 1e-6 < x[2] < DEEP + 1e-6,
        ),
        "bolt_section": [tag for _, tag in of[2]],
    }
    for name, faces in named.items():
        gmsh.model.addPhysicalGroup(2, faces, name=name)
    sizes = {
        "flange_face": fine,
        "cover_face": fine,
        "spot_face": 0.8 * fine,
        "head": 0.7 * fine,
        "bolt_section": fine,
    }
    for name, size in sizes.items():
        faces = [(2, tag) for tag in named[name]]
        gmsh.model.mesh.setSize(gmsh.model.getBoundary(faces, combined=False, recursive=True), size)
    gmsh.option.setNumber("Mesh.MeshSizeMax", coarse)
    gmsh.option.setNumber("Mesh.MeshSizeFromCurvature", 14)
    gmsh.model.mesh.generate(3)
    gmsh.model.mesh.optimize("Netgen")
    gmsh.model.mesh.setOrder(2)
    gmsh.write(str(mesh))


def _faces(solids: list, there: Callable[[np.ndarray], bool]) -> list[int]:
    """Faces of solids all of whose points, a few of each, are there."""
    found = []
    for _, tag in gmsh.model.getBoundary(solids, combined=True, oriented=False):
        lower, upper = gmsh.model.getParametrizationBounds(2, tag)
        grid = np.stack(np.meshgrid(*np.linspace(lower, upper, 7).T), axis=-1).reshape(-1, 2)
        inside = [one for one in grid if gmsh.model.isInside(2, tag, one, parametric=True)]
        points = np.array(gmsh.model.getValue(2, tag, np.ravel(inside))).reshape(-1, 3)
        if len(points) and all(map(there, points)):
            found.append(tag)
    return found
