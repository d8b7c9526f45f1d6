"""A rectangular or cuboid block, for obstacle contact and for tests with closed-form answers."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from dolfinx import mesh as dmesh

if TYPE_CHECKING:
    from mpi4py.MPI import Comm

    from hhr_dolfinx.compat import TaggedMesh

SOLID = 1
"""Cell tag of the block."""


def side(axis: int, upper: bool) -> int:
    """Facet tag of a side: 10 * (axis + 1), plus 1 on the upper side.

    Args:
        axis: axis across the side, from 0.
        upper: True for the side with the largest coordinate.
    """
    return 10 * (axis + 1) + int(upper)


def check_box(lower: Sequence[float], upper: Sequence[float], cells: Sequence[int]) -> None:
    """Check that a box has a volume and cells.

    Args:
        lower: corner with the smallest coordinates, length 2 or 3.
        upper: corner with the largest coordinates.
        cells: number of cells along each axis.

    Raises:
        ValueError: for a box without volume or cells.
    """
    sizes = {np.size(lower), np.size(upper), np.size(cells)}
    fits = (
        sizes in ({2}, {3})
        and np.all(np.less(lower, upper))
        and np.issubdtype(np.asarray(cells).dtype, np.integer)
    )
    if not fits or np.min(cells) < 1:
        raise ValueError(
            f"a block from {tuple(lower)} to {tuple(upper)} with {cells} cells needs 2 or 3 of "
            "each: corners with increasing coordinates, and positive integers of cells"
        )


def block(
    comm: Comm,
    *,
    lower: Sequence[float],
    upper: Sequence[float],
    cells: Sequence[int],
    simplices: bool = False,
) -> TaggedMesh:
    """Build a structured block with every side tagged by :func:`side`.

    Args:
        comm: MPI communicator.
        lower: corner with the smallest coordinates, length 2 or 3.
        upper: corner with the largest coordinates.
        cells: number of cells along each axis.
        simplices: triangles or tetrahedra instead of quadrilaterals or hexahedra.

    Returns:
        The mesh, its cell tags, :data:`SOLID`, and its facet tags.

    Raises:
        ValueError: for a box without volume or cells.
    """
    check_box(lower, upper, cells)
    dim = len(lower)
    create, kinds = (
        (dmesh.create_rectangle, (dmesh.CellType.quadrilateral, dmesh.CellType.triangle))
        if dim == 2
        else (dmesh.create_box, (dmesh.CellType.hexahedron, dmesh.CellType.tetrahedron))
    )
    corners = [np.asarray(corner, dtype=float) for corner in (lower, upper)]
    mesh = create(comm, corners, list(cells), cell_type=kinds[int(simplices)])
    count = mesh.topology.index_map(dim).size_local + mesh.topology.index_map(dim).num_ghosts
    cells_of = np.full(count, SOLID, dtype=np.int32)
    cell_tags = dmesh.meshtags(mesh, dim, np.arange(count, dtype=np.int32), cells_of)
    return (
        mesh,
        cell_tags,
        side_tags(mesh, cells_of, {SOLID: (lower, upper)}, lambda body, axis, end: side(axis, end)),
    )


def side_tags(
    mesh: dmesh.Mesh,
    body: np.ndarray,
    boxes: Mapping[int, Sequence[Sequence[float]]],
    name: Callable[[int, int, bool], int],
) -> dmesh.MeshTags:
    """Tag the sides of bodies that are boxes; the body of a facet is that of the cell behind it.

    Args:
        mesh: mesh of the bodies.
        body: cell tag of each cell of this rank.
        boxes: smallest and largest corner of each body by its cell tag.
        name: function of a body, an axis and a flag for the upper side that returns the facet tag.
    """
    dim = mesh.topology.dim
    mesh.topology.create_connectivity(dim - 1, dim)
    to_cell = mesh.topology.connectivity(dim - 1, dim)
    facets_of = []
    values = []
    for tag, (lower, upper, *_) in boxes.items():
        size = float(np.max(np.subtract(upper, lower)))
        for axis in range(dim):
            for is_upper, at in ((False, lower[axis]), (True, upper[axis])):
                on_side = dmesh.locate_entities_boundary(
                    mesh,
                    dim - 1,
                    lambda x, axis=axis, at=at, size=size: np.abs(x[axis] - at) < 1e-9 * size,
                )
                of_body = np.array(
                    [body[to_cell.links(facet)[0]] == tag for facet in on_side], dtype=bool
                )
                facets_of.append(on_side[of_body])
                values.append(np.full(of_body.sum(), name(tag, axis, is_upper), dtype=np.int32))
    facets = np.concatenate(facets_of)
    order = np.argsort(facets)
    return dmesh.meshtags(mesh, dim - 1, facets[order], np.concatenate(values)[order])
