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
    pins: np.ndarray  #: dofs that fix them all, (r + l,)
    motions: np.ndarray  #: orthonormal motions that contact resists, (N, r)
    idle: np.ndarray  #: the same without loads and resistance, (N, l), which answers do not have
    law: ContactLaw  #: of the problem's conditions, in the form that solves for motions

    def at(self, problem: Any) -> Kernel:
        """Kernel of the problem on another shape of bodies that it does not move.

        NotOfferedError if it differs.
        """

    def condensed(self, there: Any) -> CondensedKernel | None:
        """The motions as unknowns of the contact problem at a point, a ``SystemAt``.

        None if contact resists none.
        """

    def exact(self, problem: Any, responses: Any) -> Any:
        """``Elimination`` at a constant stiffness, by the ``Responses`` of the pinned bodies."""

    def beside(self, eliminated: Any) -> Any:
        """``Elimination`` by one that leaves out the motions, at any stiffness."""

    def holding(self) -> np.ndarray:
        """Numbers of the conditions that resist the motions, (k,)."""

    def without(self, rows: Rows, fields: np.ndarray) -> np.ndarray:
        """Displacements, (own, k), without the motions that contact resists."""

    def first(self, rows: Rows, basis: np.ndarray) -> np.ndarray:
        """Basis, (own, ell), of these motions, the first r, and of a given one."""

    def balanced(self, problem: Any, basis: np.ndarray, sets: Any, reduced: Any) -> Any:
        """A ``ReducedProblem``: replace the equations tested with the first r modes by the balance
        of whole bodies.
        """


class CondensedKernel(Protocol):
    """Motions as unknowns of one condensed contact problem (n unknowns, m conditions)."""

    equalities: Any  #: equality problems on S with them
    driving: np.ndarray  #: loads along them, (r,)
    modes: np.ndarray  #: they as primal unknowns, (n, r)

    def drift(self, forces: np.ndarray, unknown: np.ndarray, /) -> np.ndarray:
        """d(residual along the motions)/dμ at fixed forces and unknown, (r, P)."""

    def answer(
        self,
        contact: Any,
        point: np.ndarray,
        start: np.ndarray,
        pairs: Pairs | None,
        fields: Any,
        gradient: bool,
    ) -> Any:
        """Answer at a point, see :func:`~hhr_dolfinx.models.eliminations.elimination.answer_of`."""


class Kernels(Protocol):
    """The tool ``kernel``."""

    def linearised(
        self, equalities: SchurEqualities, contact_of_motions: np.ndarray, modes: np.ndarray
    ) -> Any:
        """``LinearisedKernel``: motions, (n, r), with their effect on the conditions, (m, r),
        beside those on S.
        """

    def of(self, scene: Any, problem: Any, bodies: Sequence[Any]) -> Kernel:
        """Kernel of a problem with these free bodies.

        Raises:
            NotSolvableError: for motions with loads that contact does not resist, and bodies that
                are not built in.
            SceneError: if the law of the contacts does not solve for motions.
        """

    def elimination(self, problem: Any, amplitudes: Amplitudes) -> Any:
        """``Elimination`` of a reduced problem whose first modes are motions."""

    def undetermined_outputs(self, answer: Any) -> set[str]:
        """Names of the outputs that an undetermined motion of an answer changes."""

    def undetermined_motions(self, answer: Any) -> str:
        """Description of the undetermined motions of an answer."""


def kernels() -> Kernels:
    """The tool.

    Raises:
        NotOfferedError: if no installed plug-in has it.
    """
    found: Any = registry.tool("kernel", "a body that contact alone holds")
    return found
