"""Meshes and tags of XDMF files, as DOLFINx and meshio write them; their grids have numbers and no names."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING
from xml.etree import ElementTree

import numpy as np
from dolfinx import io
from dolfinx import mesh as dmesh

from hhr_dolfinx.compat import NamedMesh
from hhr_dolfinx.errors import FileContentError

if TYPE_CHECKING:
    from mpi4py.MPI import Comm

_DIMENSIONS = {"polyline": 1, "interval": 1, "edge": 1, "triangle": 2, "tri": 2, "quadrilateral": 2, "quad": 2,
               "tetrahedron": 3, "tet": 3, "hexahedron": 3, "hex": 3}  # fmt: skip


def read_xdmf(path: Path, comm: Comm, scale: float) -> NamedMesh:
    """The mesh of a file, shared out, and the tags of its cells and facets.

    Raises:
        FileContentError: for a file without a mesh, or without tags of both.
    """
    grids = _grids(path)
    meshes = [name for name, dim, tagged in grids if dim == max(item[1] for item in grids)]
    with io.XDMFFile(comm, str(path), "r") as file:
        mesh = file.read_mesh(name=meshes[0])
        top = mesh.topology.dim
        tags = {}
        for name, dim, tagged in grids:
            if tagged and dim in (top, top - 1) and dim not in tags:
                mesh.topology.create_connectivity(dim, top)
                tags[dim] = file.read_meshtags(mesh, name=name)
    missing = [what for dim, what in ((top, "cells"), (top - 1, "facets")) if dim not in tags]
    if "facets" in missing:
        names = [name for name, *_ in grids]
        raise FileContentError(f"{path} has no tags of facets, only the grids {names}: write them too")
    if missing:
        count = mesh.topology.index_map(top).size_local
        tags[top] = dmesh.meshtags(mesh, top, np.arange(count, dtype=np.int32), np.ones(count, dtype=np.int32))
    mesh.geometry.x[:] *= scale
    return NamedMesh(mesh, tags[top], tags[top - 1], [])


def _grids(path: Path) -> list[tuple[str, int, bool]]:
    """Name and dimension of the grids of a file, and whether they have numbers of their cells."""
    try:
        root = ElementTree.parse(path).getroot()
    except ElementTree.ParseError as error:
        raise FileContentError(f"mesh file {path} is no XDMF ({error})") from error
    found = []
    for grid in root.iter("Grid"):
        topology = grid.find("Topology")
        if topology is not None:
            kind = (topology.get("TopologyType") or topology.get("Type") or "").lower().split("_")[0]
            tagged = any(item.get("Center") == "Cell" for item in grid.findall("Attribute"))
            found.append((grid.get("Name", "mesh"), _DIMENSIONS.get(kind, 0), tagged))
    if not any(dim >= 2 for _, dim, _ in found):
        raise FileContentError(f"mesh file {path} has no grid of triangles, quadrilaterals, tetrahedra or hexahedra")
    return found
