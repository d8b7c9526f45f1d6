"""Outer facets of bodies as node numbers, split at the middle nodes of cells of second order."""

from __future__ import annotations

import numpy as np

from hhr_dolfinx.geometries.cells import FACES
from hhr_dolfinx.models.answer_mesh import AnswerMesh
from hhr_dolfinx.plugins.plots.cell_kinds import (
    CORNERS_OF_KIND,
    HEXAHEDRON_KINDS,
    QUADRILATERAL_KINDS,
    TETRAHEDRON_KINDS,
    TRIANGLE_KINDS,
)


def _kind_of(mesh: AnswerMesh) -> str:
    """Name of the kind of cell."""
    if mesh.kind in HEXAHEDRON_KINDS:
        return "hexahedron"
    if mesh.kind in TETRAHEDRON_KINDS:
        return "tetrahedron"
    return "quadrilateral" if mesh.kind in QUADRILATERAL_KINDS else "triangle"


def _middle(mesh: AnswerMesh, corners: tuple[int, ...]) -> int | None:
    """Index within a cell of the node between some of its corners; None without one.

    Middle nodes are found by their positions in the first cell, in which VTK's orders agree.
    """
    first = mesh.points[mesh.cells[0]]
    mid_nodes = np.arange(CORNERS_OF_KIND[mesh.kind], len(first))
    if not mid_nodes.size:
        return None
    middle = first[list(corners)].mean(axis=0)
    distances = np.linalg.norm(first[mid_nodes] - middle, axis=1)
    nearest = int(distances.argmin())
    size = np.linalg.norm(first[list(corners)] - middle, axis=1).max()
    return int(mid_nodes[nearest]) if distances[nearest] < 0.3 * size else None


def _split(mesh: AnswerMesh, face: tuple[int, ...]) -> list[tuple[int, ...]]:
    """Parts of a face of a cell between all of its nodes; the face itself if some are missing."""
    edges = [(face[k], face[(k + 1) % len(face)]) for k in range(len(face))]
    if len(face) == 2:
        middle = _middle(mesh, face)
        return [face] if middle is None else [(face[0], middle), (middle, face[1])]
    middles = [_middle(mesh, edge) for edge in edges]
    mid_nodes = [middle for middle in middles if middle is not None]
    if len(mid_nodes) < len(face):
        return [face]
    before = [mid_nodes[-1], *mid_nodes[:-1]]
    if len(face) == 3:
        around = list(zip(face, mid_nodes, before, strict=True))
        return [*around, tuple(mid_nodes)]
    centre = _middle(mesh, face)
    if centre is None:
        return [face]
    corners = zip(face, mid_nodes, before, strict=True)
    return [(corner, after, centre, ahead) for corner, after, ahead in corners]


def _is_surface(mesh: AnswerMesh) -> bool:
    """True for a mesh of triangles in space: outer faces of blocks of other codes."""
    return mesh.points.shape[1] == 3 and mesh.kind in TRIANGLE_KINDS


def outer_facets(mesh: AnswerMesh, body: int, *, split: bool = True) -> np.ndarray:
    """Nodes of the outer facets of a body, (f, k), with outer normals; lines in the plane.

    Args:
        mesh: the mesh.
        body: index of the body in the scene.
        split: split facets of second order at their middle nodes, else take their corners.
    """
    cells = mesh.cells[mesh.bodies == body]
    if _is_surface(mesh):
        return cells
    faces = FACES[_kind_of(mesh)]
    keys = np.concatenate([np.sort(cells[:, list(face)], axis=1) for face in faces])
    _, first, count = np.unique(keys, axis=0, return_index=True, return_counts=True)
    outer = np.zeros(len(keys), dtype=bool)
    outer[first[count == 1]] = True
    chosen = outer.reshape(len(faces), len(cells))
    facets = []
    for face, rows in zip(faces, chosen, strict=True):
        pieces = _split(mesh, face) if split else [face]
        centres = mesh.points[cells[rows]].mean(axis=1)
        facets += [_outward(mesh.points, cells[rows][:, list(piece)], centres) for piece in pieces]
    return np.concatenate(facets)


def _outward(points: np.ndarray, facets: np.ndarray, centres: np.ndarray) -> np.ndarray:
    """Facets in space with normals that point away from points of their cells, (f, 3)."""
    if points.shape[1] == 2:
        return facets
    corners = points[facets]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, -1] - corners[:, 0])
    inward = np.einsum("fd,fd->f", normals, corners.mean(axis=1) - centres) < 0
    return np.where(inward[:, None], facets[:, ::-1], facets)


def contact_facets(mesh: AnswerMesh, contact: int) -> np.ndarray:
    """Nodes of the outer facets that carry conditions of a contact at all of their nodes, (f, k).

    Args:
        mesh: the mesh.
        contact: index of the contact in the scene.

    Returns:
        Split facets of second order if all of their nodes carry conditions, else whole ones; none
        if conditions are at single nodes.
    """
    is_slave = np.zeros(len(mesh.points), dtype=bool)
    is_slave[mesh.slaves[mesh.contacts[contact]]] = True
    bodies = np.unique(mesh.bodies[is_slave[mesh.cells].any(axis=1)])
    for split in (True, False):
        facets = [outer_facets(mesh, int(body), split=split) for body in bodies]
        if not facets:
            break
        all_facets = np.concatenate(facets)
        carrying = all_facets[is_slave[all_facets].all(axis=1)]
        if len(carrying):
            return carrying
    return np.zeros((0, mesh.points.shape[1]), dtype=np.int64)
