"""Fuel pellet inside a tube of cladding, axisymmetric in (r, z), thesis section 1.5.2.

Two structured rectangles of quadrilaterals that face each other across a gap. The defaults, in mm,
give the thesis' 6161 + 909 nodes; with ``cladding_axial_cells`` other than ``axial_cells`` the
meshes do not match.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hhr_dolfinx.geometries.gmsh_model import gmsh, mesh_of

if TYPE_CHECKING:
    from mpi4py.MPI import Comm

    from hhr_dolfinx.compat import TaggedMesh

PELLET = 1
CLADDING = 2
"""Cell tags of the two bodies."""
PELLET_BOTTOM = 11
PELLET_SIDE = 12
PELLET_TOP = 13
PELLET_AXIS = 14
CLADDING_BOTTOM = 21
CLADDING_OUTER = 22
CLADDING_TOP = 23
CLADDING_INNER = 24
"""Facet tags, counter-clockwise from the bottom."""


def pellet_cladding(
    comm: Comm,
    *,
    radius: float = 4.1,
    height: float = 7.0,
    thickness: float = 0.57,
    gap: float = 2e-3,
    radial_cells: int = 60,
    axial_cells: int = 100,
    cladding_radial_cells: int = 8,
    cladding_axial_cells: int | None = None,
) -> TaggedMesh:
    """Build the mesh of pellet and cladding on all ranks of ``comm``.

    Args:
        comm: MPI communicator.
        radius: radius of the pellet, in the unit of length of the scene, as all lengths.
        height: height of both bodies.
        thickness: thickness of the cladding.
        gap: distance of the two surfaces.
        radial_cells: cells of the pellet along r.
        axial_cells: cells of the pellet along z.
        cladding_radial_cells: cells of the cladding along r.
        cladding_axial_cells: cells of the cladding along z; None for as many as the pellet has.

    Raises:
        ValueError: for lengths or numbers of cells that are not positive.
    """
    if min(radius, height, thickness) <= 0:
        raise ValueError(
            f"radius {radius}, height {height} and thickness {thickness} must be positive"
        )
    if cladding_axial_cells is None:
        cladding_axial_cells = axial_cells
    counts = (radial_cells, axial_cells, cladding_radial_cells, cladding_axial_cells)
    if min(counts) < 1:
        raise ValueError(f"cells {counts} along the sides of pellet and cladding must be positive")
    inner = radius + gap

    def make() -> None:
        _rectangle(PELLET, 0.0, radius, height, radial_cells, axial_cells)
        _rectangle(
            CLADDING, inner, inner + thickness, height, cladding_radial_cells, cladding_axial_cells
        )
        gmsh.model.mesh.generate(2)

    return mesh_of(make, comm, dim=2)


def _rectangle(
    tag: int, left: float, right: float, height: float, radial_cells: int, axial_cells: int
) -> None:
    """Add a structured rectangle; its sides are tagged 10 * tag + 1 to 4 from the bottom."""
    geo = gmsh.model.geo
    corners = [
        geo.addPoint(r, z, 0) for r, z in ((left, 0), (right, 0), (right, height), (left, height))
    ]
    sides = [geo.addLine(corners[k], corners[(k + 1) % 4]) for k in range(4)]
    for side, cells in zip(sides, (radial_cells, axial_cells) * 2, strict=True):
        geo.mesh.setTransfiniteCurve(side, cells + 1)
    body = geo.addPlaneSurface([geo.addCurveLoop(sides)])
    geo.mesh.setTransfiniteSurface(body)
    geo.mesh.setRecombine(2, body)
    geo.synchronize()
    gmsh.model.addPhysicalGroup(2, [body], tag)
    for k, side in enumerate(sides, start=1):
        gmsh.model.addPhysicalGroup(1, [side], 10 * tag + k)
