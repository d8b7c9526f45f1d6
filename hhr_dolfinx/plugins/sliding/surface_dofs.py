"""Full order of a scene whose sliding surfaces have a row for each dof, beside the pairs that do
not slide.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI
from scipy.sparse import csr_matrix

from hhr_dolfinx.amplitudes import Amplitudes
from hhr_dolfinx.contact.law import ContactLaw, PairLaw
from hhr_dolfinx.contact.prolongation import Prolongation
from hhr_dolfinx.contact.rows import ContactRows, joined, normals_of
from hhr_dolfinx.contact.shares import Shares
from hhr_dolfinx.full_order.discretisation import Discretisation
from hhr_dolfinx.full_order.eliminated import DependentDofs
from hhr_dolfinx.full_order.full import FullOrderModel
from hhr_dolfinx.pairings.obstacle import Obstacle
from hhr_dolfinx.pairings.surface import SlaveAndMaster, Surface
from hhr_dolfinx.plugins.friction.tangents import tangents_of
from hhr_dolfinx.plugins.sliding.beside import BesideTools
from hhr_dolfinx.plugins.sliding.law import SlidingLaw
from hhr_dolfinx.plugins.sliding.pairs import sliding_law
from hhr_dolfinx.plugins.sliding.pressures import before_dofs
from hhr_dolfinx.plugins.sliding.repairing import no_friction, nodes_of
from hhr_dolfinx.scene import Scene


@dataclass(frozen=True)
class SurfaceDofs(SlaveAndMaster):
    """Rows of the identity at the nodes of two surfaces, component by component.

    They span all contact conditions.
    """

    def rows(self, surfaces: Sequence[Surface], dofs: int) -> ContactRows:
        """One row for each component of the displacement of each node, node by node.

        Args:
            surfaces: slave and master.
            dofs: number of columns of the rows.
        """
        nodes, points = nodes_of(surfaces)
        dim = points.shape[1]
        columns = (nodes[:, None] * dim + np.arange(dim)).ravel()
        matrix = csr_matrix(
            (np.ones(columns.size), (np.arange(columns.size), columns)), shape=(columns.size, dofs)
        )
        nothing = np.zeros(columns.size)
        return ContactRows(
            matrix, nothing, np.repeat(nodes, dim), np.repeat(points, dim, axis=0), nothing
        )


class SurfacesThatSlide(Discretisation):
    """Finite element model with rows of surface dofs and of motion along curved tools.

    See :class:`SurfaceDofs`. The rows of motion are no conditions.

    All of the former are kept, also those of imposed dofs, and of dofs that constraints make one:
    the displacement of a surface is ``lifts θ + T U0`` at each of its nodes, whatever moves it.
    Their law remembers, since positions do.

    Attributes:
        beside: conditions of curved tools, whose motion along them are the last rows.
        meant: the scene with the pairs that are paired again.
        sliding: these pairs, and the law on them.
    """

    beside = BesideTools.none()
    meant: Scene
    sliding: SlidingLaw
    _prolongation: Prolongation

    def conditions(
        self,
        rows: ContactRows,
        pairs: np.ndarray,
        opened: np.ndarray,
        eliminated: DependentDofs,
        amplitudes: Amplitudes,
    ) -> tuple[ContactRows, np.ndarray, np.ndarray, ContactLaw, Shares | None]:
        """Conditions of the pairs that do not slide, followed by dofs and motion.

        Args:
            rows: rows of all contacts.
            pairs: contact of each row, (m,).
            opened: gaps that openings add, (m, 1 + T).
            eliminated: dependent dofs.
            amplitudes: θ as a function of the parameters.
        """
        slide = np.array([isinstance(contact, SurfaceDofs) for contact in self.scene.contacts])[
            pairs
        ]
        dofs = rows.take(np.flatnonzero(slide))
        of_dofs = pairs[slide]
        law: ContactLaw = no_friction(rows.points.shape[1])
        self._prolongation = eliminated.prolongation
        lifts = eliminated.prolongation.lifts
        if slide.all():
            law = self._slides(law, 0)
            return dofs, pairs, -(dofs.matrix @ lifts).toarray(), law, None
        fixed_rows = np.flatnonzero(~slide)
        fixed, of_pairs, gaps, law_of_pairs, shares = super().conditions(
            rows.take(fixed_rows), pairs[fixed_rows], opened[fixed_rows], eliminated, amplitudes
        )
        law = law_of_pairs if law_of_pairs.plugin else law
        self.beside = self._beside_tools(fixed, of_pairs, law)
        along = _along(fixed.take(self.beside.conditions))
        moving = joined([dofs, along])
        law = self._slides(law, of_pairs.size, moving.gap.size)
        gaps = np.vstack(
            [gaps, -(moving.matrix @ lifts).toarray()]
        )  # openings add to gaps of pairs, not of dofs
        # motions bear no force, whatever contact they count for
        of_motion = np.full(along.gap.size, of_dofs[-1])
        return (
            joined([fixed, moving]),
            np.concatenate([of_pairs, of_dofs, of_motion]),
            gaps,
            law,
            shares,
        )

    def _slides(self, of_others: ContactLaw, first: int, further: int = 0) -> ContactLaw:
        """Law on all rows: that of the pairs that do not slide, or for bodies with laws of all.

        Args:
            of_others: law of the pairs that do not slide.
            first: number of their conditions.
            further: number of rows that follow.
        """
        sliding = {
            number: contact
            for number, contact in enumerate(self.meant.contacts)
            if isinstance(self.scene.contacts[number], SurfaceDofs)
        }
        self.sliding = sliding_law(self.meant, sliding, self, of_others, first)
        return self.sliding if self.scene.reader else before_dofs(of_others, first, first + further)

    @property
    def dofs(self) -> int:
        """Number of dofs of the mesh, N."""
        return self._prolongation.movable.size

    def laws_on(
        self, laws: dict[int, PairLaw], rows: ContactRows, pairs: np.ndarray
    ) -> tuple[ContactRows, ContactLaw]:
        """Rows with those that laws append, and the law on all of them.

        Args:
            laws: laws by pair.
            rows: conditions of pressures.
            pairs: contact of each, (n,).
        """
        longer, _, law = self._with_laws(laws, rows, pairs, self._prolongation)
        return longer, law

    def _beside_tools(self, rows: ContactRows, pairs: np.ndarray, law: ContactLaw) -> BesideTools:
        """Conditions of curved tools, with the largest facet at each slave node."""
        curved = [
            not isinstance(contact, SurfaceDofs | Obstacle) for contact in self.scene.contacts
        ]
        conditions = np.flatnonzero(np.array(curved)[pairs] & law.pressing(pairs.size))
        sizes = np.zeros(rows.matrix.shape[1] // rows.points.shape[1])
        for number in np.unique(pairs[conditions]).tolist():
            surface = self.surface(self.scene.contacts[number].tags[0])
            sizes[surface.nodes] = surface.cell_sizes()
        return BesideTools(conditions, sizes[rows.slaves[conditions]])


def _along(rows: ContactRows) -> ContactRows:
    """Rows of the displacement of the slave of each condition along its tangents.

    The matrix is (m (dim - 1), N).
    """
    dim = rows.points.shape[1]
    tangents = tangents_of(normals_of(rows.matrix, rows.slaves, dim))
    slaves = np.repeat(rows.slaves, dim - 1)
    columns = (slaves[:, None] * dim + np.arange(dim)).ravel()
    indices = np.repeat(np.arange(slaves.size), dim), columns
    matrix = csr_matrix((tangents.ravel(), indices), shape=(slaves.size, rows.matrix.shape[1]))
    nothing = np.zeros(slaves.size)
    return ContactRows(matrix, nothing, slaves, np.repeat(rows.points, dim - 1, axis=0), nothing)


class FullOrderOfSurfaces(FullOrderModel):
    """Full order of such a scene.

    Args:
        scene: the scene with rows of the dofs of surfaces.
        comm: communicator of its mesh.
        meant: the scene with the pairs that are paired again.
    """

    def __init__(self, scene: Scene, comm: MPI.Comm, meant: Scene):
        def kind(made: type[Discretisation]) -> type[Discretisation]:
            bases = (SurfacesThatSlide,) if made is Discretisation else (SurfacesThatSlide, made)
            return type(f"{made.__name__}ThatSlides", bases, {"meant": meant})

        self.kind = kind
        super().__init__(scene, comm)
