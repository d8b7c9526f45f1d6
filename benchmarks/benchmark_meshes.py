"""Meshes of published benchmarks: half of a disc or ball and what it is pressed on, fine where they
touch.
"""

from collections.abc import Sequence
from typing import Any

import gmsh

from hhr_dolfinx.geometries.gmsh_model import mesh_of


def half_round(
    comm: Any,
    *,
    radius: float,
    fine: float,
    reach: float,
    block: Sequence[float] = (),
    order: int = 1,
) -> Any:
    """A quarter of a disc with its pole at the origin, on a block below it; or without one.

    Args:
        radius: of the disc.
        fine: length of cells within ``reach`` of the pole.
        reach: see there.
        block: half width and height of the block; none for no block.
        order: of the cells; those of second order are curved.
    """

    def make() -> None:
        occ = gmsh.model.occ
        pole, top, end = (
            occ.addPoint(0, 0, 0),
            occ.addPoint(0, radius, 0),
            occ.addPoint(radius, radius, 0),
        )
        lines = [occ.addCircleArc(pole, top, end), occ.addLine(end, top), occ.addLine(top, pole)]
        bodies = {
            "round": (
                occ.addPlaneSurface([occ.addCurveLoop(lines)]),
                dict(zip(("arc", "top", "axis"), lines, strict=True)),
            )
        }
        if block:
            width, height = block
            corners = [
                occ.addPoint(x, y, 0)
                for x, y in ((0, 0), (0, -height), (width, -height), (width, 0))
            ]
            sides = [
                occ.addLine(one, two)
                for one, two in zip(corners, corners[1:] + corners[:1], strict=True)
            ]
            named = dict(zip(("block_axis", "base", "side", "face"), sides, strict=True))
            bodies["block"] = occ.addPlaneSurface([occ.addCurveLoop(sides)]), named
        occ.synchronize()
        for name, (surface, curves) in bodies.items():
            gmsh.model.addPhysicalGroup(2, [surface], name=name)
            for side, curve in curves.items():
                gmsh.model.addPhysicalGroup(1, [curve], name=side)
        _refine(fine, reach, radius / 12)
        gmsh.model.mesh.generate(2)
        gmsh.model.mesh.setOrder(order)

    quiet = {
        f"Mesh.MeshSize{name}": 0.0
        for name in ("FromPoints", "FromCurvature", "ExtendFromBoundary")
    }
    return mesh_of(make, comm, dim=2, options=quiet)


def _refine(fine: float, reach: float, coarse: float) -> None:
    """Cells of a length around the pole, which grow with the distance."""
    field = gmsh.model.mesh.field
    ball = field.add("MathEval")
    grown = f"{fine} + 0.12 * Max(0, Sqrt(x*x + y*y) - {reach})"
    field.setString(ball, "F", f"Min({coarse}, {grown})")
    field.setAsBackgroundMesh(ball)
