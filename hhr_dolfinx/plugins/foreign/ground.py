"""Contact of single nodes with the ground, by normals, gaps and areas: no facets."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.sparse import csr_matrix

from hhr_dolfinx.contact.law import LAW, PairLaw
from hhr_dolfinx.contact.rows import ContactRows
from hhr_dolfinx.declared import KnownArguments
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.parameters import Tag
from hhr_dolfinx.plugins.foreign.parts import BareNodes

if TYPE_CHECKING:
    from numpy.typing import ArrayLike


@dataclass(frozen=True)
class NodesToGround(KnownArguments):
    """Contact u·n <= gap at each node of a set, in ascending order of nodes.

    Of shells and beams of CalculiX these are the nodes of the deck, in the middle of the section.

    Attributes:
        nodes: name of the set, or of a surface.
        normal: direction in which the ground lies, (3,), or one for each node, (n, 3), of any
            length.
        gap: distance of the ground, or of each node, (n,).
        plane: offset of a plane n·x = plane, n of length 1, whose distances are added to the gaps;
            None for none.
        area: tributary area of each node, (n,), or of all; 1 gives forces instead of pressures.
        friction: coefficient of friction, a formula, or a law; None without.
        law: any law of a plug-in in addition to unilateral contact; None without.
    """

    nodes: Tag
    normal: ArrayLike
    gap: ArrayLike = 0.0
    plane: float | None = None
    area: ArrayLike = 1.0
    friction: PairLaw | str | float | None = field(default=None, metadata=LAW)
    law: PairLaw | None = field(default=None, metadata=LAW)

    @property
    def tags(self) -> tuple[Tag, ...]:
        """The set."""
        return (self.nodes,)

    def rows(self, surfaces: Sequence[Any], dofs: int) -> ContactRows:
        """One row for each node.

        Args:
            surfaces: the nodes, as one surface.
            dofs: number of dofs, N.

        Raises:
            SceneError: for normals, gaps or areas that do not fit the nodes.
        """
        (surface,) = surfaces
        bare = isinstance(surface, BareNodes)
        nodes, points = (
            (surface.slaves, surface.middles) if bare else (surface.nodes, surface.points)
        )
        count, dim = points.shape
        try:
            normals = np.broadcast_to(np.asarray(self.normal, dtype=float), (count, dim))
            gaps, areas = (
                np.broadcast_to(np.asarray(value, dtype=float), (count,))
                for value in (self.gap, self.area)
            )
        except ValueError:
            raise SceneError(
                f"NodesToGround of '{self.nodes}', {count} nodes: normal must be ({dim},) or "
                f"({count}, {dim}), gap and "
                f"area numbers or ({count},)"
            ) from None
        lengths = np.linalg.norm(normals, axis=1)
        if not (lengths > 0).all() or not (areas > 0).all() or not np.isfinite(gaps).all():
            raise SceneError(
                f"NodesToGround of '{self.nodes}' needs normals and areas above 0, and finite gaps"
            )
        means = surface.means if bare else _single(nodes, dofs // dim)
        at = means.tocoo()
        units = normals / lengths[:, None]
        gaps = gaps + (
            0.0 if self.plane is None else self.plane - np.einsum("nd,nd->n", units, points)
        )
        columns = (dim * at.col[:, None] + np.arange(dim)).ravel()
        values = (at.data[:, None] * units[at.row]).ravel()
        matrix = csr_matrix((values, (np.repeat(at.row, dim), columns)), shape=(count, dofs))
        matrix.eliminate_zeros()  # a dof across the normal is no dof of contact
        return ContactRows(matrix, gaps, nodes, points, areas.copy())


def _single(nodes: np.ndarray, count: int) -> csr_matrix:
    """Each node by itself, (n, count)."""
    return csr_matrix(
        (np.ones(nodes.size), (np.arange(nodes.size), nodes)), shape=(nodes.size, count)
    )
