"""Make leaf_spring.msh: a clamped leaf spring, a roller that pushes it, and a stop below it.

    python demos/meshes/leaf_spring.py [--out DIR] [--quick] [--seed N]

``--out demos/meshes`` replaces the file that the demo reads. ``--quick`` makes coarse cells.
Nothing is random.

Lengths in mm. Bodies and surfaces have names, as physical groups.
"""

import math
import sys
from pathlib import Path

import gmsh

sys.path.append(str(Path(__file__).parents[1]))

LENGTH, THICKNESS, RADIUS = 60.0, 4.0, 10.0
ROLLER, STOP = 48.0, 32.0
"""Where roller and stop touch the spring."""
GAP = 0.2
"""Between the spring and the stop; the roller touches the spring."""
FINE, COARSE = 0.15, 2.0


def segment(name: str, place: float, pole: float, up: float) -> None:
    """A segment of a disc, 60 degrees to each side of its pole, which looks down or up.

    Its round and its flat side.

    No more than that can touch: nodes that look aside find nothing that they face.
    """
    occ = gmsh.model.occ
    wide, high = RADIUS * math.sin(math.pi / 3), RADIUS * (1 - math.cos(math.pi / 3))
    places = ((-wide, up * high), (0, 0), (wide, up * high), (0, up * RADIUS))
    points = [occ.addPoint(place + x, pole + y, 0) for x, y in places]
    arcs = [
        occ.addCircleArc(points[0], points[3], points[1]),
        occ.addCircleArc(points[1], points[3], points[2]),
    ]
    flat = occ.addLine(points[2], points[0])
    body = occ.addPlaneSurface([occ.addCurveLoop([*arcs, flat])])
    occ.synchronize()
    gmsh.model.addPhysicalGroup(2, [body], name=name)
    gmsh.model.addPhysicalGroup(1, arcs, name=f"{name}_round")
    gmsh.model.addPhysicalGroup(1, [flat], name=f"{name}_flat")


def spring() -> None:
    """The spring, whose left end is clamped."""
    occ = gmsh.model.occ
    body = occ.addRectangle(0, 0, 0, LENGTH, THICKNESS)
    occ.synchronize()
    bottom, _, top, clamp = (tag for _, tag in gmsh.model.getBoundary([(2, body)], oriented=False))
    gmsh.model.addPhysicalGroup(2, [body], name="spring")
    for name, curve in (("spring_bottom", bottom), ("spring_top", top), ("clamp", clamp)):
        gmsh.model.addPhysicalGroup(1, [curve], name=name)


def refine_contact(finest: float) -> None:
    """Cells of the length ``finest`` where bodies touch."""
    field = gmsh.model.mesh.field
    places = []
    for x, y in ((ROLLER, THICKNESS), (STOP, 0.0)):
        ball = field.add("Ball")
        shape = {
            "XCenter": x,
            "YCenter": y,
            "Radius": 1.2,
            "Thickness": 9.0,
            "VIn": finest,
            "VOut": COARSE,
        }
        for key, value in shape.items():
            field.setNumber(ball, key, value)
        places.append(ball)
    least = field.add("Min")
    field.setNumbers(least, "FieldsList", places)
    field.setAsBackgroundMesh(least)
    for option in ("FromPoints", "FromCurvature", "ExtendFromBoundary"):
        gmsh.option.setNumber(f"Mesh.MeshSize{option}", 0)


def main() -> None:
    """Mesh, write the mesh and ``report.json``."""
    from parts import cli

    options = cli.parse_on_first_rank(cli.demo_parser("leaf_spring", __doc__))
    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    spring()
    segment("roller", ROLLER, THICKNESS, 1.0)
    segment("stop", STOP, -GAP, -1.0)
    refine_contact(5 * FINE if options.quick else FINE)
    gmsh.model.mesh.generate(2)
    gmsh.write(str(options.out / "leaf_spring.msh"))
    nodes, cells = len(gmsh.model.mesh.getNodes()[0]), len(gmsh.model.mesh.getElementsByType(2)[0])
    gmsh.finalize()
    cli.write_drawn("leaf_spring", {"nodes": nodes, "cells": cells}, options)


if __name__ == "__main__":
    main()
