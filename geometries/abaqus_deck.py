"""Nodes, elements, sets and surfaces of an Abaqus or CalculiX deck (``.inp``).

meshio reads such decks too, but without surfaces and without plane-strain and axisymmetric elements; of several blocks
of elements with the same set it keeps the last one.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from hhr_dolfinx.errors import FileContentError
from hhr_dolfinx.geometries.cells import (
    CORNERS,
    DIMENSION,
    FACES,
    are_sides,
    one_kind,
    outer_faces_of_cells,
    sides_of,
)
from hhr_dolfinx.geometries.raw_mesh import RawMesh

_LINES = ("T2D", "T3D", "B2", "B3", "R2D2", "RAX2", "SAX1", "SAX2")
_PLANE = ("CPE", "CPS", "CAX", "S", "M3D", "R3D")
_NOT_PLANE = ("SPRING", "SC6", "SC8")
_SOLID = ("C3D", "SC8", "F3D")
"""First letters of types of elements. Line elements, and plane ones in space, stand for facets, as gmsh writes them."""
_COUNTED = re.compile(r"(?:AC|DC|GK|COH|[CFMRT])[23]D(\d+)|(?:C?GAX|C?CAX|CPE|CPS|SC?)(\d+)")
"""Types whose name has the number of nodes, such as C3D8R."""
_COUNTS = {2: {3: "triangle", 6: "triangle", 4: "quadrilateral", 8: "quadrilateral", 9: "quadrilateral"},
           3: {4: "tetrahedron", 10: "tetrahedron", 8: "hexahedron", 20: "hexahedron", 27: "hexahedron", 5: "pyramid",
               6: "prism", 15: "prism"}}  # fmt: skip
"""Kinds of cells by dimension and number of nodes."""


@dataclass
class _Deck:
    """Contents of a deck, filled block by block.

    Attributes:
        nodes: coordinates by number.
        elements: kind and corners by number.
        whole: all nodes of each element by number.
        types: types of all elements as written, by number, unsupported ones too.
        node_sets, element_sets: numbers by name in capitals.
        faces: faces of surfaces by name in capitals: an element or a set, and a face.
        unions: names of the parts of surfaces that are unions, by name in capitals.
        left_out: reasons for unsupported surfaces, by name.
        spelling: names as first written, by kind of set and name in capitals.
    """

    nodes: dict[int, list[float]] = field(default_factory=dict)
    elements: dict[int, tuple[str, list[int]]] = field(default_factory=dict)
    whole: dict[int, list[int]] = field(default_factory=dict)
    types: dict[int, str] = field(default_factory=dict)
    node_sets: dict[str, list[int]] = field(default_factory=dict)
    element_sets: dict[str, list[int]] = field(default_factory=dict)
    faces: dict[str, list[tuple[str, str]]] = field(default_factory=dict)
    unions: dict[str, list[str]] = field(default_factory=dict)
    left_out: dict[str | int, str] = field(default_factory=dict)
    spelling: dict[tuple[str, str], str] = field(default_factory=dict)
    parts: set[str] = field(default_factory=set)

    def named(self, kind: str, name: str) -> str:
        """A name in capitals, as Abaqus compares them."""
        self.spelling.setdefault((kind, name.upper()), name)
        return name.upper()


def read_deck(path: Path) -> RawMesh:
    """Read the mesh of a deck with its includes; other parts are left out with the reason.

    Raises:
        FileContentError: for a deck without a mesh, or a damaged one.
    """
    deck = _Deck()
    for line, keyword, options, rows in blocks(path):
        try:
            _take(deck, keyword, options, rows)
            _name_loaded(deck, f"{keyword}:{line}", rows)
        except (ValueError, IndexError) as error:
            raise FileContentError(f"{path}, block *{keyword} at line {line}: {error}") from None
    return _mesh_of(deck, path)


def _lines(path: Path) -> Iterator[tuple[int, str]]:
    """Lines without blanks and comments, with their numbers. Included files are inserted, keyword lines are joined."""
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
    """Words of a line between commas, without the quotes of names."""
    return [word.strip().strip('"') for word in re.findall(r'((?:"[^"]*"|[^,"])*)(?:,|$)', line)][: line.count(",") + 1]


def blocks(path: Path) -> Iterator[tuple[int, str, dict[str, str], list[list[str]]]]:
    """First line number, keyword, options and data lines of each block, with included files inserted."""
    options: dict[str, str] = {}
    rows: list[list[str]] = []
    keyword = ""
    start = 0
    more = False
    nodes: float = np.inf
    for number, line in _lines(path):
        words = _words(line)
        if not line.startswith("*"):
            if more and rows and keyword == "ELEMENT" and len(rows[-1]) - 1 < nodes:
                # a line that ends in a comma continues in the next one, unless the element has all its nodes
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
        counted = _COUNTED.match(options.get("TYPE", "").upper())
        nodes = int(counted[1] or counted[2]) if counted else np.inf
    if keyword:
        yield start, keyword, options, rows


def _take(deck: _Deck, keyword: str, options: dict[str, str], rows: list[list[str]]) -> None:
    """Add a block to a deck; blocks that are not part of a mesh are skipped."""
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
        _surface(deck, options, rows)
    elif keyword == "INSTANCE":
        deck.parts.add(options.get("PART", ""))
        said = "parts and instances that are moved" if rows else "several parts, each with nodes 1, 2, ... of its own,"
        if rows or len(deck.parts) > 1:
            raise ValueError(f"{said} are not understood: write a flat deck, in Abaqus by "
                             "'Do not use parts and assemblies in input files'")  # fmt: skip
    elif keyword == "SYSTEM" and rows:
        raise ValueError("nodes in a coordinate system of their own (*SYSTEM) are not understood")


def _name_loaded(deck: _Deck, block: str, rows: list[list[str]]) -> None:
    """Name the nodes and faces that supports and loads give by numbers, so that a scene can have the same ones."""
    for row in rows:
        if block.startswith("DLOAD:") and re.fullmatch(r"[Pp]\d", row[1] if len(row) > 1 else ""):
            name = deck.named("surface", name_of_loaded(block, row))
            deck.faces.setdefault(name, []).append((row[0], f"S{row[1][1]}"))
        elif block.startswith(("BOUNDARY:", "CLOAD:")) and row[0].isdigit():
            deck.node_sets.setdefault(deck.named("nset", name_of_loaded(block, row)), []).append(int(row[0]))


def name_of_loaded(block: str, row: list[str]) -> str:
    """Name of the nodes or faces of a row: of those in the same block, ``CLOAD:45``, under the same load."""
    return " ".join([block, *(word for word in row[1:] if word)])


def _place(words: list[str]) -> list[float]:
    """Three coordinates of a node; missing or blank ones are zero, and 1.0D+00 of Fortran is accepted."""
    return [float(word.upper().replace("D", "E")) if word else 0.0 for word in (*words, "", "", "")[:3]]


def _surface(deck: _Deck, options: dict[str, str], rows: list[list[str]]) -> None:
    """Add a surface of faces or nodes, or a union of surfaces; other types are left out."""
    name = deck.named("surface", options["NAME"])
    kind = options.get("TYPE", "ELEMENT").upper()
    combined = options.get("COMBINE", "UNION").upper()
    if kind == "NODE":
        deck.node_sets.setdefault(deck.named("nset", options["NAME"]), []).extend(
            # a node or a set may be followed by its area
            _members(deck.node_sets, [row[:1] for row in rows], False)
        )
    elif kind != "ELEMENT" or combined != "UNION":
        what = f"TYPE={kind}" if kind != "ELEMENT" else f"COMBINE={combined}"
        deck.left_out[options["NAME"]] = f"surfaces of {what} are not read"
    elif "COMBINE" in options:
        deck.unions[name] = [word.upper() for row in rows for word in row if word]
    else:
        deck.faces.setdefault(name, []).extend((row[0], row[1].upper() if len(row) > 1 else "") for row in rows)


def _elements(deck: _Deck, options: dict[str, str], rows: list[list[str]]) -> None:
    """Add a block of elements; elements that are not cells, lines or facets keep only types and sets."""
    name = options["TYPE"].upper()
    kinds: dict[int, str] = {}
    if name.startswith(_LINES):
        kinds = {2: "line", 3: "line"}
    elif name.startswith(_PLANE) and not name.startswith(_NOT_PLANE):
        kinds = _COUNTS[2]
    elif name.startswith(_SOLID):
        kinds = _COUNTS[3]
    if not kinds:
        # continuation lines may look like elements; the set then only gets more numbers
        rows = [row for row in rows if row and row[0].isdigit()]
    for row in rows:
        number, *nodes = (int(word) for word in row) if kinds else (int(row[0]),)
        deck.types[number] = name
        if not kinds:
            continue
        if len(nodes) not in kinds:
            raise ValueError(f"element {number} of type {name} has {len(nodes)} nodes, which is not understood")
        kind = kinds[len(nodes)]
        # the second of three nodes on a line is the middle one
        deck.elements[number] = kind, nodes[:: len(nodes) - 1] if kind == "line" else nodes[: CORNERS.get(kind)]
        deck.whole[number] = nodes
    if "ELSET" in options:
        members = deck.element_sets.setdefault(deck.named("elset", options["ELSET"]), [])
        members.extend(int(row[0]) for row in rows)


def _members(sets: dict[str, list[int]], rows: list[list[str]], ranges: bool) -> list[int]:
    """Numbers of a set, given one by one, as ranges, or as names of other sets."""
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
    """Make the mesh of a deck: cells of the highest dimension, and sets of them."""
    dimensions = {DIMENSION.get(kind, 3) for kind, _ in deck.elements.values() if kind != "line"}
    if not dimensions:
        types = sorted(set(deck.types.values()))
        raise FileContentError(
            f"{path} has no elements of the plane or of space"
            + (f" that are understood: {', '.join(types)}" if types else "")
        )
    solid = {
        number: item
        for number, item in deck.elements.items()
        if item[0] != "line" and DIMENSION.get(item[0], 3) == max(dimensions)
    }
    blocks: dict[tuple[str, int], list[list[int]]] = {}
    for number, (of, _) in solid.items():
        blocks.setdefault((of, len(deck.whole[number])), []).append(deck.whole[number])
    kind, left_out = one_kind(((of, np.array(rows)) for (of, _), rows in blocks.items()), path)
    cells = {number: nodes for number, (own, nodes) in solid.items() if own == kind}
    lost = next((number for number in cells if not deck.nodes.keys() >= set(deck.whole[number])), None)
    if lost is not None:
        raise FileContentError(f"{path}: element {lost} has a node that is not in the deck")
    node_of = {number: k for k, number in enumerate(deck.nodes)}
    row_of = {number: k for k, number in enumerate(cells)}
    array = np.array([[node_of[n] for n in nodes] for nodes in cells.values()], dtype=np.int64)
    bodies = {deck.spelling["elset", name]: np.array([row_of[n] for n in numbers if n in row_of], dtype=np.int64)
              for name, numbers in deck.element_sets.items()}  # fmt: skip
    counts = {len(deck.whole[number]) for number in cells}
    whole = [
        np.array([[node_of[n] for n in deck.whole[k]] for k in cells if len(deck.whole[k]) == count])
        for count in counts
    ]
    sides = sides_of(kind, whole, path)
    facets = _facets(deck, kind, array, node_of)
    surfaces, reasons = _surfaces(deck, kind, array, row_of, facets)
    nodes = {deck.spelling["nset", name]: np.array([node_of[n] for n in numbers if n in node_of], dtype=np.int64)
             for name, numbers in deck.node_sets.items()}  # fmt: skip
    bodies = {name: rows for name, rows in bodies.items() if rows.size} or {"all": np.arange(len(array))}
    left_out |= deck.left_out | _idle_elements(deck, cells.keys() | facets.keys()) | reasons
    return RawMesh(np.array(list(deck.nodes.values())), kind, array, bodies, surfaces, nodes, sides, left_out)


def _facets(deck: _Deck, kind: str, cells: np.ndarray, node_of: dict[int, int]) -> dict[int, np.ndarray]:
    """Corners of the elements that are sides of cells, by number: shells on a solid, lines around a plane body."""
    width = len(FACES[kind][0])
    own = {
        number: np.array([node_of[n] for n in nodes])
        for number, (of, nodes) in deck.elements.items()
        if DIMENSION.get(of, 1) == DIMENSION[kind] - 1 and len(nodes) == width and all(n in node_of for n in nodes)
    }
    if not own:
        return {}
    inside = are_sides(kind, cells, np.array(list(own.values())))
    return {number: corners for (number, corners), kept in zip(own.items(), inside, strict=True) if kept}


def _idle_elements(deck: _Deck, used: set[int]) -> dict[str | int, str]:
    """Elements that are neither cells nor sides of cells, by set, or by type if they are in none."""
    idle: dict[str, set[int]] = {}
    for number, name in deck.types.items():
        if number not in used:
            idle.setdefault(name, set()).add(number)
    found: dict[str | int, str] = {}
    for name, numbers in idle.items():
        what = f"{len(numbers)} element{'' if len(numbers) == 1 else 's'} of type {name}"
        sets = [deck.spelling["elset", key] for key, own in deck.element_sets.items() if numbers & set(own)]
        for key in sets or [what]:
            more = f"; {found[key]}" if key in found else ""
            found[key] = (f"{what} in it, " if sets else "") + f"neither cells nor sides of cells{more}"
    return found


def _surfaces(
    deck: _Deck, kind: str, cells: np.ndarray, row_of: dict[int, int], facets: dict[int, np.ndarray]
) -> tuple[dict[str | int, np.ndarray], dict[str | int, str]]:
    """Corners of the facets of sets of elements and of surfaces, (f, k), by name, and reasons for those without."""
    found: dict[str | int, np.ndarray] = {}
    reasons: dict[str | int, str] = {}
    for name, numbers in deck.element_sets.items():
        own = [facets[n] for n in numbers if n in facets]
        if own:
            found[deck.spelling["elset", name]] = np.array(own)
    for name, given in deck.faces.items():
        spelt = deck.spelling["surface", name]
        parts = [_faces(deck, item, kind, cells, row_of, facets, spelt) for item in given]
        said = [part for part in parts if isinstance(part, str)]
        if said:
            reasons[spelt] = said[0]
        else:
            found[spelt] = np.concatenate([np.zeros((0, len(FACES[kind][0])), dtype=np.int64), *parts])
    for name, members in deck.unions.items():
        spelt = deck.spelling["surface", name]
        spelt_members = [deck.spelling.get(("surface", member), "") for member in members]
        if members and all(member in found for member in spelt_members):
            found[spelt] = np.concatenate([found[member] for member in spelt_members])
        else:
            reasons[spelt] = f"a union of surfaces that are not all there: {', '.join(members)}"
    return found, reasons


def _faces(
    deck: _Deck, item: tuple[str, str], kind: str, cells: np.ndarray, row_of: dict[int, int],
    facets: dict[int, np.ndarray], name: str,
) -> np.ndarray | str:  # fmt: skip
    """Corners of the faces of an element or a set in a surface, (f, k), or the reason why there are none.

    Raises:
        FileContentError: for a face that the cells do not have.
    """
    given, face = item
    corners = np.array(FACES[kind])
    numbers = [int(given)] if given.isdigit() else deck.element_sets.get(given.upper(), [])
    rows = [row_of[n] for n in numbers if n in row_of]
    if face in ("SPOS", "SNEG"):
        own = [facets[n] for n in numbers if n in facets]
        return np.array(own) if own else f"its elements '{given}' are no sides of cells"
    if not rows:
        types = sorted({deck.types[n] for n in numbers if n in deck.types})
        return f"'{given}' has no cells of the mesh" + (f", but elements of type {', '.join(types)}" if types else "")
    if not face:
        # all outer faces of the set
        outer, of = outer_faces_of_cells(kind, cells)
        return outer[np.isin(of, rows)]
    number = int(face[1:]) if face.startswith("S") and face[1:].isdigit() else 0
    if not 1 <= number <= len(corners):
        raise FileContentError(f"surface '{name}': '{given}, {face}' is no face of cells of kind {kind}")
    return cells[rows][:, corners[number - 1]]
