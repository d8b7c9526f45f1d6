"""Contact surfaces of cells of second order: displacements of second order, multipliers piecewise
linear.

A facet of second order is cut into flat parts between its nodes. On these parts pairings find
opposite surfaces as on facets of first order. The conditions that they make at all nodes are then
averaged with the linear shape functions psi_i of these parts,

    sum_j C_ij B_j u <= sum_j C_ij d_j,        C_ij = ∫ psi_i phi_j / ∫ psi_i,

with the shape functions phi_j of second order. Pressures are then linear on each part, positive if
those of its nodes are, and a constant pressure does the work of its consistent nodal forces.
Conditions of single nodes would not: the corners of a six-node triangle bear no share of a constant
pressure. There are as many functions psi as phi, and C is well-conditioned, so that the multipliers
are as stable as those of first order (B. I. Wohlmuth, Acta Numerica 20, 2011, section 5; A. Popp,
B. I. Wohlmuth, M. W. Gee and W. A. Wall, SIAM J. Sci. Comput. 34, 2012, on positive weights).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Annotated

import numpy as np
from scipy.sparse import csr_matrix, diags, identity

from hhr_dolfinx.contact.rows import ContactRows
from hhr_dolfinx.declared import Integers
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.pairings.surface import Surface, shape_functions, warn

CORNER_COUNTS = {3: 2, 6: 3, 9: 4}
"""Corners of a facet by its number of nodes."""
FLAT_PARTS = {
    3: ((0, 2), (2, 1)),
    6: ((0, 5, 4), (5, 1, 3), (4, 3, 2), (3, 4, 5)),
    9: ((0, 4, 5, 8), (4, 1, 8, 6), (5, 8, 2, 7), (8, 6, 7, 3)),
}
"""Nodes of the flat parts of a facet, quadrilaterals in tensor order.

Nodes have the order of DOLFINx: corners, edges, middle. Edge i of a triangle is opposite to corner
i; edges of a quadrilateral are (0, 1), (0, 2), (1, 3), (2, 3).
"""
REFERENCE_NODES = {
    3: np.array([[0.0], [1.0], [0.5]]),
    6: np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [0.5, 0.5], [0.0, 0.5], [0.5, 0.0]]),
    9: np.array(
        [[0, 0], [1, 0], [0, 1], [1, 1], [0.5, 0], [0, 0.5], [1, 0.5], [0.5, 1], [0.5, 0.5]],
        dtype=float,
    ),
}
"""Reference coordinates of the nodes."""
STRAIGHT_SIDES = 1e-6
"""Angle between the flat parts of a facet of second order below which its sides are straight."""
CURVED = 1e-4
"""Mean sag of straight sides, in lengths of a flat part, below which a surface is flat: sides meet
at 0.1 degrees.
"""
SAME_CURVATURE = 0.1
"""Sum of the sags of two surfaces over the larger one, below which they are curved alike."""
GAUSS_POINTS = 5
"""Gauss points along an axis: products of psi, phi, the Jacobian and a radius are polynomials of
degree 7 at most if facets are flat.
"""


@dataclass(frozen=True)
class QuadraticFacets:
    """Facets of second order of a surface whose ``facets`` are the flat parts of these (F facets, K
    nodes each).
    """

    nodes: Annotated[
        Integers, "whole facets", "facet nodes"
    ]  #: nodes of each facet, counted within the surface, (F, K)

    @property
    def corners(self) -> np.ndarray:
        """Corners of each facet, (F, k)."""
        return self.nodes[:, : CORNER_COUNTS[self.nodes.shape[1]]]

    @property
    def parts(self) -> int:
        """Number of flat parts of a facet.

        Part p of facet f is facet f parts + p of the surface.
        """
        return len(FLAT_PARTS[self.nodes.shape[1]])

    def functions(self, flat: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Facets, (q,), and shape functions, (q, K), of points in flat parts.

        Args:
            flat: flat part of each point, (q,).
            values: shape functions of the flat parts, (q, k).
        """
        count = self.nodes.shape[1]
        facet, flat_part = np.divmod(flat, self.parts)
        local = np.einsum(
            "qk,qkd->qd", values, REFERENCE_NODES[count][np.array(FLAT_PARTS[count])][flat_part]
        )
        return facet, quadratic(local, count)

    def integrals(self, points: np.ndarray, weights: np.ndarray, covered: np.ndarray) -> csr_matrix:
        """Integrals ∫ psi_i phi_j over facets whose nodes all have conditions, (n, n).

        Over such flat parts of other facets phi_j are linear, as psi_i.

        Args:
            points: coordinates of the nodes of the surface, (n, dim).
            weights: weights of the measure at the nodes, (n,).
            covered: True for nodes with conditions, (n,).
        """
        complete = covered[self.nodes].all(axis=1)
        total = csr_matrix((len(points), len(points)))
        for flat_part in FLAT_PARTS[self.nodes.shape[1]]:
            alone = covered[self.nodes[:, list(flat_part)]].all(axis=1) & ~complete
            for nodes, linearly in ((self.nodes[complete], False), (self.nodes[alone], True)):
                if len(nodes):
                    total = total + _integrated(
                        points, weights, nodes, flat_part, linearly=linearly
                    )
        total.eliminate_zeros()
        return csr_matrix(total)

    def sag_shares(self, outward: np.ndarray) -> np.ndarray:
        """Deviation of flat parts from the smooth surface over that of flat facets, (f,).

        Flat parts of a facet of second order with straight sides deviate four times as much: each
        is half of it. Curved sides are parabolas, which deviate from an arc by the square of the
        angle between the parts.

        Args:
            outward: normals of the flat parts, (f, dim).
        """
        normals = outward.reshape(-1, self.parts, outward.shape[1])
        cosines = np.einsum("fpd,fqd->fpq", normals, normals).min(axis=(1, 2))
        angles = np.repeat(np.arccos(np.clip(cosines, -1.0, 1.0)), self.parts)
        return np.where(angles < STRAIGHT_SIDES, 4.0, angles**2)

    def averaged(self, surface: Surface, rows: ContactRows) -> ContactRows:
        """Average conditions of single nodes of the slave surface of these facets.

        Nodes beyond the edge of a master have no condition. A facet that lies there in part
        contributes the flat parts with conditions at all nodes, as facets of first order.

        Args:
            surface: the slave surface.
            rows: conditions of its nodes.

        Raises:
            SceneError: if no flat part has conditions at all of its nodes.
        """
        index = np.full(len(surface.nodes), -1)
        index[np.searchsorted(surface.nodes, rows.slaves)] = np.arange(rows.gap.size)
        integrals = self.integrals(surface.points, surface.weights, index >= 0)
        nodes = np.flatnonzero(np.diff(integrals.indptr))
        if not nodes.size:
            raise SceneError(
                f"no part of a facet of slave surface {surface.tag} lies in front of its master "
                "with all of its nodes: mesh it finer"
            )
        nodes = nodes[np.argsort(index[nodes])]
        normals = np.zeros_like(surface.points)
        entries = rows.matrix.tocoo()
        at_slave = entries.col // surface.points.shape[1] == rows.slaves[entries.row]
        slaves = np.searchsorted(surface.nodes, rows.slaves)
        normals[slaves[entries.row[at_slave]], entries.col[at_slave] % surface.points.shape[1]] = (
            entries.data[at_slave]
        )
        shared = self.shared(surface, normals, nodes)
        tested = csr_matrix(shared @ integrals)
        nodes = nodes[np.diff(csr_matrix(shared).indptr)[nodes] > 0]
        mixed = tested[nodes].tocoo()
        areas = np.bincount(mixed.row, mixed.data, nodes.size)
        shape = nodes.size, rows.gap.size
        means = csr_matrix(
            (mixed.data / areas[mixed.row], (mixed.row, index[mixed.col])), shape=shape
        )
        matrix = csr_matrix(means @ rows.matrix)
        return ContactRows(
            matrix, means @ rows.gap, surface.nodes[nodes], surface.points[nodes], areas
        )

    def shared(self, surface: Surface, normals: np.ndarray, nodes: np.ndarray) -> csr_matrix:
        """Matrix that shares functions psi_j among free neighbours, (n, n).

        Functions of nodes with imposed displacements are shared. With one function for each node
        conditions would be dependent if some displacements are imposed, as at the end of a mortar
        surface. The matrix is the identity if all ``nodes`` with conditions are free, or none is.

        Args:
            surface: the slave surface.
            normals: normals of the conditions at its nodes, (n, dim).
            nodes: nodes with conditions.
        """
        count = len(surface.nodes)
        held = np.zeros(count, dtype=bool)
        if surface.free is not None:
            held[nodes] = ~(np.abs(normals) * surface.free > 0).any(axis=1)[nodes]
        if not held.any() or held[nodes].all():
            return identity(count, format="csr")
        moving = np.zeros(count)
        moving[nodes] = ~held[nodes]
        k = surface.facets.shape[1]
        pattern = np.repeat(surface.facets, k, axis=1).ravel(), np.tile(surface.facets, k).ravel()
        beside = csr_matrix((np.ones(surface.facets.size * k), pattern), shape=(count, count))
        beside.data[:] = 1.0
        towards = diags(moving) @ beside @ diags(held.astype(float))
        share = np.asarray(towards.sum(axis=0)).ravel()
        return csr_matrix(diags(moving) + towards @ diags(1 / np.where(share > 0, share, 1.0)))

    @staticmethod
    def warn_of_straight_sides(surfaces: Sequence[Surface]) -> None:
        """Warn of a curved surface with straight sides.

        Sags of surfaces curved alike cancel in the gap.
        """
        sags = [_straight_sag(surface) for surface in surfaces]
        index = int(np.abs(sags).argmax())
        worst = surfaces[index]
        largest = abs(sags[index])
        if largest < CURVED * worst.lengths().mean() or abs(sum(sags)) < SAME_CURVATURE * largest:
            return
        warn(
            f"displacements are of second order and the sides of surface {worst.tag} are "
            "straight, though it is curved: between corners its gap is that of chords, "
            f"{largest:.2g} off on average, and pressures alternate from node to node. Mesh it "
            "with cells of second order, whose sides are curved (gmsh: setOrder(2)), or take "
            "displacements of first order, Scene(order=1)"
        )


def _integrated(
    points: np.ndarray,
    weights: np.ndarray,
    nodes: np.ndarray,
    part: tuple[int, ...],
    *,
    linearly: bool,
) -> csr_matrix:
    """Integrals ∫ psi_i phi_j over one flat part of facets with nodes (f, K), (n, n).

    ``linearly``: of linear phi_j.
    """
    values, functions, slopes, shares = _rule(nodes.shape[1], part)
    along = np.einsum("qjd,fjx->fqdx", slopes, points[nodes])
    if along.shape[2] == 1:
        sizes = np.linalg.norm(along[:, :, 0], axis=2)
    else:
        sizes = np.linalg.norm(np.cross(along[:, :, 0], along[:, :, 1]), axis=2)
    measure = sizes * shares * (weights[nodes] @ functions.T)
    tests = nodes[:, list(part)]
    trials = tests if linearly else nodes
    entries = np.einsum("fq,qi,qj->fij", measure, values, values if linearly else functions)
    rows = np.repeat(tests, trials.shape[1], axis=1)
    columns = np.tile(trials, len(part))
    shape = len(points), len(points)
    return csr_matrix((entries.ravel(), (rows.ravel(), columns.ravel())), shape=shape)


def _straight_sag(surface: Surface) -> float:
    """Mean height of the curved surface above its flat parts if sides of second order are straight.

    Else 0.
    """
    if surface.quadratic is None or (surface.sag_shares() != 4.0).any():
        return 0.0
    count, k = surface.facets.shape
    bulges = surface.bulges(np.arange(count), np.full((count, k), 1 / k))
    return float(bulges @ surface.sizes / surface.sizes.sum())


def parted(
    facet_nodes: np.ndarray, inner_points: np.ndarray
) -> tuple[np.ndarray, np.ndarray, QuadraticFacets]:
    """Flat parts of facets of second order.

    Args:
        facet_nodes: nodes of the facets, (F, K).
        inner_points: a point inside of the body of each facet, (F, dim).

    Returns:
        Nodes of the flat parts, facet by facet, (parts F, k), points inside, and the facets.
    """
    count = facet_nodes.shape[1]
    flat = facet_nodes[:, np.array(FLAT_PARTS[count])].reshape(-1, CORNER_COUNTS[count])
    quadratic = QuadraticFacets(np.searchsorted(np.unique(facet_nodes), facet_nodes))
    return flat, np.repeat(inner_points, len(flat) // len(facet_nodes), axis=0), quadratic


def quadratic(local: np.ndarray, count: int) -> np.ndarray:
    """Shape functions of second order, (q, K).

    Args:
        local: reference coordinates, (q, 1) or (q, 2).
        count: number K of nodes of the facet: 3, 6 or 9.
    """
    if count == 3:
        return _on_line(local[:, 0])
    if count == 6:
        first, second, third = shape_functions(local, 3)[0].T
        corners = [function * (2 * function - 1) for function in (first, second, third)]
        return np.column_stack(
            [*corners, 4 * second * third, 4 * first * third, 4 * first * second]
        )
    x, y = map(_on_line, local[:, :2].T)
    return np.column_stack([x[:, i] * y[:, j] for i, j in _TENSOR])


_TENSOR = ((0, 0), (1, 0), (0, 1), (1, 1), (2, 0), (0, 2), (1, 2), (2, 1), (2, 2))
"""The two functions on a line whose product is the function of each node of a square."""


def _on_line(x: np.ndarray) -> np.ndarray:
    """Shape functions on a line: both ends, and the middle."""
    return np.column_stack([(1 - x) * (1 - 2 * x), x * (2 * x - 1), 4 * x * (1 - x)])


@cache
def _rule(
    count: int, part: tuple[int, ...]
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Quadrature on a flat part: its functions, (q, k), those of the facet, (q, K), slopes, (q, K,
    d), and weights.
    """
    ends, sizes = np.polynomial.legendre.leggauss(GAUSS_POINTS)
    local = (ends[:, None] + 1) / 2
    weights = sizes / 2
    if count != 3:
        first, second = (grid.ravel() for grid in np.meshgrid(local, local, indexing="ij"))
        local = np.column_stack([first, second])
        weights = np.outer(weights, weights).ravel()
    if count == 6:  # a square folded to a triangle
        local[:, 0] *= 1 - second
        weights *= 1 - second
    values = np.hstack([1 - local, local]) if count == 3 else shape_functions(local, len(part))[0]
    coordinates = values @ REFERENCE_NODES[count][list(part)]
    steps = np.eye(coordinates.shape[1]) * 0.5
    # central differences are exact for parabolas
    slopes = [
        quadratic(coordinates + step, count) - quadratic(coordinates - step, count)
        for step in steps
    ]
    share = 1 / len(FLAT_PARTS[count])
    return values, quadratic(coordinates, count), np.stack(slopes, axis=2), share * weights
