"""Folded cells untangled by gmsh: nodes inside of bodies move, those on curved surfaces stay."""

from __future__ import annotations

import importlib
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np

from hhr_dolfinx.compat import extra
from hhr_dolfinx.geometries import high_order
from hhr_dolfinx.geometries.cells import EDGE_ORDERS, EDGES, FACES
from hhr_dolfinx.geometries.raw_mesh import RawMesh

WAYS = {2: ("HighOrder", "HighOrderElastic"), 3: ("HighOrderElastic", "HighOrder")}
"""Optimisers of gmsh in the order in which they are tried, by the dimension of cells.

The first one moves nodes least, and in space may fail or take long: it did not end in minutes on
92,000 tetrahedra, of which the second one, an elastic body, mended all 1,440 folded ones in 5 s.
``HighOrderFastCurving`` mended few cells and folded others.
"""
ELEMENTS = {"line": 8, "triangle": 9, "quadrilateral": 16, "tetrahedron": 11, "hexahedron": 17}
"""Numbers in gmsh of elements of second order with nodes on their edges and no others."""
FACETS = {
    "triangle": "line",
    "quadrilateral": "line",
    "tetrahedron": "triangle",
    "hexahedron": "quadrilateral",
}
COPLANAR_FACETS = 1e-9
"""Deviation of a facet from its plane, and of unit normals, below which facets lie in one plane."""
MOVED_LAYERS = 5
"""Layers of cells around bad ones whose nodes may move."""
OPTIMISER_SECONDS = 60.0
"""Longest duration of one run of an optimiser."""
OF_MPI = ("OMPI_", "PMIX_", "PMI_", "HYDI_", "MPI")
"""Beginnings of variables of the environment that make a child process a rank."""


def optimised(
    raw: RawMesh, rows: np.ndarray, matched: np.ndarray, bad: Callable[[np.ndarray], int]
) -> np.ndarray:
    """Coordinates of all nodes, (nodes, dim), with the fewest bad cells that gmsh reaches.

    Nodes of :data:`MOVED_LAYERS` layers of cells around the bad ones move. Those on curved
    surfaces and between bodies stay. In space those on flat sides of bodies move in their plane
    first, unless other nodes are at the same place, ``matched``: with folded facets on a
    surface no cell inside can be mended.

    Args:
        raw: the mesh.
        rows: rows of the bad cells.
        matched: True for nodes whose place other nodes share, (nodes,).
        bad: function that returns the number of bad cells for coordinates of all nodes.

    Raises:
        MissingPackageError: without gmsh.
    """
    with extra("mesh", "Untangled(how='gmsh')"):
        importlib.import_module("gmsh")
    near = _around(raw, rows)
    labels = _labels(raw)
    best = raw.points
    least = bad(best)
    for points in _starts(raw, near, labels, matched):
        for way in WAYS[raw.dim]:
            patch = raw.cells[near], np.asarray(raw.sides)[near], labels[near]
            new = _optimised(raw.kind, points, *patch, way)
            if new is not None and (count := bad(new)) < least:
                best = new
                least = count
            if not least:
                return best
    return best


def _around(raw: RawMesh, rows: np.ndarray) -> np.ndarray:
    """Rows of the cells of some layers around cells."""
    in_layers = np.zeros(len(raw.points), dtype=bool)
    for _ in range(MOVED_LAYERS):
        in_layers[raw.cells[rows]] = True
        rows = np.flatnonzero(in_layers[raw.cells].any(axis=1))
    return rows


def _starts(
    raw: RawMesh, near: np.ndarray, labels: np.ndarray, matched: np.ndarray
) -> Iterator[np.ndarray]:
    """Coordinates to begin with: those after moves in flat sides of bodies, and those of the
    file.
    """
    if raw.dim == 3:
        facets, sides, planes = _flat(raw, near, labels, matched)
        if len(facets):
            new = _optimised(FACETS[raw.kind], raw.points, facets, sides, planes, WAYS[2][0])
            if new is not None:
                yield new
    yield raw.points


def _labels(raw: RawMesh) -> np.ndarray:
    """A number for each cell, common to those that are in the same bodies, (c,)."""
    members = np.zeros((len(raw.cells), len(raw.bodies)), dtype=bool)
    for column, rows in enumerate(raw.bodies.values()):
        members[rows, column] = True
    return np.unique(members, axis=0, return_inverse=True)[1].ravel()


def _facets(kind: str, cells: np.ndarray, sides: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Corners of all facets of all cells, (c * facets, k), and the nodes on their sides, (c *
    facets, m).
    """
    listed = [frozenset(edge) for edge in EDGES[kind]]
    ends = [face if len(face) == 2 else (*face, face[0]) for face in FACES[kind]]
    edges = [[listed.index(frozenset(pair)) for pair in pairwise(face)] for face in ends]
    corners = cells[:, np.array(FACES[kind])]
    middles = sides[:, np.array(edges)]
    return corners.reshape(-1, corners.shape[2]), middles.reshape(-1, middles.shape[2])


def borders(
    kind: str, cells: np.ndarray, sides: np.ndarray, labels: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Nodes of the facets that belong to one cell, or to cells with several labels.

    Args:
        kind: kind of the cells, such as ``hexahedron``.
        cells: corners of the cells, (c, k).
        sides: nodes on the edges of the cells, (c, edges).
        labels: label of each cell, (c,).

    Returns:
        Nodes of the facets, (f, k + m), and the cells of these, (f,).
    """
    corners, middles = _facets(kind, cells, sides)
    owner = np.repeat(np.arange(len(cells)), len(FACES[kind]))
    _, first, which = np.unique(
        np.sort(corners, axis=1), axis=0, return_index=True, return_inverse=True
    )
    which = which.ravel()
    low = np.full(len(first), labels.max(initial=0) + 1)
    high = np.full(len(first), -1)
    np.minimum.at(low, which, labels[owner])
    np.maximum.at(high, which, labels[owner])
    border = first[(np.bincount(which) == 1) | (low < high)]
    return np.hstack([corners, middles])[border], owner[border]


def _flat(
    raw: RawMesh, near: np.ndarray, labels: np.ndarray, matched: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Corners, nodes on sides, and labels of the outer facets of some cells that lie in a plane,
    without matched nodes.

    Facets in the same plane and of the same bodies have the same label.
    """
    nodes, owner = borders(raw.kind, raw.cells, np.asarray(raw.sides), np.zeros_like(labels))
    is_near = np.isin(owner, near)
    nodes = nodes[is_near]
    coordinates = raw.points[nodes]
    normals = np.cross(coordinates[:, 1] - coordinates[:, 0], coordinates[:, 2] - coordinates[:, 0])
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    size = np.ptp(raw.points, axis=0).max()
    off = np.abs(np.einsum("fkd,fd->fk", coordinates - coordinates[:, :1], normals)).max(axis=1)
    # opposite normals of one plane are the same
    axis = np.abs(normals).argmax(axis=1)
    normals *= np.sign(np.take_along_axis(normals, axis[:, None], axis=1))
    planes = np.column_stack(
        [normals, np.einsum("fd,fd->f", coordinates[:, 0], normals) / size, labels[owner[is_near]]]
    )
    selected = (off < COPLANAR_FACETS * size) & ~matched[nodes].any(axis=1)
    same = np.unique(
        (planes[selected] / (1e3 * COPLANAR_FACETS)).round(), axis=0, return_inverse=True
    )[1].ravel()
    width = len(FACES[raw.kind][0])
    return nodes[selected, :width], nodes[selected, width:], same


def _optimised(
    kind: str,
    points: np.ndarray,
    cells: np.ndarray,
    sides: np.ndarray,
    labels: np.ndarray,
    way: str,
) -> np.ndarray | None:
    """Coordinates after an optimiser of gmsh moves nodes inside of cells with one label.

    None if it failed.
    """
    held = borders(kind, cells, sides, labels)[0]
    listed = [frozenset(edge) for edge in EDGES[kind]]
    order = [listed.index(frozenset(edge)) for edge in EDGE_ORDERS["gmsh"].get(kind, EDGES[kind])]
    nodes = np.hstack([cells, sides[:, order]])
    used, which = np.unique(nodes, return_inverse=True)
    numbers = np.zeros(len(points), dtype=np.int64)
    numbers[used] = np.arange(len(used))
    coordinates = np.zeros((len(used), 3))
    coordinates[:, : points.shape[1]] = points[used]
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "mesh.npz"
        kinds = [ELEMENTS[kind], ELEMENTS[FACETS[kind]]]
        np.savez(
            file,
            points=coordinates,
            cells=which.reshape(nodes.shape),
            held=numbers[held],
            kinds=kinds,
        )
        environment = {
            name: value for name, value in os.environ.items() if not name.startswith(OF_MPI)
        }
        command = [sys.executable, "-P", high_order.__file__, str(file), way]
        try:
            subprocess.run(
                command,
                cwd=folder,
                env=environment,
                capture_output=True,
                check=True,
                timeout=OPTIMISER_SECONDS,
            )
        except (subprocess.CalledProcessError, subprocess.TimeoutExpired):
            return None
        with np.load(file) as new:
            new_points = points.copy()
            new_points[used] = new["points"][:, : points.shape[1]]
    return new_points if np.isfinite(new_points).all() else None
