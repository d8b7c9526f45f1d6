"""Closest points on a surface: a tree finds candidates, arrays do the rest.

Nothing here needs a mesh, so that reduced models can pair the surfaces of changed shapes.
"""

from __future__ import annotations

from itertools import chain
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from hhr_dolfinx.pairings.surface import shape_functions

BOX_ENLARGEMENT = 1e-9
"""Fraction of the size of the surfaces by which bounding boxes are enlarged."""
EQUAL = 1e-12
"""Fraction of the size of the surface within which two facets are equally near."""
PROJECTED_AT_ONCE = 1000
"""Points in one batch of the search: a distant point has hundreds of candidate facets."""


class ClosestPoints(NamedTuple):
    """Closest points of a surface: facets, (m,), shape functions, (m, k), and offsets to the given
    points, (m, dim).
    """

    facets: np.ndarray
    weights: np.ndarray
    offsets: np.ndarray


def closest_points(points: np.ndarray, corners: np.ndarray) -> ClosestPoints:
    """Closest points on facets.

    Among equally near ones the first counts.

    Args:
        points: the points, (m, dim).
        corners: corners of the facets, (f, k, dim).
    """
    middles = corners.mean(axis=1)
    radius = np.linalg.norm(corners - middles[:, None], axis=2).max()
    # the closest point is no farther than the nearest corner or middle
    bound = cKDTree(np.concatenate([middles, corners.reshape(-1, corners.shape[2])])).query(points)[
        0
    ]
    tree = cKDTree(middles)
    batches = []
    for first in range(0, len(points), PROJECTED_AT_ONCE):
        batch = slice(first, first + PROJECTED_AT_ONCE)
        pairs = pairs_within(tree, points[batch], (bound[batch] + radius) * (1 + BOX_ENLARGEMENT))
        batches.append(closest_of(points[batch], corners, bound[batch], *pairs))
    return ClosestPoints(*(np.concatenate(arrays) for arrays in zip(*batches, strict=True)))


def closest_of(
    points: np.ndarray, corners: np.ndarray, bound: np.ndarray, point: np.ndarray, facet: np.ndarray
) -> ClosestPoints:
    """Closest points on the facets that each point is paired with.

    Args:
        points: the points, (m, dim).
        corners: corners of the facets, (f, k, dim).
        bound: distance of each point that its closest one does not exceed, (m,).
        point: index of the point of each pair, (p,), sorted.
        facet: index of the facet of each pair, (p,).
    """
    size = np.ptp(corners)
    # for a distant point many facets are within reach, but few of their boxes are near enough
    low = corners.min(axis=1)
    high = corners.max(axis=1)
    beside = np.maximum(np.maximum(low[facet] - points[point], points[point] - high[facet]), 0.0)
    near = np.linalg.norm(beside, axis=1) <= bound[point] * (1 + BOX_ENLARGEMENT) + EQUAL * size
    point = point[near]
    facet = facet[near]
    weights = project(points[point], corners[facet])
    offsets = points[point] - np.einsum("mk,mkd->md", weights, corners[facet])
    distance = np.linalg.norm(offsets, axis=1)
    least = np.full(len(points), np.inf)
    np.minimum.at(least, point, distance)
    nearest = np.flatnonzero(distance <= least[point] + EQUAL * size)
    order = nearest[np.lexsort((facet[nearest], point[nearest]))]
    best = order[np.searchsorted(point[order], np.arange(len(points)))]
    return ClosestPoints(facet[best], weights[best], offsets[best])


def pairs_within(
    centres: cKDTree, points: np.ndarray, reach: np.ndarray, norm: float = 2.0
) -> tuple[np.ndarray, np.ndarray]:
    """Pairs of a point and a centre within the reach of the point, (p,) each, point by point.

    Args:
        centres: tree of the centres.
        points: the points, (m, dim).
        reach: reach of each point, (m,).
        norm: order of the norm of distances.
    """
    neighbours = centres.query_ball_point(points, reach, p=norm)
    counts = np.array([len(near_centres) for near_centres in neighbours], dtype=np.int64)
    near = np.fromiter(chain.from_iterable(neighbours), dtype=np.int64, count=int(counts.sum()))
    return np.repeat(np.arange(len(points)), counts), near


def project(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Shape functions at the closest point of one facet for each point, (m, k).

    Args:
        points: the points, (m, dim).
        corners: corners of the facet of each point, (m, k, dim).
    """
    k = corners.shape[1]
    if k == 2:
        return _on_segment(points, corners)
    weights, is_inside = _inside(points, corners)
    if is_inside.all():
        return weights
    sides = [[0, 1], [1, 2], [2, 0]] if k == 3 else [[0, 1], [1, 3], [3, 2], [2, 0]]
    best = np.where(is_inside, 0.0, np.inf)
    for side in sides:
        on_side = np.zeros_like(weights)
        on_side[:, side] = _on_segment(points, corners[:, side])
        distance = np.linalg.norm(points - np.einsum("mk,mkd->md", on_side, corners), axis=1)
        nearer = distance < best
        weights[nearer] = on_side[nearer]
        best[nearer] = distance[nearer]
    return weights


def local_coordinates(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Reference coordinates of the orthogonal projection on a facet by Gauss-Newton, (m, 2).

    The projection may lie outside of the facet.

    Args:
        points: the points, (m, 3).
        corners: corners of the facet of each point, (m, k, 3).
    """
    k = corners.shape[1]
    local = np.full((len(points), 2), 1 / k if k == 3 else 0.5)
    # converged points are left out: most converge after three rounds, the worst ones take all
    moving = np.arange(len(points))
    for _ in range(1 if k == 3 else 20):
        values, slopes = shape_functions(local[moving], k)
        facets = corners[moving]
        residual = points[moving] - (values[:, None] @ facets)[:, 0]
        tangents = slopes.transpose(0, 2, 1) @ facets
        step = _least_squares(tangents, (tangents @ residual[:, :, None])[:, :, 0])
        # a bilinear map folds far outside of the facet
        local[moving] = np.clip(local[moving] + step, -2.0, 3.0)
        moving = moving[np.abs(step).max(axis=1, initial=0.0) >= 1e-14]
        if not moving.size:
            break
    return local


def _least_squares(tangents: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solve T T^T x = b for two tangents at each point, (m, 2, dim) and (m, 2): (m, 2)."""
    first = tangents[:, 0]
    second = tangents[:, 1]
    a, b, c = (
        np.einsum("md,md->m", *pair) for pair in ((first, first), (first, second), (second, second))
    )
    # if corners coincide, the tangents are dependent
    shift = 1e-14 * (a + c)
    a = a + shift
    c = c + shift
    determinant = a * c - b * b
    x, y = right.T
    return np.stack([c * x - b * y, a * y - b * x], axis=1) / determinant[:, None]


def _inside(points: np.ndarray, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Weights of the orthogonal projection, and a mask of the points where it lies in the facet."""
    k = corners.shape[1]
    local = local_coordinates(points, corners)
    # the edge belongs to the facet: points that round-off puts outside are set onto it
    local = np.where(np.abs(local) < 1e-12, 0.0, np.where(np.abs(local - 1) < 1e-12, 1.0, local))
    values, _ = shape_functions(local, k)
    return values, (values >= 0).all(axis=1) & ((local >= 0) & (local <= 1)).all(axis=1)


def _on_segment(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    start = corners[:, 0]
    along = corners[:, 1] - corners[:, 0]
    position = np.einsum("md,md->m", points - start, along) / np.einsum("md,md->m", along, along)
    position = np.clip(position, 0.0, 1.0)
    # a node of the master surface is met exactly, not to round-off
    position = np.where(position < 1e-12, 0.0, np.where(position > 1 - 1e-12, 1.0, position))
    return np.column_stack([1 - position, position])
