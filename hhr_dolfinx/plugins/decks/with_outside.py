"""A mesh file whose outside is a surface with a name, or is divided at edges into sides with
names.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from hhr_dolfinx.geometries.cells import outer_faces, outer_faces_of_cells
from hhr_dolfinx.geometries.mesh_file import MeshFile
from hhr_dolfinx.geometries.raw_mesh import RawMesh
from hhr_dolfinx.plugins.scene_checks.candidates import outward

OUTSIDE_SURFACE = "outside of all bodies"
"""Name of the surface of all outer facets."""
SMOOTH_EDGE = np.cos(np.deg2rad(40.0))
"""Cosine between the normals of neighbours from which on they belong to one side: gmsh's default is
40 degrees too.
"""
PLANE_SIDE = 1e-6
"""Deviation of unit normals up to which a side is a plane."""


@dataclass(frozen=True)
class WithOutside(MeshFile):
    """A mesh file with a surface :data:`OUTSIDE_SURFACE`: a scene needs a contact pair, and a
    file may name no surface.

    Attributes:
        sides: also name the sides of each body, ``LOWER z = 1`` for a plane across an axis and
            ``LOWER side 7`` for others. Sides end where the outer normal turns by more than 40
            degrees from a facet to the next.
    """

    sides: bool = False

    def read(self) -> RawMesh:
        """See :meth:`~hhr_dolfinx.geometries.mesh_file.MeshFile.read`."""
        raw = super().read()
        raw = with_sides(raw) if self.sides else raw
        return replace(
            raw, surfaces={**raw.surfaces, OUTSIDE_SURFACE: outer_faces(raw.kind, raw.cells)}
        )


def with_sides(raw: RawMesh) -> RawMesh:
    """The mesh with the sides of its bodies as further surfaces.

    Those of the file keep their names.
    """
    outer, of = outer_faces_of_cells(raw.kind, raw.cells)
    normals = outward(raw.points[outer], raw.points[raw.cells[of]].mean(axis=1))
    owner = np.zeros(len(raw.cells), dtype=np.int64)
    tags = sorted(
        raw.bodies, key=lambda body: (isinstance(body, int), len(raw.bodies[body])), reverse=True
    )
    for number, tag in enumerate(tags):
        owner[raw.bodies[tag]] = number
    # facets with a common edge, in the plane a common node
    width = outer.shape[1]
    edges = (
        outer[:, :, None] if width == 2 else np.stack([outer, np.roll(outer, -1, axis=1)], axis=2)
    )
    flat = np.sort(edges.reshape(len(outer) * width, -1), axis=1)
    order = np.lexsort(flat.T)
    same = np.flatnonzero((flat[order][1:] == flat[order][:-1]).all(axis=1))
    first, second = (order[same + k] // width for k in (0, 1))
    smooth = np.einsum("fd,fd->f", normals[first], normals[second]) > SMOOTH_EDGE
    smooth &= owner[of[first]] == owner[of[second]]
    graph = coo_matrix(
        (np.ones(int(smooth.sum())), (first[smooth], second[smooth])), shape=(len(outer),) * 2
    )
    sides: dict[str | int, np.ndarray] = {}
    for number in range(
        (labels := connected_components(graph, directed=False)[1]).max(initial=-1) + 1
    ):
        rows = labels == number
        name = _name(tags[owner[of[rows][0]]], normals[rows], raw.points[outer[rows]], number + 1)
        sides[name if name not in sides else f"{name}, side {number + 1}"] = outer[rows]
    return replace(raw, surfaces={**sides, **raw.surfaces})


def _name(tag: str | int, normals: np.ndarray, corners: np.ndarray, number: int) -> str:
    """Name of a side of a body: the plane in which it lies, or its number."""
    axis = int(np.abs(normals[0]).argmax())
    if (
        np.abs(np.abs(normals[:, axis]) - 1).max() < PLANE_SIDE
        and len(np.unique(np.sign(normals[:, axis]))) == 1
    ):
        return f"{tag} {'xyz'[axis]} = {corners[0, 0, axis].round(12) + 0.0:.6g}"
    return f"{tag} side {number}"
