"""What contact conditions do to each other through the bodies, S = B K^-1 B^T, where it is known at a parameter.

Forces λ then make the slack free + S λ of the field in equilibrium with them, whatever model they come from: all that
is asked here has the size of the contact surface. Several answers at once, (n, m), share the factors of S where their
statuses are the same.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from hhr_dolfinx.contact.active_set import SchurEqualities, Status, active_set, settled
from hhr_dolfinx.linear.dense import LapackCholesky
from hhr_dolfinx.plain import Rebuilt


class Outside(NamedTuple):
    """Contact conditions whose forces are not given, beside those whose are (k and m - k of m conditions).

    Attributes:
        inside, outside: places of those that are given, (k,), and of the others, (m - k,).
        equalities: equality problems on S of the others.
        columns: S by which those given open and close the others, (k, m - k).
    """

    inside: np.ndarray
    outside: np.ndarray
    equalities: SchurEqualities
    columns: np.ndarray

    def completed(self, own: np.ndarray, free: np.ndarray) -> np.ndarray:
        """All forces, (n, m): the others close their gaps, each a small contact problem.

        Args:
            own: the forces given, (n, k).
            free: slack without forces, (n, m).
        """
        forces = np.zeros(free.shape)
        forces[:, self.inside] = own
        if self.outside.size:
            slacks = free[:, self.outside] + own @ self.columns
            for k in np.flatnonzero(~(slacks.min(axis=1) >= 0)):
                found = active_set(self.equalities, slacks[k], slacks[k] < 0).forces
                forces[k, self.outside] = np.maximum(found, 0.0)
        return forces

    def changes(self, forces: np.ndarray, own: np.ndarray, free: np.ndarray) -> np.ndarray:
        """Derivatives of all forces along some parameters, (m, P), while the statuses stay.

        Args:
            forces: completed ones, (m,).
            own: derivatives of the forces given, (k, P).
            free: those of the slack without forces, (m, P).
        """
        found = np.zeros(free.shape)
        found[self.inside] = own
        touching = forces[self.outside] > 0
        if touching.any():
            slacks = free[self.outside] + self.columns.T @ own
            found[self.outside] = self.equalities.several(touching, slacks)[0]
        return found


@dataclass(frozen=True)
class ContactResponse(Rebuilt):
    """S of m conditions.

    Attributes:
        schur: S, symmetric and positive definite, (m, m).
    """

    schur: np.ndarray

    def outside(self, inside: np.ndarray, outside: np.ndarray | None = None) -> Outside:
        """What conditions do to each other where the forces of some, ``inside``, are given; the others if known."""
        if outside is None:
            outside = np.setdiff1d(np.arange(len(self.schur)), inside, assume_unique=True)
        if not outside.size:
            return Outside(inside, outside, self.equalities, np.zeros((inside.size, 0)))
        equalities = SchurEqualities.symmetric(np.ascontiguousarray(self.schur[np.ix_(outside, outside)]))
        return Outside(inside, outside, equalities, np.ascontiguousarray(self.schur[np.ix_(inside, outside)]))

    @cached_property
    def equalities(self) -> SchurEqualities:
        """Equality problems on S; neighbouring answers share factors."""
        return SchurEqualities.symmetric(self.schur)

    def settled(self, forces: np.ndarray, free: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Forces that solve the contact problem on S, (n, m), and whether the search for them settled, (n,) bool.

        It starts from the statuses of given forces, which stay where it does not settle.

        Args:
            forces: not negative, (n, m).
            free: slack without forces, (n, m).
        """
        found = np.empty(forces.shape)
        left = list(range(len(forces)))
        touching = self._stiffness * forces > free + forces @ self.schur
        if len(forces) > 1:
            found, _, left = settled(self.schur, free, touching, LapackCholesky)
        closed = np.ones(len(forces), dtype=bool)
        for k in left:
            alone = active_set(self.equalities, free[k], touching[k])
            closed[k] = alone.status is Status.CONVERGED
            found[k] = alone.forces if closed[k] else forces[k]
        return np.maximum(found, 0.0), closed

    @cached_property
    def _stiffness(self) -> np.ndarray:
        """Diagonal of S, (m,)."""
        return self.schur.diagonal().copy()
