"""A spherical cap that faces the flat top of a block: one quarter of both, with meshes that do not
match.

Structured hexahedra, graded towards the point of first contact at the origin. The cap is the column
of a sphere above a square, the block a cuboid below it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hhr_dolfinx.geometries.two_blocks import FIRST, SECOND, side, two_blocks

if TYPE_CHECKING:
    from mpi4py.MPI import Comm

    from hhr_dolfinx.compat import TaggedMesh

SPHERE = FIRST
BLOCK = SECOND
"""Cell tags of the two bodies."""
SPHERE_BOTTOM, SPHERE_TOP, BLOCK_TOP, BLOCK_BOTTOM = (
    side(SPHERE, 2, False), side(SPHERE, 2, True), side(BLOCK, 2, True), side(BLOCK, 2, False),
)  # fmt: skip
SYMMETRY = {axis: (side(SPHERE, axis, False), side(BLOCK, axis, False)) for axis in (0, 1)}
"""Facet tags of the planes x = 0 and y = 0."""
BLOCK_SIDE = side(BLOCK, 0, True)
"""Facet tag of the outer side of the block along x."""


def sphere_on_block(
    comm: Comm,
    *,
    radius: float = 10.0,
    width: float = 0.5,
    depth: float = 1.0,
    gap: float = 0.0,
    sphere_cells: tuple[int, int] = (20, 10),
    block_cells: tuple[int, int] = (16, 8),
    grading: float = 3.0,
) -> TaggedMesh:
    """Build the mesh of both bodies on all ranks of ``comm``.

    Args:
        comm: MPI communicator.
        radius: radius R of the sphere, in the unit of length of the scene.
        width: width over R, at most 0.7, of the modelled square of the sphere and the block.
        depth: depth of the block over R, and height over R of the flat top of the sphere above the
            point of contact.
        gap: distance of sphere and block at the origin.
        sphere_cells: cells of the sphere along x and y, and along z.
        block_cells: cells of the block along x and y, and along z.
        grading: 0 for even cells; cells grow from the origin like the slope of sinh over [0,
            grading].

    Raises:
        ValueError: for a radius, width, depth or grading out of its range.
    """
    if radius <= 0 or not 0 < width <= 0.7 or grading < 0:
        raise ValueError(
            f"radius = {radius} must be positive, width = {width} in (0, 0.7], grading = "
            f"{grading} >= 0"
        )
    corner = 1 - (1 - 2 * width**2) ** 0.5
    if depth <= corner:
        raise ValueError(
            f"depth = {depth} must be above {corner:.3g}, where the sphere ends over a width of "
            f"{width}"
        )

    def warp(points: np.ndarray, tag: int) -> np.ndarray:
        """Coordinates, (n, 3), of ``points`` of the unit cube of body ``tag``."""
        x, y = (width * radius * _graded(points[:, axis], grading) for axis in (0, 1))
        if tag == BLOCK:
            return np.column_stack([x, y, -depth * radius * _graded(-points[:, 2], grading)])
        surface = radius - np.sqrt(radius**2 - x**2 - y**2)
        return np.column_stack(
            [x, y, gap + surface + (depth * radius - surface) * _graded(points[:, 2], grading)]
        )

    upper = ((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), (sphere_cells[0], sphere_cells[0], sphere_cells[1]))
    lower = ((0.0, 0.0, -1.0), (1.0, 1.0, 0.0), (block_cells[0], block_cells[0], block_cells[1]))
    return two_blocks(comm, first=upper, second=lower, warp=warp)


def indentation_cells(count: int) -> dict[str, tuple[int, int]]:
    """Cells for a soft block under a stiffer sphere, from one number.

    The block has finer cells than the sphere, since its strains are larger. With ``count`` in (10,
    14, 19, 25, 33) the bodies have 3500, 8200, 20,000, 44,000 and 97,000 unknowns, and the block
    (count + 1)^2 nodes on its top.

    Args:
        count: cells of the block along x and y, at least 4.

    Returns:
        The options ``sphere_cells`` and ``block_cells`` of :func:`sphere_on_block`.

    Raises:
        ValueError: for a count below 4.
    """
    if count < 4:
        raise ValueError(f"{count} cells along a side of the block are too few: give at least 4")
    along = [round(share * count) for share in (0.8, 0.31, 0.6)]
    return {"sphere_cells": (along[0], along[1]), "block_cells": (count, along[2])}


def _graded(position: np.ndarray, grading: float) -> np.ndarray:
    """Map [0, 1] onto itself, denser towards 0."""
    return np.sinh(grading * position) / np.sinh(grading) if grading > 0 else position
