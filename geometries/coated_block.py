"""A spherical cap above a block with a coating, axisymmetric in (r, z), with nodes that face each
other.

Structured quadrilaterals, graded towards the point of first contact at the origin.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from dolfinx import mesh as dmesh

from hhr_dolfinx.compat import geometry_dofmap
from hhr_dolfinx.geometries.two_blocks import FIRST, SECOND, side, two_blocks

if TYPE_CHECKING:
    from mpi4py.MPI import Comm

    from hhr_dolfinx.compat import TaggedMesh

SPHERE = FIRST
BLOCK = SECOND
COATING = 3
"""Cell tags of the three bodies; block and coating share nodes."""
SPHERE_BOTTOM = side(SPHERE, 1, False)
SPHERE_TOP = side(SPHERE, 1, True)
COATING_TOP = side(BLOCK, 1, True)
BLOCK_BOTTOM = side(BLOCK, 1, False)
AXIS = side(SPHERE, 0, False), side(BLOCK, 0, False)
"""Facet tags of the axis."""


def coated_block(
    comm: Comm,
    *,
    radius: float = 5.0,
    width: float = 1.5,
    thickness: float = 0.1,
    cells: tuple[int, int] = (48, 24),
    layers: int = 6,
    grading: float = 3.5,
) -> TaggedMesh:
    """Build the mesh of all bodies on all ranks of ``comm``.

    Args:
        comm: MPI communicator.
        radius: radius of the sphere, in the unit of length of the scene.
        width: radius of the modelled column, and the height of both bodies.
        thickness: thickness of the coating.
        cells: cells of each body along the radius and along the axis.
        layers: cells of the coating along the axis, among those of the block.
        grading: 0 for even cells; cells grow from the origin like the slope of sinh over [0,
            grading].

    Raises:
        ValueError: for a width, a thickness or layers that do not fit.
    """
    if not 0 < width < radius or not 0 < thickness < width or not 0 < layers < cells[1]:
        raise ValueError(
            f"width = {width}, thickness = {thickness} and layers = {layers} must fit in the block"
        )

    def warp(points: np.ndarray, tag: int) -> np.ndarray:
        """Coordinates, (n, 2), of ``points`` of the unit square of body ``tag``."""
        r = width * _graded(points[:, 0], grading)
        if tag == BLOCK:
            share = layers / cells[1]
            depth = -points[:, 1]
            below = np.maximum(depth - share, 0.0) / (1 - share)
            return np.column_stack(
                [
                    r,
                    -np.where(
                        depth <= share,
                        thickness * depth / share,
                        thickness + (width - thickness) * _graded(below, 2.0),
                    ),
                ]
            )
        surface = radius - np.sqrt(radius**2 - r**2)
        return np.column_stack([r, surface + (width - surface) * _graded(points[:, 1], grading)])

    upper = ((0.0, 0.0), (1.0, 1.0), cells)
    lower = ((0.0, -1.0), (1.0, 0.0), cells)
    mesh, tags, facets = two_blocks(comm, first=upper, second=lower, warp=warp)
    middles = mesh.geometry.x[geometry_dofmap(mesh)].mean(axis=1)
    body = np.zeros(len(middles), dtype=np.int32)
    body[tags.indices] = tags.values
    body[(body == BLOCK) & (middles[:, 1] > -thickness)] = COATING
    return mesh, dmesh.meshtags(mesh, 2, np.arange(body.size, dtype=np.int32), body), facets


def _graded(position: np.ndarray, grading: float) -> np.ndarray:
    """Map [0, 1] onto itself, denser towards 0."""
    return np.sinh(grading * position) / np.sinh(grading) if grading > 0 else position
