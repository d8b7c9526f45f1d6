"""Small decks of CalculiX: boxes of cells, also bent into rings or arcs, with sets, surfaces and
other blocks.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

Where = Callable[[np.ndarray], np.ndarray]
"""True for the points of a box, (n, 3), that are meant, before the box is bent."""
Bend = Callable[[np.ndarray], np.ndarray]

_CORNERS = {"quad": 4, "tri": 3, "hex": 8, "tet": 4, "wedge": 6}
_EDGES = {
    "quad": "01 12 23 30",
    "tri": "01 12 20",
    "hex": "01 12 23 30 45 56 67 74 04 15 26 37",
    "tet": "01 12 20 03 13 23",
    "wedge": "01 12 20 34 45 53 03 14 25",
}
_FACES = {
    "quad": "01 12 23 30",
    "tri": "01 12 20",
    "hex": "0123 4567 0154 1265 2376 3047",
    "tet": "012 013 123 203",
    "wedge": "012 345 0143 1254 2035",
}
_PARTS = {  # corners of a square or a cube in those of the pieces that it is cut into
    "quad": "0123",
    "tri": "012 023",
    "hex": "01234567",
    "tet": "0126 0236 0376 0746 0456 0516",
    "wedge": "012456 023467",
}


def shape_of(kind: str) -> tuple[str, bool]:
    """Shape of an element by its name, and whether it is of second order."""
    digits = int("".join(letter for letter in kind[3:] if letter.isdigit()))
    plane = kind[:3] in ("CPE", "CPS", "CAX")
    shapes = {3: "tri", 6: "tri", 4: "quad", 8: "quad"} if plane else {}
    shapes = shapes or {4: "tet", 10: "tet", 8: "hex", 20: "hex", 6: "wedge", 15: "wedge"}
    return shapes[digits], digits > _CORNERS[shapes[digits]]


def at(axis: int, value: float) -> Where:
    """Points with a coordinate."""
    return lambda points: np.abs(points[:, axis] - value) < 1e-9


def both(*conditions: Where) -> Where:
    """Points that meet all conditions."""
    return lambda points: np.all([one(points) for one in conditions], axis=0)


@dataclass(frozen=True)
class Box:
    """Nodes, (n,) numbers at points, (n, 3), before they are bent, and cells, (c, k) places among
    them.
    """

    shape: str
    first: int
    numbers: np.ndarray
    points: np.ndarray
    cells: np.ndarray

    def nodes(self, where: Where) -> list[int]:
        """Numbers of nodes."""
        return self.numbers[where(self.points)].tolist()

    def faces(self, where: Where) -> list[tuple[int, int]]:
        """Faces all of whose corners are meant: numbers of the element and of its face."""
        meant = where(self.points)
        faces = [[int(digit) for digit in face] for face in _FACES[self.shape].split()]
        return [
            (self.first + row, number)
            for row, cell in enumerate(self.cells)
            for number, face in enumerate(faces, 1)
            if meant[cell[face]].all()
        ]


class Writer:
    """Text of a deck that grows; numbers go on from box to box."""

    def __init__(self) -> None:
        """An empty deck."""
        self.text = ""
        self.nodes = self.elements = 0

    def add(self, text: str) -> None:
        """Blocks as they are written, lines apart by ``/``."""
        self.text += "".join(f"{line.strip()}\n" for line in text.split("/"))

    def node(self, *place: float) -> int:
        """One more node."""
        self.nodes += 1
        self.add(f"*NODE, NSET=NALL/{self.nodes}, {', '.join(map(repr, place))}")
        return self.nodes

    def box(
        self,
        elset: str,
        kind: str,
        counts: Sequence[int],
        lower: Sequence[float],
        upper: Sequence[float],
        bend: Bend | None = None,
        comma: str = "",
        shared: bool = True,
    ) -> Box:
        """Cells of a kind, counts along each axis, in the set of elements ``elset``.

        Commas end lines of elements. Nodes in the middle of edges are shared by cells, or each cell
        has its own.
        """
        shape, second = shape_of(kind)
        dim = len(counts)
        axes = [np.linspace(a, b, n + 1) for a, b, n in zip(lower, upper, counts, strict=True)]
        grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, dim)
        places = np.arange(len(grid)).reshape([n + 1 for n in counts])
        steps = [(0, 0), (1, 0), (1, 1), (0, 1)]
        steps = steps if dim == 2 else [(*one, z) for z in (0, 1) for one in steps]
        corner = [
            places[tuple(slice(s, s + n) for s, n in zip(step, counts, strict=True))].ravel()
            for step in steps
        ]
        parts = [[int(digit) for digit in part] for part in _PARTS[shape].split()]
        whole = np.stack(corner, axis=1)
        cells = np.stack([whole[:, part] for part in parts], axis=1).reshape(-1, len(parts[0]))
        if second:
            ends = np.array([[int(digit) for digit in edge] for edge in _EDGES[shape].split()])
            edges = np.sort(cells[:, ends], axis=2).reshape(-1, 2)
            back = np.arange(len(edges))
            if shared:
                edges, back = np.unique(edges, axis=0, return_inverse=True)
            cells = np.hstack([cells, len(grid) + back.reshape(len(cells), -1)])
            grid = np.vstack([grid, grid[edges].mean(axis=1)])
        points = np.hstack([grid, np.zeros((len(grid), 3 - dim))])
        numbers = self.nodes + 1 + np.arange(len(points))
        bent = points if bend is None else bend(points)
        self.text += "*NODE, NSET=NALL\n"
        self.text += "".join(
            f"{n}, {x:.12g}, {y:.12g}, {z:.12g}\n"
            for n, (x, y, z) in zip(numbers, bent, strict=True)
        )
        self.text += f"*ELEMENT, TYPE={kind}, ELSET={elset}\n"
        for row, cell in enumerate(numbers[cells], self.elements + 1):
            words = [str(row), *map(str, cell)]
            lines = [", ".join(words[start : start + 11]) for start in range(0, len(words), 11)]
            self.text += ",\n".join(lines) + f"{comma}\n"
        made = Box(shape, self.elements + 1, numbers, points, cells)
        self.nodes, self.elements = self.nodes + len(points), self.elements + len(cells)
        return made

    def nset(self, name: str, nodes: Iterable[int]) -> None:
        """A set of nodes."""
        self.add(f"*NSET, NSET={name}/" + "/".join(f"{node}," for node in nodes))

    def surface(self, name: str, faces: Iterable[tuple[int, int]]) -> None:
        """A surface of faces."""
        self.add(f"*SURFACE, NAME={name}/" + "/".join(f"{cell}, S{face}" for cell, face in faces))

    def nodal_surface(self, name: str, nodes: Iterable[int]) -> None:
        """A surface of nodes, which are a set too."""
        self.nset(f"N{name}", nodes)
        self.add(f"*SURFACE, NAME={name}, TYPE=NODE/N{name}")

    def material(
        self, young: float = 210000.0, poisson: float = 0.3, name: str = "EL", more: str = ""
    ) -> None:
        """An elastic material, and blocks that follow it."""
        self.add(
            f"*MATERIAL, NAME={name}/*ELASTIC/{young}, {poisson}" + (f"/{more}" if more else "")
        )

    def section(self, elset: str = "EALL", material: str = "EL", more: str = "") -> None:
        """The material of a set of elements."""
        self.add(
            f"*SOLID SECTION, ELSET={elset}, MATERIAL={material}" + (f"/{more}" if more else "")
        )

    def pair(
        self, slave: str, master: str, law: str, kind: str = "SURFACE TO SURFACE", more: str = ""
    ) -> None:
        """A contact pair with its interaction: ``law`` are the words after
        PRESSURE-OVERCLOSURE=.
        """
        self.add(
            f"*CONTACT PAIR, INTERACTION=SI1, TYPE={kind}/{slave}, {master}/*SURFACE INTERACTION, "
            "NAME=SI1"
        )
        self.add(f"*SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE={law}" + (f"/{more}" if more else ""))
