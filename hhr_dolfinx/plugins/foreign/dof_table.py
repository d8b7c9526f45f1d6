"""Tables of dofs: the node and the direction of each row of a matrix, as codes and users write
them.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from hhr_dolfinx.errors import FileContentError, FileError

DIRECTIONS = {
    **{str(number): number for number in range(7)},
    **{
        f"{word}{axis}": place
        for word in ("U", "D", "T")
        for place, axis in enumerate("XYZ", start=1)
    },
    **{
        f"{word}{axis}": place
        for word in ("ROT", "DR", "R", "UR")
        for place, axis in enumerate("XYZ", start=4)
    },
}
"""Directions by the words of CalculiX and Abaqus (numbers), Ansys (UX, ROTX), code_aster (DX, DRX),
Nastran (T1, R1).
"""
DIRECTIONS |= {f"T{number}": number for number in (1, 2, 3)} | {
    f"R{number}": number + 3 for number in (1, 2, 3)
}
_LINE = re.compile(r"^\s*(?:(\d+)[\s,;]+)?N?(\d+)[\s.,;]+(\w+)\s*$")
_TITLE = re.compile(r"[A-Za-z#%*!]")


def read_dofs(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Nodes and directions of the rows of a matrix, (n,) each.

    A line is ``node.direction`` (CalculiX), ``node direction``, or ``row node direction`` (mapping
    files of Ansys), with blanks, commas or semicolons between; directions are numbers or words such
    as UX, ROTZ, DX, DRZ, T1. Lines that begin with a letter or with #, %, * or ! before the first
    dof are titles.

    Args:
        path: file of text.

    Raises:
        FileError: without the file.
        FileContentError: for a line that is no dof, and for rows that do not count from 1 on.
    """
    if not path.is_file():
        raise FileError(
            f"there is no table of dofs {path}: the node and the direction of each row of K"
        )
    rows: list[int] = []
    nodes: list[int] = []
    directions: list[int] = []
    for number, line in enumerate(
        path.read_text(encoding="utf-8", errors="replace").splitlines(), start=1
    ):
        if not line.strip() or (_TITLE.match(line.lstrip()) and not _LINE.match(line)):
            continue
        matched = _LINE.match(line)
        direction = DIRECTIONS.get(matched[3].upper()) if matched else None
        if matched is None or direction is None:
            raise FileContentError(
                f"{path.name}:{number} '{line.strip()}' is no dof: write node.direction, or row "
                "node direction, with "
                "directions 1 to 6, UX to ROTZ or DX to DRZ"
            )
        rows.append(int(matched[1]) if matched[1] else len(rows) + 1)
        nodes.append(int(matched[2]))
        directions.append(direction)
    order = np.argsort(rows, kind="stable")
    if sorted(rows) != list(range(1, len(rows) + 1)):
        raise FileContentError(
            f"the rows of {path.name} must be counted from 1 to {len(rows)}, each once"
        )
    return np.array(nodes, dtype=np.int64)[order], np.array(directions, dtype=np.int64)[order]


def write_dofs(path: Path, nodes: np.ndarray, directions: np.ndarray) -> None:
    """Write a table of dofs, a line ``node.direction`` for each row.

    Args:
        path: file to write.
        nodes, directions: of each row, (n,).
    """
    lines = [f"{node}.{direction}\n" for node, direction in zip(nodes, directions, strict=True)]
    path.write_text("".join(lines), encoding="utf-8")
