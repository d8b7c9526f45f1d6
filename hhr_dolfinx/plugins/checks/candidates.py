"""Pairs of surfaces of a mesh file that can be contacts: those of pieces that share no node, which face each other."""

from __future__ import annotations

from itertools import combinations

import numpy as np
from scipy.spatial import cKDTree

from hhr_dolfinx.full_order.free_bodies import components_of_nodes
from hhr_dolfinx.geometries.cells import outer_faces_of_cells
from hhr_dolfinx.geometries.raw_mesh import RawMesh

NEAR = 0.1
DEEP = 0.01
"""Largest gap and overlap of a pair over the size of the smaller piece."""
TRIED = 8
"""Nearest facets of the other surface that a point is projected on."""


def contact_candidates(raw: RawMesh) -> list[tuple[str, float]]:
    """Names of pairs of surfaces with their smallest gap, negative for an overlap, from the smallest gap on."""
    if raw.points.shape[1] > raw.dim:  # shells have no outside
        return []
    outer, of = outer_faces_of_cells(raw.kind, raw.cells)
    corners = raw.points[outer]
    normals = outward(corners, raw.points[raw.cells[of]].mean(axis=1))
    row_of = {tuple(own): row for row, own in enumerate(np.sort(outer, axis=1).tolist())}
    names: dict[tuple[int, ...], str | int] = {}
    for name, facets in raw.all_surfaces().items():
        found = {row_of[own] for own in map(tuple, np.sort(facets, axis=1).tolist()) if own in row_of}
        rows = tuple(sorted(found))
        names[rows] = name if isinstance(name, str) else names.get(rows, name)
    pieces = components_of_nodes(len(raw.points), raw.cells)
    sizes = {piece: np.ptp(raw.points[pieces == piece], axis=0).max() for piece in np.unique(pieces[outer])}
    pairs = []
    for first, second in combinations([list(rows) for rows in names if rows], 2):
        own, other = (set(pieces[outer[rows]].ravel().tolist()) for rows in (first, second))
        limit = NEAR * min(sizes[piece] for piece in own | other)
        boxes = [(corners[rows].min(axis=(0, 1)), corners[rows].max(axis=(0, 1))) for rows in (first, second)]
        if own & other or (np.maximum(boxes[0][0], boxes[1][0]) > np.minimum(boxes[0][1], boxes[1][1]) + limit).any():
            continue
        gap = min(_gap(corners, normals, *rows, limit) for rows in ((first, second), (second, first)))
        if gap < np.inf:
            pairs.append((f"{names[tuple(first)]} and {names[tuple(second)]}", gap))
    return sorted(pairs, key=lambda item: item[1])


def outward(corners: np.ndarray, inside: np.ndarray) -> np.ndarray:
    """Unit normals, (f, dim), of facets with corners (f, k, dim) that point away from a point of their cells."""
    edges = corners[:, 1:3] - corners[:, :1]
    normals = np.cross(edges[:, 0], edges[:, 1]) if edges.shape[1] == 2 else edges[:, 0, ::-1] * (1.0, -1.0)
    signs = np.sign(np.einsum("fd,fd->f", normals, corners.mean(axis=1) - inside))
    # collapsed facets have no normal, and face nothing
    return normals * (signs / np.maximum(np.linalg.norm(normals, axis=1), 1e-300))[:, None]


def _gap(corners: np.ndarray, normals: np.ndarray, rows: list[int], others: list[int], limit: float) -> float:
    """Smallest distance of corners and middles of facets from other facets along the normals of these; inf if far."""
    points = np.concatenate([corners[rows], corners[rows].mean(axis=1, keepdims=True)], axis=1)
    along = normals[others]
    middles = corners[others].mean(axis=1)
    tried = min(TRIED, len(middles))
    near = cKDTree(middles).query(points, k=tried)[1].reshape(*points.shape[:2], tried)
    off = points[:, :, None] - middles[near]
    gaps = np.einsum("fptd,fptd->fpt", off, along[near])
    across = np.linalg.norm(off - gaps[..., None] * along[near], axis=-1)
    inside = across <= 1.001 * np.linalg.norm(corners[others] - middles[:, None], axis=2).max(axis=1)[near]
    opposite = np.einsum("fd,fptd->fpt", normals[rows], along[near]) < -0.5
    facing = inside & opposite & (gaps <= limit) & (gaps > -limit * DEEP / NEAR)
    return float(gaps[facing].min(initial=np.inf))
