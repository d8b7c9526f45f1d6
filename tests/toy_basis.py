"""A basis of a user's own, in one file: some of the snapshots themselves, made orthonormal."""

from dataclasses import dataclass

import numpy as np
from scipy import linalg

from hhr_dolfinx.contact.problem import ContactProblem
from hhr_dolfinx.snapshots.records import SnapshotSet


@dataclass(frozen=True)
class EveryKth:
    """Every k-th snapshot, the most independent first; what depends on the others is left out.

    Attributes:
        k: 1 takes all of them.
        tolerance: part of a snapshot's length that the others leave over, below which it depends on them.
    """

    k: int
    tolerance: float = 1e-9

    def modes(self, problem: ContactProblem, snapshots: SnapshotSet) -> np.ndarray:
        """V, (N, ell); see :class:`hhr_dolfinx.reduction.recipe.Basis`."""
        columns = snapshots.displacements[:, :: self.k]
        modes, triangle, _ = linalg.qr(columns / np.linalg.norm(columns, axis=0), mode="economic", pivoting=True)
        return modes[:, np.abs(np.diag(triangle)) > self.tolerance]
