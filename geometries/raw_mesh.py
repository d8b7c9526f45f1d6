"""A mesh in the form of files: nodes, cells of one kind, and named sets that may overlap."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from hhr_dolfinx.compat import topology
from hhr_dolfinx.errors import FileContentError
from hhr_dolfinx.geometries.cells import (
    CORNERS,
    DIMENSION,
    EDGES,
    FACES,
    TENSOR_FACET,
    TENSOR_ORDER,
    outer_faces,
)

FAR_OFF = 0.4
"""Largest distance of an edge's node from the middle over the length of the edge: that of an arc of
140 degrees.
"""


@dataclass(frozen=True)
class RawMesh:
    """Nodes, cells of one kind, and sets of them.

    Attributes:
        points: coordinates, (nodes, 2 or 3).
        kind: kind of the cells: ``triangle``, ``quadrilateral``, ``tetrahedron`` or ``hexahedron``.
        cells: corners, (c, k), in the order of most formats.
        bodies: rows of ``cells`` by name or number.
        surfaces: corners of facets, (f, k), by name or number.
        nodes: sets of nodes by name; their facets are the outer ones whose corners all belong to
            the set.
        sides: nodes on the edges of cells of second order, (c, edges); None at first order.
        left_out: reasons for parts of the file that are not in the mesh, by name or description.
    """

    points: np.ndarray
    kind: str
    cells: np.ndarray
    bodies: Mapping[str | int, np.ndarray]
    surfaces: Mapping[str | int, np.ndarray] = field(default_factory=dict)
    nodes: Mapping[str, np.ndarray] = field(default_factory=dict)
    sides: np.ndarray | None = None
    left_out: Mapping[str | int, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Refuse invalid meshes."""
        if not len(self.cells):
            raise FileContentError(
                "no triangles, quadrilaterals, tetrahedra or hexahedra are in this file"
            )
        named = self.cells if self.sides is None else np.hstack([self.cells, self.sides])
        if named.min() < 0 or named.max() >= len(self.points):
            raise FileContentError(
                f"a cell names node {named.max()}, and there are {len(self.points)}: the file is "
                "damaged"
            )
        if self.cells.shape[1] != CORNERS[self.kind]:
            raise FileContentError(
                f"cells of kind {self.kind} have {self.cells.shape[1]} corners in this file"
            )

    @property
    def dim(self) -> int:
        """Dimension of the cells."""
        return DIMENSION[self.kind]

    def all_surfaces(self) -> dict[str | int, np.ndarray]:
        """Corners of facets by name or number, including those of sets of nodes."""
        surfaces = {name: facets for name, facets in self.surfaces.items() if len(facets)}
        wanted = {name: nodes for name, nodes in self.nodes.items() if name not in surfaces}
        if wanted:
            outer = outer_faces(self.kind, self.cells)
            for name, nodes in wanted.items():
                in_set = np.zeros(len(self.points), dtype=bool)
                in_set[nodes] = True
                if (on_set := in_set[outer].all(axis=1)).any():
                    surfaces[name] = outer[on_set]
        return surfaces

    def once(self) -> RawMesh:
        """The mesh with each cell once.

        Files of gmsh before version 4 have a cell once for each of its groups.
        """
        _, first, which = np.unique(
            np.sort(self.cells, axis=1), axis=0, return_index=True, return_inverse=True
        )
        if first.size == len(self.cells):
            return self
        order = np.argsort(first)
        row_of = np.argsort(order)[which.ravel()]
        bodies = {name: np.unique(row_of[rows]) for name, rows in self.bodies.items()}
        rows_once = first[order]
        sides = None if self.sides is None else self.sides[rows_once]
        return replace(self, cells=self.cells[rows_once], bodies=bodies, sides=sides)

    def compact(self) -> RawMesh:
        """The mesh without nodes that belong to no cell.

        In the plane without a coordinate that is constant.
        """
        used = np.unique(self.cells if self.sides is None else np.hstack([self.cells, self.sides]))
        numbers = np.full(len(self.points), -1)
        numbers[used] = np.arange(used.size)
        points = self.points[used]
        if self.dim == 2 and points.shape[1] == 3:
            flat = np.ptp(points[:, 2]) <= 1e-12 * max(np.ptp(points, axis=0).max(), 1e-300)
            points = points[:, :2] if flat else points
        surfaces = {name: numbers[facets] for name, facets in self.surfaces.items()}
        surfaces = {name: facets[(facets >= 0).all(axis=1)] for name, facets in surfaces.items()}
        nodes = {name: numbers[rows][numbers[rows] >= 0] for name, rows in self.nodes.items()}
        sides = None if self.sides is None else numbers[self.sides]
        cells = numbers[self.cells]
        return replace(
            self, points=points, cells=cells, surfaces=surfaces, nodes=nodes, sides=sides
        )

    def ordered(self) -> np.ndarray:
        """Corners of the cells in the order of DOLFINx."""
        return self.cells[:, TENSOR_ORDER[self.kind]] if self.kind in TENSOR_ORDER else self.cells

    def whole(self) -> tuple[np.ndarray, np.ndarray]:
        """Points, (nodes, dim), and all nodes of the cells in the order of DOLFINx, (c, K)."""
        if self.sides is None:
            return self.points, self.ordered()
        self._check_sides(self.sides)
        corners = self.ordered()
        order = TENSOR_ORDER.get(self.kind, range(corners.shape[1]))
        listed = [frozenset(edge) for edge in EDGES[self.kind]]
        edges, faces = topology(self.kind)
        sides = self.sides[:, [listed.index(frozenset((order[a], order[b]))) for a, b in edges]]
        if self.kind not in TENSOR_ORDER:
            return self.points, np.hstack([corners, sides])
        points = self.points
        cells = np.hstack([corners, sides])
        if self.kind == "hexahedron":
            points, middles = _middles_of_faces(points, corners, sides, edges, faces)
            cells = np.hstack([cells, middles])
        # serendipity functions at the middle of a cell: -1/4 at corners, 1/2 (8 nodes) or 1/4 (20
        # nodes) on edges
        weight = 0.5 if self.kind == "quadrilateral" else 0.25
        middle = weight * points[sides].sum(axis=1) - 0.25 * points[corners].sum(axis=1)
        last = len(points) + np.arange(len(cells))
        return np.concatenate([points, middle]), np.hstack([cells, last[:, None]])

    def _check_sides(self, sides: np.ndarray) -> None:
        """Raise FileContentError for nodes of edges that lie far from the middle of their edge."""
        ends = self.points[self.cells[:, np.array(EDGES[self.kind])]]
        off = np.linalg.norm(self.points[sides] - ends.mean(axis=2), axis=2)
        far = off > FAR_OFF * np.linalg.norm(ends[:, :, 1] - ends[:, :, 0], axis=2)
        if far.any():
            point = self.points[sides[far][0]].tolist()
            raise FileContentError(
                f"{int(far.sum())} nodes on sides of cells of second order lie far from the "
                f"middles of these, e.g. at {point}: the cells are too curved, or their nodes in "
                "an order that is not understood. Write them as .msh or .vtu"
            )


def _middles_of_faces(
    points: np.ndarray,
    corners: np.ndarray,
    sides: np.ndarray,
    edges: list[list[int]],
    faces: list[list[int]],
) -> tuple[np.ndarray, np.ndarray]:
    """Points followed by the middles of the faces of hexahedra, and the numbers of these middles,
    (c, 6).
    """
    on_faces = [[k for k, edge in enumerate(edges) if set(edge) <= set(face)] for face in faces]
    face_corners = np.stack([np.sort(corners[:, face], axis=1) for face in faces], axis=1).reshape(
        -1, 4
    )
    _, first, which = np.unique(face_corners, axis=0, return_index=True, return_inverse=True)
    values = [
        0.5 * points[sides[:, on_face]].sum(axis=1) - 0.25 * points[corners[:, face]].sum(axis=1)
        for face, on_face in zip(faces, on_faces, strict=True)
    ]
    middles = np.stack(values, axis=1).reshape(-1, points.shape[1])[first]
    return np.concatenate([points, middles]), len(points) + which.reshape(len(corners), len(faces))


@dataclass(frozen=True)
class ItemNumbers:
    """A number for each item that is in some set, and the numbers of each set.

    Attributes:
        items: indices of the items, (n,).
        values: number of each item, (n,).
        sets: numbers of each set, by name or number of the set.
    """

    items: np.ndarray
    values: np.ndarray
    sets: dict[str | int, tuple[int, ...]]

    @classmethod
    def of(cls, sets: Mapping[str | int, np.ndarray], count: int) -> ItemNumbers:
        """Number the items of sets: items that are in the same sets share a number.

        Items that are in one set only have its number, if the set has one.

        Args:
            sets: indices of the items of each set, by name or number.
            count: number of all items.
        """
        names = list(sets)
        members_of = np.zeros((count, len(names)), dtype=bool)
        for column, name in enumerate(names):
            members_of[sets[name], column] = True
        items = np.flatnonzero(members_of.any(axis=1))
        patterns, which = np.unique(members_of[items], axis=0, return_inverse=True)
        used = {name for name in names if isinstance(name, int)}
        fresh = iter(n for n in range(1, len(patterns) + len(used) + 1) if n not in used)
        numbers = []
        for pattern in patterns:
            names_of = [names[k] for k in np.flatnonzero(pattern)]
            integers = [name for name in names_of if isinstance(name, int)]
            numbers.append(
                integers[0] if len(integers) == 1 and _same(sets, names_of) else next(fresh)
            )
        number_of = np.array(numbers, dtype=np.int64)
        members = {
            name: tuple(sorted({int(n) for n in number_of[patterns[:, column]]}))
            for column, name in enumerate(names)
        }
        return cls(
            items, number_of[which.ravel()] if items.size else np.zeros(0, dtype=np.int64), members
        )


def _same(sets: Mapping[str | int, np.ndarray], names: Iterable[str | int]) -> bool:
    """True if sets have the same items, as those of a number and its name."""
    first, *remaining = (np.unique(sets[name]) for name in names)
    return all(np.array_equal(first, items_of) for items_of in remaining)


def facets_by_number(raw: RawMesh) -> tuple[np.ndarray, ItemNumbers]:
    """All facets of sets, each once, (f, k) in the order of DOLFINx, and their numbers."""
    surfaces = raw.all_surfaces()
    width = len(FACES[raw.kind][0])
    if not surfaces:
        return np.zeros((0, width), dtype=np.int64), ItemNumbers.of({}, 0)
    all_facets = np.concatenate(list(surfaces.values()))
    _, first, which = np.unique(
        np.sort(all_facets, axis=1), axis=0, return_index=True, return_inverse=True
    )
    ends = np.cumsum([len(facets) for facets in surfaces.values()])
    indices = np.split(which.ravel(), ends[:-1])
    numbers = ItemNumbers.of(dict(zip(surfaces, indices, strict=True)), len(first))
    facets = all_facets[first]
    return (facets[:, TENSOR_FACET] if width == 4 else facets)[numbers.items], numbers
