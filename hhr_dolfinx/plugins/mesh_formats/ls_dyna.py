"""Meshes of LS-DYNA's keyword files, ``.k``: nodes, solids, shells, parts as bodies, sets of nodes and segments."""

from __future__ import annotations

import re
from pathlib import Path

from hhr_dolfinx.geometries.raw_mesh import RawMesh
from hhr_dolfinx.plugins.mesh_formats.contents import LOW, PLANE, SOLID, Contents

_SET = re.compile(r"SET_(NODE|SEGMENT)(?:_LIST)?(?:_TITLE)?")
Rows = list[tuple[int, str]]  # with their lines


def read_keywords(path: Path) -> RawMesh:
    """Read a file with its includes; raise FileContentError, with the line, for a damaged one."""
    found = Contents()
    titles: dict[int, str] = {}
    _read(found, titles, path)
    for number, title in titles.items():
        if title and number in found.sets:
            found.sets.setdefault(title, []).extend(found.sets[number])
    return found.mesh(path)


def _read(found: Contents, titles: dict[int, str], path: Path) -> None:
    keyword = ""
    long = False
    rows: Rows = []
    with found.reading(path) as lines:
        for line in lines:
            if line.upper().startswith("*END"):
                break
            if line.startswith("*"):
                _take(found, titles, keyword, rows, path)
                long = long or "LONG=Y" in line.upper().replace(" ", "")
                keyword = line[1:].strip().upper() + "+" * long
                rows = []
            elif not line.startswith("$"):
                rows.append((found.line, line))
        _take(found, titles, keyword, rows, path)


def _take(found: Contents, titles: dict[int, str], keyword: str, rows: Rows, path: Path) -> None:
    """Add a block; blocks that are not part of a mesh are skipped. ``*NODE+`` has fields of 20 letters."""
    width = 20 if keyword.endswith("+") else 8 if keyword.startswith(("NODE", "ELEMENT")) else 10
    keyword = keyword.rstrip("+-% ")
    if keyword == "NODE":
        for found.line, row in rows:
            node, *place = _fields(row, width, max(width, 16))
            found.points[int(node)] = [float(word or 0) for word in (*place, "", "")[:3]]
    elif keyword in ("ELEMENT_SOLID", "ELEMENT_SHELL"):
        _elements(found, keyword, rows, width)
    elif keyword == "PART":
        for (_, title), (found.line, row) in zip(rows[::2], rows[1::2], strict=False):
            titles[_numbers(row, width)[0]] = title.strip()
    elif keyword == "INCLUDE":
        for found.line, row in rows:
            _read(found, titles, path.parent / row.strip())
    elif of := _SET.fullmatch(keyword):
        title = rows[0][1].strip() if keyword.endswith("_TITLE") else ""
        _set(found, of[1], title, [_numbers(row, width) for found.line, row in rows[bool(title) :]])
    elif keyword.startswith(("ELEMENT_", "SET_", "INCLUDE_", "NODE_")):
        found.left_out[f"*{keyword}"] = "blocks of this kind are not read"


def _set(found: Contents, what: str, title: str, rows: list[list[int]]) -> None:
    """Add a set by its title or its number, which is in its first row."""
    number = rows[0][0]
    if what == "NODE":
        found.nodes[title or f"nodes {number}"] = [node for row in rows[1:] for node in row if node]
        return
    for k, row in enumerate(rows[1:]):
        nodes = list(dict.fromkeys(node for node in row[:4] if node))
        found.add((LOW if len(nodes) == 2 else PLANE)[len(nodes)], (what, number, k), nodes)
        found.sets.setdefault(title or number, []).append((what, number, k))


def _elements(found: Contents, keyword: str, rows: Rows, width: int) -> None:
    """Add solids or shells. Their nodes are in the same row, or in the next one; repeated ones make simpler cells."""
    kinds = SOLID if keyword == "ELEMENT_SOLID" else PLANE
    held: list[int] = []
    for found.line, row in rows:
        held += _numbers(row, width)
        if len(held) > 2:
            element, part, *nodes = held
            nodes = list(dict.fromkeys(node for node in nodes if node))
            if len(nodes) not in kinds:
                raise ValueError(f"element {element} has {len(nodes)} nodes, which is not understood")
            found.add(kinds[len(nodes)], (keyword, element), nodes)
            found.sets.setdefault(part, []).append((keyword, element))
            held = []
    if held:
        raise ValueError(f"element {held[0]} has no nodes")


def _fields(row: str, *widths: int) -> list[str]:
    """Fields of a row between commas, or of these widths, of which the last one repeats."""
    if "," in row:
        return [word.strip() for word in row.split(",")]
    first = row[: widths[0]]
    rest = row[widths[0] :].rstrip()
    return [word.strip() for word in (first, *(rest[k : k + widths[-1]] for k in range(0, len(rest), widths[-1])))]


def _numbers(row: str, width: int) -> list[int]:
    return [int(float(word)) if word else 0 for word in _fields(row, width)]
