"""Meshes read by meshio: blocks of elements, with sets by name and arrays of numbers."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from contextlib import redirect_stderr, redirect_stdout, suppress
from dataclasses import dataclass, field
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hhr_dolfinx.compat import extra
from hhr_dolfinx.errors import FileContentError
from hhr_dolfinx.geometries.cells import (
    CELL_KINDS,
    CORNERS,
    DIMENSION,
    FACES,
    FACET_KINDS,
    OTHERS,
    of_other_kinds,
    one_kind,
    sides_of,
)
from hhr_dolfinx.geometries.raw_mesh import RawMesh

if TYPE_CHECKING:
    import meshio

Sets = dict[str | int, np.ndarray]
Groups = list[tuple[str, tuple[int, int]]]
"""Names with number and dimension."""

MARKERS = ("gmsh:physical", "cell_tags", "medit:ref", "gambit:group", "su2:tag", "MaterialID")
"""Arrays that are known to number bodies and surfaces; 0 stands for no number."""
NO_MARKERS = (
    "vtkghosttype",
    "vtkoriginalcellids",
    "globalcellid",
    "globalcellids",
    "globalelementid",
    "cell_ids",
)
"""Arrays of integers, in small letters, that do not number bodies."""
_ONE = np.ones(1)
MOST_MARKERS = 1000
"""Largest count of different numbers in an array of unknown name that may number bodies and
surfaces.
"""


@dataclass(frozen=True, eq=False)
class Elements:
    """Elements of one kind.

    Attributes:
        type: meshio's name of the kind.
        nodes: nodes of each element, (b, K).
        numbers: arrays of numbers of the elements, (b,), by name.
        sets: indices of elements, by name of the set.
    """

    type: str
    nodes: np.ndarray
    numbers: Mapping[str, np.ndarray] = field(default_factory=dict)
    sets: Mapping[str, np.ndarray] | Mapping[str | int, np.ndarray] = field(default_factory=dict)

    @property
    def kind(self) -> str:
        """Kind of cells; empty for elements that are no cells."""
        return CELL_KINDS.get(self.type) or next(
            (kind for start, kind in OTHERS.items() if self.type.startswith(start)), ""
        )


def opened(path: Path) -> meshio.Mesh:
    """The mesh of meshio in a file.

    Raises:
        FileContentError: if meshio does not know its format.
    """
    with extra("mesh", f"the mesh file {path}"):
        import meshio
    output = StringIO()
    # meshio prints errors on the console and ends the program
    try:
        with redirect_stdout(output), redirect_stderr(output):
            return meshio.read(path)
    except SystemExit:
        reason = (
            " ".join(output.getvalue().split())
            or f"meshio does not read files that end in {path.suffix}"
        )
        raise FileContentError(
            f"mesh file {path} cannot be read: {reason}. It is damaged, or of a kind that meshio "
            "does not know: write it as .msh, .inp, .med, .e or .vtu"
        ) from None


def read_by_meshio(path: Path) -> RawMesh:
    """Read a mesh file by meshio.

    Raises:
        FileContentError: if meshio cannot read it, or its elements do not form a mesh.
    """
    mesh = opened(path)
    arrays = _arrays(mesh.cell_data)
    elements = [
        Elements(
            block.type,
            np.asarray(block.data),
            {name: blocks[k] for name, blocks in arrays.items()},
            _places(mesh.cell_sets, k),
        )
        for k, block in enumerate(mesh.cells)
    ]
    names = _physical_names(path) or _names_of_fields(mesh.field_data)
    names += [
        (name, (int(number), -1))
        for number, tags in getattr(mesh, "cell_tags", {}).items()
        for name in tags
    ]
    nodes = {str(name): np.asarray(rows) for name, rows in mesh.point_sets.items()}
    fields = [name for name in mesh.point_data if not name.startswith(("gmsh:", "medit:"))]
    left_out: dict[str | int, str] = {"values at nodes": ", ".join(fields)} if fields else {}
    return raw_mesh(
        mesh.points,
        elements,
        path,
        names=[*names, *_markers_of_su2(path)],
        nodes=nodes,
        left_out=left_out,
    )


def _arrays(data: Mapping[str, Sequence[np.ndarray]]) -> dict[str, list[np.ndarray]]:
    """Arrays of a mesh with an integer for each element of all blocks, (b,) each, by name."""
    arrays = {}
    for name, blocks in data.items():
        values = [np.asarray(block) for block in blocks]
        candidates = [whole_numbers(block.ravel()) for block in values if block.size == len(block)]
        if len(integers := [block for block in candidates if block is not None]) == len(values):
            arrays[name] = integers
    return arrays


def whole_numbers(values: np.ndarray) -> np.ndarray | None:
    """The array as integers; None if any of its values is no integer."""
    if np.issubdtype(values.dtype, np.integer):
        return values.astype(np.int64)
    finite = np.issubdtype(values.dtype, np.floating) and bool((np.abs(values) < 2**31).all())
    return values.astype(np.int64) if finite and bool((values == np.rint(values)).all()) else None


def _places(sets: Mapping[str, Sequence[np.ndarray | None]], k: int) -> dict[str, np.ndarray]:
    """Indices of the elements of a block in each of the named sets of meshio."""
    return {
        name.strip(): np.asarray(rows[k], dtype=np.int64)
        for name, rows in sets.items()
        if not name.startswith("gmsh:") and rows[k] is not None
    }


def _physical_names(path: Path) -> Groups:
    """Names of gmsh with number and dimension: if a body and a surface have the same name, meshio
    keeps the last.
    """
    if path.suffix.lower() != ".msh":
        return []
    text = path.read_bytes().partition(b"$PhysicalNames")[2].partition(b"$EndPhysicalNames")[0]
    rows = re.findall(
        r'^\s*(\d+)\s+(\d+)\s+"(.*)"\s*$', text.decode(errors="replace"), re.MULTILINE
    )
    return [(name, (int(number), int(dim))) for dim, number, name in rows]


def _names_of_fields(fields: Mapping[str, Sequence[int]]) -> Groups:
    """Names with number and dimension from the field data of meshio."""
    groups: Groups = []
    for name, group in fields.items():
        with suppress(TypeError, ValueError, IndexError):
            groups.append((name.strip(), (int(group[0]), int(group[1]))))
    return groups


def _markers_of_su2(path: Path) -> Groups:
    """Names of the markers of SU2 with meshio's numbers: a text gets the last number plus one."""
    if path.suffix.lower() != ".su2":
        return []
    text = path.read_text(errors="replace")
    dim = re.search(r"^\s*NDIME\s*=\s*(\d)", text, re.MULTILINE)
    groups: Groups = []
    number = 0
    for word in re.findall(r"^\s*MARKER_TAG\s*=\s*(.*?)\s*$", text, re.MULTILINE):
        text_only = not word.lstrip("+-").isdigit()
        number = number + 1 if text_only else int(word)
        if text_only and dim:
            groups.append((word, (number, int(dim[1]) - 1)))
    return groups


def raw_mesh(
    points: np.ndarray,
    elements: Sequence[Elements],
    path: Path,
    *,
    names: Iterable[tuple[str, tuple[int, int]]] = (),
    nodes: Mapping[str, np.ndarray] | None = None,
    left_out: Mapping[str | int, str] | None = None,
) -> RawMesh:
    """Make a mesh of blocks of elements.

    It has the cells of the highest dimension, their facets, and the sets of both.

    Args:
        points: coordinates, (n, 2 or 3).
        elements: blocks of all kinds of elements.
        path: path of the file, for messages.
        names: names of numbers, with their dimension, or -1 for all.
        nodes: sets of nodes by name.
        left_out: reasons of the reader for names that are left out.

    Raises:
        FileContentError: for elements that do not form a mesh.
    """
    cell_blocks = [block for block in elements if block.kind]
    if not cell_blocks:
        raise FileContentError(f"{path} {_without_cells(elements)}")
    dim = max(DIMENSION.get(block.kind, 3) for block in cell_blocks)
    kind, other_kinds = one_kind(
        ((b.kind, b.nodes) for b in cell_blocks if DIMENSION.get(b.kind, 3) == dim), path
    )
    blocks = [block for block in cell_blocks if block.kind == kind]
    order = sides_of(kind, (block.nodes for block in blocks), path)
    width = len(FACES[kind][0])
    sides = [
        block for block in elements if FACET_KINDS.get(block.type) == width and block.kind != kind
    ]
    bodies, body_reasons = _sets(blocks, dim, names)
    facet_sets, surface_reasons = _sets(sides, dim - 1, names)
    facets = _corners(sides, width)
    smaller = [
        block
        for block in elements
        if block not in blocks and block not in sides and block not in cell_blocks
    ]
    reasons = {**other_kinds, **body_reasons, **surface_reasons, **(left_out or {})}
    cells = _corners(blocks, CORNERS[kind])
    others = [b for b in cell_blocks if b.kind != kind and DIMENSION.get(b.kind, 3) == dim]
    lost = _kinds_by_name(others, dim, names)
    reasons |= of_other_kinds(lost, kind)
    if not any(bodies) or (
        len(bodies) == 1
        and not any(block.numbers.get("gmsh:physical", _ONE).any() for block in blocks)
    ):
        # elements have no number, or 0, or all have that of the only entity of gmsh
        bodies = {1: np.arange(len(cells)), **bodies}
    bodies = {name: rows for name, rows in bodies.items() if name not in lost}
    surfaces = {name: facets[rows] for name, rows in facet_sets.items()}
    return RawMesh(
        points,
        kind,
        cells,
        bodies,
        surfaces,
        {**_smaller(smaller, names), **(nodes or {})},
        order,
        reasons,
    )


def _without_cells(elements: Iterable[Elements]) -> str:
    """What a file has in the place of cells, and what to do."""
    kinds = sorted({block.type for block in elements})
    high = any(kind.rstrip("0123456789") in CELL_KINDS for kind in kinds)
    why = (
        "it is empty, or of a format that is not understood. Write it as .msh, .inp, .med, .e "
        "or .vtu"
    )
    return (
        f"has cells of kinds {kinds}, and no triangles, quadrilaterals, tetrahedra or hexahedra of "
        "order 1 or 2: "
        f"{'mesh with cells of these orders, in gmsh by setOrder(2)' if high else why}"
    )


def _kinds_by_name(
    blocks: Iterable[Elements], dim: int, names: Iterable[tuple[str, tuple[int, int]]]
) -> dict[str | int, Counter[str]]:
    """Counts of elements by kind of each set of some blocks."""
    found: dict[str | int, Counter[str]] = {}
    for block in blocks:
        for name, rows in _sets([block], dim, names)[0].items():
            found.setdefault(name, Counter())[block.kind] += len(rows)
    return found


def _corners(blocks: Iterable[Elements], count: int) -> np.ndarray:
    """Corners of the elements of some blocks, (c, count)."""
    return np.concatenate(
        [np.zeros((0, count), dtype=np.int64), *(block.nodes[:, :count] for block in blocks)]
    )


def _sets(
    blocks: Sequence[Elements], dim: int, names: Iterable[tuple[str, tuple[int, int]]]
) -> tuple[Sets, dict[str | int, str]]:
    """Sets of indices in the concatenated blocks, by name or number, and reasons for numbers that
    are left out.
    """
    starts = np.cumsum([0, *(len(block.nodes) for block in blocks)])
    rows_of: dict[str | int, list[np.ndarray]] = {}
    for start, block in zip(starts, blocks, strict=False):
        for name, rows in block.sets.items():
            rows_of.setdefault(name, []).append(start + rows)
    sets: Sets = {name: np.concatenate(rows) for name, rows in rows_of.items()}
    numbered, left_out = _numbered(_whole_arrays(blocks, starts))
    of_number: dict[str | int, list[str]] = {}
    for name, (number, of) in names:
        if of in (dim, -1):
            of_number.setdefault(number, []).append(name.strip())
    for tag, rows in numbered.items():
        for name in (tag, *of_number.get(tag, ())):
            if name not in rows_of:
                sets[name] = np.concatenate([sets[name], rows]) if name in sets else rows
    return {name: rows for name, rows in sets.items() if rows.size}, left_out


def _whole_arrays(
    blocks: Sequence[Elements], starts: np.ndarray
) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Indices and values of the arrays that may number bodies or surfaces: known ones, else gmsh's,
    else others.
    """
    pairs_of: dict[str, list[tuple[np.ndarray, np.ndarray]]] = {}
    for start, block in zip(starts, blocks, strict=False):
        for name, values in block.numbers.items():
            keep = (
                np.flatnonzero(values > 0)
                if name in (*MARKERS, "gmsh:geometrical")
                else np.flatnonzero(values >= 0)
            )
            if keep.size:
                pairs_of.setdefault(name, []).append((start + keep, values[keep]))
    joined = {
        name: (np.concatenate([p for p, _ in pairs]), np.concatenate([v for _, v in pairs]))
        for name, pairs in pairs_of.items()
    }
    for names in (
        [name for name in MARKERS if name in joined],
        [name for name in joined if name == "gmsh:geometrical"],
    ):
        if names:
            return {name: joined[name] for name in names}
    return {
        name: pairs
        for name, pairs in joined.items()
        if name.lower() not in NO_MARKERS and np.unique(pairs[1]).size <= MOST_MARKERS
    }


def _numbered(
    arrays: Mapping[str, tuple[np.ndarray, np.ndarray]],
) -> tuple[Sets, dict[str | int, str]]:
    """Indices by number.

    With several arrays also by ``array:number``, the only name of a number in several arrays.
    """
    sets: Sets = {}
    left_out: dict[str | int, str] = {}
    holders: dict[int, list[str]] = {}
    has_markers = any(name in MARKERS for name in arrays)
    for name, (indices, values) in arrays.items():
        for number in np.unique(values).tolist():
            rows = indices[values == number]
            holders.setdefault(number, []).append(name)
            sets[number] = np.concatenate([sets[number], rows]) if number in sets else rows
            if len(arrays) > 1:
                sets[f"{name}:{number}"] = rows
    for number, names in holders.items():
        if len(names) > 1 and not has_markers:
            del sets[number]
            left_out[number] = (
                "is in several arrays: name it "
                f"{' or '.join(repr(f'{name}:{number}') for name in names)}"
            )
    return sets, left_out


def _smaller(
    blocks: Iterable[Elements], names: Iterable[tuple[str, tuple[int, int]]]
) -> dict[str, np.ndarray]:
    """Nodes of named sets of elements of too low a dimension for facets, such as lines in space."""
    node_sets: dict[str, np.ndarray] = {}
    for block in blocks:
        dim = {"vertex": 0, "line": 1, "line3": 1}.get(block.type, 2)
        sets, _ = _sets([block], dim, names)
        named = {number for _, (number, of) in names if of in (dim, -1)}
        grouped = block.numbers.get("gmsh:physical", _ONE[:0]).any()
        for name, rows in sets.items():
            key = (
                name
                if isinstance(name, str)
                else f"nodes {name}"
                if grouped and name not in named
                else ""
            )
            if key:
                node_sets[key] = np.union1d(node_sets.get(key, rows[:0]), block.nodes[rows].ravel())
    return node_sets
