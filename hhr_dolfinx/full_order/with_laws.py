"""Bodies with laws on the whole mesh: what a plug-in makes of a scene, its facet ``full_order``."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

import numpy as np

from hhr_dolfinx import registry

if TYPE_CHECKING:
    from scipy.sparse import csr_matrix

    from hhr_dolfinx.formulas import Modulus
    from hhr_dolfinx.full_order.discretisation import Discretisation
    from hhr_dolfinx.models.full import FullModel
    from hhr_dolfinx.models.functionals.functional import Functional
    from hhr_dolfinx.models.histories.equilibrium import FullEquilibrium, StressOutput
    from hhr_dolfinx.scene import Scene


class BodiesWithLaws(Protocol):
    """Bodies with laws on the mesh of a scene."""

    discretisation: Discretisation  # mesh and forms; each process has the whole mesh
    stiffness: tuple[csr_matrix, ...]  # parts of the elastic stiffness, (N, N) each
    moduli: tuple[Modulus, ...]  # their amplitudes; empty if elasticity is constant, with a single part
    places: int  # number of places at which laws are evaluated

    def mises(self, output: StressOutput, cells: np.ndarray) -> Functional:
        """Von Mises' stress of an output in some cells, by their numbers."""

    def equilibrium(self, full: FullModel) -> FullEquilibrium:
        """Equilibrium of a full model, which has factored the elastic stiffness."""


def with_laws(scene: Scene) -> BodiesWithLaws:
    """Bodies of a scene that has a ``reader``; NotOfferedError if this plug-in solves nothing in full order."""
    made: BodiesWithLaws = registry.facet(scene.reader, "full_order", f"the full model of scene '{scene.name}'")(scene)
    return made
