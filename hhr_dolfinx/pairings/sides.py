"""Sides of the nodes of a surface: groups of facets at a node that meet smoothly.

A node on an edge of a body has several sides, and the mean of their normals looks along none of them.
"""

from __future__ import annotations

import numpy as np

from hhr_dolfinx.pairings.surface import GRAZING, Surface


def looking(surface: Surface, normals: np.ndarray, least: float) -> tuple[np.ndarray, np.ndarray]:
    """Nodes with a side that looks along a normal, (n,) bool, and the tributary area of that side, (n,).

    Unit normals are (n, dim), or one for all, (dim,). The cosine of such a side is above ``least``.
    """
    k = surface.facets.shape[1]
    along = np.broadcast_to(normals, surface.points.shape)[surface.facets]
    sides = np.einsum("fkd,fkd->fk", surface.corner_normals, along) > least
    # integrals of the linear functions of a facet over it; the weight of the measure is linear, too
    weights = surface.weights[surface.facets]
    shares = surface.sizes[:, None] * (weights + weights.sum(axis=1, keepdims=True)) / (k + 1)
    nodes = surface.facets.ravel()
    whole = np.bincount(nodes, shares.ravel(), len(surface.nodes))
    part = np.bincount(nodes, (shares * sides).ravel(), len(surface.nodes))
    found = np.bincount(nodes, sides.ravel(), len(surface.nodes)) > 0
    return found, surface.areas * np.divide(part, whole, out=np.zeros_like(whole), where=whole > 0)


def along_normal(surface: Surface, normal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Nodes with a side that looks along a normal, (m,), and areas of all, (n,); all nodes of a parallel surface."""
    looks, areas = looking(surface, normal, GRAZING)
    if not looks.any():
        return np.arange(len(surface.nodes)), surface.areas
    return np.flatnonzero(looks), areas
