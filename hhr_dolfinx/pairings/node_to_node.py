"""Contact of facing nodes on matching meshes, thesis (1.25)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial import cKDTree

from hhr_dolfinx.contact.law import LAW, PairLaw
from hhr_dolfinx.contact.rows import ContactRows
from hhr_dolfinx.declared import KnownArguments
from hhr_dolfinx.errors import SceneError, rounded
from hhr_dolfinx.pairings.surface import (
    Surface,
    along_normal,
    check_facing,
    nodal_rows,
    tangential_order,
    unit,
    warn_of_overlap,
)
from hhr_dolfinx.parameters import Tag


@dataclass(frozen=True)
class NodeToNode(KnownArguments):
    """Contact of nodes that face each other along n, thesis (1.25): ``(u_1 - u_2)·n <= d``.

    Attributes:
        first: facet tag of the surface whose outer normal is n.
        second: facet tag of the facing surface.
        normal: unit vector n, from the first to the second surface.
        friction: coefficient of Coulomb's law, a number or a formula, or its law; None without. A
            plug-in reads it.
        law: any law of a plug-in in addition to unilateral contact, such as ``Coulomb(0.3)``; None
            without.

    Example:
        >>> pair = hhr.NodeToNode(first="pellet", second="cladding", normal=(1, 0), friction=0.2)
        >>> pair.tags, pair.normal
        (('pellet', 'cladding'), (1, 0))
    """

    first: Tag
    second: Tag
    normal: tuple[float, ...]
    friction: PairLaw | float | str | None = field(default=None, metadata=LAW)
    law: PairLaw | None = field(default=None, metadata=LAW)

    @property
    def tags(self) -> tuple[Tag, ...]:
        """Both surfaces."""
        return (self.first, self.second)

    def rows(self, surfaces: Sequence[Surface], dofs: int) -> ContactRows:
        """One row for each pair of nodes whose sides look along n and against n.

        Args:
            surfaces: the first and the second surface.
            dofs: number of dofs.

        Raises:
            SceneError: if the surfaces do not face each other node to node.
        """
        first, second = surfaces
        normal = unit(self.normal, first.points.shape[1])
        check_facing(first, normal, along=True)
        check_facing(second, normal, along=False)
        first_nodes, areas = along_normal(first, normal)
        first_nodes = first_nodes[tangential_order(first.points[first_nodes], normal)]
        second_nodes, _ = along_normal(second, -normal)
        second_nodes = second_nodes[_partners(first, second, first_nodes, second_nodes, normal)]
        nodes = np.column_stack([first.nodes[first_nodes], second.nodes[second_nodes]])
        matrix = nodal_rows(
            nodes, np.tile(normal, (len(nodes), 1)), np.tile([1.0, -1.0], (len(nodes), 1)), dofs
        )
        gap = (second.points[second_nodes] - first.points[first_nodes]) @ normal
        rows = ContactRows(matrix, gap, nodes[:, 0], first.points[first_nodes], areas[first_nodes])
        warn_of_overlap(first, rows)
        return first.averaged(rows)


def _partners(
    first: Surface, second: Surface, own: np.ndarray, others: np.ndarray, normal: np.ndarray
) -> np.ndarray:
    """Index, among ``others`` of the second surface, of the node that each of ``own`` of the first
    one faces.
    """
    along = np.eye(normal.size) - np.outer(normal, normal)
    first_points = first.points[own] @ along
    second_points = second.points[others] @ along
    distance, partner = cKDTree(second_points).query(first_points)
    # the scale of the tolerance is the median distance of neighbours
    spacing = (
        float(np.median(cKDTree(first_points).query(first_points, k=2)[0][:, 1]))
        if len(first_points) > 1
        else 1.0
    )
    lonely = distance > 1e-4 * spacing
    if (
        len(first_points) != len(second_points)
        or lonely.any()
        or np.unique(partner).size != partner.size
    ):
        unmatched = np.setdiff1d(np.arange(len(second_points)), partner)
        lost = first.points[own][lonely] if lonely.any() else second.points[others][unmatched]
        # if two nodes face the same one, none is without a partner
        point = (lost if len(lost) else first.points[own])[0].tolist()
        raise SceneError(
            f"surfaces {first.tag} ({len(first_points)} nodes that look along the normal) and "
            f"{second.tag} ({len(second_points)} that look against it) do not face each other node "
            f"to node along {rounded(normal)}: {len(lost)} nodes have no partner, e.g. at {point}. "
            "Mesh both surfaces alike or use a pairing for non-matching meshes, NodeToSurface or "
            "Mortar"
        )
    return partner
