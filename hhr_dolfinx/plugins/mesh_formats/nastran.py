"""Meshes of Nastran's bulk data, ``.bdf`` and ``.nas``: grid points, elements, and the numbers of
their properties.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from hhr_dolfinx.geometries.raw_mesh import RawMesh
from hhr_dolfinx.plugins.mesh_formats.contents import LOW_KINDS, PLANE_KINDS, SOLID_KINDS, Contents

_SOLIDS = {
    "CTETRA": (4, 10),
    "CPYRAM": (5, 13),
    "CPYRA": (5, 13),
    "CPENTA": (6, 15),
    "CHEXA": (8, 20),
}
_PLANES = {"CTRIA3": (3,), "CTRIAR": (3,), "CTRIA6": (3, 6), "CTRIAX": (3, 6)}
_PLANES |= {
    "CQUAD4": (4,),
    "CQUADR": (4,),
    "CSHEAR": (4,),
    "CQUAD8": (4, 8),
    "CQUADX": (4, 8),
    "CQUAD": (4, 8),
}
_LINES = {"CROD": (2,), "CBAR": (2,), "CBEAM": (2,), "CTUBE": (2,), "CBEAM3": (2, 3)}
"""Numbers of nodes of the elements, of first and of second order."""
_KINDS = {name: (LOW_KINDS, counts) for name, counts in _LINES.items()}
_KINDS |= {name: (PLANE_KINDS, counts) for name, counts in _PLANES.items()}
_KINDS |= {name: (SOLID_KINDS, counts) for name, counts in _SOLIDS.items()}
WORDS = ("THRU", "SKIN")
"""Words in lists of nodes."""
DEFAULT_SYSTEM = ""
"""Name of no node, with the coordinate system of nodes that name none, by GRDSET."""
_OTHERS = re.compile(r"C(?!ORD|END)[A-Z]+\d*|RB\w+|RROD|RSPLINE|PLOTEL")


def read_nastran(path: Path) -> RawMesh:
    """Read a file with its includes.

    Raises:
        FileContentError: with the line, for a damaged file.
    """
    contents = Contents()
    systems: dict[int, tuple[str, np.ndarray]] = {}
    turned: dict[str, str] = {}
    _read(contents, systems, turned, path)
    with contents.reading(path):
        usual = turned.pop(DEFAULT_SYSTEM, "")
        for node, word in turned.items():
            if number := int(word or usual or 0):
                contents.points[node] = _in_space(contents.points[node], systems, number)
    return contents.mesh(path)


def _read(
    contents: Contents,
    systems: dict[int, tuple[str, np.ndarray]],
    turned: dict[str, str],
    path: Path,
) -> None:
    with contents.reading(path) as lines:
        for name, words in _cards(lines):
            if name == "INCLUDE":
                _read(contents, systems, turned, path.parent / words[0])
            else:
                _take(contents, systems, turned, name, words)


def _cards(lines: Iterator[str]) -> Iterator[tuple[str, list[str]]]:
    """Names of cards without the star of wide ones, and their fields.

    What precedes BEGIN BULK is no mesh.
    """
    name = ""
    words: list[str] = []
    for raw_line in lines:
        line = raw_line.partition("$")[0].expandtabs(8).rstrip()
        if re.match(r"\s*BEGIN\s+BULK", line, re.IGNORECASE):
            name = ""
        elif line.upper().startswith("ENDDATA"):
            break
        elif include := re.match(r"INCLUDE\s*['\"]?([^'\"]+)", line, re.IGNORECASE):
            yield "INCLUDE", [include[1].strip()]
        elif line:
            head, fields = _fields(line)
            if not head or head[0] in "+*":
                words += fields
                continue
            if name:
                yield name, words
            # meshio marks elements of second order by CHEXA_
            name = head.upper().rstrip("*_")
            words = fields
    if name:
        yield name, words


def _fields(line: str) -> tuple[str, list[str]]:
    """First field of a line, and the others: eight, or four wide ones, between commas or in fixed
    columns.
    """
    if "," in line:
        head, *fields = (word.strip() for word in line.split(","))
        count = 4 if "*" in head else 8
    else:
        head = line[:8].strip()
        width = 16 if "*" in head else 8
        count = 64 // width
        fields = [line[k : k + width].strip() for k in range(8, 72, width)]
    return head, (fields + [""] * count)[:count]


def _take(
    contents: Contents,
    systems: dict[int, tuple[str, np.ndarray]],
    turned: dict[str, str],
    name: str,
    words: list[str],
) -> None:
    """Add a card; those that are not part of a mesh are skipped."""
    if name == "GRID":
        contents.points[words[0]] = [_number(word) for word in words[2:5]]
        turned[words[0]] = words[1]
    elif name == "GRDSET":
        turned[DEFAULT_SYSTEM] = words[1]
    elif name in ("CORD2R", "CORD2C", "CORD2S"):
        if int(words[1] or 0):
            raise ValueError(
                f"coordinate system {words[0]} refers to system {words[1]}: write points in "
                "system 0"
            )
        systems[int(words[0])] = (
            name[-1],
            np.array([_number(word) for word in words[2:11]]).reshape(3, 3),
        )
    elif name == "CONROD":
        contents.add("line", words[0], words[1:3])
    elif name in _KINDS:
        kinds, counts = _KINDS[name]
        nodes = [word for word in words[2 : 2 + counts[-1]] if word]
        # a rod or a shell may have fewer nodes than fields
        if len(nodes) not in counts:
            raise ValueError(
                f"{name} {words[0]} has {len(nodes)} nodes, and not "
                f"{' or '.join(map(str, counts))}: elements of second order need all nodes on "
                "their edges"
            )
        contents.add(kinds[len(nodes)], words[0], nodes)
        if words[1]:
            contents.sets.setdefault(int(words[1]), []).append(words[0])
    elif name == "SET1" and any(
        word and not word.isdigit() and word.upper() not in WORDS for word in words[1:]
    ):
        contents.left_out[f"SET1 {words[0]}"] = "its list has other words than numbers and THRU"
    elif name == "SET1":
        contents.nodes.setdefault(f"SET1 {words[0]}", []).extend(_members(words[1:]))
    elif _OTHERS.fullmatch(name):
        contents.left_out[name] = "elements of this kind are not read"


def _members(words: Sequence[str]) -> Iterator[str]:
    """Numbers of a list in which ``1 THRU 9`` stands for all from 1 to 9."""
    items_of_list = [word.upper() for word in words if word and not word.upper().startswith("SKIN")]
    for k, word in enumerate(items_of_list):
        if word == "THRU":
            yield from map(str, range(int(items_of_list[k - 1]) + 1, int(items_of_list[k + 1])))
        else:
            yield str(int(word))


def _number(word: str) -> float:
    """A number; a blank is zero, and 1.5-3 stands for 1.5E-3."""
    return (
        float(re.sub(r"(?<=[\d.])([+-]\d+)$", r"E\1", word.upper().replace("D", "E")))
        if word
        else 0.0
    )


def _in_space(
    coordinates: Sequence[float], systems: dict[int, tuple[str, np.ndarray]], number: int
) -> list[float]:
    """Coordinates of a point of a rectangular, cylindrical or spherical system, with angles in
    degrees.

    Raises:
        ValueError: for a system that is not in the file.
    """
    if number not in systems:
        raise ValueError(
            f"grid points are in coordinate system {number}, and the file has no CORD2R, CORD2C "
            "or CORD2S of it: write them in system 0"
        )
    kind, (origin, on_axis, on_plane) = systems[number]
    upright = (on_axis - origin) / np.linalg.norm(on_axis - origin)
    across = np.cross(upright, on_plane - origin)
    across /= np.linalg.norm(across)
    axes = np.array([np.cross(across, upright), across, upright])
    first, second, third = coordinates
    if kind == "C":
        angle = np.deg2rad(second)
        coordinates = (first * np.cos(angle), first * np.sin(angle), third)
    elif kind == "S":
        down, angle = np.deg2rad([second, third])
        coordinates = (
            first * np.sin(down) * np.cos(angle),
            first * np.sin(down) * np.sin(angle),
            first * np.cos(down),
        )
    point: list[float] = (origin + np.array(coordinates) @ axes).tolist()
    return point
