"""Exodus files: blocks, side sets and node sets by name, which meshio reads only in part."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hhr_dolfinx.compat import netcdf_read
from hhr_dolfinx.errors import FileContentError
from hhr_dolfinx.geometries.cells import (
    CORNERS,
    DIMENSION,
    FACES,
    of_other_kinds,
    one_kind,
    sides_of,
)
from hhr_dolfinx.geometries.raw_mesh import RawMesh

if TYPE_CHECKING:
    from netCDF4 import Dataset

_KINDS = {
    "TRI": "triangle",
    "QUA": "quadrilateral",
    "TET": "tetrahedron",
    "HEX": "hexahedron",
    "WED": "prism",
    "PYR": "pyramid",
}
"""Kinds of cells by the first letters of their names."""
_HEX_SIDES = ((0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7), (0, 1, 2, 3), (4, 5, 6, 7))
_TET_SIDES = ((0, 1, 3), (1, 2, 3), (0, 2, 3), (0, 1, 2))
_SIDES = FACES | {"hexahedron": _HEX_SIDES, "tetrahedron": _TET_SIDES}
"""Corners of the sides 1, 2, ... of Exodus."""


def read_exodus(path: Path) -> RawMesh:
    """Read the mesh of an Exodus file.

    Raises:
        FileContentError: for a file without cells, or with several kinds that touch.
    """
    with netcdf_read(path, f"the mesh file {path}") as data:
        return _read(data, path)


def _read(data: Dataset, path: Path) -> RawMesh:
    count = len(data.dimensions["num_el_blk"])
    labels = _labels(data, "eb", count)
    blocks = [_Block.of(data, k, *labels[k - 1]) for k in range(1, count + 1)]
    dim = max((DIMENSION.get(block.kind, 3) for block in blocks if block.kind), default=0)
    if not dim:
        types = ", ".join(sorted({block.type for block in blocks}))
        raise FileContentError(
            f"{path} has elements of type {types}, and no triangles, quadrilaterals, tetrahedra "
            "or hexahedra"
        )
    solid = [block for block in blocks if block.kind and DIMENSION.get(block.kind, 3) == dim]
    kind, left_out = one_kind(((block.kind, block.nodes) for block in solid), path)
    main = [block for block in solid if block.kind == kind]
    sides = sides_of(kind, [block.nodes for block in main], path, "exodus")
    cells = np.concatenate([block.nodes[:, : CORNERS[kind]] for block in main])
    starts = np.cumsum([0, *(len(block.nodes) for block in main)])
    bodies: dict[str | int, np.ndarray] = {}
    for k, block in enumerate(main):
        bodies |= dict.fromkeys(block.names, np.arange(starts[k], starts[k + 1]))
    # side sets count the elements of all blocks
    row_of = np.full(sum(len(block.nodes) for block in blocks), -1)
    row_of[np.concatenate([block.first + np.arange(len(block.nodes)) for block in main])] = (
        np.arange(len(cells))
    )
    surfaces, reasons = _side_sets(data, kind, cells, row_of)
    width = len(FACES[kind][0])
    for block in blocks:
        if block.corners == width and DIMENSION.get(block.kind, 1) == dim - 1:
            surfaces |= {
                name: block.nodes[:, :width] for name in block.names if name not in surfaces
            }
        elif block in solid and block not in main:
            left_out |= of_other_kinds(
                {name: {block.kind: len(block.nodes)} for name in block.names}, kind
            )
        elif block not in main:
            reason = (
                f"a block of {len(block.nodes)} elements of type {block.type}, which are no cells"
            )
            left_out |= dict.fromkeys(block.names, reason)
    return RawMesh(
        _points(data), kind, cells, bodies, surfaces, _node_sets(data), sides, left_out | reasons
    )


@dataclass(frozen=True, eq=False)
class _Block:
    """Elements of one type.

    Attributes:
        type: name of the type in the file.
        kind: kind of cells; empty for elements that are no cells.
        corners: number of corners of an element; 0 if it is unknown.
        nodes: rows of all nodes, (b, K).
        first: number in the file of the first element.
        names: number of the block, and its name if it has one.
    """

    type: str
    kind: str
    corners: int
    nodes: np.ndarray
    first: int
    names: tuple[str | int, ...]

    @classmethod
    def of(cls, data: Dataset, k: int, number: int, name: str) -> _Block:
        """Block k = 1, 2, ... of a file; an empty one has no variable.

        Args:
            data: the open file.
            k: position of the block in the file, from 1.
            number: number of the block.
            name: name of the block, empty without one.
        """
        sizes = [
            len(data.dimensions[f"num_el_in_blk{j}"])
            if f"num_el_in_blk{j}" in data.dimensions
            else 0
            for j in range(1, k + 1)
        ]
        names = (number, name) if name else (number,)
        if f"connect{k}" not in data.variables:
            return cls("none", "", 0, np.zeros((0, 0), dtype=np.int64), sum(sizes[:-1]), names)
        connected = data.variables[f"connect{k}"]
        type_ = str(getattr(connected, "elem_type", "")).upper()
        nodes = np.asarray(connected[:], dtype=np.int64) - 1
        line = type_.startswith(("BAR", "BEA", "EDG", "LIN", "TRU"))
        kind = (
            ""
            if line
            else _kind(
                type_,
                nodes.shape[1],
                "num_dim" in data.dimensions and len(data.dimensions["num_dim"]),
            )
        )
        corners = 2 if line else CORNERS.get(kind, 0)
        return cls(type_, kind, corners, nodes, sum(sizes[:-1]), names)


def _kind(type_: str, count: int, dim: int) -> str:
    """Kind of cells of a type; empty for other elements.

    Some writers name the lines of plane meshes shells.
    """
    if type_.startswith("SHE"):
        return "" if dim == 2 else "triangle" if count in (3, 6) else "quadrilateral"
    return _KINDS.get(type_[:3], "")


def _points(data: Dataset) -> np.ndarray:
    """Coordinates, (nodes, dim), as one array or one for each axis."""
    if "coord" in data.variables:
        return np.asarray(data.variables["coord"][:]).T
    return np.column_stack(
        [data.variables[f"coord{axis}"][:] for axis in "xyz" if f"coord{axis}" in data.variables]
    )


def _side_sets(
    data: Dataset, kind: str, cells: np.ndarray, row_of: np.ndarray
) -> tuple[dict[str | int, np.ndarray], dict[str | int, str]]:
    """Corners of the facets of side sets, and reasons for side sets of other elements, which are
    left out.
    """
    surfaces: dict[str | int, np.ndarray] = {}
    reasons: dict[str | int, str] = {}
    count = len(data.dimensions["num_side_sets"]) if "num_side_sets" in data.dimensions else 0
    for k, (number, name) in enumerate(_labels(data, "ss", count), start=1):
        # an empty set has no variable
        if f"elem_ss{k}" not in data.variables:
            continue
        elements, sides = (
            np.asarray(data.variables[f"{variable}_ss{k}"][:], dtype=np.int64) - 1
            for variable in ("elem", "side")
        )
        rows = row_of[elements]
        valid = (rows >= 0) & (sides < len(_SIDES[kind]))
        if not valid.all():
            reasons[name or number] = (
                f"{int((~valid).sum())} of its {len(rows)} sides are of elements that are no cells"
            )
        facets = np.take_along_axis(
            cells[rows[valid]], np.array(_SIDES[kind])[sides[valid]], axis=1
        )
        surfaces |= {number: facets} | ({name: facets} if name else {})
    return surfaces, reasons


def _node_sets(data: Dataset) -> dict[str, np.ndarray]:
    count = len(data.dimensions["num_node_sets"]) if "num_node_sets" in data.dimensions else 0
    return {
        name or f"nodes {number}": np.asarray(data.variables[f"node_ns{k}"][:], dtype=np.int64) - 1
        for k, (number, name) in enumerate(_labels(data, "ns", count), start=1)
        if f"node_ns{k}" in data.variables
    }


def _labels(data: Dataset, kind: str, count: int) -> list[tuple[int, str]]:
    """Number and name of the blocks or sets of a kind; empty if there is no name."""
    if not count:
        return []
    numbers = np.asarray(data.variables[f"{kind}_prop1"][:], dtype=np.int64).tolist()
    names = [""] * count
    if f"{kind}_names" in data.variables:
        rows = np.asarray(data.variables[f"{kind}_names"][:])
        names = [
            b"".join(letter for letter in row if letter).decode(errors="replace").strip("\x00 ")
            for row in rows
        ]
    return list(zip(numbers, names, strict=True))
