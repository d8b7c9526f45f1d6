"""A way to reduce of a user's own, with an elimination of its own: K inverted once and for all,
densely.
"""

from dataclasses import dataclass
from functools import partial
from typing import Annotated

import numpy as np

from hhr_dolfinx.amplitudes import Amplitudes
from hhr_dolfinx.declared import Floats
from hhr_dolfinx.errors import NotOfferedError
from hhr_dolfinx.models.condensed import CondensedModel
from hhr_dolfinx.models.eliminations.elimination import CondensedContact, Elimination
from hhr_dolfinx.models.exact import ExactFields


@dataclass(frozen=True)
class DenseElimination(Elimination):
    """Eliminates with K^-1 as a dense matrix; loads and gaps are terms of θ."""

    inverse: Annotated[Floats, "unknowns", "unknowns"]
    contact: Annotated[Floats, "m", "unknowns"]
    loads: Annotated[Floats, "unknowns", "terms"]
    gaps: Annotated[Floats, "m", "terms"]
    amplitudes: Amplitudes

    def __call__(self, point):
        theta, pushed = self.amplitudes(point), self.inverse @ self.contact.T
        free = self.inverse @ (self.loads @ theta)
        slack = self.gaps @ theta - self.contact @ free
        changes = partial(self._changes, point)
        return CondensedContact(
            self.contact @ pushed, slack, free, partial(np.matmul, pushed), changes
        )

    def _changes(self, point, forces, unknown):
        acting, slopes = self.amplitudes.slopes_at(point)
        moved = self.inverse @ (self.loads[:, acting] @ slopes)
        return self.gaps[:, acting] @ slopes - self.contact @ moved, moved


@dataclass(frozen=True)
class DenseCondensation:
    """Exact where the stiffness is constant, refused elsewhere and beyond ``most`` dofs, as slow as
    it is short.
    """

    most: int = 2000

    def reduced(self, full, snapshots, held_out):
        problem, free = full.problem, np.flatnonzero(full.problem.free)
        if problem.varies or problem.law.plugin:
            raise NotOfferedError(
                "this condensation is exact for constant stiffness without friction only"
            )
        if free.size > self.most:
            raise ValueError(f"{free.size} dofs are more than {self.most}")
        inverse = np.zeros((problem.free.size,) * 2)
        inverse[np.ix_(free, free)] = np.linalg.inv(problem.stiffness[free][:, free].toarray())
        contact, loads = problem.contact.toarray(), problem.loads.toarray()
        eliminated = DenseElimination(
            inverse, contact, loads, np.array(problem.gaps), problem.amplitudes
        )
        per_force = inverse @ contact.T
        fields = ExactFields(
            problem.amplitudes,
            problem.lifts,
            per_force,
            inverse @ loads,
            problem.block_size,
            functionals=full.functionals,
        )
        return CondensedModel(
            full.parameters, eliminated, snapshots.known_statuses(), fields, problem.contact_pairs
        )
