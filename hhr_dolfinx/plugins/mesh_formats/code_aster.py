"""Meshes of code_aster's text format, ``.mail``: nodes, elements and groups by name."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

from hhr_dolfinx.geometries.raw_mesh import RawMesh
from hhr_dolfinx.plugins.mesh_formats.contents import COUNTS, Contents

_KINDS = dict(
    pair.split(":")
    for pair in (
        "POI1:vertex SEG2:line SEG3:line3 TRIA3:triangle TRIA6:triangle6 QUAD4:quad QUAD8:quad8 "
        "QUAD9:quad9 TETRA4:tetra TETRA10:tetra10 PYRAM5:pyramid PYRAM13:pyramid13 PENTA6:wedge "
        "PENTA15:wedge15 HEXA8:hexahedron HEXA20:hexahedron20 HEXA27:hexahedron27"
    ).split()
)
_WIDTHS = {"COOR_2D": 3, "COOR_3D": 4} | {
    head: COUNTS[kind] + 1 for head, kind in _KINDS.items()
}  # words of an item
_OTHERS = ("TITRE", "TRIA7", "SEG4", "PENTA18", "PENTA21", "PYRAM19", "TETRA15", "HEXA9", "HEXA16")


def read_mail(path: Path) -> RawMesh:
    """Read a mesh file of code_aster.

    Raises:
        FileContentError: with the line, for a damaged file.
    """
    contents = Contents()
    with contents.reading(path) as lines:
        # NOM = A is one word, and comments begin with %
        words = (
            word
            for line in lines
            for word in re.sub(r"\s*=\s*", "=", line.partition("%")[0]).split()
        )
        for word in words:
            if word.upper() == "FIN":
                break
            _block(contents, word.upper(), words)
    return contents.mesh(path)


def _block(contents: Contents, head: str, words: Iterator[str]) -> None:
    """Read a block up to FINSF; ValueError for an unknown one, or one that ends too soon."""
    if head not in _WIDTHS and head not in ("GROUP_MA", "GROUP_NO", *_OTHERS):
        raise ValueError(f"'{head}' begins no block of a mesh of code_aster")
    name = ""
    row: list[str] = []
    for word in words:
        if word.upper() == "FINSF":
            break
        name = word[4:] if word.upper().startswith("NOM=") else name
        row += [word] if "=" not in word else []
        if len(row) == _WIDTHS.get(head):
            if head in _KINDS:
                contents.add(_KINDS[head], row[0], row[1:])
            else:
                contents.points[row[0]] = [
                    float(number.upper().replace("D", "E")) for number in row[1:]
                ]
            row = []
    else:
        raise ValueError(f"the block {head} has no FINSF")
    if head in _WIDTHS and row:
        raise ValueError(f"the last item of {head} has {len(row)} words, and not {_WIDTHS[head]}")
    if head.startswith("GROUP"):
        # the name stands after NOM, or is the first word
        name, *members = [name, *row] if name else row
        (contents.sets if head == "GROUP_MA" else contents.nodes).setdefault(name, []).extend(
            members
        )
    elif head in _OTHERS[1:]:
        contents.left_out[head] = "elements of this kind are not read"
