"""Kinds of cells by their names in mesh files: corners, faces, and the order in which DOLFINx lists nodes."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from hhr_dolfinx.errors import FileContentError, SceneError

FACES = {
    "triangle": ((0, 1), (1, 2), (2, 0)),
    "quadrilateral": ((0, 1), (1, 2), (2, 3), (3, 0)),
    "tetrahedron": ((0, 1, 2), (0, 1, 3), (1, 2, 3), (2, 0, 3)),
    "hexahedron": ((0, 1, 2, 3), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)),
}
"""Corners of the faces of a cell, in the order of Abaqus' and Exodus' faces 1, 2, ... of plane cells and of Abaqus' in
space; nodes as most formats list them."""
CORNERS = {"triangle": 3, "quadrilateral": 4, "tetrahedron": 4, "hexahedron": 8}
DIMENSION = {"triangle": 2, "quadrilateral": 2, "tetrahedron": 3, "hexahedron": 3}
KINDS = {
    "triangle": "triangle", "triangle6": "triangle", "triangle7": "triangle",
    "quad": "quadrilateral", "quad8": "quadrilateral", "quad9": "quadrilateral",
    "tetra": "tetrahedron", "tetra10": "tetrahedron",
    "hexahedron": "hexahedron", "hexahedron20": "hexahedron", "hexahedron27": "hexahedron",
}  # fmt: skip
"""Kinds of cells that are understood, by meshio's names; those of second order are refused by their own."""
OTHERS = {"wedge": "prism", "pyramid": "pyramid"}
"""Cells of bodies in space that are not supported: how meshio's names of them begin, and their own names."""
OF_CORNERS = {4: "tetrahedron", 5: "pyramid", 6: "prism", 8: "hexahedron"}
"""Cells in space by their number of corners."""
_PLURAL = {"tetrahedron": "tetrahedra", "hexahedron": "hexahedra"}
_ONE_KIND = {
    2: "in gmsh without 'Recombine Surface' and with Mesh.RecombineAll = 0 for triangles, or recombined and with "
    "Mesh.SubdivisionAlgorithm = 1 for quadrilaterals",
    3: "in gmsh without 'Recombine' and layers of extrusions for tetrahedra, or with Mesh.SubdivisionAlgorithm = 2 for "
    "hexahedra",
}
"""How cells of one kind are asked for, by dimension."""
FACET_KINDS = {"line": 2, "line3": 2, "triangle": 3, "triangle6": 3, "triangle7": 3, "quad": 4, "quad8": 4, "quad9": 4}
"""Corners of what facets may be."""
TENSOR = {"quadrilateral": [0, 1, 3, 2], "hexahedron": [0, 1, 3, 2, 4, 5, 7, 6]}
"""Places of the nodes of a cell in the order that DOLFINx wants."""
TENSOR_FACET = [0, 1, 3, 2]


def one_kind(kinds: Iterable[str], path: Path) -> str:
    """The kind of all cells of a file; raises FileContentError for several, or one that is not supported."""
    found = sorted(set(kinds))
    if len(found) == 1 and found[0] in CORNERS:
        return found[0]
    names = " and ".join(_PLURAL.get(kind, f"{kind}s") for kind in found)
    said = f"mixes {names}" if len(found) > 1 else f"has {names}"
    raise FileContentError(
        f"{path} {said}, and a mesh must have cells of one kind: triangles, quadrilaterals, tetrahedra or hexahedra. "
        f"Mesh all bodies so: {_ONE_KIND[max(DIMENSION.get(kind, 3) for kind in found)]}"
    )


def require_first_order(kind: str, nodes: Iterable[int], path: Path) -> None:
    """Raise SceneError for cells of a file with more nodes than corners, given the number of nodes of each.

    Their corners alone would be another body: a half-disc of curved cells came out as a coarse polygon.
    """
    found = [count for count in nodes if count > CORNERS[kind]]
    if found:
        counts = " or ".join(str(count) for count in sorted(set(found)))
        raise SceneError(
            f"{path}: {len(found)} cells of kind {kind} have {counts} nodes where their corners are {CORNERS[kind]}. "
            "Cells of second order are not built in, and their corners alone are another body: export cells of first "
            "order (in gmsh Mesh.ElementOrder = 1 or setOrder(1), in Abaqus types such as CPE4, CAX4 or C3D8), on a "
            "finer mesh where sides are curved"
        )


def faces(kind: str, cells: np.ndarray) -> np.ndarray:
    """Corners of all faces of cells, (c, faces, k)."""
    return cells[:, np.array(FACES[kind])]


def outer_faces(kind: str, cells: np.ndarray) -> np.ndarray:
    """Corners of the faces that belong to one cell only, (f, k)."""
    every = faces(kind, cells).reshape(-1, len(FACES[kind][0]))
    _, first, count = np.unique(np.sort(every, axis=1), axis=0, return_index=True, return_counts=True)
    return every[first[count == 1]]
