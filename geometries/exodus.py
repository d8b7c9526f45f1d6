"""Exodus files: blocks, side sets and node sets by name, which meshio reads in part only."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from hhr_dolfinx.compat import extra
from hhr_dolfinx.errors import FileContentError
from hhr_dolfinx.geometries.cells import CORNERS, FACES, one_kind, sides_of
from hhr_dolfinx.geometries.raw_mesh import RawMesh

_KINDS = {"TRI": "triangle", "QUA": "quadrilateral", "SHE": "quadrilateral", "TET": "tetrahedron", "HEX": "hexahedron",
          "WED": "prism", "PYR": "pyramid"}  # fmt: skip
"""Kinds of cells by the first letters of their names."""
_HEX_SIDES = ((0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7), (0, 1, 2, 3), (4, 5, 6, 7))
_TET_SIDES = ((0, 1, 3), (1, 2, 3), (0, 2, 3), (0, 1, 2))
_SIDES = FACES | {"hexahedron": _HEX_SIDES, "tetrahedron": _TET_SIDES}
"""Corners of the sides 1, 2, ... as Exodus counts them."""


def read_exodus(path: Path) -> RawMesh:
    """The mesh of an Exodus file; raises FileContentError for one of several kinds of cells."""
    with extra("mesh", f"the mesh file {path}"):
        import netCDF4
    with netCDF4.Dataset(path) as data:
        data.set_auto_mask(False)
        return _read(data, path)


def _read(data: Any, path: Path) -> RawMesh:
    count = len(data.dimensions["num_el_blk"])
    kinds = []
    blocks = []
    for k in range(1, count + 1):
        connected = data.variables[f"connect{k}"]
        kind = _KINDS.get(str(connected.elem_type).upper()[:3])
        if kind is None:
            raise FileContentError(f"{path}: block {k} has elements of type {connected.elem_type}: not understood")
        kinds.append(kind)
        blocks.append(np.asarray(connected[:], dtype=np.int64) - 1)
    kind = one_kind(kinds, path)
    sides = sides_of(kind, blocks, path, "exodus")
    cells = np.concatenate([block[:, : CORNERS[kind]] for block in blocks])
    starts = np.cumsum([0, *map(len, blocks)])
    bodies: dict[str | int, np.ndarray] = {}
    for k, (number, name) in enumerate(_labels(data, "eb", count)):
        rows = np.arange(starts[k], starts[k + 1])
        bodies |= {number: rows} | ({name: rows} if name else {})
    return RawMesh(_points(data), kind, cells, bodies, _side_sets(data, kind, cells), _node_sets(data), sides)


def _points(data: Any) -> np.ndarray:
    """Coordinates, (nodes, dim), as one array or one for each axis."""
    if "coord" in data.variables:
        return np.asarray(data.variables["coord"][:]).T
    return np.column_stack([data.variables[f"coord{axis}"][:] for axis in "xyz" if f"coord{axis}" in data.variables])


def _side_sets(data: Any, kind: str, cells: np.ndarray) -> dict[str | int, np.ndarray]:
    found: dict[str | int, np.ndarray] = {}
    count = len(data.dimensions["num_side_sets"]) if "num_side_sets" in data.dimensions else 0
    for k, (number, name) in enumerate(_labels(data, "ss", count), start=1):
        # of empty ones there is no variable
        if f"elem_ss{k}" not in data.variables:
            continue
        elements, sides = (
            np.asarray(data.variables[f"{what}_ss{k}"][:], dtype=np.int64) - 1 for what in ("elem", "side")
        )
        facets = np.take_along_axis(cells[elements], np.array(_SIDES[kind])[sides], axis=1)
        found |= {number: facets} | ({name: facets} if name else {})
    return found


def _node_sets(data: Any) -> dict[str, np.ndarray]:
    count = len(data.dimensions["num_node_sets"]) if "num_node_sets" in data.dimensions else 0
    return {name or f"nodes {number}": np.asarray(data.variables[f"node_ns{k}"][:], dtype=np.int64) - 1
            for k, (number, name) in enumerate(_labels(data, "ns", count), start=1)
            if f"node_ns{k}" in data.variables}  # fmt: skip


def _labels(data: Any, kind: str, count: int) -> list[tuple[int, str]]:
    """Number and name of the blocks or sets of a kind; an empty text where there is no name."""
    if not count:
        return []
    numbers = np.asarray(data.variables[f"{kind}_prop1"][:], dtype=np.int64).tolist()
    names = [""] * count
    if f"{kind}_names" in data.variables:
        rows = np.asarray(data.variables[f"{kind}_names"][:])
        names = [b"".join(letter for letter in row if letter).decode(errors="replace").strip("\x00 ") for row in rows]
    return list(zip(numbers, names, strict=True))
