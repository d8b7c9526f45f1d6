"""Three rings shrunk onto each other, axisymmetric, for ``extreme_cases.py``."""

import numpy as np
from dolfinx import mesh as dmesh
from mpi4py import MPI

import hhr_dolfinx as hhr
from hhr_dolfinx.compat import geometry_dofmap, linear_mesh
from hhr_dolfinx.geometries import block

RADII, HEIGHT, CELLS, OVERLAP = ((1.0, 1.5), (1.5, 2.0), (2.0, 2.6)), 2.0, (4, 20), 2e-3
ENDS = 1
"""Facet tag of the lower ends of all rings."""


def side(ring: int, outer: bool) -> int:
    """Facet tag of the inner or outer side of a ring, 0 to 2."""
    return 10 * (ring + 1) + int(outer)


def build(comm: MPI.Comm) -> tuple:
    """Mesh and tags: each ring begins ``OVERLAP`` inside the one before."""
    boxes = [(inner - OVERLAP * (ring > 0), outer) for ring, (inner, outer) in enumerate(RADII)]
    parts = [block.block(MPI.COMM_SELF, lower=(inner, 0.0), upper=(outer, HEIGHT), cells=CELLS)[0]
             for inner, outer in boxes]  # fmt: skip
    counts = np.cumsum([0, *(len(part.geometry.x) for part in parts)])
    points = np.concatenate([part.geometry.x[:, :2] for part in parts])
    cells = np.concatenate(
        [geometry_dofmap(part) + first for part, first in zip(parts, counts, strict=False)]
    )
    mesh = linear_mesh(comm, points, cells, "quadrilateral")
    per_ring = CELLS[0] * CELLS[1]
    rings = (np.asarray(mesh.topology.original_cell_index) // per_ring + 1).astype(np.int32)
    places = {ENDS: (1, 0.0)}
    places |= {
        side(ring, outer): (0, box[outer])
        for ring, box in enumerate(boxes)
        for outer in (False, True)
    }
    facets, values = [], []
    for tag, (axis, at) in places.items():
        found = dmesh.locate_entities_boundary(
            mesh, 1, lambda x, axis=axis, at=at: np.abs(x[axis] - at) < 1e-9
        )
        facets.append(found)
        values.append(np.full(found.size, tag, dtype=np.int32))
    facets, values = np.concatenate(facets), np.concatenate(values)
    order = np.argsort(facets)
    sides = dmesh.meshtags(mesh, 1, facets[order], values[order])
    return mesh, dmesh.meshtags(mesh, 2, np.arange(rings.size, dtype=np.int32), rings), sides


def three_rings() -> hhr.Scene:
    """Pressed from outside up to a height, in mm and MPa; contact never opens."""
    normal = (1.0, 0.0)
    return hhr.Scene(
        name="three_rings",
        geometry=build,
        hypothesis="axisymmetric",
        bodies=tuple(hhr.Body(tag, 200e3, 0.3) for tag in (1, 2, 3)),
        contacts=tuple(
            hhr.NodeToNode(side(k, True), side(k + 1, False), normal=normal) for k in (0, 1)
        ),
        parameters=hhr.ParameterSpace(("P", "h"), (5.0, 0.2), (100.0, 2.0)),
        displacements=(hhr.Displacement(ENDS, 1),),
        loads=(hhr.PartialPressure(side(2, True), hhr.Amplitude(slopes={"P": 1.0}), extent="h"),),
    )
