"""Kernel of K: motions of bodies that imposed displacements do not hold.

A plug-in with the tool ``kernel``, a :class:`Kernels`, solves for the motions that contact resists.
Without one, scenes with such bodies are refused.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from hhr_dolfinx import registry

if TYPE_CHECKING:
    from hhr_dolfinx.amplitudes import Amplitudes
    from hhr_dolfinx.contact.active_set import Pairs, SchurEqualities
    from hhr_dolfinx.contact.law import ContactLaw
    from hhr_dolfinx.linear.rows import Rows


class Kernel(Protocol):
    """Motions of a problem on which K is singular (N dofs, r of them resisted by contact, l by
    nothing).
    """

    described: str  #: the bodies that contact holds, and how they can move
    contact_of_motions: np.ndarray  #: B R, (m, r)
    loads: np.ndarray  #: along them, (r, 1 + T), the same for every stiffness
    pins: np.ndarray  #: dofs that fix them all, (r + l,)
    motions: np.ndarray  #: orthonormal motions that contact resists, (N, r)
    idle: np.ndarray  #: the same without loads and resistance, (N, l), which answers do not have
    law: ContactLaw  #: of the problem's conditions, in the form that solves for motions

    def at(self, problem: Any) -> Kernel:
        """Kernel of the problem on another shape of bodies that it does not move.

        Raises:
            NotOfferedError: if it differs.
        """

    def condensed(self, there: Any) -> CondensedKernel | None:
        """The motions as unknowns of the contact problem at a point.

        Returns:
            None if contact resists none.
        """

    def exact(self, problem: Any, responses: Any) -> Any:
        """``Elimination`` at a constant stiffness, by the ``Responses`` of the pinned bodies.

        Args:
            problem: the contact problem.
            responses: ``Responses`` of the pinned bodies to loads and contact forces.
        """

    def beside(self, eliminated: Any) -> Any:
        """``Elimination`` by one that leaves out the motions, at any stiffness."""

    def holding(self) -> np.ndarray:
        """Numbers of the conditions that resist the motions, (k,)."""

    def without(self, rows: Rows, fields: np.ndarray) -> np.ndarray:
        """Displacements, (own, k), without the motions that contact resists.

        Args:
            rows: rows of this rank.
            fields: displacements, (own, k).
        """

    def first(self, rows: Rows, basis: np.ndarray) -> np.ndarray:
        """Basis, (own, ell), of these motions, the first r, and of a given one.

        Args:
            rows: rows of this rank.
            basis: the given basis, (own, ell).
        """

    def balanced(self, problem: Any, basis: np.ndarray, sets: Any, reduced: Any) -> Any:
        """Replace the equations tested with the first r modes by the balance of whole bodies.

        Args:
            problem: the full contact problem.
            basis: modes, (N, ell), the motions first.
            sets: index sets of the RID.
            reduced: the reduced problem without the balance, a ``ReducedProblem``.

        Returns:
            A ``ReducedProblem`` with the balance.
        """


class CondensedKernel(Protocol):
    """Motions as unknowns of one condensed contact problem (n unknowns, m conditions)."""

    equalities: Any  #: equality problems on S with them
    driving: np.ndarray  #: loads along them, (r,)
    modes: np.ndarray  #: they as primal unknowns, (n, r)

    def drift(self, forces: np.ndarray, unknown: np.ndarray, /) -> np.ndarray:
        """d(residual along the motions)/dμ at fixed forces and unknown, (r, P).

        Args:
            forces: contact forces, (m,).
            unknown: primal unknown, (n,).
        """

    def answer(
        self,
        contact: Any,
        point: np.ndarray,
        start: np.ndarray,
        pairs: Pairs | None,
        fields: Any,
        gradient: bool,
    ) -> Any:
        """Answer at a point, see :func:`~hhr_dolfinx.models.eliminations.elimination.answer_of`.

        Args:
            contact: the ``CondensedContact`` at the point.
            point: parameters, (P,).
            start: statuses to start from, (m,) bool.
            pairs: contact pair of each condition; None takes all for one pair.
            fields: the ``ModelFields``, for the answer.
            gradient: compute the derivatives along the parameters.
        """


class Kernels(Protocol):
    """The tool ``kernel``."""

    def linearised(
        self, equalities: SchurEqualities, contact_of_motions: np.ndarray, modes: np.ndarray
    ) -> Any:
        """``LinearisedKernel``: motions as unknowns of the linearised contact problems.

        Args:
            equalities: equality problems on S, (m, m).
            contact_of_motions: effect of the motions on the conditions, (m, r).
            modes: the motions, (n, r).
        """

    def of(self, scene: Any, problem: Any, bodies: Sequence[Any]) -> Kernel:
        """Kernel of a problem with these free bodies.

        Args:
            scene: the scene.
            problem: its contact problem.
            bodies: each ``FreeBody`` of the scene.

        Raises:
            NotSolvableError: for motions with loads that contact does not resist, and bodies that
                are not built in.
            SceneError: if the law of the contacts does not solve for motions.
        """

    def elimination(self, problem: Any, amplitudes: Amplitudes) -> Any:
        """``Elimination`` of a reduced problem whose first modes are motions.

        Args:
            problem: the reduced problem.
            amplitudes: amplitudes of its terms.
        """

    def undetermined_outputs(self, answer: Any) -> set[str]:
        """Names of the outputs that an undetermined motion of an answer changes."""

    def undetermined_motions(self, answer: Any) -> str:
        """Description of the undetermined motions of an answer."""


def kernels() -> Kernels:
    """Tool ``kernel`` of the installed plug-ins.

    Raises:
        NotOfferedError: if no installed plug-in has it.
    """
    tool: Kernels = registry.tool("kernel", "a body that contact alone holds")
    return tool
