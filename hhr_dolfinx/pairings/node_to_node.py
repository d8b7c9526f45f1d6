"""Contact of facing nodes on matching meshes, thesis (1.25)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

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
    """

    first: Tag
    second: Tag
    normal: tuple[float, ...]
    friction: Any = field(default=None, metadata=LAW)
    law: PairLaw | None = field(default=None, metadata=LAW)

    @property
    def tags(self) -> tuple[Tag, ...]:
        """Both surfaces."""
        return (self.first, self.second)

    def rows(self, surfaces: Sequence[Surface], dofs: int) -> ContactRows:
        """One row for each pair of nodes, one with a side that looks along n, the other with one
        against n.
        """
        first, second = surfaces
        normal = unit(self.normal, first.points.shape[1])
        check_facing(first, normal, along=True)
        check_facing(second, normal, along=False)
        here, areas = along_normal(first, normal)
        here = here[tangential_order(first.points[here], normal)]
        there, _ = along_normal(second, -normal)
        there = there[_partners(first, second, here, there, normal)]
        nodes = np.column_stack([first.nodes[here], second.nodes[there]])
        matrix = nodal_rows(
            nodes, np.tile(normal, (len(nodes), 1)), np.tile([1.0, -1.0], (len(nodes), 1)), dofs
        )
        gap = (second.points[there] - first.points[here]) @ normal
        rows = ContactRows(matrix, gap, nodes[:, 0], first.points[here], areas[here])
        warn_of_overlap(first, rows)
        return first.averaged(rows)


def _partners(
    first: Surface, second: Surface, own: np.ndarray, others: np.ndarray, normal: np.ndarray
) -> np.ndarray:
    """Index, among ``others`` of the second surface, of the node that each of ``own`` of the first
    one faces.
    """
    along = np.eye(normal.size) - np.outer(normal, normal)
    here = first.points[own] @ along
    there = second.points[others] @ along
    distance, partner = cKDTree(there).query(here)
    # the scale of the tolerance is the median distance of neighbours
    spacing = float(np.median(cKDTree(here).query(here, k=2)[0][:, 1])) if len(here) > 1 else 1.0
    lonely = distance > 1e-4 * spacing
    if len(here) != len(there) or lonely.any() or np.unique(partner).size != partner.size:
        unmatched = np.setdiff1d(np.arange(len(there)), partner)
        lost = first.points[own][lonely] if lonely.any() else second.points[others][unmatched]
        # if two nodes face the same one, none is without a partner
        place = (lost if len(lost) else first.points[own])[0].tolist()
        raise SceneError(
            f"surfaces {first.tag} ({len(here)} nodes that look along the normal) and "
            f"{second.tag} ({len(there)} that look against it) do not face each other node to "
            f"node along {rounded(normal)}: {len(lost)} nodes have no partner, e.g. at {place}. "
            "Mesh both surfaces alike or use a pairing for non-matching meshes, NodeToSurface or "
            "Mortar"
        )
    return partner
