"""Kinds of cells by their names in mesh files: corners, faces, and the order of nodes in
DOLFINx.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np

from hhr_dolfinx.errors import FileContentError

FACES = {
    "triangle": ((0, 1), (1, 2), (2, 0)),
    "quadrilateral": ((0, 1), (1, 2), (2, 3), (3, 0)),
    "tetrahedron": ((0, 1, 2), (0, 1, 3), (1, 2, 3), (2, 0, 3)),
    "hexahedron": (
        (0, 1, 2, 3),
        (4, 5, 6, 7),
        (0, 1, 5, 4),
        (1, 2, 6, 5),
        (2, 3, 7, 6),
        (3, 0, 4, 7),
    ),
}
"""Corners of the faces of a cell: plane cells in the order of faces 1, 2, ... of Abaqus and Exodus,
cells in space in that of Abaqus. Nodes have the order of most formats.
"""
CORNERS = {"triangle": 3, "quadrilateral": 4, "tetrahedron": 4, "hexahedron": 8}
DIMENSION = {"triangle": 2, "quadrilateral": 2, "tetrahedron": 3, "hexahedron": 3}
CELL_KINDS = {
    "triangle": "triangle", "triangle6": "triangle", "triangle7": "triangle",
    "quad": "quadrilateral", "quad8": "quadrilateral", "quad9": "quadrilateral",
    "tetra": "tetrahedron", "tetra10": "tetrahedron",
    "hexahedron": "hexahedron", "hexahedron20": "hexahedron", "hexahedron27": "hexahedron",
    "VTK_LAGRANGE_TRIANGLE": "triangle", "VTK_LAGRANGE_QUADRILATERAL": "quadrilateral",
    "VTK_LAGRANGE_TETRAHEDRON": "tetrahedron", "VTK_LAGRANGE_HEXAHEDRON": "hexahedron",
}  # fmt: skip
"""Supported kinds of cells, by meshio's names."""
OTHERS = {"wedge": "prism", "pyramid": "pyramid"}
"""Unsupported cells in space, by the beginning of meshio's names."""
OF_CORNERS = {4: "tetrahedron", 5: "pyramid", 6: "prism", 8: "hexahedron"}
"""Cells in space by their number of corners."""
PLURAL = {"triangle": "triangles", "quadrilateral": "quadrilaterals", "tetrahedron": "tetrahedra",
          "hexahedron": "hexahedra", "prism": "prisms", "pyramid": "pyramids"}  # fmt: skip
"""Plurals of the names of cells."""
_ONE_KIND = {
    2: (
        "in gmsh without 'Recombine Surface' and with Mesh.RecombineAll = 0 for triangles, or "
        "recombined and with Mesh.SubdivisionAlgorithm = 1 for quadrilaterals"
    ),
    3: (
        "in gmsh without 'Recombine' and layers of extrusions for tetrahedra, or with "
        "Mesh.SubdivisionAlgorithm = 2 for hexahedra"
    ),
}
"""Instructions for cells of one kind, by dimension."""
FACET_KINDS = {
    "line": 2,
    "line3": 2,
    "triangle": 3,
    "triangle6": 3,
    "triangle7": 3,
    "quad": 4,
    "quad8": 4,
    "quad9": 4,
}
"""Number of corners of the elements that may be facets, by meshio's names."""
EDGES = {
    "triangle": ((0, 1), (1, 2), (2, 0)),
    "quadrilateral": ((0, 1), (1, 2), (2, 3), (3, 0)),
    "tetrahedron": ((0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)),
    "hexahedron": (
        (0, 1),
        (1, 2),
        (2, 3),
        (3, 0),
        (4, 5),
        (5, 6),
        (6, 7),
        (7, 4),
        (0, 4),
        (1, 5),
        (2, 6),
        (3, 7),
    ),
}
"""Corners of the edges of a cell, in the order in which VTK, Abaqus and meshio list the nodes on
them.
"""
EDGE_ORDERS: dict[str, dict[str, tuple[tuple[int, int], ...]]] = {
    "vtk": {},
    "gmsh": {
        "tetrahedron": ((0, 1), (1, 2), (2, 0), (0, 3), (2, 3), (1, 3)),
        "hexahedron": (
            (0, 1),
            (0, 3),
            (0, 4),
            (1, 2),
            (1, 5),
            (2, 3),
            (2, 6),
            (3, 7),
            (4, 5),
            (4, 7),
            (5, 6),
            (6, 7),
        ),
    },
    "exodus": {
        "hexahedron": (
            (0, 1),
            (1, 2),
            (2, 3),
            (3, 0),
            (0, 4),
            (1, 5),
            (2, 6),
            (3, 7),
            (4, 5),
            (5, 6),
            (6, 7),
            (7, 4),
        ),
    },
}
"""Corners of edges as :data:`EDGES`, for formats with another order."""
WHOLE = {"triangle": (7,), "quadrilateral": (9,), "hexahedron": (27,)}
"""Numbers of nodes of cells that also have nodes in the middle of their faces and of the cell."""
TENSOR_ORDER = {"quadrilateral": [0, 1, 3, 2], "hexahedron": [0, 1, 3, 2, 4, 5, 7, 6]}
"""Indices of the nodes of a cell in the order of DOLFINx."""
TENSOR_FACET = [0, 1, 3, 2]


def one_kind(
    blocks: Iterable[tuple[str, np.ndarray]], path: Path
) -> tuple[str, dict[str | int, str]]:
    """Kind of the cells of a file, and reasons for cells of other kinds that are left out.

    The kind is the supported one with most cells. Others are left out if they touch none of these:
    they are then separate bodies, which a scene need not have. Otherwise the mesh without them
    would have holes.

    Args:
        blocks: kind and nodes, (b, K), of all cells of the highest dimension.
        path: path of the file, for messages.

    Raises:
        FileContentError: for several kinds that touch each other, or one that is not supported.
    """
    nodes: dict[str, list[np.ndarray]] = {}
    for kind, rows in blocks:
        nodes.setdefault(kind, []).append(np.asarray(rows))
    kinds = sorted(nodes)
    counts = {kind: sum(map(len, nodes[kind])) for kind in kinds}
    main = max((kind for kind in kinds if kind in CORNERS), key=counts.__getitem__, default="")
    if main:
        used = np.unique(np.concatenate([rows.ravel() for rows in nodes[main]]))
        other_kinds = [kind for kind in kinds if kind != main]
        if not any(np.isin(rows, used).any() for kind in other_kinds for rows in nodes[kind]):
            reasons = {
                kind: f"the mesh has {PLURAL[main]}" if kind in CORNERS else "not supported"
                for kind in other_kinds
            }
            return main, {
                in_words(counts[kind], kind): f"{text}; none touches a cell of the mesh"
                for kind, text in reasons.items()
            }
    names = " and ".join(PLURAL.get(kind, f"{kind}s") for kind in kinds)
    many = " and ".join(str(counts[kind]) for kind in kinds)
    text = f"mixes {names}, {many} of them" if len(kinds) > 1 else f"has {names}"
    raise FileContentError(
        f"{path} {text}, and a mesh must have cells of one kind: triangles, quadrilaterals, "
        "tetrahedra or hexahedra. Mesh all bodies so: "
        f"{_ONE_KIND[max(DIMENSION.get(kind, 3) for kind in kinds)]}"
    )


def in_words(count: int, kind: str) -> str:
    """A number of cells in words.

    Args:
        count: number of cells.
        kind: kind of the cells, such as ``hexahedron``.
    """
    return f"{count} {kind if count == 1 else PLURAL[kind]}"


def of_other_kinds(sets: Mapping[str | int, Mapping[str, int]], kept: str) -> dict[str | int, str]:
    """Reasons why sets with cells of other kinds than the mesh are no bodies.

    Args:
        sets: number of cells of each kind that is left out, by set.
        kept: kind of the cells of the mesh.
    """
    texts = {
        name: " and ".join(in_words(count, kind) for kind, count in counts.items())
        for name, counts in sets.items()
    }
    return {
        name: (
            f"{text} in it, and a mesh has cells of one kind, here {PLURAL[kept]}: mesh all "
            "bodies of the scene so"
        )
        for name, text in texts.items()
    }


def sides_of(
    kind: str, cells: Iterable[np.ndarray], path: Path, order: str = "vtk"
) -> np.ndarray | None:
    """Nodes on the edges of cells of second order, (c, edges), in the order of :data:`EDGES`.

    None at first order.

    Nodes in the middle of faces and cells are skipped: they follow from those of the edges.

    Args:
        kind: kind of all cells.
        cells: nodes of the cells by blocks, (b, K) each.
        path: path of the file, for messages.
        order: order of nodes in the file, a key of :data:`EDGE_ORDERS`.

    Raises:
        FileContentError: for cells of several orders, or of one that is not supported.
    """
    blocks = [np.asarray(block) for block in cells if len(block)]
    counts = sorted({block.shape[1] for block in blocks})
    corners = CORNERS[kind]
    if counts == [corners]:
        return None
    edges = EDGES[kind]
    allowed = {corners + len(edges), *WHOLE.get(kind, ())}
    if len(counts) > 1 and corners in counts:
        raise FileContentError(
            f"{path}: cells of kind {kind} have {' or '.join(map(str, counts))} nodes: mesh all "
            "bodies with cells of one order, in gmsh by setOrder(2)"
        )
    if not set(counts) <= allowed:
        raise FileContentError(
            f"{path}: cells of kind {kind} have {' or '.join(map(str, counts))} nodes, and those "
            f"of order 1 or 2 have {corners} or {' or '.join(map(str, sorted(allowed)))}: in gmsh "
            "setOrder(2)"
        )
    listed = [frozenset(edge) for edge in EDGE_ORDERS[order].get(kind, edges)]
    columns = corners + np.array([listed.index(frozenset(edge)) for edge in edges])
    return np.concatenate([block[:, columns] for block in blocks])


def faces(kind: str, cells: np.ndarray) -> np.ndarray:
    """Corners of all faces of cells, (c, faces, k).

    Args:
        kind: kind of the cells, such as ``hexahedron``.
        cells: corners of the cells, (c, k).
    """
    return cells[:, np.array(FACES[kind])]


def outer_faces(kind: str, cells: np.ndarray) -> np.ndarray:
    """Corners of the faces that belong to one cell only, (f, k).

    Args:
        kind: kind of the cells, such as ``hexahedron``.
        cells: corners of the cells, (c, k).
    """
    return outer_faces_of_cells(kind, cells)[0]


def outer_faces_of_cells(kind: str, cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Corners of the faces that belong to one cell only, (f, k), and this cell, (f,).

    Args:
        kind: kind of the cells, such as ``hexahedron``.
        cells: corners of the cells, (c, k).
    """
    corners = faces(kind, cells)
    flat = corners.reshape(-1, corners.shape[-1])
    _, first, count = np.unique(
        np.sort(flat, axis=1), axis=0, return_index=True, return_counts=True
    )
    outer = first[count == 1]
    return flat[outer], outer // len(FACES[kind])


def are_sides(kind: str, cells: np.ndarray, facets: np.ndarray) -> np.ndarray:
    """Mask of the facets, (f, k), that are sides of some cells, by their corners, (f,) bool.

    Args:
        kind: kind of the cells, such as ``hexahedron``.
        cells: corners of the cells, (c, k).
        facets: corners of the facets, (f, k).
    """
    # few nodes of a mesh in space are on facets, and sorting all of its sides takes seconds
    wanted = np.zeros(max(cells.max(initial=0), facets.max(initial=0)) + 1, dtype=bool)
    wanted[facets] = True
    sides = faces(kind, cells[wanted[cells].any(axis=1)]).reshape(-1, len(FACES[kind][0]))
    sides = np.sort(sides[wanted[sides].all(axis=1)], axis=1)
    joined = np.concatenate([np.unique(sides, axis=0), np.sort(facets, axis=1)])
    _, which = np.unique(joined, axis=0, return_inverse=True)
    first, last = np.split(which.ravel(), [len(joined) - len(facets)])
    return np.isin(last, first)
