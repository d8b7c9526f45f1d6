"""Meshes of Kratos, ``.mdpa``: nodes, elements, conditions, geometries, and parts of the model with
those in them.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

from hhr_dolfinx.geometries.raw_mesh import RawMesh
from hhr_dolfinx.plugins.mesh_formats.contents import LOW_KINDS, PLANE_KINDS, SOLID_KINDS, Contents

_LINES = ("Line", "Truss", "Cable", "Beam", "CrBeam")
_FLAT = ("Triangle", "Quadrilateral", "Shell", "Membrane")
_SOLIDS = ("Tetrahedra", "Hexahedra", "Prism", "Pyramid")
_NUMBERED = ("Elements", "Conditions", "Geometries")


def read_mdpa(path: Path) -> RawMesh:
    """Read a mesh file of Kratos.

    A part within another one is ``Outer.Inner``, and ``Inner`` too if no other part is called so.

    Raises:
        FileContentError: with the line, for a damaged file.
    """
    contents = Contents()
    with contents.reading(path) as lines:
        rows = (row for line in lines if (row := line.partition("//")[0].split()))
        for row in rows:
            if row[0] != "Begin":
                raise ValueError(f"'{' '.join(row)}' begins no block")
            _block(contents, row, rows)
    short = {full: str(full).rpartition(".")[2] for full in contents.sets}
    for full, name in short.items():
        if "." in str(full) and list(short.values()).count(name) == 1:
            contents.sets[name] = contents.sets[full]
            contents.nodes[name] = contents.nodes.get(full, [])
    return contents.mesh(path)


def _inside(kind: str, rows: Iterator[list[str]]) -> Iterator[list[str]]:
    """Rows of a block up to its end; ValueError for a block without end."""
    for row in rows:
        if row[:2] == ["End", kind]:
            return
        if row[0] == "End":
            raise ValueError(f"'{' '.join(row)}' ends no block of {kind}")
        yield row
    raise ValueError(f"a block of {kind} has no end")


def _block(contents: Contents, head: list[str], rows: Iterator[list[str]]) -> None:
    """Read one block; those without a mesh are skipped."""
    kind = head[1]
    if kind == "SubModelPart":
        _part(contents, head[2], rows)
        return
    for row in _inside(kind, rows):
        if row[0] == "Begin":
            _block(contents, row, rows)
        elif kind == "Nodes":
            contents.points[row[0]] = [float(word) for word in row[1:4]]
        elif kind in _NUMBERED:
            # a geometry has no property
            nodes = row[1:] if kind == "Geometries" else row[2:]
            contents.add(_kind_of(head[2], kind, len(nodes)), (kind, row[0]), nodes)
            if kind == "Elements":
                contents.sets.setdefault(int(row[1]), []).append((kind, row[0]))


def _kind_of(name: str, kind: str, count: int) -> str:
    """Meshio's kind of the elements ``SmallDisplacementElement3D8N`` or ``Triangle2D3``, with so
    many nodes.
    """
    plane = re.search(r"2D\d+N?$", name)
    line = name.startswith(_LINES) or count < 3 or (kind == "Conditions" and plane)
    solid = name.startswith(_SOLIDS) or (
        kind == "Elements" and not plane and not name.startswith(_FLAT)
    )
    # shells of any name have three corners
    kinds = LOW_KINDS if line else SOLID_KINDS if solid and count in SOLID_KINDS else PLANE_KINDS
    if count not in kinds:
        raise ValueError(f"'{name}' has {count} nodes, which is not understood")
    return kinds[count]


def _part(contents: Contents, name: str, rows: Iterator[list[str]]) -> None:
    """Read a part of the model: its elements and conditions, or its nodes if it has neither, and
    the parts in it.
    """
    members: list[tuple[str, str]] = []
    for row in _inside("SubModelPart", rows):
        if row[:2] == ["Begin", "SubModelPart"]:
            _part(contents, f"{name}.{row[2]}", rows)
        elif row[0] == "Begin":
            kind = row[1].removeprefix("SubModelPart")
            members += [(kind, number) for line in _inside(row[1], rows) for number in line]
    contents.sets[name] = [member for member in members if member[0] in _NUMBERED]
    if not contents.sets[name]:
        contents.nodes[name] = [number for kind, number in members if kind == "Nodes"]
