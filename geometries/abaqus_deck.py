"""Nodes, elements, sets and surfaces of an Abaqus or CalculiX deck (``.inp``).

meshio reads such decks too, but knows no elements of plane strain or of revolution and no surfaces, and keeps the last
one of several blocks of elements that name the same set.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from hhr_dolfinx.errors import FileContentError
from hhr_dolfinx.geometries.cells import CORNERS, DIMENSION, FACES, one_kind, sides_of
from hhr_dolfinx.geometries.raw_mesh import RawMesh

_LINES = ("T2D", "T3D", "B2", "B3", "R2D2", "RAX2", "SAX1", "SAX2")
_PLANE = ("CPE", "CPS", "CAX", "S", "M3D", "R3D")
_NOT_PLANE = ("SPRING", "SC6", "SC8")
_SOLID = ("C3D", "SC8", "F3D")
_NO_CELLS = ("MASS", "SPRING", "DASHPOT", "D", "CONN", "GAP", "ROTARYI", "U", "RB")
"""First letters of types of elements. Lines, and plane ones in space, name facets; gmsh writes surfaces so."""
_COUNTS = {2: {3: "triangle", 6: "triangle", 4: "quadrilateral", 8: "quadrilateral", 9: "quadrilateral"},
           3: {4: "tetrahedron", 10: "tetrahedron", 8: "hexahedron", 20: "hexahedron", 27: "hexahedron", 5: "pyramid",
               6: "prism", 15: "prism"}}  # fmt: skip
"""Kinds of cells by dimension and number of nodes."""


@dataclass
class _Deck:
    """What has been read so far.

    Attributes:
        nodes: coordinates by number.
        elements: kind and corners by number.
        whole: all nodes of each of them.
        node_sets, element_sets: numbers by name in capitals.
        faces: of surfaces by name in capitals: an element or a set, and a face.
        spelling: names as they were first written, by kind of set and name in capitals.
    """

    nodes: dict[int, list[float]] = field(default_factory=dict)
    elements: dict[int, tuple[str, list[int]]] = field(default_factory=dict)
    whole: dict[int, list[int]] = field(default_factory=dict)
    node_sets: dict[str, list[int]] = field(default_factory=dict)
    element_sets: dict[str, list[int]] = field(default_factory=dict)
    faces: dict[str, list[tuple[str, str]]] = field(default_factory=dict)
    spelling: dict[tuple[str, str], str] = field(default_factory=dict)
    parts: set[str] = field(default_factory=set)

    def named(self, kind: str, name: str) -> str:
        """A name in capitals, as Abaqus compares them."""
        self.spelling.setdefault((kind, name.upper()), name)
        return name.upper()


def read_deck(path: Path) -> RawMesh:
    """The mesh of a deck, with its includes; raises FileContentError for what is none."""
    deck = _Deck()
    for line, keyword, options, rows in _blocks(path):
        try:
            _take(deck, keyword, options, rows)
        except (ValueError, IndexError) as error:
            raise FileContentError(f"{path}, block *{keyword} at line {line}: {error}") from None
    return _mesh_of(deck, path)


def _lines(path: Path) -> Iterator[tuple[int, str]]:
    """Lines that say something with their numbers, those of included files in their place; keywords in one line."""
    text = path.read_text(encoding="utf-8-sig", errors="replace")
    kept = [(number, line.strip()) for number, line in enumerate(text.splitlines(), start=1)]
    lines = iter([(number, line) for number, line in kept if line and not line.startswith("**")])
    for number, line in lines:
        while line.startswith("*") and line.endswith(","):
            line += next(lines, (0, "*"))[1]
        found = re.match(r"\*\s*INCLUDE\s*,\s*INPUT\s*=\s*(.*)", line, re.IGNORECASE)
        if found:
            yield from _lines(path.parent / found[1].strip().strip('"'))
        else:
            yield number, line


def _words(line: str) -> list[str]:
    """What commas part, without the quotes of names."""
    return [word.strip().strip('"') for word in re.findall(r'((?:"[^"]*"|[^,"])*)(?:,|$)', line)][: line.count(",") + 1]


def _blocks(path: Path) -> Iterator[tuple[int, str, dict[str, str], list[list[str]]]]:
    """Keyword, options and data lines of each block, and the line it begins at; included files in their place."""
    options: dict[str, str] = {}
    rows: list[list[str]] = []
    keyword = ""
    start = 0
    more = False
    for number, line in _lines(path):
        words = _words(line)
        if not line.startswith("*"):
            if more and rows and keyword == "ELEMENT":
                # a line that ends in a comma goes on in the next one
                rows[-1] = [*rows[-1], *(word for word in words if word)]
            else:
                rows.append([word for word in words if word] if keyword == "ELEMENT" else words)
            more = line.endswith(",")
            continue
        if keyword:
            yield start, keyword, options, rows
        keyword = " ".join(words[0].lstrip("* ").upper().split())
        start = number
        rows = []
        more = False
        pairs = (word.partition("=") for word in words[1:] if word)
        options = {key.strip().upper(): value.strip().strip('"') for key, _, value in pairs}
    if keyword:
        yield start, keyword, options, rows


def _take(deck: _Deck, keyword: str, options: dict[str, str], rows: list[list[str]]) -> None:
    """Add a block to what has been read; others than those of a mesh are passed over."""
    if keyword == "NODE":
        deck.nodes |= {int(row[0]): _place(row[1:4]) for row in rows}
        if "NSET" in options:
            deck.node_sets.setdefault(deck.named("nset", options["NSET"]), []).extend(int(row[0]) for row in rows)
    elif keyword == "ELEMENT":
        _elements(deck, options, rows)
    elif keyword in ("NSET", "ELSET"):
        sets = deck.node_sets if keyword == "NSET" else deck.element_sets
        name = deck.named(keyword.lower(), options[keyword])
        sets.setdefault(name, []).extend(_members(sets, rows, "GENERATE" in options))
    elif keyword == "SURFACE":
        name = deck.named("surface", options["NAME"])
        if options.get("TYPE", "ELEMENT").upper() == "NODE":
            deck.node_sets.setdefault(deck.named("nset", options["NAME"]), []).extend(
                # behind a node or a set there may be its area
                _members(deck.node_sets, [row[:1] for row in rows], False)
            )
        else:
            deck.faces.setdefault(name, []).extend((row[0], row[1].upper() if len(row) > 1 else "") for row in rows)
    elif keyword == "INSTANCE":
        deck.parts.add(options.get("PART", ""))
        if rows or len(deck.parts) > 1:
            raise ValueError("parts and instances that are moved are not understood: write a flat deck, in Abaqus by "
                             "'Do not use parts and assemblies in input files'")  # fmt: skip
    elif keyword == "SYSTEM" and rows:
        raise ValueError("nodes in a coordinate system of their own (*SYSTEM) are not understood")


def _place(words: list[str]) -> list[float]:
    """Three coordinates of a node: what is left out or blank is zero, and Fortran writes 1.0D+00."""
    return [float(word.upper().replace("D", "E")) if word else 0.0 for word in (*words, "", "", "")[:3]]


def _elements(deck: _Deck, options: dict[str, str], rows: list[list[str]]) -> None:
    """Add a block of elements; masses, springs and the like have no cells."""
    name = options["TYPE"].upper()
    if name.startswith(_LINES):
        kinds = {2: "line", 3: "line"}
    elif name.startswith(_PLANE) and not name.startswith(_NOT_PLANE):
        kinds = _COUNTS[2]
    elif name.startswith(_SOLID):
        kinds = _COUNTS[3]
    elif name.startswith(_NO_CELLS):
        return
    else:
        raise ValueError(f"elements of type {name} are not understood")
    for row in rows:
        number, *nodes = (int(word) for word in row)
        if len(nodes) not in kinds:
            raise ValueError(f"element {number} of type {name} has {len(nodes)} nodes, which is not understood")
        kind = kinds[len(nodes)]
        # the second of three nodes on a line is that in the middle
        deck.elements[number] = kind, nodes[:: len(nodes) - 1] if kind == "line" else nodes[: CORNERS.get(kind)]
        deck.whole[number] = nodes
    if "ELSET" in options:
        members = deck.element_sets.setdefault(deck.named("elset", options["ELSET"]), [])
        members.extend(int(row[0]) for row in rows)


def _members(sets: dict[str, list[int]], rows: list[list[str]], ranges: bool) -> list[int]:
    """Numbers of a set: one by one, as ranges, or those of other sets."""
    found: list[int] = []
    for row in rows:
        words = [word for word in row if word]
        if ranges:
            first, last, step = (*(int(word) for word in words), 1)[:3]
            found.extend(range(first, last + 1, step))
            continue
        for word in words:
            if word.lstrip("+-").isdigit():
                found.append(int(word))
            elif word.upper() in sets:
                found.extend(sets[word.upper()])
            else:
                raise ValueError(f"there is no set '{word}' before it")
    return found


def _mesh_of(deck: _Deck, path: Path) -> RawMesh:
    """Arrays of a deck: cells of the highest dimension, and sets of them."""
    dimensions = {DIMENSION.get(kind, 3) for kind, _ in deck.elements.values() if kind != "line"}
    if not dimensions:
        raise FileContentError(f"{path} has no elements of the plane or of space")
    cells = {
        number: item
        for number, item in deck.elements.items()
        if item[0] != "line" and DIMENSION.get(item[0], 3) == max(dimensions)
    }
    kind = one_kind((kind for kind, _ in cells.values()), path)
    lost = next((number for number in cells if not deck.nodes.keys() >= set(deck.whole[number])), None)
    if lost is not None:
        raise FileContentError(f"{path}: element {lost} has a node that is not in the deck")
    node_of = {number: k for k, number in enumerate(deck.nodes)}
    row_of = {number: k for k, number in enumerate(cells)}
    bodies = {deck.spelling["elset", name]: np.array([row_of[n] for n in numbers if n in row_of], dtype=np.int64)
              for name, numbers in deck.element_sets.items()}  # fmt: skip
    array = np.array([[node_of[n] for n in nodes] for _, nodes in cells.values()], dtype=np.int64)
    blocks = {len(deck.whole[number]) for number in cells}
    whole = [
        np.array([[node_of[n] for n in deck.whole[k]] for k in cells if len(deck.whole[k]) == count])
        for count in blocks
    ]
    sides = sides_of(kind, whole, path)
    surfaces = _facet_sets(deck, max(dimensions), node_of, len(FACES[kind][0]))
    for name, faces in deck.faces.items():
        spelt = deck.spelling["surface", name]
        surfaces[spelt] = _faces(deck, faces, kind, array, row_of, spelt)
    nodes = {deck.spelling["nset", name]: np.array([node_of[n] for n in numbers if n in node_of], dtype=np.int64)
             for name, numbers in deck.node_sets.items()}  # fmt: skip
    bodies = {name: rows for name, rows in bodies.items() if rows.size} or {"all": np.arange(len(array))}
    return RawMesh(np.array(list(deck.nodes.values())), kind, array, bodies, surfaces, nodes, sides)


def _facet_sets(deck: _Deck, dim: int, node_of: dict[int, int], width: int) -> dict[str | int, np.ndarray]:
    """Corners of facets of sets of elements that are facets themselves, (f, width), by name."""
    found: dict[str | int, np.ndarray] = {}
    for name, numbers in deck.element_sets.items():
        there = [deck.elements[n] for n in numbers if n in deck.elements]
        own = [nodes for kind, nodes in there if DIMENSION.get(kind, 1) == dim - 1 and len(nodes) == width]
        if own and all(n in node_of for nodes in own for n in nodes):
            found[deck.spelling["elset", name]] = np.array([[node_of[n] for n in nodes] for nodes in own])
    return found


def _faces(
    deck: _Deck, faces: list[tuple[str, str]], kind: str, cells: np.ndarray, row_of: dict[int, int], name: str
) -> np.ndarray:
    """Corners of the faces of a surface, (f, k)."""
    corners = np.array(FACES[kind])
    found = []
    for given, face in faces:
        numbers = [int(given)] if given.isdigit() else deck.element_sets.get(given.upper(), [])
        rows = [row_of[n] for n in numbers if n in row_of]
        number = int(face[1:]) if face[1:].isdigit() else 0
        if not rows or not face.startswith("S") or not 1 <= number <= len(corners):
            raise FileContentError(f"surface '{name}': '{given}, {face}' is no face of cells that are there")
        found.append(cells[rows][:, corners[number - 1]])
    return np.concatenate(found) if found else np.zeros((0, corners.shape[1]), dtype=np.int64)
