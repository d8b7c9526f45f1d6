"""Makes leaf_spring.msh beside this file: a clamped leaf spring, a roller that pushes it, and a stop below it.

    python demos/meshes/leaf_spring.py

Lengths in mm. Bodies and surfaces have names, as physical groups.
"""

import math
from pathlib import Path

import gmsh

LENGTH, THICKNESS, RADIUS = 60.0, 4.0, 10.0
ROLLER, STOP = 48.0, 32.0
"""Where roller and stop touch the spring."""
GAP = 0.2
"""Between the spring and the stop; the roller touches the spring."""
FINE, COARSE = 0.15, 2.0


def segment(name: str, place: float, pole: float, up: float) -> None:
    """A segment of a disc, 60 degrees to each side of its pole, which looks down or up; its round and its flat side.

    No more than that can touch: nodes that look aside find nothing that they face.
    """
    occ = gmsh.model.occ
    wide, high = RADIUS * math.sin(math.pi / 3), RADIUS * (1 - math.cos(math.pi / 3))
    places = ((-wide, up * high), (0, 0), (wide, up * high), (0, up * RADIUS))
    points = [occ.addPoint(place + x, pole + y, 0) for x, y in places]
    arcs = [occ.addCircleArc(points[0], points[3], points[1]), occ.addCircleArc(points[1], points[3], points[2])]
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


def fine_where_bodies_touch() -> None:
    """Small cells by the places of contact."""
    field = gmsh.model.mesh.field
    places = []
    for x, y in ((ROLLER, THICKNESS), (STOP, 0.0)):
        ball = field.add("Ball")
        shape = {"XCenter": x, "YCenter": y, "Radius": 1.2, "Thickness": 9.0, "VIn": FINE, "VOut": COARSE}
        for key, value in shape.items():
            field.setNumber(ball, key, value)
        places.append(ball)
    least = field.add("Min")
    field.setNumbers(least, "FieldsList", places)
    field.setAsBackgroundMesh(least)
    for option in ("FromPoints", "FromCurvature", "ExtendFromBoundary"):
        gmsh.option.setNumber(f"Mesh.MeshSize{option}", 0)


def main() -> None:
    """Mesh and write."""
    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    spring()
    segment("roller", ROLLER, THICKNESS, 1.0)
    segment("stop", STOP, -GAP, -1.0)
    fine_where_bodies_touch()
    gmsh.model.mesh.generate(2)
    gmsh.write(str(Path(__file__).with_suffix(".msh")))
    gmsh.finalize()


if __name__ == "__main__":
    main()
