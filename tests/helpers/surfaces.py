"""Contact surfaces of raw arrays, which do not trust the geometry of the package."""

import numpy as np

from hhr_dolfinx.errors import PairingWarning
from hhr_dolfinx.pairings.surface import make_surface
from hhr_dolfinx.warn import ignored


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


UP2, UP3 = (0.0, 1.0), (0.0, 0.0, 1.0)


def lines(slave, master, up=(0.0, 1.0), weight=None):
    """Two polylines; the slave's body lies below, the master's above."""
    points = np.vstack([slave, master])
    up = np.asarray(up)
    a, b = chain(len(slave)), chain(len(master), len(slave))
    weights = None if weight is None else weight(points)
    return (
        make(1, points, a, points[a].mean(axis=1) - up, weights),
        make(2, points, b, points[b].mean(axis=1) + up, weights),
        points,
    )


def grid(nx, ny, height, low=(0.0, 0.0), high=(1.0, 1.0), triangles=False, jitter=0.0, rng=None):
    x, y = np.linspace(low[0], high[0], nx + 1), np.linspace(low[1], high[1], ny + 1)
    flat = np.stack(np.meshgrid(x, y, indexing="ij"), -1).reshape(-1, 2)
    n = np.arange(len(flat)).reshape(nx + 1, ny + 1)
    facets = np.stack([n[:-1, :-1], n[1:, :-1], n[:-1, 1:], n[1:, 1:]], -1).reshape(-1, 4)
    if jitter:
        inner = np.zeros((nx + 1, ny + 1), dtype=bool)
        inner[1:-1, 1:-1] = True
        cell = np.array([(high[0] - low[0]) / nx, (high[1] - low[1]) / ny])
        flat[inner.ravel()] += rng.uniform(-jitter, jitter, (inner.sum(), 2)) * cell
    if triangles:
        facets = np.vstack([facets[:, [0, 1, 3]], facets[:, [0, 3, 2]]])
    z = height(*flat.T) if callable(height) else np.full(len(flat), height)
    return np.column_stack([flat, z]), facets


def sheets(slave, master, turn=None):
    turn = np.eye(3) if turn is None else turn
    points = np.vstack([slave[0], master[0]]) @ turn.T
    a, b, up = slave[1], master[1] + len(slave[0]), turn @ np.array(UP3)
    return (
        make(1, points, a, points[a].mean(axis=1) - 9 * up),
        make(2, points, b, points[b].mean(axis=1) + 9 * up),
        points,
    )


def rows_of(pairing, slave, master, points):
    with ignored(PairingWarning):
        return pairing.rows((slave, master), points.size)


def turned(rng):
    q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    return q * np.sign(np.linalg.det(q))
