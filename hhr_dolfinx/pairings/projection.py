"""Closest points on a surface: DOLFINx's bounding-volume tree finds the facet, a projection the point on it."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from mpi4py import MPI
from scipy.sparse import csr_matrix

from hhr_dolfinx import compat

if TYPE_CHECKING:
    from dolfinx.mesh import Mesh


class ClosestPoints(NamedTuple):
    """Closest points of a surface.

    Attributes:
        facets: facet of each, (m,).
        weights: values of the facet's shape functions there, (m, k).
        offsets: from the closest point to the point asked for, (m, dim).
    """

    facets: np.ndarray
    weights: np.ndarray
    offsets: np.ndarray


def closest_points(points: np.ndarray, corners: np.ndarray, nodes: np.ndarray | None = None) -> ClosestPoints:
    """Closest points on facets given by their corners.

    Args:
        points: (m, dim).
        corners: (f, k, dim).
        nodes: numbers of the corners, (f, k). If given, the neighbours of the facet found are tried too: the
            library takes quadrilaterals for their convex hulls, which matters where they are warped.
    """
    # the library's distances have an absolute tolerance of about 1e-6: give it lengths of order 1
    shift, size = corners.reshape(-1, corners.shape[2]).mean(axis=0), np.ptp(corners, axis=(0, 1)).max()
    mesh = _facet_mesh((corners - shift) / size)
    found = compat.closest_cells(mesh, _in_space((points - shift) / size))
    facets = np.asarray(mesh.topology.original_cell_index)[found]
    if nodes is not None and corners.shape[1] == 4:
        return _closest_of_neighbours(points, corners, nodes, facets)
    weights = project(points, corners[facets])
    return ClosestPoints(facets, weights, points - np.einsum("mk,mkd->md", weights, corners[facets]))


def _closest_of_neighbours(
    points: np.ndarray, corners: np.ndarray, nodes: np.ndarray, facets: np.ndarray
) -> ClosestPoints:
    """The closest point on the given facet of each point and on all facets that share a node with it."""
    count, k = nodes.shape
    touches = csr_matrix((np.ones(count * k), (np.repeat(np.arange(count), k), nodes.ravel())))
    tried = (touches @ touches.T)[facets]
    point, facet = np.repeat(np.arange(len(points)), np.diff(tried.indptr)), tried.indices
    weights = project(points[point], corners[facet])
    offsets = points[point] - np.einsum("mk,mkd->md", weights, corners[facet])
    # the nearest of each point comes first; of equals, the facet with the smallest number
    order = np.lexsort((facet, np.round(np.linalg.norm(offsets, axis=1) / np.ptp(corners), 14), point))
    best = order[np.searchsorted(point[order], np.arange(len(points)))]
    return ClosestPoints(facet[best], weights[best], offsets[best])


def near_pairs(first: np.ndarray, second: np.ndarray, reach: float) -> tuple[np.ndarray, np.ndarray]:
    """Pairs of facets whose bounding boxes, the first ones enlarged by the length ``reach``, meet.

    Corners are (f, k, dim) and (g, l, dim); returned are facets of the first and of the second surface, (p,) each.
    """
    size = max(np.ptp(first, axis=(0, 1)).max(), np.ptp(second, axis=(0, 1)).max())
    shift = second.reshape(-1, second.shape[2]).mean(axis=0)
    meshes = [_facet_mesh((corners - shift) / size) for corners in (first, second)]
    pairs = compat.meeting_cells(meshes[0], meshes[1], reach / size + 1e-9)
    here, there = (np.asarray(mesh.topology.original_cell_index) for mesh in meshes)
    return here[pairs[:, 0]], there[pairs[:, 1]]


def _facet_mesh(corners: np.ndarray) -> Mesh:
    """Mesh of facets that share no nodes."""
    count, k, dim = corners.shape
    kind = {2: "interval", 3: "triangle", 4: "quadrilateral"}[k]
    cells = np.arange(count * k).reshape(count, k)
    return compat.linear_mesh(MPI.COMM_SELF, np.ascontiguousarray(corners.reshape(-1, dim)), cells, kind)


def project(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Shape functions at the closest point of a facet for each point, (m, dim), by its corners, (m, k, dim): (m, k)."""
    k = corners.shape[1]
    if k == 2:
        return _on_segment(points, corners)
    weights, inside = _inside(points, corners)
    if inside.all():
        return weights
    sides = [[0, 1], [1, 2], [2, 0]] if k == 3 else [[0, 1], [1, 3], [3, 2], [2, 0]]
    best = np.where(inside, 0.0, np.inf)
    for side in sides:
        on_side = np.zeros_like(weights)
        on_side[:, side] = _on_segment(points, corners[:, side])
        distance = np.linalg.norm(points - np.einsum("mk,mkd->md", on_side, corners), axis=1)
        nearer = distance < best
        weights[nearer], best[nearer] = on_side[nearer], distance[nearer]
    return weights


def shape_functions(local: np.ndarray, k: int) -> tuple[np.ndarray, np.ndarray]:
    """Shape functions of triangles (k = 3) or tensor-ordered quadrilaterals (k = 4), (m, k), and slopes, (m, k, 2).

    ``local`` holds reference coordinates in the unit triangle or square, (m, 2).
    """
    x, y = local.T
    one = np.ones_like(x)
    if k == 3:
        values = np.stack([one - x - y, x, y], axis=1)
        slopes = np.broadcast_to([[-1.0, -1.0], [1.0, 0.0], [0.0, 1.0]], (len(x), 3, 2))
    else:
        values = np.stack([(1 - x) * (1 - y), x * (1 - y), (1 - x) * y, x * y], axis=1)
        along_x = np.stack([y - 1, 1 - y, -y, y], axis=1)
        along_y = np.stack([x - 1, -x, 1 - x, x], axis=1)
        slopes = np.stack([along_x, along_y], axis=2)
    return values, slopes


def local_coordinates(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Reference coordinates of the orthogonal projection on a facet, inside or not, by Gauss-Newton, (m, 2)."""
    k = corners.shape[1]
    local = np.full((len(points), 2), 1 / k if k == 3 else 0.5)
    # points that have settled are left alone: most do after three of the rounds that the worst ones take
    moving = np.arange(len(points))
    for _ in range(1 if k == 3 else 20):
        values, slopes = shape_functions(local[moving], k)
        own = corners[moving]
        residual = points[moving] - (values[:, None] @ own)[:, 0]
        tangents = slopes.transpose(0, 2, 1) @ own
        step = _least_squares(tangents, (tangents @ residual[:, :, None])[:, :, 0])
        # a bilinear map folds far outside: do not go there
        local[moving] = np.clip(local[moving] + step, -2.0, 3.0)
        moving = moving[np.abs(step).max(axis=1, initial=0.0) >= 1e-14]
        if not moving.size:
            break
    return local


def _least_squares(tangents: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solve T T^T x = b for two tangents at each point, (m, 2, dim) and (m, 2): (m, 2)."""
    first, second = tangents[:, 0], tangents[:, 1]
    a, b, c = (np.einsum("md,md->m", *pair) for pair in ((first, first), (first, second), (second, second)))
    # where corners coincide the tangents are dependent
    shift = 1e-14 * (a + c)
    a, c = a + shift, c + shift
    determinant = a * c - b * b
    x, y = right.T
    return np.stack([c * x - b * y, a * y - b * x], axis=1) / determinant[:, None]


def _inside(points: np.ndarray, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Weights of the orthogonal projection, and whether it lies in the facet."""
    k = corners.shape[1]
    local = local_coordinates(points, corners)
    # the edge belongs to the facet: what round-off puts outside is moved there
    local = np.where(np.abs(local) < 1e-12, 0.0, np.where(np.abs(local - 1) < 1e-12, 1.0, local))
    values, _ = shape_functions(local, k)
    return values, (values >= 0).all(axis=1) & ((local >= 0) & (local <= 1)).all(axis=1)


def _on_segment(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    start, along = corners[:, 0], corners[:, 1] - corners[:, 0]
    position = np.einsum("md,md->m", points - start, along) / np.einsum("md,md->m", along, along)
    position = np.clip(position, 0.0, 1.0)
    # a node of the master surface is met exactly, not to round-off
    position = np.where(position < 1e-12, 0.0, np.where(position > 1 - 1e-12, 1.0, position))
    return np.column_stack([1 - position, position])


def _in_space(points: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(np.pad(points, ((0, 0), (0, 3 - points.shape[1]))))
