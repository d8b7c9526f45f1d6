"""Contact of facing nodes on matching meshes, thesis (1.25)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial import cKDTree

from hhr_dolfinx.contact.problem import ContactRows
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.pairings.surface import Surface, check_facing, nodal_rows, tangential_order, unit, warn_of_overlap
from hhr_dolfinx.parameters import Tag

if TYPE_CHECKING:
    from hhr_dolfinx.contact.friction import Law


@dataclass(frozen=True)
class NodeToNode:
    """Contact of nodes that face each other along n, thesis (1.25): ``(u_1 - u_2)·n <= d``.

    Attributes:
        first: facet tag of the surface whose outer normal is n.
        second: facet tag of the facing surface.
        normal: unit vector n, from the first to the second surface.
        friction: coefficient of Coulomb's law, or a law, see :mod:`hhr_dolfinx.contact.friction`; None without.
    """

    first: Tag
    second: Tag
    normal: tuple[float, ...]
    friction: float | str | Law | None = None

    @property
    def tags(self) -> tuple[Tag, ...]:
        """Both surfaces."""
        return (self.first, self.second)

    def rows(self, surfaces: Sequence[Surface], dofs: int) -> ContactRows:
        """One row for each pair of nodes."""
        first, second = surfaces
        normal = unit(self.normal, first.points.shape[1])
        check_facing(first, normal, along=True)
        check_facing(second, normal, along=False)
        partner = _partners(first, second, normal)
        order = tangential_order(first.points, normal)
        nodes = np.column_stack([first.nodes, second.nodes[partner]])[order]
        matrix = nodal_rows(nodes, np.tile(normal, (len(nodes), 1)), np.tile([1.0, -1.0], (len(nodes), 1)), dofs)
        gap = ((second.points[partner] - first.points) @ normal)[order]
        rows = ContactRows(matrix, gap, nodes[:, 0], first.points[order], first.areas[order])
        warn_of_overlap(first, rows)
        return first.averaged(rows)


def _partners(first: Surface, second: Surface, normal: np.ndarray) -> np.ndarray:
    """For each node of the first surface the node of the second that it faces."""
    along = np.eye(normal.size) - np.outer(normal, normal)
    here = first.points @ along
    there = second.points @ along
    distance, partner = cKDTree(there).query(here)
    lonely = distance > 1e-4 * _spacing(here)
    if len(here) != len(there) or lonely.any() or np.unique(partner).size != partner.size:
        unmatched = np.setdiff1d(np.arange(len(there)), partner)
        lost = first.points[lonely] if lonely.any() else second.points[unmatched]
        raise SceneError(
            f"surfaces {first.tag} ({len(here)} nodes) and {second.tag} ({len(there)} nodes) do not face each other "
            f"node to node along {normal.tolist()}: {len(lost)} nodes have no partner, e.g. at {lost[0].tolist()}. "
            "Mesh both surfaces alike or use a pairing for non-matching meshes, NodeToSurface or Mortar"
        )
    return partner


def _spacing(points: np.ndarray) -> float:
    """Median distance of neighbours, the measure of what 'facing' means."""
    if len(points) < 2:
        return 1.0
    return float(np.median(cKDTree(points).query(points, k=2)[0][:, 1]))
