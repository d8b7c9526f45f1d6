"""Contact surfaces of raw arrays, which do not trust the geometry of the package."""

import numpy as np

from hhr_dolfinx.pairings.surface import make_surface


def make(tag, points, facets, inner, weights=None):
    weights = np.ones(len(points)) if weights is None else weights
    corners, k = points[facets], facets.shape[1]
    if k == 2:
        sizes = np.linalg.norm(corners[:, 1] - corners[:, 0], axis=1)
    elif k == 3:
        sizes = (
            np.linalg.norm(
                np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
            )
            / 2
        )
    else:
        sizes = (
            np.linalg.norm(
                np.cross(corners[:, 3] - corners[:, 0], corners[:, 2] - corners[:, 1]), axis=1
            )
            / 2
        )
    areas = np.zeros(len(points))
    for j in range(k):  # in the plane the weight is linear along each facet, in space it is 1
        own = weights[facets[:, j]]
        mean = (own + weights[facets].sum(axis=1)) / 3 if k == 2 else own
        np.add.at(areas, facets[:, j], sizes / k * mean)
    return make_surface(
        tag,
        facets,
        np.broadcast_to(inner, points[facets].mean(axis=1).shape),
        points,
        weights,
        areas,
    )


def chain(n, first=0):
    return np.column_stack([np.arange(n - 1), np.arange(1, n)]) + first
