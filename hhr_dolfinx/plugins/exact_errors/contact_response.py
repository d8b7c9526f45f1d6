"""Response of contact conditions to each other through the bodies, S = B K^-1 B^T, if it is known
at a parameter.

Forces λ give the slack free + S λ of the field in equilibrium with them, for any model: all arrays
here have the size of the contact surface. Several answers at once, (n, m), share the factors of S
if their statuses are the same.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from hhr_dolfinx.contact.active_set import SchurEqualities, Status, active_set, settled
from hhr_dolfinx.linear.dense import LapackCholesky
from hhr_dolfinx.plain import Rebuilt

CANCELLED = 1e-3
"""Round-off of fields that cancel, over the round-off of the remainder."""


class Outside(NamedTuple):
    """Partition of the m contact conditions into k given and m - k free ones."""

    inside: np.ndarray  #: indices of the given conditions, (k,)
    outside: np.ndarray  #: indices of the free ones, (m - k,)
    equalities: SchurEqualities  #: equality problems on S of the free ones
    columns: np.ndarray  #: response of the free conditions to the given forces, (k, m - k)

    def completed(self, own: np.ndarray, free: np.ndarray) -> np.ndarray:
        """All forces, (n, m): the free ones close gaps.

        Each answer has a small contact problem.

        Args:
            own: given forces, (n, k).
            free: slack without forces, (n, m).
        """
        forces = np.zeros(free.shape)
        forces[:, self.inside] = own
        if self.outside.size:
            slacks = free[:, self.outside] + own @ self.columns
            for k in np.flatnonzero(~(slacks.min(axis=1) >= 0)):
                forces_outside = active_set(self.equalities, slacks[k], slacks[k] < 0).forces
                forces[k, self.outside] = np.maximum(forces_outside, 0.0)
        return forces

    def changes(self, forces: np.ndarray, own: np.ndarray, free: np.ndarray) -> np.ndarray:
        """Derivatives of all completed forces, (m, P), at constant statuses.

        Args:
            forces: completed forces, (m,).
            own: derivatives of the given forces, (k, P).
            free: derivatives of the slack without forces, (m, P).
        """
        slopes = np.zeros(free.shape)
        slopes[self.inside] = own
        touching = forces[self.outside] > 0
        if touching.any():
            slacks = free[self.outside] + self.columns.T @ own
            slopes[self.outside] = self.equalities.several(touching, slacks)[0]
        return slopes


@dataclass(frozen=True)
class ContactResponse(Rebuilt):
    """S of m conditions."""

    schur: np.ndarray  #: symmetric and positive definite, (m, m)

    def outside(self, inside: np.ndarray, outside: np.ndarray | None = None) -> Outside:
        """Partition with given forces of some conditions.

        Args:
            inside: conditions with given forces, (k,).
            outside: all other conditions, (m - k,); None to compute them.
        """
        if outside is None:
            outside = np.setdiff1d(np.arange(len(self.schur)), inside, assume_unique=True)
        if not outside.size:
            return Outside(inside, outside, self.equalities, np.zeros((inside.size, 0)))
        equalities = SchurEqualities.symmetric(
            np.ascontiguousarray(self.schur[np.ix_(outside, outside)])
        )
        return Outside(
            inside, outside, equalities, np.ascontiguousarray(self.schur[np.ix_(inside, outside)])
        )

    @cached_property
    def equalities(self) -> SchurEqualities:
        """Equality problems on S; neighbouring answers share factors."""
        return SchurEqualities.symmetric(self.schur)

    def settled(self, forces: np.ndarray, free: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Forces that solve the contact problem on S.

        The search starts from the statuses of given forces, which remain if it does not converge.

        Args:
            forces: forces to start from, >= 0, (n, m).
            free: slack without forces, (n, m).

        Returns:
            The forces, (n, m), and True for those that converged, (n,).
        """
        solution = np.empty(forces.shape)
        unsolved = list(range(len(forces)))
        touching = self.schur.diagonal() * forces > free + forces @ self.schur
        if len(forces) > 1:
            solution, _, unsolved = settled(self.schur, free, touching, LapackCholesky)
        closed = np.ones(len(forces), dtype=bool)
        for k in unsolved:
            alone = active_set(self.equalities, free[k], touching[k])
            closed[k] = alone.status is Status.CONVERGED
            solution[k] = alone.forces if closed[k] else forces[k]
        return np.maximum(solution, 0.0), closed
