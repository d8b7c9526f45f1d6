"""A mesh whose shape does not depend on parameters."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import AbstractContextManager, nullcontext
from typing import TYPE_CHECKING

import numpy as np

from hhr_dolfinx.contact.law import ContactLaw
from hhr_dolfinx.contact.problem import ContactProblem
from hhr_dolfinx.loads import Term

if TYPE_CHECKING:
    import ufl


class StillMesh:
    """A mesh that keeps its shape. The tool ``shapes`` of a plug-in is a class like it, of a discretisation.

    See :class:`~hhr_dolfinx.contact.problem.Reshaping` too.
    """

    def at(self, point: np.ndarray) -> AbstractContextManager[None]:
        """Context in which the mesh has the shape of a point, (P,)."""
        return nullcontext()

    def measure(self, dx: ufl.Measure) -> ufl.Measure:
        """Measure of cells for their stiffness."""
        return dx

    def check(self, law: ContactLaw) -> None:
        """Raise SceneError for a law of contacts that does not suit the shapes."""

    def check_still(self, what: str, nodes: np.ndarray, terms: Sequence[Term]) -> None:
        """Raise NotOfferedError for terms of gaps that know places of nodes, (n,), if a shape moves these."""

    def attached(self, problem: ContactProblem) -> ContactProblem:
        """The problem, which knows that its mesh moves."""
        return problem
