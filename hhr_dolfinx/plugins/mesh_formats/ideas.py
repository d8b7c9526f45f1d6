"""Meshes of I-DEAS' universal files, ``.unv``: nodes, elements, and groups in all of their data
sets.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import takewhile
from pathlib import Path

from hhr_dolfinx.geometries.raw_mesh import RawMesh
from hhr_dolfinx.plugins.mesh_formats.contents import LOW_KINDS, PLANE_KINDS, SOLID_KINDS, Contents

_NODES = {"15": False, "781": True, "2411": True}
"""Data sets of nodes: true if the coordinates are in a further row."""
_ELEMENTS = {"71": 2, "780": 3, "2412": 2}
"""Data sets of elements: column of the number of the physical property."""
_GROUPS = {"2417": 4, "2429": 4, "2430": 4, "2432": 4, "2435": 2, "2452": 2, "2467": 2, "2477": 2}
"""Data sets of groups: members in a row, of two values each in older ones, of four in newer
ones.
"""
_OF_NODES = 7
_OF_ELEMENTS = 8
"""Codes of the types of members."""
_BEAMS = frozenset((11, 21, 22, 23, 24, 31, 32))
"""Elements with a further row, of their orientation."""
_AROUND = {
    "line3": (0, 2, 1),
    "triangle6": (0, 2, 4, 1, 3, 5),
    "quad8": (0, 2, 4, 6, 1, 3, 5, 7),
    "tetra10": (0, 2, 4, 9, 1, 3, 5, 6, 7, 8),
    "wedge15": (0, 2, 4, 9, 11, 13, 1, 3, 5, 10, 12, 14, 6, 7, 8),
    "hexahedron20": (0, 2, 4, 6, 12, 14, 16, 18, 1, 3, 5, 7, 13, 15, 17, 19, 8, 9, 10, 11),
}
"""Places of the nodes in the order of VTK: files list them around the lower side, then upright
edges, then the top.
"""


def read_unv(path: Path) -> RawMesh:
    """Read a universal file.

    Groups are bodies, surfaces and sets of nodes by name. Elements of a dimension of which no group
    has any belong to the numbers of their physical properties.

    Raises:
        FileContentError: with the line, for a damaged file.
    """
    contents = Contents()
    properties: dict[str, int] = {}
    with contents.reading(path) as lines:
        for line in lines:
            if line.strip() != "-1":
                continue
            kind = next(lines, "").strip()
            rows = (row.split() for row in takewhile(lambda row: row.strip() != "-1", lines))
            if kind in _NODES:
                _nodes(contents, rows, _NODES[kind])
            elif kind in _ELEMENTS:
                _elements(contents, rows, _ELEMENTS[kind], properties)
            elif kind in _GROUPS:
                _groups(contents, rows, _GROUPS[kind])
            else:
                for _ in rows:
                    pass
    _by_property(contents, properties)
    return contents.mesh(path)


def _nodes(contents: Contents, rows: Iterator[list[str]], two_rows: bool) -> None:
    for row in rows:
        words = next(rows, []) if two_rows else row[4:]
        if len(words) < 3:
            raise ValueError(f"node {row[0]} has {len(words)} coordinates, and not 3")
        contents.points[row[0]] = [float(word.upper().replace("D", "E")) for word in words[:3]]


def _elements(
    contents: Contents, rows: Iterator[list[str]], column: int, properties: dict[str, int]
) -> None:
    """Add elements and their properties; those of unknown kinds are left out."""
    for row in rows:
        type_ = int(row[1])
        count = int(row[-1])
        if type_ in _BEAMS:
            next(rows, [])
        nodes: list[str] = []
        while len(nodes) < count:
            more = next(rows, [])
            if not more:
                raise ValueError(f"element {row[0]} has {len(nodes)} nodes, and not {count}")
            nodes += more
        kinds = (
            LOW_KINDS
            if type_ in _BEAMS
            else PLANE_KINDS
            if 41 <= type_ < 100
            else SOLID_KINDS
            if 101 <= type_ <= 118
            else {}
        )
        if len(nodes) in kinds:
            kind = kinds[len(nodes)]
            contents.add(kind, row[0], [nodes[k] for k in _AROUND.get(kind, range(len(nodes)))])
            properties[row[0]] = int(row[column])
        else:
            contents.left_out[f"type {type_}"] = (
                f"elements of this type, with {count} nodes, are not read"
            )


def _groups(contents: Contents, rows: Iterator[list[str]], width: int) -> None:
    """Add groups: a head that ends in the count, a name, and members."""
    for head in rows:
        count = int(head[-1])
        name = " ".join(next(rows, [])) or head[0]
        words = [int(word) for _ in range(-(-count // width)) for word in next(rows, [])]
        values = 8 // width
        if len(words) != count * values:
            raise ValueError(f"group '{name}' has {len(words) // values} members, and not {count}")
        members = list(zip(words[::values], words[1::values], strict=True))
        for sets, code in ((contents.sets, _OF_ELEMENTS), (contents.nodes, _OF_NODES)):
            if numbers := [str(number) for type_, number in members if type_ == code]:
                sets.setdefault(name, []).extend(numbers)
        if unknown := sorted({type_ for type_, _ in members} - {_OF_ELEMENTS, _OF_NODES}):
            contents.left_out[f"{name}, type {unknown[0]}"] = (
                "members of this type are no nodes and no elements"
            )


def _by_property(contents: Contents, properties: dict[str, int]) -> None:
    """Add sets of elements by their properties, in dimensions of which no group has elements."""
    dims = dict.fromkeys(SOLID_KINDS.values(), 3) | dict.fromkeys(PLANE_KINDS.values(), 2)
    dimension = {
        member: dims.get(kind, 1)
        for kind, members in contents.elements.items()
        for member in members
    }
    grouped = {
        dimension.get(str(member)) for members in contents.sets.values() for member in members
    }
    for element, number in properties.items():
        if dimension[element] not in grouped:
            contents.sets.setdefault(number, []).append(element)
