"""Common parts of facets that face each other, and quadrature over them, for mortar integrals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from itertools import permutations
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from scipy.special import roots_sh_jacobi

from hhr_dolfinx.compat import extra
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.pairings.surface import Surface, shape_functions

_SKEWED = ((4, -1.0, 1e-10), (8, 1e-10, 1e-2), (14, 1e-2, 0.2), (30, 0.2, np.inf))
"""Degree of quadrature by skewness s of the facets, for 1e-10 of the load of a node.

On quadrilaterals that are no parallelograms products of shape functions are series of polynomials
of degree 4 + p and size s^p.
"""


_QUADRATIC = 8
"""Degree of quadrature of facets of second order: products of linear and quadratic functions on a
square have 6.
"""

_ORBITS: Mapping[int, tuple[tuple[float, float, float], ...]] = MappingProxyType(
    {
        4: (
            (0.44594849091596483, 0.44594849091596483, 0.22338158967801144),
            (0.09157621350977073, 0.09157621350977073, 0.10995174365532187),
        ),
        8: (
            (1 / 3, 1 / 3, 0.1443156076777872),
            (0.17056930775176027, 0.17056930775176027, 0.10321737053471824),
            (0.4592925882927231, 0.4592925882927231, 0.09509163426728463),
            (0.05054722831703107, 0.05054722831703107, 0.03245849762319808),
            (0.008394777409957675, 0.26311282963463806, 0.027230314174434996),
        ),
        14: (
            (0.41764471934045394, 0.41764471934045394, 0.032788353544125355),
            (0.0617998830908727, 0.0617998830908727, 0.014433699669776668),
            (0.2734775283088387, 0.2734775283088387, 0.051774104507291585),
            (0.1772055324125435, 0.1772055324125435, 0.04216258873699302),
            (0.0193909612487011, 0.0193909612487011, 0.004923403602400082),
            (0.4889639103621786, 0.4889639103621786, 0.021883581369428893),
            (0.014646950055654471, 0.29837288213625773, 0.014436308113533842),
            (0.09291624935697185, 0.336861459796345, 0.038571510787060684),
            (0.05712475740364799, 0.17226668782135557, 0.024665753212563677),
            (0.001268330932872076, 0.11897449769695682, 0.005010228838500672),
        ),
    }
)
"""Symmetric rules on a triangle by degree: two barycentric coordinates of a point, which stands for
all permutations of the three, and the share of the area of each (D. A. Dunavant, Int. J. Numer.
Methods Eng. 21, 1985).
"""


class Segments(NamedTuple):
    """Quadrature over the common parts of slave and master facets."""

    slave: np.ndarray  #: slave facet of each quadrature point, (q,)
    master: np.ndarray  #: master facet of each, (q,)
    slave_values: np.ndarray  #: shape functions of the slave facet, (q, k)
    master_values: np.ndarray  #: shape functions of the master facet, (q, l)
    measures: np.ndarray  #: quadrature weight times the weight of the surface measure, (q,)


def common_parts(
    slave: Surface, master: Surface, directions: np.ndarray, here: np.ndarray, there: np.ndarray
) -> Segments:
    """Common parts of pairs of facets, projected along the directions of the slave facets.

    Args:
        slave: the slave surface.
        master: the master surface.
        directions: direction of projection of each slave facet, (f, dim).
        here: slave facet of each pair, (p,).
        there: master facet of each pair, (p,).
    """
    return (_segments if slave.points.shape[1] == 2 else _polygons)(
        slave, master, directions, here, there
    )


def _segments(
    slave: Surface, master: Surface, directions: np.ndarray, here: np.ndarray, there: np.ndarray
) -> Segments:
    """Common parts of segments in the plane.

    Master nodes are projected on the slave along the direction.
    """
    start, end = slave.corners[here].transpose(1, 0, 2)
    cross = lambda a, b: a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]  # noqa: E731
    length = cross(end - start, directions[here])
    ends = np.stack(
        [
            cross(corner - start, directions[here]) / length
            for corner in master.corners[there].transpose(1, 0, 2)
        ]
    )
    low = np.maximum(ends.min(axis=0), 0.0)
    high = np.minimum(ends.max(axis=0), 1.0)
    common = high - low > 1e-12
    here = here[common]
    there = there[common]
    low = low[common]
    high = high[common]
    ends = ends[:, common]
    nodes, weights = _on_interval(4)
    position = low[:, None] + (high - low)[:, None] * nodes
    on_master = (position - ends[0][:, None]) / (ends[1] - ends[0])[:, None]
    slave_values, master_values = (
        np.stack([1 - t, t], axis=-1).reshape(-1, 2) for t in (position, on_master)
    )
    facet = np.repeat(here, nodes.size)
    measure = ((high - low) * slave.sizes[here])[:, None] * weights
    density = np.einsum("qk,qk->q", slave_values, slave.weights[slave.facets[facet]])
    return Segments(
        facet, np.repeat(there, nodes.size), slave_values, master_values, measure.ravel() * density
    )


def _polygons(
    slave: Surface, master: Surface, directions: np.ndarray, here: np.ndarray, there: np.ndarray
) -> Segments:
    """Common parts of facets in space, cut into triangles.

    Facets are projected along the direction of the slave facet.
    """
    # two unit vectors orthogonal to each direction, (f, 3, 2)
    first = np.cross(directions, np.eye(3)[np.abs(directions).argmin(axis=1)])
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    frames = np.stack([first, np.cross(directions, first)], axis=2)[here]
    sides = ((slave, here), (master, there))
    flat = [np.einsum("pkd,pde->pke", surface.corners[which], frames) for surface, which in sides]
    # facets that overlap by round-off alone have no common part
    least = 1e-13 * np.ptp(flat[0].reshape(-1, 2), axis=0).max() if here.size else 0.0
    apart = [
        first_flat.min(axis=1) > second_flat.max(axis=1) - least
        for first_flat, second_flat in (flat, flat[::-1])
    ]
    apart = apart[0] | apart[1]
    meeting = ~apart.any(axis=1)
    here = here[meeting]
    there = there[meeting]
    flat = [corners[meeting] for corners in flat]
    pair, triangles = _common_triangles(slave, master, here, there, flat)
    # areas are measured across the direction of projection
    tilt = np.einsum("pd,pd->p", slave.outward[here], directions[here])
    skew = np.maximum(*(_skewness(corners) for corners in flat))[pair] if pair.size else np.zeros(0)
    pieces = []
    for degree, low, high in _SKEWED:
        rule = _on_triangle(degree if slave.quadratic is None else max(degree, _QUADRATIC))
        which = np.flatnonzero((skew > low) & (skew <= high))
        (slave_values, master_values), measures = _on_triangles(
            flat, pair[which], triangles[which], *rule
        )
        facet = np.repeat(pair[which], len(rule[1]))
        density = (
            np.einsum("qk,qk->q", slave_values, slave.weights[slave.facets[here[facet]]])
            / tilt[facet]
        )
        pieces.append(
            Segments(here[facet], there[facet], slave_values, master_values, measures * density)
        )
    return Segments(*(np.concatenate(arrays) for arrays in zip(*pieces, strict=True)))


def _common_triangles(
    slave: Surface, master: Surface, here: np.ndarray, there: np.ndarray, flat: Sequence[np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Triangles that fill the common part of each pair.

    Number of the pair, (t,), and corners, (t, 3, 2).
    """
    with extra("mortar", "mortar in space"):
        import shapely

    ring = {3: [0, 1, 2], 4: [0, 1, 3, 2]}
    outlines = [shapely.polygons(corners[:, ring[corners.shape[1]]]) for corners in flat]
    for surface, which, outline in ((slave, here, outlines[0]), (master, there, outlines[1])):
        crossed = ~shapely.is_valid(outline)
        if crossed.any():
            position = surface.corners[which[crossed][0]].mean(axis=0)
            raise SceneError(
                f"a facet of surface {surface.tag} at {position.tolist()} is so warped that its "
                "outline crosses itself seen from the other surface: mesh it finer or with "
                "triangles, or give the contact a normal"
            )
    common = shapely.intersection(*outlines)
    wanted = np.flatnonzero(shapely.area(common) > 1e-12 * shapely.area(outlines[0]))
    # the common part of two convex polygons is convex: a fan fills it; the last point of a ring is
    # its first one
    corners, polygon = shapely.get_coordinates(common[wanted], return_index=True)
    counts = np.bincount(polygon, minlength=wanted.size)
    starts = np.cumsum(counts) - counts
    position = np.arange(polygon.size) - starts[polygon]
    second = np.flatnonzero((position >= 1) & (position <= counts[polygon] - 3))
    triangles = np.stack(
        [corners[starts[polygon[second]]], corners[second], corners[second + 1]], axis=1
    )
    return wanted[polygon[second]], triangles


def _on_triangles(
    flat: Sequence[np.ndarray],
    pair: np.ndarray,
    triangles: np.ndarray,
    local: np.ndarray,
    weights: np.ndarray,
) -> tuple[list[np.ndarray], np.ndarray]:
    """Shape functions of both facets at the quadrature points of each triangle, and weights.

    Weights are multiplied by its area.
    """
    sides = triangles[:, 1:] - triangles[:, :1]
    area = np.abs(sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0]) / 2
    points = triangles[:, None, 0] + local @ sides
    values = [
        shape_functions(_within_facets(points, corners[pair]).reshape(-1, 2), corners.shape[1])[0]
        for corners in flat
    ]
    return values, (area[:, None] * weights).ravel()


def _within_facets(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Reference coordinates of points in flat convex facets, (t, q, 2) in (t, k, 2): (t, q, 2).

    x = a ξ + b η + c ξ η is solved for η, a root of a quadratic equation, in the form that allows c
    = 0. The Jacobian at the solution is the root of the discriminant; it has one sign within a
    convex facet.
    """
    first = corners[:, 0]
    a = corners[:, 1] - first
    b = corners[:, 2] - first
    c = corners[:, 3] - first - a - b if corners.shape[1] == 4 else np.zeros_like(a)
    x, y = (points - first[:, None]).transpose(2, 0, 1)
    (ax, ay), (bx, by), (cx, cy) = (vector.T[:, :, None] for vector in (a, b, c))
    area = ax * by - ay * bx
    constant = x * ay - y * ax
    linear = x * cy - y * cx + area
    square = cx * by - cy * bx
    jacobian = np.sign(area) * np.sqrt(np.maximum(linear * linear - 4 * constant * square, 0.0))
    second = -2 * constant / (linear + jacobian)
    along_x = ax + cx * second
    along_y = ay + cy * second
    along_first = (x - bx * second) * along_x + (y - by * second) * along_y
    return np.stack([along_first / (along_x * along_x + along_y * along_y), second], axis=-1)


@cache
def _on_interval(degree: int) -> tuple[np.ndarray, np.ndarray]:
    """Gauss points and weights on (0, 1), exact up to a degree."""
    points, weights = np.polynomial.legendre.leggauss(degree // 2 + 1)
    return (points + 1) / 2, weights / 2


@cache
def _on_triangle(degree: int) -> tuple[np.ndarray, np.ndarray]:
    """Points in the unit triangle, (q, 2), and weights as shares of its area, exact up to a degree.

    Without a symmetric rule they are the Gauss points of a square that is folded to a triangle.
    """
    if degree in _ORBITS:
        orbits = (
            (np.round((a, b, 1 - a - b), 15).tolist(), weight) for a, b, weight in _ORBITS[degree]
        )
        turned = [(set(permutations(point)), weight) for point, weight in orbits]
        points = [point[:2] for orbit, _ in turned for point in sorted(orbit)]
        return np.array(points), np.concatenate(
            [np.full(len(orbit), weight) for orbit, weight in turned]
        )
    along, weights = _on_interval(degree)
    # the weight function of the second rule is the width of the triangle
    height, shares = roots_sh_jacobi(len(along), 2, 1)
    x = np.outer(along, 1 - height)
    y = np.broadcast_to(height, x.shape)
    return np.column_stack([x.ravel(), y.ravel()]), np.outer(weights, 2 * shares).ravel()


def _skewness(corners: np.ndarray) -> np.ndarray:
    """Deviation of quadrilaterals from parallelograms, on which shape functions are polynomials.

    0 for triangles.
    """
    if corners.shape[1] == 3:
        return np.zeros(len(corners))
    skew = corners[:, 0] - corners[:, 1] - corners[:, 2] + corners[:, 3]
    return np.linalg.norm(skew, axis=1) / np.linalg.norm(corners[:, 3] - corners[:, 0], axis=1)
