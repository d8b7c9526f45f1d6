"""Faces of elements with the nodes on their edges, and forces of tractions on them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain

import numpy as np

from hhr_dolfinx.geometries.cells import EDGES

CORNER_FACES = {
    4: ((0, 1, 2), (0, 1, 3), (1, 2, 3), (2, 0, 3)),
    5: ((0, 1, 2, 3), (0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4)),
    6: ((0, 1, 2), (3, 4, 5), (0, 1, 4, 3), (1, 2, 5, 4), (2, 0, 3, 5)),
    8: ((0, 1, 2, 3), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)),
}
"""Corners of the faces S1, S2, ... of solids by their number of corners, in the order of Abaqus and
CalculiX.
"""
EDGES_BY_CORNERS = {
    4: EDGES["tetrahedron"],
    6: ((0, 1), (1, 2), (2, 0), (3, 4), (4, 5), (5, 3), (0, 3), (1, 4), (2, 5)),
    8: EDGES["hexahedron"],
}
"""Corners of the edges, in the order of the nodes on them."""
CORNERS_BY_NODES = {4: 4, 10: 4, 5: 5, 6: 6, 15: 6, 8: 8, 20: 8}
"""Number of corners of a solid by its number of nodes."""
PARTS = {
    3: ((0, 1, 2),),
    4: ((0, 1, 2), (0, 2, 3)),
    6: ((0, 3, 5), (3, 1, 4), (5, 4, 2), (3, 4, 5)),
    8: ((0, 4, 7), (4, 1, 5), (5, 2, 6), (6, 3, 7), (4, 5, 6), (4, 6, 7)),
}
"""Flat triangles of a face by its number of nodes, corners first, then the middles of its edges in
turn.
"""


@dataclass(frozen=True, eq=False)
class Faces:
    """Faces of elements, in groups of one number of nodes.

    Attributes:
        nodes: indices of the nodes of the faces of each group, (f, k) each, k = 3, 4, 6 or 8.
        inner: an inner point of each face, on the side of the body, (f, 3) each.
    """

    nodes: tuple[np.ndarray, ...]
    inner: tuple[np.ndarray, ...]

    @classmethod
    def of(cls, rows: Sequence[Sequence[int]], inner: Sequence[np.ndarray]) -> Faces:
        """Faces from the nodes and an inner point of each.

        Args:
            rows: nodes of each face.
            inner: inner point of each face, (3,).
        """
        counts = sorted({len(row) for row in rows})
        indices_by_count = [
            [k for k, row in enumerate(rows) if len(row) == count] for count in counts
        ]
        nodes = tuple(
            np.array([rows[k] for k in indices], dtype=np.int64) for indices in indices_by_count
        )
        return cls(
            nodes, tuple(np.array([inner[k] for k in indices]) for indices in indices_by_count)
        )

    @property
    def members(self) -> np.ndarray:
        """Indices of all nodes, each once, (n,)."""
        return np.unique(np.concatenate([group.ravel() for group in self.nodes]))

    def shifted(self, first: int) -> Faces:
        """The same faces where nodes count from another number."""
        return Faces(tuple(group + first for group in self.nodes), self.inner)

    def flat(self) -> tuple[np.ndarray, np.ndarray]:
        """Flat facets, (f, 3) or (f, 4), and an inner point of each, (f, 3).

        Faces are quadrilaterals if all of them are, otherwise triangles between all nodes.
        """
        if len(self.nodes) == 1 and self.nodes[0].shape[1] == 4:
            return self.nodes[0], self.inner[0]
        facets = [
            group[:, list(corners)] for group in self.nodes for corners in PARTS[group.shape[1]]
        ]
        inner = [
            inner_points
            for group, inner_points in zip(self.nodes, self.inner, strict=True)
            for _ in PARTS[group.shape[1]]
        ]
        return np.concatenate(facets), np.concatenate(inner)

    def triangles(self) -> np.ndarray:
        """Triangles of all faces, (t, 3)."""
        return np.concatenate(
            [group[:, list(corners)] for group in self.nodes for corners in PARTS[group.shape[1]]]
        )

    def forces(self, points: np.ndarray, traction: np.ndarray | None) -> np.ndarray:
        """Consistent nodal forces of a traction, (3,), or with None of a unit pressure: (nodes, 3).

        Args:
            points: coordinates of all nodes, (nodes, 3).
            traction: force per area.
        """
        forces = np.zeros(points.shape)
        for group, inner_points in zip(self.nodes, self.inner, strict=True):
            for weights, values, slopes in _rule(group.shape[1]):
                corners = points[group]
                along = np.einsum("ka,fkd->fad", slopes, corners)
                normal = np.cross(along[:, 0], along[:, 1])
                if traction is None:
                    outward = np.sign(
                        np.einsum("fd,fd->f", normal, corners.mean(axis=1) - inner_points)
                    )
                    pull = -normal * outward[:, None]
                else:
                    pull = np.linalg.norm(normal, axis=1)[:, None] * traction
                np.add.at(
                    forces,
                    group.ravel(),
                    np.einsum("k,fd->fkd", weights * values, pull).reshape(-1, 3),
                )
        return forces


def solid_faces(element: Sequence[int]) -> list[list[int]]:
    """Nodes of all faces of a solid, corners first, then the middles of its edges in turn.

    Args:
        element: nodes in the order of decks, 4, 5, 6, 8, 10, 15 or 20.
    """
    count = CORNERS_BY_NODES[len(element)]
    middles = {}
    if len(element) > count:
        middles = {
            frozenset(edge): element[count + k] for k, edge in enumerate(EDGES_BY_CORNERS[count])
        }
    faces = []
    for face in CORNER_FACES[count]:
        edges = [frozenset((face[k], face[(k + 1) % len(face)])) for k in range(len(face))]
        faces.append([element[k] for k in face] + [middles[edge] for edge in edges if middles])
    return faces


def outer_faces(elements: Sequence[Sequence[int]], points: np.ndarray) -> Faces:
    """Faces that belong to one solid only.

    Args:
        elements: indices of the nodes of each solid.
        points: coordinates, (nodes, 3).
    """
    owners: dict[frozenset[int], list[tuple[list[int], int]]] = {}
    for number, element in enumerate(elements):
        for face in solid_faces(element):
            owners.setdefault(frozenset(face), []).append((face, number))
    single = [sharing[0] for sharing in owners.values() if len(sharing) == 1]
    middles = [
        points[list(elements[number][: CORNERS_BY_NODES[len(elements[number])]])].mean(axis=0)
        for _, number in single
    ]
    return Faces.of([face for face, _ in single], middles)


def joined_faces(parts: Sequence[Faces]) -> Faces:
    """All faces of several groups."""
    rows = list(chain.from_iterable(group.tolist() for faces in parts for group in faces.nodes))
    return Faces.of(rows, [point for faces in parts for group in faces.inner for point in group])


def _rule(count: int) -> list[tuple[float, np.ndarray, np.ndarray]]:
    """Gauss points of a face: weight, shape functions (k,), and their derivatives (k, 2)."""
    if count in (3, 6):
        positions = [(1 / 6, 1 / 6), (2 / 3, 1 / 6), (1 / 6, 2 / 3)]
        return [(1 / 6, *_triangle(count, *position)) for position in positions]
    line = [(-(0.6**0.5), 5 / 9), (0.0, 8 / 9), (0.6**0.5, 5 / 9)]
    return [(a * b, *_quadrilateral(count, x, y)) for x, a in line for y, b in line]


def _triangle(count: int, x: float, y: float) -> tuple[np.ndarray, np.ndarray]:
    """Shape functions of a triangle of 3 or 6 nodes, and their derivatives."""
    corners = np.array([1 - x - y, x, y])
    slopes = np.array([[-1.0, -1.0], [1.0, 0.0], [0.0, 1.0]])
    if count == 3:
        return corners, slopes
    pairs = ((0, 1), (1, 2), (2, 0))
    values = [*(corners * (2 * corners - 1)), *(4 * corners[i] * corners[j] for i, j in pairs)]
    derivatives = [
        *((4 * corners - 1)[:, None] * slopes),
        *(4 * (corners[i] * slopes[j] + corners[j] * slopes[i]) for i, j in pairs),
    ]
    return np.array(values), np.array(derivatives)


def _quadrilateral(count: int, x: float, y: float) -> tuple[np.ndarray, np.ndarray]:
    """Shape functions of a quadrilateral of 4 or 8 nodes, and their derivatives."""
    ends = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)], dtype=float)
    a = 1 + ends[:, 0] * x
    b = 1 + ends[:, 1] * y
    if count == 4:
        return a * b / 4, np.column_stack([ends[:, 0] * b, ends[:, 1] * a]) / 4
    c = ends[:, 0] * x + ends[:, 1] * y - 1
    values = a * b * c / 4
    first = ends[:, 0] * b * (c + a) / 4
    second = ends[:, 1] * a * (c + b) / 4
    middles = (
        np.array(
            [
                (1 - x * x) * (1 - y),
                (1 + x) * (1 - y * y),
                (1 - x * x) * (1 + y),
                (1 - x) * (1 - y * y),
            ]
        )
        / 2
    )
    along = [
        (-2 * x * (1 - y), -(1 - x * x)),
        (1 - y * y, -2 * y * (1 + x)),
        (-2 * x * (1 + y), 1 - x * x),
        (-(1 - y * y), -2 * y * (1 - x)),
    ]
    corners = np.column_stack([first, second])
    return np.concatenate([values, middles]), np.vstack([corners, np.array(along) / 2])
