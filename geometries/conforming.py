"""Checks of conforming cells: distinct corners in a cell, one node for both cells of a side, facets
that are sides.

DOLFINx assumes all of this; otherwise it aborts the process, or corrupts memory.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from hhr_dolfinx.errors import FileContentError
from hhr_dolfinx.geometries.cells import EDGES, PLURAL, are_sides

if TYPE_CHECKING:
    from hhr_dolfinx.geometries.raw_mesh import RawMesh

COINCIDE = 1e-5
"""Distance of two nodes over the length of their side below which they coincide: files have about 7
digits.
"""


def conforming(raw: RawMesh) -> RawMesh:
    """The mesh with one node in the middle of each side, and surfaces of sides of cells only.

    Raises:
        FileContentError: for cells that have a node twice, or sides with several middle nodes at
            different positions.
    """
    _check_distinct(raw)
    joined = raw if raw.sides is None else _joined(raw, raw.sides)
    return _with_sides_only(joined)


def _check_distinct(raw: RawMesh) -> None:
    """Refuse cells that have a node twice, such as wedges written as hexahedra."""
    order = np.sort(raw.cells, axis=1)
    twice = (order[:, 1:] == order[:, :-1]).any(axis=1)
    if twice.any():
        middle = raw.points[raw.cells[twice][0]].mean(axis=0).round(6).tolist()
        raise FileContentError(
            f"{int(twice.sum())} of {len(raw.cells)} {PLURAL[raw.kind]} have a node twice, e.g. "
            f"around {middle}: collapsed cells are not supported. Mesh these places with whole "
            "cells"
        )


def _joined(raw: RawMesh, sides: np.ndarray) -> RawMesh:
    """The mesh with one of the coincident middle nodes of each side."""
    ends = np.sort(raw.cells[:, np.array(EDGES[raw.kind])].reshape(-1, 2), axis=1)
    _, first, which = np.unique(ends, axis=0, return_index=True, return_inverse=True)
    flat = sides.ravel()
    representative = flat[first][which.ravel()]
    lengths = np.linalg.norm(raw.points[ends[:, 0]] - raw.points[ends[:, 1]], axis=1)
    apart = (
        np.linalg.norm(raw.points[flat] - raw.points[representative], axis=1) > COINCIDE * lengths
    )
    if apart.any():
        _refuse(
            raw,
            ends[apart],
            "have nodes of their own in the middle of each of their cells, at different places",
        )
    _, firsts, counts = np.unique(representative[first], return_index=True, return_counts=True)
    shared = np.isin(representative[first], representative[first][firsts[counts > 1]])
    wrong = shared | np.isin(representative[first], raw.cells)
    if wrong.any():
        _refuse(
            raw,
            ends[first][wrong],
            "have a node in the middle that is that of another side or a corner of a cell",
        )
    if np.array_equal(representative, flat):
        return raw
    numbers = np.arange(len(raw.points))
    numbers[flat] = representative
    nodes = {name: np.unique(numbers[nodes_of]) for name, nodes_of in raw.nodes.items()}
    return replace(raw, sides=representative.reshape(sides.shape), nodes=nodes)


def _refuse(raw: RawMesh, ends: np.ndarray, what: str) -> None:
    """Raise the error for sides of second order that do not meet."""
    ends = np.unique(ends, axis=0)
    from_, to = raw.points[ends[0]].round(6).tolist()
    raise FileContentError(
        f"{len(ends)} sides of cells of second order {what}, e.g. the side from {from_} to {to}: "
        "neighbouring cells do not meet there. Merge coinciding nodes where the mesh is made "
        "(gmsh: Geometry.AutoCoherence, removeDuplicateNodes), or mesh with cells of first order "
        "and set order=2 in the scene"
    )


def _with_sides_only(raw: RawMesh) -> RawMesh:
    """The mesh with surfaces of sides of its cells only; ``left_out`` counts the other facets."""
    names = [name for name, facets in raw.surfaces.items() if len(facets)]
    if not names:
        return raw
    ends = np.cumsum([len(raw.surfaces[name]) for name in names])
    masks = np.split(
        are_sides(raw.kind, raw.cells, np.concatenate([raw.surfaces[name] for name in names])),
        ends[:-1],
    )
    surfaces = {name: raw.surfaces[name][mask] for name, mask in zip(names, masks, strict=True)}
    lost = {
        name: counted(int((~mask).sum()), raw.dim - 1)
        for name, mask in zip(names, masks, strict=True)
        if not mask.all()
    }
    reasons = {
        name: f"{count} of it belong to no cell: there are no shells, membranes or bars"
        for name, count in lost.items()
    }
    # the reasons of the reader are more specific
    return replace(raw, surfaces={**raw.surfaces, **surfaces}, left_out={**reasons, **raw.left_out})


def counted(count: int, dim: int) -> str:
    """A number of elements of a dimension, in words.

    Args:
        count: number of elements.
        dim: their dimension, 0 to 3.
    """
    noun = {0: "node", 1: "line", 2: "facet", 3: "cell"}[dim]
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"
