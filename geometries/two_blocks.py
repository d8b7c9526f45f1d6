"""Two rectangular or cuboid blocks with independent meshes: non-matching contact, press fits, patch
tests.

In axisymmetry two rectangles in (r, z) are two thick-walled cylinders.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import permutations
from typing import TYPE_CHECKING

import numpy as np
from dolfinx import mesh as dmesh

from hhr_dolfinx.compat import geometry_dofmap, linear_mesh
from hhr_dolfinx.geometries import block
from hhr_dolfinx.geometries.partition import shares

if TYPE_CHECKING:
    from mpi4py.MPI import Comm

    from hhr_dolfinx.compat import TaggedMesh

Box = tuple[Sequence[float], Sequence[float], Sequence[int]]
"""Two corners of a block, and the cells along each axis."""
Warp = Callable[[np.ndarray, int], np.ndarray]
"""Map of the coordinates of all nodes of a body, (n, dim), and its tag to new coordinates."""

FIRST = 1
SECOND = 2
"""Cell tags of the two bodies."""


def side(body: int, axis: int, upper: bool) -> int:
    """Facet tag of a side of a body: 100 * body + 10 * (axis + 1), plus 1 on the upper side.

    Args:
        body: cell tag of the body.
        axis: axis across the side, from 0.
        upper: True for the side with the largest coordinate.
    """
    return 100 * body + block.side(axis, upper)


def two_blocks(
    comm: Comm,
    *,
    first: Box,
    second: Box,
    simplices: bool = False,
    warp: Warp | None = None,
    closed: int | None = None,
) -> TaggedMesh:
    """Build two structured blocks with every side tagged by :func:`side`.

    Args:
        comm: MPI communicator.
        first: ``(lower, upper, cells)`` of the first block: two corners and the cells along each
            axis.
        second: ``(lower, upper, cells)`` of the second block.
        simplices: triangles or tetrahedra instead of quadrilaterals or hexahedra.
        warp: map of the coordinates of all nodes of a body and its tag to new coordinates, ``((n,
            dim), tag) -> (n, dim)``, for instance to grade a mesh, to bend a surface or to rotate
            both blocks; None leaves the blocks as they are.
        closed: axis along which the last cells of both blocks end where the first begin, for a warp
            to rings.

    Raises:
        ValueError: for a block without volume or cells, or one that cannot close.
    """
    shapes = {FIRST: first, SECOND: second}
    for shape in shapes.values():
        block.check_box(*shape)
        if closed is not None:
            _check_closed(shape, closed)
    grids = {tag: _grid(shape, simplices, closed) for tag, shape in shapes.items()}
    dim = len(first[0])
    per_cell = grids[FIRST][1].shape[1]
    count = len(grids[FIRST][1])
    points = np.concatenate([grid[0] for grid in grids.values()])
    cells = np.concatenate([grids[FIRST][1], grids[SECOND][1] + len(grids[FIRST][0])])
    if comm.rank > 0:
        points = points[:0]
        cells = cells[:0]
    kind = {
        (2, 3): "triangle",
        (2, 4): "quadrilateral",
        (3, 4): "tetrahedron",
        (3, 8): "hexahedron",
    }[dim, per_cell]
    mesh = linear_mesh(
        comm, points.reshape(-1, dim), cells.reshape(-1, per_cell), kind, shares=shares
    )
    body = np.where(np.asarray(mesh.topology.original_cell_index) < count, FIRST, SECOND).astype(
        np.int32
    )
    cell_tags = dmesh.meshtags(mesh, dim, np.arange(body.size, dtype=np.int32), body)
    facet_tags = block.side_tags(mesh, body, shapes, side)
    if warp is not None:
        cell_nodes = geometry_dofmap(mesh)
        for tag in shapes:
            nodes = np.unique(cell_nodes[cell_tags.find(tag)])
            mesh.geometry.x[nodes, :dim] = warp(mesh.geometry.x[nodes, :dim], tag)
    return mesh, cell_tags, facet_tags


def _check_closed(box: Box, axis: int) -> None:
    """Raise ValueError if a block cannot close along an axis, since two cells would have the same
    corners.
    """
    cells = box[2]
    if isinstance(axis, bool) or axis not in range(len(cells)) or cells[axis] < 3:
        raise ValueError(
            f"closed = {axis!r} must be an axis of the mesh, from 0, with three cells at least: "
            f"{tuple(cells)}"
        )


def _grid(box: Box, simplices: bool, closed: int | None) -> tuple[np.ndarray, np.ndarray]:
    """Points (n, dim) and cells (c, 2^dim), or simplices (c, dim + 1), of one block."""
    lower, upper, cells = box
    dim = len(lower)
    axes = [
        np.linspace(low, high, count + 1)
        for low, high, count in zip(lower, upper, cells, strict=True)
    ]
    if closed is not None:
        axes[closed] = axes[closed][:-1]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, dim)
    numbers = np.arange(len(points)).reshape([axis.size for axis in axes])
    if closed is not None:
        numbers = np.concatenate([numbers, numbers.take([0], axis=closed)], axis=closed)
    # corners in tensor order: the first axis changes fastest
    corners = [
        numbers[
            tuple(slice(bit, count + bit) for bit, count in zip(bits[::-1], cells, strict=True))
        ].ravel()
        for bits in np.ndindex(*(2,) * dim)
    ]
    boxes = np.stack(corners, axis=1)
    if not simplices:
        return points, boxes
    # paths along the edges from the first corner to the last, which conform across neighbours
    paths = [np.cumsum([0, *(1 << axis for axis in order)]) for order in permutations(range(dim))]
    return points, np.concatenate([boxes[:, path] for path in paths])
