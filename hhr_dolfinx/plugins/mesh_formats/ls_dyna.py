"""Meshes of LS-DYNA's keyword files, ``.k``: nodes, solids, shells, parts as bodies, sets of nodes
and segments.
"""

from __future__ import annotations

import re
from pathlib import Path

from hhr_dolfinx.geometries.raw_mesh import RawMesh
from hhr_dolfinx.plugins.mesh_formats.contents import LOW_KINDS, PLANE_KINDS, SOLID_KINDS, Contents

_SET = re.compile(r"SET_(NODE|SEGMENT|SOLID|SHELL|PART)(?:_LIST)?(_GENERATE)?(?:_TITLE)?")
_SOLID = re.compile(r"ELEMENT_SOLID(?:_(H20|H27|TET4TOTET10|H8TOH20))?")
_COUNTED = {"H20": 20, "H27": 27}
Rows = list[tuple[int, str]]  # with their lines


def read_keywords(path: Path) -> RawMesh:
    """Read a keyword file with its includes.

    Raises:
        FileContentError: with the line, for a damaged file.
    """
    contents = Contents()
    titles: dict[int, str] = {}
    _read(contents, titles, path)
    for number, title in titles.items():
        if title and number in contents.sets:
            contents.sets.setdefault(title, []).extend(contents.sets[number])
    for name, part_numbers in contents.unions.items():
        contents.sets.setdefault(name, []).extend(
            element for number in part_numbers for element in contents.sets.get(number, ())
        )
    return contents.mesh(path)


def _read(contents: Contents, titles: dict[int, str], path: Path) -> None:
    keyword = ""
    usual = "-"
    rows: Rows = []
    with contents.reading(path) as lines:
        for line in lines:
            if line.upper().startswith("*END"):
                break
            if line.startswith("*"):
                _take(contents, titles, keyword, rows, path)
                # writers add (ten nodes format) to solids, whose nodes are in the next row
                keyword = line[1:].partition("(")[0].strip().upper()
                options = keyword.replace(" ", "")
                usual = "+" if "LONG=Y" in options else "%" if "I10=Y" in options else usual
                # a mark of the block counts more than the option of the file
                keyword += "" if keyword.endswith(("+", "-", "%")) else usual
                rows = []
            elif not line.startswith("$"):
                rows.append((contents.line, line))
        _take(contents, titles, keyword, rows, path)


def _take(contents: Contents, titles: dict[int, str], keyword: str, rows: Rows, path: Path) -> None:
    """Add a block; blocks that are not part of a mesh are skipped.

    ``*NODE+`` has fields of 20 letters, as all blocks after ``LONG=Y``, and ``*NODE %`` of 10 and
    not 8, as after ``I10=Y``.
    """
    short = keyword.endswith("-") and keyword.startswith(("NODE", "ELEMENT"))
    width = 20 if keyword.endswith("+") else 8 if short else 10
    keyword = keyword.rstrip("+-% ")
    if keyword == "NODE":
        for contents.line, row in rows:
            node, *coordinates = _fields(row, width, max(width, 16))
            contents.points[int(_number(node))] = [
                _number(word) for word in (*coordinates, "", "", "")[:3]
            ]
    elif keyword == "ELEMENT_SHELL":
        _elements(contents, PLANE_KINDS, keyword, rows, width)
    elif solid := _SOLID.fullmatch(keyword):
        _elements(contents, SOLID_KINDS, "ELEMENT_SOLID", rows, width, _COUNTED.get(solid[1], 0))
    elif keyword == "PART":
        for (_, title), (contents.line, row) in zip(rows[::2], rows[1::2], strict=False):
            titles[_numbers(row, width, 1)[0]] = title.strip()
    elif keyword == "INCLUDE":
        for contents.line, row in rows:
            _read(contents, titles, path.parent / row.strip())
    elif of := _SET.fullmatch(keyword):
        title = rows[0][1].strip() if keyword.endswith("_TITLE") else ""
        titled = keyword.endswith("_TITLE")
        # the first row goes on with attributes and the name of a solver
        numbers = [
            _numbers(row, width, None if k else 1)
            for k, (contents.line, row) in enumerate(rows[titled:])
        ]
        _set(contents, of[1], title, numbers, bool(of[2]))
    elif keyword.startswith(("ELEMENT_", "SET_", "INCLUDE_", "NODE_")):
        contents.left_out[f"*{keyword}"] = "blocks of this kind are not read"


def _set(contents: Contents, kind: str, title: str, rows: list[list[int]], ranges: bool) -> None:
    """Add a set by its title or its number, which is in its first row.

    Members may be ranges, first and last each.
    """
    number = rows[0][0]
    members = [member for row in rows[1:] for member in row if member]
    if ranges:
        pairs = zip(members[::2], members[1::2], strict=True)
        members = [member for first, last in pairs for member in range(first, last + 1)]
    if kind == "NODE":
        contents.nodes[title or f"nodes {number}"] = [*members]
    elif kind == "PART":
        # its parts may follow
        contents.unions[title or f"parts {number}"] = [*members]
    elif kind != "SEGMENT":
        name = title or f"{kind.lower()}s {number}"
        contents.sets.setdefault(name, []).extend((f"ELEMENT_{kind}", member) for member in members)
    for k, row in enumerate(rows[1:] if kind == "SEGMENT" else ()):
        nodes = list(dict.fromkeys(node for node in row[:4] if node))
        contents.add(
            (LOW_KINDS if len(nodes) == 2 else PLANE_KINDS)[len(nodes)], (kind, number, k), nodes
        )
        contents.sets.setdefault(title or number, []).append((kind, number, k))


def _elements(
    contents: Contents, kinds: dict[int, str], keyword: str, rows: Rows, width: int, count: int = 0
) -> None:
    """Add solids or shells.

    Their nodes are in the same row, or in the next ones; repeated ones make simpler cells.

    An element goes on in the next row if this one ends in a comma, or while it has fewer nodes than
    ``count``.
    """
    held: list[int] = []
    for contents.line, row in rows:
        held += _numbers(row.rstrip().rstrip(","), width)
        if len(held) > 2 and len(held) - 2 >= count and (count or not row.rstrip().endswith(",")):
            element, part_number, *nodes = held
            nodes = list(dict.fromkeys(node for node in nodes if node))
            if len(nodes) not in kinds:
                raise ValueError(
                    f"element {element} has {len(nodes)} nodes, which is not understood"
                )
            contents.add(kinds[len(nodes)], (keyword, element), nodes)
            contents.sets.setdefault(part_number, []).append((keyword, element))
            held = []
    if held:
        raise ValueError(f"element {held[0]} has {'too few' if len(held) > 2 else 'no'} nodes")


def _fields(row: str, *widths: int) -> list[str]:
    """Fields of a row between commas, or of these widths, of which the last one repeats."""
    if "," in row:
        return [word.strip() for word in row.split(",")]
    first = row[: widths[0]]
    remaining = row[widths[0] :].rstrip()
    return [
        word.strip()
        for word in (
            first,
            *(remaining[k : k + widths[-1]] for k in range(0, len(remaining), widths[-1])),
        )
    ]


def _numbers(row: str, width: int, count: int | None = None) -> list[int]:
    """Integers of a row, or the first ones."""
    return [int(_number(word)) for word in _fields(row, width)[:count]]


def _number(word: str) -> float:
    """Number of a field, 0 of an empty one.

    ValueError for a parameter or an expression, which stand for numbers.
    """
    if "&" in word or word.startswith("<"):
        raise ValueError(
            f"{word!r} is a number of *PARAMETER, which is not read: write the number there"
        )
    return float(word or 0)
