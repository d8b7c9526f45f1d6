"""A mesh whose shape does not depend on parameters, with its system and outputs."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import AbstractContextManager, nullcontext
from typing import TYPE_CHECKING

import numpy as np

from hhr_dolfinx.contact.problem import ContactProblem
from hhr_dolfinx.full_order.system import System, system_of
from hhr_dolfinx.loads import Term

if TYPE_CHECKING:
    import ufl

    from hhr_dolfinx.contact.stiffness import SparseStiffness
    from hhr_dolfinx.full_order.discrete_space import DiscreteSpace
    from hhr_dolfinx.full_order.free_bodies import FreeBody
    from hhr_dolfinx.full_order.system import Made, Middle
    from hhr_dolfinx.models.functionals.functional import AllOutputs
    from hhr_dolfinx.models.histories.equilibrium import FullEquilibrium


class StillMesh:
    """A mesh that keeps its shape; it states the system of its bodies, see :class:`StatedSystem`.

    The tool ``shapes`` of a plug-in is a class like it, of a discretisation, and a
    :class:`~hhr_dolfinx.contact.problem.Reshaping`.
    """

    def at(self, point: np.ndarray) -> AbstractContextManager[None]:
        """Context in which the mesh has the shape of a point, (P,)."""
        return nullcontext()

    def measure(self, dx: ufl.Measure) -> ufl.Measure:
        """Measure of cells for their stiffness."""
        return dx

    def check_still(self, what: str, nodes: np.ndarray, terms: Sequence[Term]) -> None:
        """Check that a shape does not move nodes on whose coordinates terms of gaps depend.

        Args:
            what: description of the contact for the message.
            nodes: the nodes, (n,).
            terms: terms of the gaps.

        Raises:
            NotOfferedError: if a shape moves these nodes.
        """

    def attached(self, problem: ContactProblem) -> ContactProblem:
        """The problem, which knows that its mesh moves."""
        return problem

    def left_free(self, bodies: list[FreeBody], problem: ContactProblem) -> list[FreeBody]:
        """Bodies with the motions that K leaves: all of them.

        Args:
            bodies: bodies with rigid motions.
            problem: the contact problem.
        """
        return bodies

    def system(self, problem: ContactProblem, middle: Middle, made: Made) -> System:
        """The system of a problem.

        Args:
            problem: the contact problem.
            middle: returns K in the middle of the box.
            made: makes a stiffness of local rows of K and a problem.
        """
        return system_of(problem, middle, made)

    def read(
        self, system: System, problem: ContactProblem
    ) -> tuple[ContactProblem, SparseStiffness]:
        """Contact problem, unchanged, and K in the middle of the box.

        Args:
            system: the system of the problem.
            problem: the contact problem.
        """
        return problem, system.middle()

    def outputs(
        self, space: DiscreteSpace, problem: ContactProblem, equilibrium: FullEquilibrium | None
    ) -> AllOutputs:
        """All outputs of a scene, on all ranks. Collective.

        Args:
            space: functions on the mesh of the scene.
            problem: the contact problem.
            equilibrium: equilibrium of bodies with laws; None without any.
        """
        from hhr_dolfinx.full_order.outputs import functionals_of

        return functionals_of(space, problem, equilibrium)
