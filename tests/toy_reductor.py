"""A way to reduce of a user's own, in one file: all contact conditions, eliminated by a dense inverse of K."""

from dataclasses import dataclass

import numpy as np
from toy_elimination import DenseElimination

from hhr_dolfinx.errors import NotOfferedError
from hhr_dolfinx.models.condensed import CondensedModel
from hhr_dolfinx.models.exact import ExactFields


@dataclass(frozen=True)
class DenseCondensation:
    """Exact where the stiffness is constant, refused elsewhere, and as slow to build as it is short.

    Attributes:
        most: dofs beyond which it refuses.
    """

    most: int = 2000

    def reduced(self, full, snapshots, held_out):
        problem, free = full.problem, np.flatnonzero(full.problem.free)
        if problem.varies or problem.law.plugin:
            raise NotOfferedError("this condensation is exact for constant stiffness without friction only")
        if free.size > self.most:
            raise ValueError(f"{free.size} dofs are more than {self.most}")
        inverse = np.zeros((problem.free.size,) * 2)
        inverse[np.ix_(free, free)] = np.linalg.inv(problem.stiffness[free][:, free].toarray())
        contact, loads = problem.contact.toarray(), problem.loads.toarray()
        eliminated = DenseElimination(inverse, contact, loads, np.array(problem.gaps), problem.amplitudes)
        per_force = inverse @ contact.T
        fields = ExactFields(problem.amplitudes, problem.lifts, per_force, inverse @ loads, problem.block_size,
                             functionals=full.functionals)  # fmt: skip
        return CondensedModel(full.parameters, eliminated, snapshots.known_statuses(), fields, problem.contact_pairs)
