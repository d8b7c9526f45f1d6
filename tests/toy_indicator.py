"""An indicator of a user's own, in one file: how far an answer is from equilibrium on the whole mesh."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hhr_dolfinx.contact.problem import ContactProblem, IndexSets
from hhr_dolfinx.models.answer import Answer


@dataclass(frozen=True)
class EquilibriumResidual:
    """Norm of K U0 + B^T Λ - F on free dofs over that of the contact forces and F, all of them on the whole mesh.

    A reduced model solves the equations of its RID; those of the rest of the mesh tell what it knows nothing of.
    """

    def prepared(self, problem: ContactProblem, basis: np.ndarray, sets: IndexSets) -> Callable[[Answer], float]:
        """K V on free dofs is all that can be computed beforehand."""
        free = problem.free
        internal, contact = (problem.stiffness @ basis)[free], problem.contact[:, free].T.tocsr()
        loads, external = problem.loads[free], problem.external[free]

        def estimate(answer: Answer) -> float:
            theta = problem.amplitudes(answer.parameter)
            pushed = contact @ answer.forces()
            residual = internal @ answer.unknown + pushed - loads @ theta
            size = np.hypot(np.linalg.norm(pushed), np.linalg.norm(external @ theta))
            # where nothing touches and nothing loads, imposed motions are all there is
            return float(np.linalg.norm(residual) / (size or np.linalg.norm(loads @ theta) or 1.0))

        return estimate
