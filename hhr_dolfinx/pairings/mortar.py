"""Mortar contact on non-matching meshes: weighted gaps integrated exactly over both meshes.

Beyond the thesis, which stays with nodes (chapter 5): a constant pressure passes through any pair of meshes, the
patch test that node-to-surface fails. After B. Wohlmuth, "A mortar finite element method using dual spaces for the
Lagrange multiplier" (SIAM J. Numer. Anal. 38, 2000), and T. Cichosz and M. Bischoff, "Consistent treatment of
boundaries with mortar contact formulations using dual Lagrange multipliers" (CMAME 200, 2011).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_matrix, diags
from scipy.spatial import cKDTree

from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.pairings.projection import local_coordinates, shape_functions
from hhr_dolfinx.pairings.surface import (
    FACING,
    GRAZING,
    check_facing,
    mean_normal,
    never_facing,
    tangential_order,
    unit,
    warn,
    warn_of_overlap,
)
from hhr_dolfinx.problem import ContactRows

COVERED = 1e-6
"""Covered part of a node's area below which it has no condition."""
MULTIPLIERS = ("dual", "standard")

_GAUSS_2 = np.polynomial.legendre.leggauss(3)
# degree 4 on a triangle, 6 points (D. A. Dunavant, Int. J. Numer. Methods Eng. 21, 1985)
_A, _B = 0.445948490915965, 0.091576213509771
_TRIANGLE = (
    np.array([[_A, _A], [1 - 2 * _A, _A], [_A, 1 - 2 * _A], [_B, _B], [1 - 2 * _B, _B], [_B, 1 - 2 * _B]]),
    np.array([0.223381589678011] * 3 + [0.109951743655322] * 3),
)


@dataclass(frozen=True)
class Mortar:
    """Weighted non-penetration ``∫ psi_j (u_s - u_m)·n ds <= ∫ psi_j g ds``, divided by ``∫ psi_j ds``.

    With that scale B is of the size of nodal rows and multipliers are nodal forces. Dual functions psi_j, which are
    biorthogonal to the shape functions of the slave, tie each row to one slave node; standard ones are these shape
    functions.

    Attributes:
        slave: facet tag of the surface that carries the multipliers.
        master: facet tag of the facing surface.
        normal: n from slave to master, along which points are projected; None takes the averaged outer normal of the
            slave at each of its nodes, and projects along the normal of each slave facet.
        multipliers: ``dual`` or ``standard``.
    """

    slave: int
    master: int
    normal: tuple[float, ...] | None = None
    multipliers: str = "dual"

    def __post_init__(self):
        """Refuse an unknown kind of multipliers."""
        if self.multipliers not in MULTIPLIERS:
            raise SceneError(f"multipliers '{self.multipliers}' are unknown, one of {', '.join(MULTIPLIERS)}")

    @property
    def tags(self) -> tuple[int, ...]:
        """Slave and master."""
        return (self.slave, self.master)

    def rows(self, surfaces, dofs: int) -> ContactRows:
        """One row for each slave node whose surroundings face the master surface.

        Raises:
            SceneError: if the surfaces do not face each other anywhere.

        Warns:
            PairingWarning: for slave nodes beyond the edge of the master, and for deep overlap.
        """
        slave, master = surfaces
        if self.normal is None:
            normals, directions = slave.node_normals(), slave.outward
            pairs = _near_facets(slave, master, np.eye(slave.points.shape[1]), reach=3.0)
            cosine = FACING
        else:
            normal = unit(self.normal, slave.points.shape[1])
            check_facing(slave, normal, along=True)
            normals, directions = np.tile(normal, (len(slave.nodes), 1)), np.tile(normal, (len(slave.facets), 1))
            # seen along the normal the surfaces are flat, and what faces each other is close
            pairs, cosine = _near_facets(slave, master, np.eye(normal.size) - np.outer(normal, normal)), GRAZING
        pairs = _opposite(slave, master, directions, *pairs, cosine)
        segments = (_segments if slave.points.shape[1] == 2 else _polygons)(slave, master, directions, *pairs)
        if not segments.measures.size:
            raise SceneError(never_facing(slave, master, "no facet of one lies in front of a facet of the other"))
        return self._rows(slave, master, normals, segments, dofs)

    def _rows(self, slave, master, normals, segments, dofs) -> ContactRows:
        """Integrate over the segments and divide by the weight of each multiplier function."""
        functions = segments.slave_values
        if self.multipliers == "dual":
            functions = _dual_functions(slave, segments)
        n = len(slave.nodes)
        area = np.zeros(n)
        here, there = slave.facets[segments.slave], master.facets[segments.master]
        np.add.at(area, here, functions * segments.measures[:, None])
        covered = area > COVERED * slave.areas
        if not covered.any():
            raise SceneError(never_facing(slave, master, "no slave node is covered by the master"))
        if not covered.all():
            warn(
                f"{int((~covered).sum())} of {n} nodes of slave surface {slave.tag} lie beyond the edge of master "
                f"surface {master.tag} and get no contact condition, e.g. at {slave.points[~covered][0].tolist()}"
            )
        scale = diags(1 / np.where(covered, area, 1.0))
        tested = functions * segments.measures[:, None]
        onto_slave = scale @ _assemble(here, tested, here, segments.slave_values, (n, n))
        onto_master = scale @ _assemble(here, tested, there, segments.master_values, (n, len(master.nodes)))
        gap = np.einsum("md,md->m", onto_master @ master.points - onto_slave @ slave.points, normals)
        matrix = _along_normals(onto_slave, slave.nodes, normals, dofs)
        matrix = matrix - _along_normals(onto_master, master.nodes, normals, dofs)
        kept = np.flatnonzero(covered)
        kept = kept[tangential_order(slave.points[kept], mean_normal(slave))]
        rows = ContactRows(csr_matrix(matrix), gap, slave.nodes, slave.points, area).take(kept)
        warn_of_overlap(slave, rows)
        return rows


class Segments(NamedTuple):
    """Quadrature over the common parts of slave and master facets.

    Attributes:
        slave: slave facet of each quadrature point, (q,).
        master: master facet of each, (q,).
        slave_values: shape functions of the slave facet, (q, k).
        master_values: shape functions of the master facet, (q, l).
        measures: quadrature weight times the weight of the surface measure, (q,).
    """

    slave: np.ndarray
    master: np.ndarray
    slave_values: np.ndarray
    master_values: np.ndarray
    measures: np.ndarray


def _near_facets(slave, master, flat, reach=1.0):
    """Pairs of facets that may have a common part, (p,) each.

    Args:
        slave, master: the surfaces.
        flat: projection in which distances are measured, (dim, dim).
        reach: how far to look, over the largest distance of a slave node to the nearest master node.
    """
    corners = [surface.corners @ flat for surface in (slave, master)]
    reach *= cKDTree(master.points @ flat).query(slave.points @ flat)[0].max()
    middles = [item.mean(axis=1) for item in corners]
    reach += sum(np.linalg.norm(c - m[:, None], axis=2).max() for c, m in zip(corners, middles, strict=True))
    near = cKDTree(middles[0]).sparse_distance_matrix(cKDTree(middles[1]), reach, output_type="ndarray")
    return near["i"], near["j"]


def _opposite(slave, master, directions, here, there, cosine):
    """Those pairs whose slave looks along its direction of projection and whose master looks against it."""
    opposite = np.einsum("pd,pd->p", directions[here], master.outward[there]) < -cosine
    opposite &= np.einsum("pd,pd->p", directions[here], slave.outward[here]) > cosine
    return here[opposite], there[opposite]


def _segments(slave, master, directions, here, there) -> Segments:
    """Common parts of segments in the plane: master nodes are projected on the slave along the direction."""
    start, end = slave.corners[here].transpose(1, 0, 2)
    cross = lambda a, b: a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]  # noqa: E731
    whole = cross(end - start, directions[here])
    ends = np.stack(
        [cross(corner - start, directions[here]) / whole for corner in master.corners[there].transpose(1, 0, 2)]
    )
    low, high = np.maximum(ends.min(axis=0), 0.0), np.minimum(ends.max(axis=0), 1.0)
    common = high - low > 1e-12
    here, there, low, high, ends = here[common], there[common], low[common], high[common], ends[:, common]
    nodes, weights = (_GAUSS_2[0] + 1) / 2, _GAUSS_2[1] / 2
    position = low[:, None] + (high - low)[:, None] * nodes
    on_master = (position - ends[0][:, None]) / (ends[1] - ends[0])[:, None]
    values = [np.stack([1 - t, t], axis=-1).reshape(-1, 2) for t in (position, on_master)]
    facet = np.repeat(here, nodes.size)
    measure = ((high - low) * slave.sizes[here])[:, None] * weights
    density = np.einsum("qk,qk->q", values[0], slave.weights[slave.facets[facet]])
    return Segments(facet, np.repeat(there, nodes.size), *values, measure.ravel() * density)


def _polygons(slave, master, directions, here, there) -> Segments:
    """Common parts of facets in space, seen along the direction of the slave facet, cut into triangles."""
    import shapely  # only scenes with mortar in space need it

    frames = _frames(directions)[here]
    flat = [
        np.einsum("pkd,pde->pke", surface.corners[which], frames) for surface, which in ((slave, here), (master, there))
    ]
    ring = {3: [0, 1, 2], 4: [0, 1, 3, 2]}
    outlines = [shapely.polygons(corners[:, ring[corners.shape[1]]]) for corners in flat]
    apart = (flat[0].min(axis=1) > flat[1].max(axis=1)) | (flat[1].min(axis=1) > flat[0].max(axis=1))
    pairs = np.flatnonzero(~apart.any(axis=1))
    common = shapely.intersection(outlines[0][pairs], outlines[1][pairs])
    wanted = shapely.area(common) > 1e-12 * shapely.area(outlines[0][pairs])
    pairs, triangles = pairs[wanted], []
    for polygon, pair in zip(common[wanted], pairs, strict=True):
        # the common part of two convex polygons is convex: a fan fills it
        ring_points = shapely.get_coordinates(polygon)[:-1]
        fan = np.stack(
            [np.broadcast_to(ring_points[0], ring_points[1:-1].shape), ring_points[1:-1], ring_points[2:]], axis=1
        )
        triangles.append((np.full(len(fan), pair), fan))
    if not triangles:
        empty = np.zeros(0, dtype=int)
        return Segments(empty, empty, np.zeros((0, 1)), np.zeros((0, 1)), np.zeros(0))
    pair, fans = (np.concatenate(part) for part in zip(*triangles, strict=True))
    sides = fans[:, 1:] - fans[:, :1]
    twice_area = np.abs(sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0])
    local, weights = _TRIANGLE
    points = (fans[:, None, 0] + np.einsum("qj,tjd->tqd", local, sides)).reshape(-1, 2)
    pair = np.repeat(pair, weights.size)
    values = []
    for corners in flat:
        here_corners = corners[pair]
        values.append(shape_functions(local_coordinates(points, here_corners), here_corners.shape[1])[0])
    facet = here[pair]
    # areas were measured across the direction of projection
    tilt = np.einsum("qd,qd->q", slave.outward[facet], directions[facet])
    density = np.einsum("qk,qk->q", values[0], slave.weights[slave.facets[facet]]) / tilt
    return Segments(facet, there[pair], *values, (twice_area[:, None] / 2 * weights).ravel() * density)


def _frames(directions):
    """Two unit vectors across each direction, (f, 3, 2)."""
    other = np.eye(3)[np.abs(directions).argmin(axis=1)]
    first = np.cross(directions, other)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(directions, first)], axis=2)


def _dual_functions(slave, segments):
    """Functions biorthogonal to the shape functions on the covered part of each slave facet, (q, k)."""
    count, k = slave.facets.shape
    mass, diagonal = np.zeros((count, k, k)), np.zeros((count, k))
    values, measures = segments.slave_values, segments.measures
    np.add.at(mass, segments.slave, values[:, :, None] * values[:, None, :] * measures[:, None, None])
    np.add.at(diagonal, segments.slave, values * measures[:, None])
    # facets that are hardly covered have a nearly singular mass matrix
    coefficients = diagonal[:, :, None] * np.linalg.pinv(mass, rcond=1e-12, hermitian=True)
    return np.einsum("qij,qj->qi", coefficients[segments.slave], values)


def _assemble(rows, tested, columns, values, shape) -> csr_matrix:
    """Sum of tested_j values_k over all quadrature points; ``rows`` and ``columns`` number j and k, (q, k) each."""
    entries = tested[:, :, None] * values[:, None, :]
    row, column = np.broadcast_arrays(rows[:, :, None], columns[:, None, :])
    return csr_matrix((entries.ravel(), (row.ravel(), column.ravel())), shape=shape)


def _along_normals(weights, nodes, normals, dofs):
    """Rows sum_k weights_jk n_j·u(nodes_k), (m, N)."""
    coo = weights.tocoo()
    # what is left of biorthogonal functions by round-off would tie a row to more than one slave node
    keep = np.abs(coo.data) > 1e-12
    row, node, value = coo.row[keep], nodes[coo.col[keep]], coo.data[keep]
    dim = normals.shape[1]
    columns = node[:, None] * dim + np.arange(dim)
    entries = value[:, None] * normals[row]
    rows = csr_matrix((entries.ravel(), (np.repeat(row, dim), columns.ravel())), shape=(weights.shape[0], dofs))
    rows.data[np.abs(rows.data) < 1e-14] = 0.0
    rows.eliminate_zeros()
    return rows
