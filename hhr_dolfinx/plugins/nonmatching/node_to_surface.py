"""Node-to-surface contact on non-matching meshes, thesis section 5.1."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from hhr_dolfinx.contact.law import LAW, PairLaw
from hhr_dolfinx.contact.rows import ContactRows
from hhr_dolfinx.errors import NeverFacingError
from hhr_dolfinx.pairings.surface import (
    GRAZING_NORMAL,
    SlaveAndMaster,
    Surface,
    check_facing,
    looking,
    mean_normal,
    nodal_rows,
    tangential_order,
    unit,
    warn,
    warn_of_overlap,
)
from hhr_dolfinx.plugins.nonmatching.facing import EDGE_OVERHANG, FACING_DIRECTIONS, opposed
from hhr_dolfinx.plugins.nonmatching.messages import (
    beyond_overlap,
    never_facing,
    warn_beyond_edge,
    warn_of_sag,
    warn_of_tilt,
)
from hhr_dolfinx.plugins.nonmatching.projection import ClosestPoints, closest_points, project

KEPT_HEIGHT = 1e-4
"""Fraction of their height that projected surfaces keep, so that the nearest of several layers is
found.
"""
FINER = 0.5
"""Size of slave facets over that of the master above which node-to-surface is inaccurate on cells
of second order.
"""
NESTED = 1.5
"""Size of slave facets over that of the master above which meshes whose nodes coincide are nested:
2 at least.
"""

WITH_MIDDLE = 9
"""Nodes of a facet of which the last one is in its middle."""
FACET_CORNERS = 4
"""Number of corners of such a facet, whose nodes come first."""


class _Partners(NamedTuple):
    """Slave nodes that have a condition, (m,).

    Closest points, normals, and areas along the normal of all n nodes.
    """

    kept: np.ndarray
    closest: ClosestPoints
    normals: np.ndarray
    areas: np.ndarray


@dataclass(frozen=True)
class NodeToSurface(SlaveAndMaster):
    """Nodes of the slave surface may not pass through the master surface, thesis (5.1)-(5.3).

    A slave node x faces the point x' of the master, with shape functions w there. The condition is
    ``(u(x) - sum_i w_i u_i)·n <= (x' - x)·n``. Take the finer surface as slave (section 5.1).

    Attributes:
        slave: facet tag of the surface whose nodes carry conditions and multipliers.
        master: facet tag of the facing surface.
        normal: n from slave to master, along which the slave nodes are projected. None takes the
            closest point, and an n for each node: against the smoothed outer normal of the master
            at that point.
        friction: coefficient of Coulomb's law, a number or a formula, or its law; None without. A
            plug-in reads it.
        law: any law of a plug-in in addition to unilateral contact, such as ``Coulomb(0.3)``; None
            without.
        at_nodes: on cells of second order, True for conditions at single nodes of edges, as
            CalculiX has them, instead of means around nodes. The end of a body presses at its nodes
            then; pressures at single nodes vary. Nodes in the middle of faces have no condition: on
            hexahedra this needs ``Serendipity()``, or faces pass there.

    Example:
        >>> pair = hhr.NodeToSurface(slave="punch", master="sheet", friction="mu")
        >>> pair.tags, pair.normal is None
        (('punch', 'sheet'), True)
    """

    normal: tuple[float, ...] | None = None
    friction: PairLaw | str | float | None = field(default=None, metadata=LAW)
    law: PairLaw | None = field(default=None, metadata=LAW)
    at_nodes: bool = False

    def rows(self, surfaces: Sequence[Surface], dofs: int) -> ContactRows:
        """One row for each slave node that faces the master surface.

        Args:
            surfaces: the slave and the master surface.
            dofs: number of dofs.

        Raises:
            NeverFacingError: if the surfaces do not face each other.
        """
        slave, master = surfaces
        rows, facets, weights = self._paired(slave, master, dofs)
        warn_of_overlap(slave, rows)
        bulges = master.bulges(facets, weights)
        warn_of_sag(slave, master, rows, float(np.abs(bulges) @ rows.areas / rows.areas.sum()))
        if self.at_nodes:
            return _without_middles(slave, rows)
        _warn_of_coarse_slave(slave, master, weights)
        return slave.averaged(rows)

    def rows_of_deformed(
        self, surfaces: Sequence[Surface], dofs: int, overlap: float
    ) -> ContactRows:
        """Rows of deformed surfaces without warnings.

        Args:
            surfaces: the slave and the master surface.
            dofs: number of dofs.
            overlap: length by which bodies may overlap beyond a cell.
        """
        slave, master = surfaces
        rows = self._paired(slave, master, dofs, overlap)[0]
        return _without_middles(slave, rows) if self.at_nodes else slave.averaged(rows)

    def _paired(
        self, slave: Surface, master: Surface, dofs: int, overlap: float = 0.0
    ) -> tuple[ContactRows, np.ndarray, np.ndarray]:
        """Rows, the facet of the master that each node faces, and the values of its shape functions
        there.
        """
        if self.normal is None:
            paired, closest, normals, areas = _closest(slave, master, overlap)
        else:
            paired, closest, normals, areas = _along(
                slave, master, unit(self.normal, slave.points.shape[1])
            )
        nodes = master.facets[closest.facets]
        weights = closest.weights
        if (
            master.quadratic is not None
        ):  # the displacement has other functions than the flat parts of the facets
            quadratic_facets, weights = master.quadratic.functions(closest.facets, weights)
            nodes = master.quadratic.nodes[quadratic_facets]
        order = paired[tangential_order(slave.points[paired], mean_normal(slave))]
        points = slave.points[order]
        master_points = np.einsum("mk,mkd->md", weights[order], master.points[nodes[order]])
        together = np.column_stack([slave.nodes[order], master.nodes[nodes[order]]])
        both = np.column_stack([np.ones(order.size), -weights[order]])
        matrix = nodal_rows(together, normals[order], both, dofs)
        gap = np.einsum("md,md->m", master_points - points, normals[order])
        rows = ContactRows(matrix, gap, slave.nodes[order], points, areas[order])
        return rows, closest.facets[order], closest.weights[order]


def _without_middles(slave: Surface, rows: ContactRows) -> ContactRows:
    """Rows without those in the middle of quadrilaterals of second order: CalculiX has no nodes
    there.

    Nodes of edges take over their areas, so that these still have the sum of the surface.
    """
    if slave.quadratic is None or slave.quadratic.nodes.shape[1] < WITH_MIDDLE:
        return rows
    index = np.full(slave.nodes.max() + 1, -1)
    index[rows.slaves] = np.arange(rows.slaves.size)
    row_of_nodes = index[slave.nodes[slave.quadratic.nodes]]
    middle = row_of_nodes[:, -1]
    edges = row_of_nodes[:, FACET_CORNERS:-1]
    has_row = (edges >= 0) & (middle >= 0)[:, None]
    shares = (
        rows.areas[middle][:, None] * has_row / np.maximum(has_row.sum(axis=1, keepdims=True), 1)
    )
    areas = rows.areas + np.bincount(edges[has_row], shares[has_row], rows.areas.size)
    return replace(rows, areas=areas).take(np.setdiff1d(np.arange(rows.slaves.size), middle))


def _warn_of_coarse_slave(slave: Surface, master: Surface, weights: np.ndarray) -> None:
    """Warn of non-matching cells of second order unless the slave is far finer: conditions belong
    to its nodes.

    Single nodes received 7 to 175 % of a constant pressure with three slave facets on four, 99.7 to
    100.1 % with ten on three.
    """
    ratio = slave.lengths().mean() / master.lengths().mean()
    matching = (
        weights.max(axis=1) > 1 - EDGE_OVERHANG
    ).all() and ratio < NESTED  # nodes of nested meshes lie on nodes too
    if slave.quadratic is not None and not matching and ratio > FINER:
        warn(
            f"surfaces {slave.tag} and {master.tag} are of second order and do not match, and the "
            "slave is not far finer: node to surface has pressures wrong at single nodes, by as "
            "much as they are. Take Mortar"
        )


def _along(slave: Surface, master: Surface, normal: np.ndarray) -> _Partners:
    check_facing(slave, normal, along=True)
    for surface in (slave, master):
        warn_of_tilt(surface, normal)
    facing = master.outward @ normal < -GRAZING_NORMAL
    if not facing.any():
        raise NeverFacingError(
            never_facing(slave, master, f"no facet of {master.tag} looks against {normal.tolist()}")
        )
    along = np.outer(normal, normal)
    flat = np.eye(normal.size) - along
    corners = master.corners[facing]
    # projected along the normal the surfaces are flat, and the closest point is the point hit
    hit = closest_points(
        slave.points @ (flat + KEPT_HEIGHT * along), corners @ (flat + KEPT_HEIGHT * along)
    ).facets
    weights = project(slave.points @ flat, corners[hit] @ flat)
    offsets = slave.points @ flat - np.einsum("mk,mkd->md", weights, corners[hit] @ flat)
    closest = ClosestPoints(np.flatnonzero(facing)[hit], weights, offsets)
    beyond = np.linalg.norm(offsets, axis=1) > EDGE_OVERHANG * master.lengths()[closest.facets]
    looks, areas = looking(slave, normal, GRAZING_NORMAL)
    paired = _kept(slave, master, beyond | ~looks, beyond & looks)
    return _Partners(paired, closest, np.tile(normal, (len(slave.nodes), 1)), areas)


def _closest(slave: Surface, master: Surface, allowed: float) -> _Partners:
    """Project the slave nodes on facets that look against them.

    Bodies may overlap by a cell plus ``allowed``.
    """
    partners = opposed(slave, master, allowed)
    closest = partners.closest
    if not partners.facing.any():
        raise NeverFacingError(
            never_facing(slave, master, "the closest facets all look the same way as the slave")
        )
    if not (partners.facing & ~partners.back_side).any():
        raise NeverFacingError(
            never_facing(slave, master, beyond_overlap(partners.depth[partners.facing].max()))
        )
    areas = looking(slave, partners.normals, FACING_DIRECTIONS)[1]
    return _Partners(
        _kept(slave, master, ~partners.meets, partners.overhanging),
        closest,
        partners.normals,
        areas,
    )


def _kept(slave: Surface, master: Surface, lost: np.ndarray, beyond: np.ndarray) -> np.ndarray:
    """Drop slave nodes that face nothing, with a warning that names a node beyond the edge of the
    master.
    """
    if lost.all():
        raise NeverFacingError(
            never_facing(slave, master, "no slave node lies in front of a master facet")
        )
    warn_beyond_edge(slave, master, beyond, ": swap slave and master, or tag only what can touch")
    return np.flatnonzero(~lost)
