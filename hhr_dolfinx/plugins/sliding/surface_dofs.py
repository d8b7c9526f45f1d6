"""Full order of a scene whose sliding surfaces have a row for each dof, beside the pairs that do not slide."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix

from hhr_dolfinx.amplitudes import Amplitudes
from hhr_dolfinx.contact.law import ContactLaw
from hhr_dolfinx.contact.rows import ContactRows, joined
from hhr_dolfinx.contact.shares import Shares
from hhr_dolfinx.full_order.discretisation import Discretisation
from hhr_dolfinx.full_order.eliminated import Eliminated
from hhr_dolfinx.full_order.full import FullOrderModel
from hhr_dolfinx.pairings.surface import SlaveAndMaster, Surface
from hhr_dolfinx.plugins.sliding.repairing import no_friction, nodes_of


@dataclass(frozen=True)
class SurfaceDofs(SlaveAndMaster):
    """Rows of the identity at the nodes of two surfaces, component by component, which span all contact conditions."""

    def rows(self, surfaces: Sequence[Surface], dofs: int) -> ContactRows:
        """One row for each component of the displacement of each node, in the order of the nodes."""
        nodes, points = nodes_of(surfaces)
        dim = points.shape[1]
        own = (nodes[:, None] * dim + np.arange(dim)).ravel()
        matrix = csr_matrix((np.ones(own.size), (np.arange(own.size), own)), shape=(own.size, dofs))
        nothing = np.zeros(own.size)
        return ContactRows(matrix, nothing, np.repeat(nodes, dim), np.repeat(points, dim, axis=0), nothing)


class SurfacesThatSlide(Discretisation):
    """Finite element model whose last rows are those of :class:`SurfaceDofs`, which are no conditions.

    All of them are kept, also those of imposed dofs, and of dofs that constraints make one: the displacement of a
    surface is ``lifts θ + T U0`` at each of its nodes, whatever moves it. Their law remembers, since positions do.
    """

    def conditions(
        self, rows: ContactRows, pairs: np.ndarray, opened: np.ndarray, eliminated: Eliminated, amplitudes: Amplitudes
    ) -> tuple[ContactRows, np.ndarray, np.ndarray, ContactLaw, Shares | None]:
        """Conditions of the pairs that do not slide, as the full order makes them, followed by the rows of dofs."""
        slide = np.array([isinstance(item, SurfaceDofs) for item in self.scene.contacts])[pairs]
        dofs = rows.take(np.flatnonzero(slide))
        moved = -(dofs.matrix @ eliminated.prolongation.lifts).toarray()  # openings add to gaps of pairs, not of dofs
        without = no_friction(rows.points.shape[1])
        if slide.all():
            return dofs, pairs, moved, without, None
        kept = np.flatnonzero(~slide)
        found, of_pairs, gaps, law, shares = super().conditions(
            rows.take(kept), pairs[kept], opened[kept], eliminated, amplitudes
        )
        law = law if law.remembers else without
        return joined([found, dofs]), np.concatenate([of_pairs, pairs[slide]]), np.vstack([gaps, moved]), law, shares


class FullOrderOfSurfaces(FullOrderModel):
    """Full order of such a scene."""

    discretised = SurfacesThatSlide
