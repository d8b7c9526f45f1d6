"""Nodes, elements and sets of a file by the names that it gives them, and the mesh that they
form.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from hhr_dolfinx.errors import FileContentError
from hhr_dolfinx.geometries.by_meshio import Elements, raw_mesh
from hhr_dolfinx.geometries.cells import EDGE_ORDERS, EDGES
from hhr_dolfinx.geometries.raw_mesh import RawMesh

LOW_KINDS = {1: "vertex", 2: "line", 3: "line3"}
PLANE_KINDS = {3: "triangle", 4: "quad", 6: "triangle6", 8: "quad8", 9: "quad9"}
_SOLID = "tetra pyramid wedge hexahedron tetra10 pyramid13 wedge15 hexahedron20 hexahedron27"
SOLID_KINDS = dict(zip((4, 5, 6, 8, 10, 13, 15, 20, 27), _SOLID.split(), strict=True))
"""Meshio's kinds of points and lines, plane elements, and those in space, by their number of
nodes.
"""
COUNTS = {
    kind: count for kinds in (LOW_KINDS, PLANE_KINDS, SOLID_KINDS) for count, kind in kinds.items()
}


@dataclass
class Contents:
    """Contents of a file.

    Attributes:
        points: coordinates by node.
        elements: nodes of each element, by meshio's kind and by element.
        sets: elements of each set, by name or number.
        nodes: nodes of each set of nodes, by name.
        unions: numbers of the sets of elements in each union of such sets, by name.
        left_out: reasons for parts of the file that are not read.
        line: line of the file that is read.
    """

    points: dict[Hashable, list[float]] = field(default_factory=dict)
    elements: dict[str, dict[Hashable, Sequence[Hashable]]] = field(default_factory=dict)
    sets: dict[str | int, list[Hashable]] = field(default_factory=dict)
    nodes: dict[str | int, list[Hashable]] = field(default_factory=dict)
    unions: dict[str, list[int]] = field(default_factory=dict)
    left_out: dict[str | int, str] = field(default_factory=dict)
    line: int = 0

    @contextmanager
    def reading(self, path: Path) -> Iterator[Iterator[str]]:
        """Lines of a file, counted.

        Raises:
            FileContentError: with the line, for errors while the lines are read.
        """
        try:
            text = path.read_text(encoding="utf-8-sig", errors="replace")
            yield (line for self.line, line in enumerate(text.splitlines(), start=1))
        except (ValueError, IndexError, KeyError, OSError) as error:
            reason = f"there is no {error}" if isinstance(error, KeyError) else error
            raise FileContentError(f"{path}, line {self.line}: {reason}") from error

    def add(self, kind: str, element: Hashable, nodes: Sequence[Hashable]) -> None:
        """Add an element.

        Args:
            kind: meshio's kind of the element.
            element: its name or number.
            nodes: its nodes.

        Raises:
            ValueError: if it has another number of nodes than its kind.
        """
        if len(nodes) != COUNTS[kind]:
            raise ValueError(
                f"an element of kind {kind} has {len(nodes)} nodes, and not {COUNTS[kind]}"
            )
        self.elements.setdefault(kind, {})[element] = nodes

    def mesh(self, path: Path) -> RawMesh:
        """The mesh of the contents.

        Raises:
            FileContentError: for an element with a node that is not in the file.
        """
        index = {node: k for k, node in enumerate(self.points)}
        points = np.array(list(self.points.values())).reshape(len(index), -1 if index else 3)
        blocks = []
        for kind, members in self.elements.items():
            lost = {node for nodes in members.values() for node in nodes} - index.keys()
            if lost:
                raise FileContentError(
                    f"{path}: a {kind} names node {min(map(str, lost))}, which is not in the file"
                )
            nodes = np.array([[index[node] for node in row] for row in members.values()])
            row_of = {element: k for k, element in enumerate(members)}
            rows_of = {
                name: {row_of[member] for member in members if member in row_of}
                for name, members in self.sets.items()
            }
            sets = {name: np.array(sorted(rows)) for name, rows in rows_of.items() if rows}
            blocks.append(Elements(kind, _in_order_of_vtk(kind, points, nodes), sets=sets))
        node_sets = {
            str(name): [index[member] for member in members if member in index]
            for name, members in self.nodes.items()
        }
        nodes_of = {name: np.array(rows, dtype=np.int64) for name, rows in node_sets.items()}
        present = {name for block in blocks for name in block.sets} | {
            name for name, rows in node_sets.items() if rows
        }
        named = [*self.sets.items(), *self.nodes.items()]
        reasons = {
            key: f"none of its {len(members)} members is in the file"
            for key, members in named
            if members and key not in present
        }
        return raw_mesh(points, blocks, path, nodes=nodes_of, left_out={**reasons, **self.left_out})


def _in_order_of_vtk(kind: str, points: np.ndarray, nodes: np.ndarray) -> np.ndarray:
    """Nodes of hexahedra of second order as VTK lists them.

    Formats list upright edges before or after the top.

    The order is the one in which the nodes lie closer to the middles of their edges.
    """
    if kind not in ("hexahedron20", "hexahedron27"):
        return nodes
    orders = [EDGES["hexahedron"], EDGE_ORDERS["exodus"]["hexahedron"]]
    middles = [points[nodes[:, np.array(order)]].mean(axis=2) for order in orders]
    listed = orders[
        int(
            np.argmin(
                [
                    np.linalg.norm(points[nodes[:, 8:20]] - middle, axis=2).sum()
                    for middle in middles
                ]
            )
        )
    ]
    columns = [8 + [set(edge) for edge in listed].index(set(edge)) for edge in EDGES["hexahedron"]]
    return nodes[:, [*range(8), *columns, *range(20, nodes.shape[1])]]
