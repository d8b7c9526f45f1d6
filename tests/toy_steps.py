"""Steps of a recipe of a user's own: a basis, a choice of nodes, and an indicator."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from hhr_dolfinx.contact.problem import ContactProblem, IndexSets
from hhr_dolfinx.models.answer import Answer
from hhr_dolfinx.snapshots.records import SnapshotSet


@dataclass(frozen=True)
class EveryKth:
    """Every k-th snapshot, the most independent first.

    Those of which the others leave less than a tolerance of their length are left out.
    """

    k: int
    tolerance: float = 1e-9

    def modes(self, problem: ContactProblem, snapshots: SnapshotSet) -> np.ndarray:
        """V, (N, ell); see :class:`hhr_dolfinx.reduction.recipe.Basis`."""
        columns = snapshots.displacements[:, :: self.k]
        modes, triangle, _ = linalg.qr(
            columns / np.linalg.norm(columns, axis=0), mode="economic", pivoting=True
        )
        return modes[:, np.abs(np.diag(triangle)) > self.tolerance]


@dataclass(frozen=True)
class WholeSurface:
    """The slave nodes of a contact pair, by its number: no contact force of it is left to be
    completed.
    """

    pair: int = 0

    def nodes(
        self, problem: ContactProblem, snapshots: SnapshotSet, basis: np.ndarray
    ) -> np.ndarray:
        """Their numbers; see :class:`hhr_dolfinx.reduction.recipe.NodeChoice`."""
        return problem.contact_slaves[problem.contact_pairs == self.pair]


@dataclass(frozen=True)
class EquilibriumResidual:
    """Norm of K U0 + B^T Λ - F on free dofs over that of the contact forces and F, all of them on
    the whole mesh.

    A reduced model solves the equations of its RID; those of the rest of the mesh tell what it
    knows nothing of.
    """

    def prepared(
        self, problem: ContactProblem, basis: np.ndarray, sets: IndexSets
    ) -> Callable[[Answer], float]:
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
