"""Lines and blocks of an Abaqus or CalculiX deck, and the nodes, elements, sets and surfaces that
they define.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from hhr_dolfinx.errors import FileContentError
from hhr_dolfinx.geometries.cells import CORNERS

_LINES = ("T2D", "T3D", "B2", "B3", "R2D2", "RAX2", "SAX1", "SAX2")
_PLANE = ("CPE", "CPS", "CAX", "S", "M3D", "R3D")
_NOT_PLANE = ("SPRING", "SC6", "SC8")
_SOLID = ("C3D", "SC8", "F3D")
"""First letters of types of elements.

Line elements, and plane ones in space, stand for facets, as gmsh writes them.
"""
_COUNTED = re.compile(r"(?:AC|DC|GK|COH|[CFMRT])[23]D(\d+)|(?:C?GAX|C?CAX|CPE|CPS|SC?)(\d+)")
"""Types whose name has the number of nodes, such as C3D8R."""
_COUNTS = {
    2: {3: "triangle", 6: "triangle", 4: "quadrilateral", 8: "quadrilateral", 9: "quadrilateral"},
    3: {
        4: "tetrahedron",
        10: "tetrahedron",
        8: "hexahedron",
        20: "hexahedron",
        27: "hexahedron",
        5: "pyramid",
        6: "prism",
        15: "prism",
    },
}
"""Kinds of cells by dimension and number of nodes."""


FACE_LETTERS = {"DLOAD": "P", "DFLUX": "S", "FILM": "F"}
"""Letters before the number of a face, by the keyword of loads and heat on faces of elements."""
LOADED = ("BOUNDARY", "CLOAD", *FACE_LETTERS)
"""Supports, loads and heat that may give nodes or elements by numbers."""
COUPLED = ("EQUATION", "MPC", "RIGID BODY", "DISTRIBUTING COUPLING")
"""Constraints that may give nodes by numbers or elements."""
STRIDE = 10**10
"""Numbers of nodes and elements of instance k = 1, 2, ... are those of its part plus k times
this.
"""


@dataclass
class DeckContents:
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
        instances: names of the instances whose contents are in the deck.
        unsorted: names in capitals of sets of nodes that keep the order in which they are given.
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
    instances: list[str] = field(default_factory=list)
    unsorted: set[str] = field(default_factory=set)

    def members(self, name: str) -> list[int]:
        """Nodes of a set, each once, by number or in the order in which they are given.

        Empty without the set.
        """
        nodes = dict.fromkeys(self.node_sets.get(name, ()))
        return list(nodes) if name in self.unsorted else sorted(nodes)

    def named(self, kind: str, name: str) -> str:
        """A name in capitals, as Abaqus compares them.

        Args:
            kind: kind of the set: ``nset``, ``elset``, ``surface`` or ``part``.
            name: the name as written; the first spelling is kept.
        """
        self.spelling.setdefault((kind, name.upper()), name)
        return name.upper()

    def label(self, number: int) -> str:
        """A node or element as it is called in the file: ``7``, or ``Instance.7``."""
        instance, local = divmod(number, STRIDE)
        return f"{self.instances[instance - 1]}.{local}" if instance else str(local)


def _lines(path: Path, above: tuple[Path, ...] = ()) -> Iterator[tuple[int, str]]:
    """Lines without blanks and comments, with their numbers.

    Included files are inserted, keyword lines are joined.

    FileContentError for an included file that does not exist, or includes itself.
    """
    text = path.read_text(encoding="utf-8-sig", errors="replace")
    numbered = [(number, line.strip()) for number, line in enumerate(text.splitlines(), start=1)]
    lines = iter(
        [(number, line) for number, line in numbered if line and not line.startswith("**")]
    )
    for number, line in lines:
        while line.startswith("*") and line.endswith(","):
            line += next(lines, (0, "*"))[1]
        source = line.startswith("*") and re.search(r",\s*INPUT\s*=\s*([^,]*)", line, re.IGNORECASE)
        include = re.match(r"\*\s*INCLUDE\b", line, re.IGNORECASE)
        if not include:
            yield number, line
        if source:
            # of *NODE, *ELEMENT and others the file holds the data
            included = path.parent / source[1].strip().strip('"').replace("\\", "/")
            if not included.is_file() or included in (path, *above):
                reason = (
                    "includes itself"
                    if included.is_file()
                    else "does not exist: put it there, or name its path"
                )
                raise FileContentError(
                    f"{path.name}:{number} {line.partition(',')[0]}: the file {included} {reason}"
                )
            yield from _lines(included, (path, *above))


def _words(line: str) -> list[str]:
    """Words of a line between commas, without the quotes of names, as in ``"an instance".set``."""
    if '"' not in line:
        return [word.strip() for word in line.split(",")]
    matched = re.findall(r'((?:"[^"]*"|[^,"])*)(?:,|$)', line)
    return [word.strip().replace('"', "") for word in matched][: line.count(",") + 1]


def blocks(path: Path) -> Iterator[tuple[int, str, dict[str, str], list[list[str]]]]:
    """Blocks of a deck, with included files inserted.

    Returns:
        First line number, keyword, options and data lines of each block.
    """
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
                # a line that ends in a comma continues in the next one, unless the element has all
                # its nodes
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


def take(deck: DeckContents, keyword: str, options: dict[str, str], rows: list[list[str]]) -> None:
    """Add a block to a deck; blocks that are not part of a mesh are skipped.

    Args:
        deck: the deck that is filled.
        keyword: keyword of the block in capitals, without its star.
        options: options of the block, by name in capitals.
        rows: words of the data lines of the block.

    Raises:
        ValueError: for a block that is damaged, or not supported.
        KeyError: for an option that is missing.
    """
    if keyword == "NODE":
        system = options.get("SYSTEM", "R").upper()
        deck.nodes |= {int(row[0]): _place(row[1:4], system) for row in rows}
        if "NSET" in options:
            deck.node_sets.setdefault(deck.named("nset", options["NSET"]), []).extend(
                int(row[0]) for row in rows
            )
    elif keyword == "ELEMENT":
        _elements(deck, options, rows)
    elif keyword in ("NSET", "ELSET"):
        sets = deck.node_sets if keyword == "NSET" else deck.element_sets
        name = deck.named(keyword.lower(), options[keyword])
        members = _members(sets, rows, "GENERATE" in options)
        if keyword == "NSET" and "ELSET" in options:
            elements = deck.element_sets.get(options["ELSET"].upper(), [])
            members = sorted({node for element in elements for node in deck.whole.get(element, ())})
        if keyword == "NSET" and "UNSORTED" in options:
            deck.unsorted.add(name)
        sets.setdefault(name, []).extend(members)
    elif keyword == "SURFACE":
        _surface(deck, options, rows)
    elif keyword == "SYSTEM" and rows:
        raise ValueError(
            "nodes in a system of *SYSTEM are not read: write them in the global one, with *NODE, "
            "SYSTEM="
        )


def _place(words: list[str], system: str) -> list[float]:
    """Three coordinates of a node; missing ones are zero, and angles are in degrees.

    Systems are R, rectangular, C, with the radius, the angle and z, and S, with two angles: from x,
    and from the plane.
    """
    first, second, third = (number_of(word) for word in (*words, "", "", "")[:3])
    if system == "R":
        return [first, second, third]
    if system not in ("C", "S"):
        raise ValueError(f"there is no coordinate system {system}, but R, C and S")
    turn, up = np.deg2rad([second, third if system == "S" else 0.0])
    radius = first * np.cos(up)
    height = first * np.sin(up) if system == "S" else third
    return [float(radius * np.cos(turn)), float(radius * np.sin(turn)), float(height)]


def number_of(word: str) -> float:
    """A number; a blank is zero, and 1.0D+00 of Fortran is accepted."""
    return float(word.upper().replace("D", "E")) if word else 0.0


def _surface(deck: DeckContents, options: dict[str, str], rows: list[list[str]]) -> None:
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
        option = f"TYPE={kind}" if kind != "ELEMENT" else f"COMBINE={combined}"
        deck.left_out[options["NAME"]] = f"surfaces of {option} are not read"
    elif "COMBINE" in options:
        deck.unions[name] = [word.upper() for row in rows for word in row if word]
    else:
        deck.faces.setdefault(name, []).extend(
            (row[0], row[1].upper() if len(row) > 1 else "") for row in rows
        )


def _elements(deck: DeckContents, options: dict[str, str], rows: list[list[str]]) -> None:
    """Add a block of elements; elements that are not cells, lines or facets keep only types and
    sets.
    """
    name = options["TYPE"].upper()
    kinds: dict[int, str] = {}
    if name.startswith(_LINES):
        kinds = {2: "line", 3: "line"}
    elif name.startswith(_PLANE) and not name.startswith(_NOT_PLANE):
        kinds = _COUNTS[2]
    elif name.startswith(_SOLID):
        kinds = _COUNTS[3]
    counted = _COUNTED.match(name)
    count = int(counted[1] or counted[2]) if counted else 0
    if count and count not in kinds:  # such as C3D9
        kinds = {}
    if not kinds:
        # continuation lines may look like elements; the set then only gets more numbers
        rows = [row for row in rows if row and row[0].isdigit()]
    for row in rows:
        number, *nodes = (int(word) for word in row) if kinds else (int(row[0]),)
        deck.types[number] = name
        if not kinds:
            continue
        if len(nodes) not in kinds or len(nodes) != (count or len(nodes)):
            raise ValueError(
                f"element {number} of type {name} has {len(nodes)} nodes, which is not understood"
            )
        kind = kinds[len(nodes)]
        # the second of three nodes on a line is the middle one
        deck.elements[number] = (
            kind,
            nodes[:: len(nodes) - 1] if kind == "line" else nodes[: CORNERS.get(kind)],
        )
        deck.whole[number] = nodes
    if "ELSET" in options:
        members = deck.element_sets.setdefault(deck.named("elset", options["ELSET"]), [])
        members.extend(int(row[0]) for row in rows)


def _members(sets: dict[str, list[int]], rows: list[list[str]], ranges: bool) -> list[int]:
    """Numbers of a set, given one by one, as ranges, or as names of other sets."""
    numbers: list[int] = []
    for row in rows:
        words = [word for word in row if word]
        if ranges:
            first, last, step = (*(int(word) for word in words), 1)[:3]
            if step < 1 or last < first:
                raise ValueError(
                    f"no numbers go from {first} to {last} in steps of {step}: write the smaller "
                    "one first"
                )
            numbers.extend(range(first, last + 1, step))
            continue
        for word in words:
            if word.lstrip("+-").isdigit():
                numbers.append(int(word))
            elif word.upper() in sets:
                numbers.extend(sets[word.upper()])
            else:
                raise ValueError(f"there is no set '{word}' before it")
    return numbers


def name_loaded(deck: DeckContents, block: str, rows: list[list[str]]) -> None:
    """Name the nodes and faces that supports and loads give by numbers.

    A scene can then have the same ones.

    Args:
        deck: the deck that is filled.
        block: keyword and line of the block, ``CLOAD:45``.
        rows: words of the data lines of the block.
    """
    for first, *row in rows:
        keyword = block.partition(":")[0]
        if row and is_face(keyword, row[0].upper()):
            name = deck.named("surface", name_of_loaded(block, row))
            deck.faces.setdefault(name, []).append((first, f"S{row[0][1]}"))
        elif keyword not in FACE_LETTERS and first.isdigit():
            deck.node_sets.setdefault(deck.named("nset", name_of_loaded(block, row)), []).append(
                int(first)
            )


def name_coupled(
    deck: DeckContents, block: str, options: dict[str, str], rows: list[list[str]]
) -> None:
    """Name the nodes of constraints.

    These are each node of an equation, and all nodes of another constraint by its block. Of a set
    in an equation its first node is named too, and the others, ``EQUATION:45 TOP first`` and ``...
    others``.

    Args:
        deck: the deck that is filled.
        block: keyword and line of the block, ``EQUATION:45``.
        options: options of the block, by name in capitals.
        rows: words of the data lines of the block.
    """
    if block.startswith("EQUATION:"):
        for word in {
            word for row in rows if len([*filter(None, row)]) > 1 for word in row[::3] if word
        }:
            if word.isdigit():
                named = {deck.label(int(word)): [int(word)]}
            else:
                members = deck.members(word.upper())
                named = (
                    {f"{word} first": members[:1], f"{word} others": members[1:]}
                    if len(members) > 1
                    else {}
                )
            for end, numbers in named.items():
                deck.node_sets[deck.named("nset", name_of_loaded(block, [end]))] = numbers
    elif block.startswith("RIGID BODY:"):
        elements = deck.element_sets.get(options.get("ELSET", "").upper(), [])
        deck.node_sets[deck.named("nset", block)] = sorted(
            {n for element in elements for n in deck.whole.get(element, ())}
        )
    else:
        # a word of *DISTRIBUTING COUPLING is followed by its weight
        words = [
            word for row in rows for word in (row[:1] if block.startswith("DIST") else row) if word
        ]
        node_lists = [
            deck.node_sets.get(word.upper(), [int(word)] if word.isdigit() else [])
            for word in words
        ]
        # the last node of a mean rotation is its pilot
        pilot = set(node_lists[-1]) if words and words[0].upper() == "MEANROT" else set()
        deck.node_sets[deck.named("nset", block)] = sorted(
            {n for node_list in node_lists for n in node_list} - pilot
        )


def is_face(keyword: str, label: str) -> bool:
    """True for a load or heat on a face of elements.

    Args:
        keyword: of the block, in capitals.
        label: of the load, in capitals.
    """
    letter = FACE_LETTERS.get(keyword)
    return letter is not None and re.fullmatch(rf"{letter}\d", label) is not None


def name_of_loaded(block: str, load: Sequence[str]) -> str:
    """Name of the nodes or faces in a block under a load.

    Args:
        block: keyword and line of the block, ``CLOAD:45``.
        load: words of the load after the number.
    """
    return " ".join([block, *filter(None, load)])
