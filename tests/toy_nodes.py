"""A choice of nodes of a user's own, in one file: all nodes of one contact pair that carry its conditions."""

from dataclasses import dataclass

import numpy as np

from hhr_dolfinx.contact.problem import ContactProblem
from hhr_dolfinx.snapshots.records import SnapshotSet


@dataclass(frozen=True)
class WholeSurface:
    """The slave nodes of a contact pair: no contact force of it is left to be completed.

    Attributes:
        pair: its number in the scene.
    """

    pair: int = 0

    def nodes(self, problem: ContactProblem, snapshots: SnapshotSet, basis: np.ndarray) -> np.ndarray:
        """Their numbers; see :class:`hhr_dolfinx.reduction.recipe.Nodes`."""
        return problem.contact_slaves[problem.contact_pairs == self.pair]
