"""The system of a scene whose shapes depend on parameters: assembled again at each point."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hhr_dolfinx.full_order.system import System

if TYPE_CHECKING:
    from hhr_dolfinx.amplitudes import Theta
    from hhr_dolfinx.contact.problem import ContactProblem
    from hhr_dolfinx.contact.stiffness import Stiffness
    from hhr_dolfinx.full_order.system import Parts

DIFFERENCE = 1e-5
"""Part of the box by which a mesh is displaced for finite differences: their error is its square, and for smaller ones
round-off of the assembly dominates."""


class ReassembledSystem(System):
    """Assembled on the mesh of each point, with other rows and gaps; ``problem.reshaped`` has its parts."""

    def parts(self) -> Parts:
        """See :class:`System`."""
        return self.problem.moduli, self.problem.stiffness_terms

    def equations(self, point: np.ndarray, theta: Theta) -> tuple[ContactProblem, Stiffness, np.ndarray]:
        """See :class:`System`."""
        problem = self.problem.at(point)
        return problem, self.made(problem.own_stiffness, problem), problem.loads[problem.rows] @ theta

    def explicit(self, point: np.ndarray, forces: np.ndarray, unknown: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See :class:`System`; by central differences of the equations on slightly displaced meshes."""

        def residual_and_slack(displaced: np.ndarray) -> np.ndarray:
            problem = self.problem.at(displaced)
            theta = problem.amplitudes(displaced)
            residual = problem.stiffness @ unknown + problem.contact.T @ forces - problem.loads @ theta
            return np.append(residual, problem.gaps @ theta - problem.contact @ unknown)

        found = self.problem.parameters.differences(residual_and_slack, point, DIFFERENCE)
        return found[: unknown.size], found[unknown.size :]
