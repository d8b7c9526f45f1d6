"""Pairs of surfaces of a mesh file that can be contacts: those of pieces that share no node, which
face each other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np
from scipy.spatial import cKDTree

from hhr_dolfinx.full_order.free_bodies import components_of_nodes
from hhr_dolfinx.geometries.cells import outer_faces_of_cells
from hhr_dolfinx.geometries.raw_mesh import RawMesh

NEARBY_PIECES = 0.1
"""Largest gap of a pair over the size of the smaller piece."""
LARGEST_OVERLAP = 0.01
"""Largest overlap of a pair over the size of the smaller piece."""
NEAREST_FACETS = 8
"""Nearest facets of the other surface that a point is projected on."""
FACING_COSINE = -0.5
"""Largest cosine between outer normals of two facets that face each other."""
ON_FACET = 1e-9
"""Distance over the size of the largest piece up to which a point counts as one on a facet."""


@dataclass(frozen=True)
class OuterFacets:
    """Outer facets of a mesh.

    Attributes:
        facets: corners of each facet, (f, k).
        corners: their coordinates, (f, k, dim).
        normals: outer unit normals, (f, dim).
        pieces: connected component of the mesh of each facet, (f,).
        sizes: largest extent of each component.
    """

    facets: np.ndarray
    corners: np.ndarray
    normals: np.ndarray
    pieces: np.ndarray
    sizes: np.ndarray

    @classmethod
    def of(cls, raw: RawMesh) -> OuterFacets:
        """Outer facets of a mesh without shells."""
        facets, cells = outer_faces_of_cells(raw.kind, raw.cells)
        corners = raw.points[facets]
        normals = outward(corners, raw.points[raw.cells[cells]].mean(axis=1))
        labels = components_of_nodes(len(raw.points), raw.cells)
        of_pieces = [raw.points[labels == piece] for piece in range(labels.max(initial=-1) + 1)]
        sizes = np.array(
            [np.ptp(points, axis=0).max() if len(points) else 0.0 for points in of_pieces]
        )
        return cls(facets, corners, normals, labels[facets[:, 0]], sizes)

    @cached_property
    def _row_of(self) -> dict[tuple[int, ...], int]:
        return {
            tuple(corners): row for row, corners in enumerate(np.sort(self.facets, axis=1).tolist())
        }

    def rows(self, facets: np.ndarray) -> list[int]:
        """Rows of the facets of a surface, (f, k), in order; facets within a body have none."""
        keys = map(tuple, np.sort(facets, axis=1).tolist())
        return sorted({self._row_of[key] for key in keys if key in self._row_of})

    @cached_property
    def _middles(self) -> np.ndarray:
        return self.corners.mean(axis=1)

    def gaps(self, rows: Sequence[int], others: Sequence[int]) -> np.ndarray:
        """Gaps of the corners and of the middle of each facet from other facets, (f, k + 1).

        Inf without one in front.

        A gap is the distance along the normal of a near facet that looks back. It is negative for
        an overlap, which is no deeper than ``LARGEST_OVERLAP`` of the smaller piece: two sides
        that look away from each other do not face.

        Args:
            rows: rows of the facets whose gaps are measured, f of them.
            others: rows of the facets that they may face.
        """
        points = np.concatenate([self.corners[rows], self._middles[rows][:, None]], axis=1)
        normals = self.normals[others]
        middles = self._middles[others]
        tried = min(NEAREST_FACETS, len(others))
        near = cKDTree(middles).query(points, k=tried)[1].reshape(*points.shape[:2], tried)
        off = points[:, :, None] - middles[near]
        gaps = np.einsum("fptd,fptd->fpt", off, normals[near])
        across = np.linalg.norm(off - gaps[..., None] * normals[near], axis=-1)
        reach = np.linalg.norm(self.corners[others] - middles[:, None], axis=2).max(axis=1)
        facing = across <= 1.001 * reach[near]
        facing &= np.einsum("fd,fptd->fpt", self.normals[rows], normals[near]) < FACING_COSINE
        deepest = LARGEST_OVERLAP * min(
            self.sizes[self.pieces[side]].min() for side in (rows, others)
        )
        facing &= (gaps >= 0) | ((gaps > -deepest) & self._inside(points, others)[..., None])
        return np.where(facing, gaps, np.inf).min(axis=2)

    def _inside(self, points: np.ndarray, rows: Sequence[int]) -> np.ndarray:
        """True for points, (f, p, dim), that lie inside of the pieces of some facets.

        The nearest outer facet tells: a point beyond a thin piece is near its other side, and in
        front of that.
        """
        of_pieces = np.flatnonzero(np.isin(self.pieces, self.pieces[rows]))
        nearest = of_pieces[cKDTree(self._middles[of_pieces]).query(points)[1]]
        heights = np.einsum("fpd,fpd->fp", points - self._middles[nearest], self.normals[nearest])
        return heights <= ON_FACET * self.sizes.max()


def contact_candidates(raw: RawMesh) -> list[tuple[str, float]]:
    """Names of pairs of surfaces with their smallest gap, negative for an overlap, from the
    smallest gap on.
    """
    if raw.points.shape[1] > raw.dim:  # shells have no outside
        return []
    outer = OuterFacets.of(raw)
    names: dict[tuple[int, ...], str | int] = {}
    for name, facets in raw.all_surfaces().items():
        rows = tuple(outer.rows(facets))
        names[rows] = name if isinstance(name, str) else names.get(rows, name)
    pairs = []
    for first, second in combinations([list(rows) for rows in names if rows], 2):
        pieces, opposite = (set(outer.pieces[rows].tolist()) for rows in (first, second))
        limit = NEARBY_PIECES * min(outer.sizes[piece] for piece in pieces | opposite)
        low, high = zip(*(_box(outer.corners[rows]) for rows in (first, second)), strict=True)
        if pieces & opposite or (np.maximum(*low) > np.minimum(*high) + limit).any():
            continue
        gap = min(outer.gaps(*rows).min() for rows in ((first, second), (second, first)))
        if gap <= limit:
            pairs.append((f"{names[tuple(first)]} and {names[tuple(second)]}", float(gap)))
    return sorted(pairs, key=lambda item: item[1])


def _box(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return corners.min(axis=(0, 1)), corners.max(axis=(0, 1))


def outward(corners: np.ndarray, inside: np.ndarray) -> np.ndarray:
    """Outer unit normals of facets, (f, dim).

    Args:
        corners: corners of the facets, (f, k, dim).
        inside: a point of the cell of each facet, (f, dim).
    """
    edges = corners[:, 1:3] - corners[:, :1]
    normals = (
        np.cross(edges[:, 0], edges[:, 1])
        if edges.shape[1] == 2
        else edges[:, 0, ::-1] * (1.0, -1.0)
    )
    signs = np.sign(np.einsum("fd,fd->f", normals, corners.mean(axis=1) - inside))
    # collapsed facets have no normal, and face nothing
    return normals * (signs / np.maximum(np.linalg.norm(normals, axis=1), 1e-300))[:, None]
