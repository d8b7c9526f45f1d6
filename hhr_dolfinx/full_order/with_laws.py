"""Bodies with laws on the whole mesh: what a plug-in makes of a scene, its facet ``full_order``."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

from hhr_dolfinx import registry
from hhr_dolfinx.models.histories.equilibrium import LawsAtPlaces

if TYPE_CHECKING:
    from scipy.sparse import csr_matrix

    from hhr_dolfinx.formulas import Modulus
    from hhr_dolfinx.full_order.discretisation import ChangedClass, Discretisation
    from hhr_dolfinx.models.full import FullModel
    from hhr_dolfinx.models.histories.equilibrium import FullEquilibrium
    from hhr_dolfinx.scene import Scene


class BodiesWithLaws(LawsAtPlaces, Protocol):
    """Bodies with laws on the mesh of a scene."""

    discretisation: Discretisation  #: mesh and forms; each process has the whole mesh
    stiffness: tuple[csr_matrix, ...]  #: parts of the elastic stiffness, (N, N) each
    moduli: tuple[
        Modulus, ...
    ]  #: their amplitudes; empty if elasticity is constant, with a single part

    def equilibrium(self, full: FullModel) -> FullEquilibrium:
        """Equilibrium of a full model, which has factored the elastic stiffness."""


def with_laws(scene: Scene, kind: ChangedClass) -> BodiesWithLaws:
    """Bodies of a scene that has a ``reader``.

    Args:
        scene: the scene.
        kind: changes the class of its finite element model.

    Raises:
        NotOfferedError: if this plug-in solves nothing in full order.
    """
    bodies: BodiesWithLaws = registry.facet(
        scene.reader, "full_order", f"the full model of scene '{scene.name}'"
    )(scene, kind)
    return bodies
