"""Two stacked blocks of edge 1 with independent meshes: patch tests, rotated scenes, curved
gaps.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial.transform import Rotation

from hhr_dolfinx.geometries.two_blocks import FIRST, SECOND, side, two_blocks

if TYPE_CHECKING:
    from mpi4py.MPI import Comm

    from hhr_dolfinx.compat import TaggedMesh

LOWER_BLOCK = FIRST
UPPER_BLOCK = SECOND
"""Cell tags of the two blocks."""


def interface(body: int, dim: int) -> int:
    """Facet tag of the side of a block that faces the other block.

    Args:
        body: cell tag of the block.
        dim: dimension of the mesh, 2 or 3.
    """
    return side(body, dim - 1, body == LOWER_BLOCK)


def outer_end(body: int, dim: int) -> int:
    """Facet tag of the side of a block that is opposite to its interface.

    Args:
        body: cell tag of the block.
        dim: dimension of the mesh, 2 or 3.
    """
    return side(body, dim - 1, body == UPPER_BLOCK)


def rotation(dim: int, angle: float) -> np.ndarray:
    """Rotation matrix of an angle, in space about the diagonal, (dim, dim).

    Args:
        dim: dimension of the mesh, 2 or 3.
        angle: angle in radians.
    """
    axis = np.array([0.0, 0.0, 1.0]) if dim == 2 else np.ones(3) / 3**0.5
    return Rotation.from_rotvec(angle * axis).as_matrix()[:dim, :dim]


def stacked_blocks(
    comm: Comm,
    *,
    lower: Sequence[int],
    upper: Sequence[int],
    angle: float = 0.0,
    bulge: float = 0.0,
    shift: float = 0.0,
    simplices: bool = False,
) -> TaggedMesh:
    """Build the mesh of both blocks on all ranks of ``comm``.

    Args:
        comm: MPI communicator.
        lower: cells of the lower block along each axis.
        upper: cells of the upper block along each axis.
        angle: rotation of both blocks, as in :func:`rotation`.
        bulge: height of the curved gap between the blocks, at their sides.
        shift: displacement of the upper block sideways, beyond the edge of the lower one.
        simplices: triangles or tetrahedra instead of quadrilaterals or hexahedra.
    """
    up = len(lower) - 1
    turn = rotation(len(lower), angle)

    def warp(points: np.ndarray, body: int) -> np.ndarray:
        """Coordinates, (n, dim), of ``points`` of the plain block ``body``."""
        points = points.copy()
        if body == UPPER_BLOCK:
            points[:, 0] += shift
            away = np.sum((points[:, :up] - 0.5) ** 2, axis=1)
            points[:, up] += 4 * bulge * away * (2 - points[:, up])
        return points @ turn.T

    boxes = [
        ((0.0,) * up + (float(k),), (1.0,) * up + (k + 1.0,), cells)
        for k, cells in enumerate((lower, upper))
    ]
    return two_blocks(comm, first=boxes[0], second=boxes[1], simplices=simplices, warp=warp)
