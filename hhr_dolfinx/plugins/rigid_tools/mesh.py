"""Geometries with one more cell, whose motion is that of a rigid tool."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from mpi4py import MPI

from hhr_dolfinx import compat
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.geometries.partition import shares

UNNAMED = 1_000_000_000
"""Tags of tools are larger, so that a mistyped one of the mesh is not that of a tool."""
CELL_SIZE = 0.1
"""Size of the cell of a tool over that of the mesh: large enough for its turns, small in
pictures.
"""


@dataclass(frozen=True)
class ToolMesh:
    """A geometry beside a cell at the reference point of a tool.

    Its body and its surface have the name of the tool.
    """

    geometry: Callable[[MPI.Comm], Any]  #: geometry of a scene
    at: tuple[float, ...]  #: the reference point, (dim,), in the middle of the cell
    name: str
    axisymmetric: bool = False  #: the cell stays at positive radii

    def __call__(self, comm: MPI.Comm) -> compat.NamedMesh:
        """Mesh of both.

        Args:
            comm: communicator of the mesh.

        Raises:
            SceneError: if the mesh has another dimension than the point, or the name already.
        """
        given = self.geometry(comm)
        mesh, *tags = given if isinstance(given, tuple | list) else _parts(given)
        dim = mesh.geometry.dim
        if len(self.at) != dim:
            raise SceneError(
                f"the reference point {self.at} of tool '{self.name}' must have {dim} coordinates"
            )
        groups: Any = getattr(given, "physical_groups", None) or []
        groups = list(groups.items() if isinstance(groups, dict) else groups)
        sets: Any = getattr(given, "nodes", None) or {}
        if self.name in sets or any(name == self.name for name, _ in groups):
            raise SceneError(
                f"the mesh has a group or set '{self.name}': give the tool another name, name=..."
            )
        kind = mesh.topology.cell_name()
        points, cells = _gathered(mesh, comm)
        entities = [_tagged(mesh, part, comm) for part in tags]
        present = (int(part.values.max(initial=UNNAMED)) for part in tags)
        numbers = [comm.allreduce(largest, op=MPI.MAX) + 1 for largest in present]
        if comm.rank == 0:
            first = len(points)
            added = self._cell(points, kind, compat.degree_of(mesh))
            nodes = first + np.arange(len(added))
            points = np.vstack([points, added])
            cells = np.vstack([cells, nodes[None]])
            corners = _corners(kind)
            own = [nodes[None, :corners], first + np.array(_facets(kind))]
            entities = [
                (np.vstack([some, new]), np.append(values, np.full(len(new), number)))
                for (some, values), new, number in zip(entities, own, numbers, strict=True)
            ]
        made = compat.linear_mesh(comm, points, cells, kind, compat.degree_of(mesh), shares)
        of_cells, of_facets = (
            compat.tags_of(made, mesh.topology.dim - k, *entities[k]) for k in (0, 1)
        )
        top = mesh.topology.dim
        groups += [(self.name, (top - k, numbers[k])) for k in (0, 1)]
        kept = {key: getattr(given, key, None) for key in ("summary", "nodes")}
        return compat.NamedMesh(made, of_cells, of_facets, groups, **kept)

    def _cell(self, points: np.ndarray, kind: str, degree: int) -> np.ndarray:
        """Nodes of the cell, (k, dim)."""
        size = CELL_SIZE * np.ptp(points, axis=0).max()
        reference = compat.nodes_of_cell(kind, degree)
        corners = reference[: _corners(kind)]
        nodes: np.ndarray = self.at + size * (reference - corners.mean(axis=0))
        if self.axisymmetric:
            nodes[:, 0] -= min(nodes[:, 0].min(), 0.0)
        return nodes


def tools_of(geometry: object) -> dict[str, tuple[float, ...]]:
    """Reference points of the tools of a geometry, by name.

    Args:
        geometry: geometry of a scene.
    """
    found: dict[str, tuple[float, ...]] = {}
    while isinstance(geometry, ToolMesh):
        found[geometry.name] = geometry.at
        geometry = geometry.geometry
    return found


def _parts(given: Any) -> tuple[Any, Any, Any]:
    """Mesh and tags of what gmsh's reader returns."""
    return given.mesh, given.cell_tags, given.facet_tags


def _corners(kind: str) -> int:
    """Number of corners of a cell."""
    return len(compat.nodes_of_cell(kind, 1))


def _facets(kind: str) -> list[list[int]]:
    """Corners of the facets of a cell, in the order of DOLFINx."""
    edges, faces = compat.topology(kind)
    return edges if kind in ("triangle", "quadrilateral") else faces


def _gathered(mesh: Any, comm: MPI.Comm) -> tuple[np.ndarray, np.ndarray]:
    """Points, (n, dim), in the order in which the mesh was made, and cells, on the first rank;
    empty elsewhere.
    """
    geometry = mesh.geometry
    dim = geometry.dim
    owned = geometry.index_map().size_local
    count = mesh.topology.index_map(mesh.topology.dim).size_local
    numbers = geometry.input_global_indices
    own_points = comm.gather((numbers[:owned], geometry.x[:owned, :dim]))
    own_cells = comm.gather(numbers[compat.geometry_dofmap(mesh)[:count]])
    if own_points is None or own_cells is None:
        width = compat.geometry_dofmap(mesh).shape[1]
        return np.zeros((0, dim)), np.zeros((0, width), dtype=np.int64)
    indices = np.concatenate([some for some, _ in own_points])
    points = np.zeros((indices.max() + 1, dim))
    points[indices] = np.concatenate([some for _, some in own_points])
    return points, np.concatenate(own_cells)


def _tagged(mesh: Any, tags: Any, comm: MPI.Comm) -> tuple[np.ndarray, np.ndarray]:
    """Corners of tagged entities, (n, k), and their tags, on the first rank; empty elsewhere."""
    from dolfinx.mesh import entities_to_geometry

    kind = mesh.topology.cell_name()
    width = _corners(kind) if tags.dim == mesh.topology.dim else len(_facets(kind)[0])
    topology = mesh.topology
    topology.create_connectivity(tags.dim, topology.dim)
    topology.create_connectivity(topology.dim, tags.dim)
    here = tags.indices < topology.index_map(tags.dim).size_local
    local = entities_to_geometry(mesh, tags.dim, tags.indices[here])
    # those of second order have their corners first
    corners = mesh.geometry.input_global_indices[local[:, :width]]
    found = comm.gather((corners, tags.values[here]))
    if found is None:
        return corners[:0], tags.values[:0]
    return np.concatenate([some for some, _ in found]), np.concatenate([own for _, own in found])
