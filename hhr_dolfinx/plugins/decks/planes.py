"""Rigid planes of files: straight lines and flat surfaces without cells."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hhr_dolfinx.geometries.mesh_file import reader_of
from hhr_dolfinx.geometries.raw_mesh import RawMesh

PLANE_POINTS = 1e-9
"""Deviation over their extent up to which the points of a rigid surface lie in a plane."""
Plane = tuple[np.ndarray, np.ndarray, np.ndarray]
"""A point of a rigid plane, its unit normal, and the motion of its reference node, (dim,) each."""


def plane_through(points: np.ndarray, sweep: bool) -> tuple[np.ndarray, np.ndarray] | None:
    """A point and the unit normal of the plane through some points; None without a plane.

    Args:
        points: the points, (n, 3).
        sweep: True if the points are swept along z.
    """
    if len(points) < 2:
        return None
    along = [0.0, 0.0, np.ptp(points, axis=0).max() * sweep]
    spans = np.concatenate([points[1:] - points[0], [along, along]])
    _, sizes, axes = np.linalg.svd(spans)
    return (points[0], axes[2]) if sizes[1] > PLANE_POINTS * sizes[0] >= sizes[2] else None


def planes_of(path: Path) -> tuple[dict[str, Plane], tuple[str, ...]]:
    """Flat surfaces of a mesh file with nodes of no cell, by name in capitals.

    Returns:
        The planes, and the names of curved surfaces.

    Raises:
        FileContentError: for a file that cannot be read.
    """
    raw: RawMesh = reader_of(path)(path)
    dim = raw.dim
    planes: dict[str, Plane] = {}
    curved = []
    for name, facets in raw.surfaces.items():
        nodes = np.unique(facets)
        if not nodes.size or np.isin(nodes, raw.cells).any():
            continue
        points = np.zeros((nodes.size, 3))
        points[:, : raw.points.shape[1]] = raw.points[nodes]
        plane = plane_through(points, sweep=dim == 2)
        if plane is None:
            curved.append(str(name).upper())
        else:
            planes[str(name).upper()] = plane[0][:dim], plane[1][:dim], np.zeros(dim)
    return planes, tuple(curved)
