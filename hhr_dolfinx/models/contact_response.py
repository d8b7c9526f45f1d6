"""What contact conditions do to each other through the bodies, S = B K^-1 B^T, where it is known at a parameter.

Forces λ then make the slack free + S λ of the field in equilibrium with them, whatever model they come from: all that
is asked here has the size of the contact surface. Several answers at once, (n, m), share the factors of S where their
statuses are the same.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg.lapack import dtrtrs

from hhr_dolfinx.contact.active_set import SchurEqualities, Status, active_set
from hhr_dolfinx.linear.dense import LapackCholesky


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
class ContactResponse:
    """S and its factor (m conditions).

    Attributes:
        schur: S, symmetric and positive definite, (m, m).
        lower: its Cholesky factor, (m, m).
    """

    schur: np.ndarray
    lower: np.ndarray

    def outside(self, inside: np.ndarray) -> Outside:
        """What conditions do to each other where the forces of some, ``inside``, are given."""
        outside = np.setdiff1d(np.arange(len(self.schur)), inside, assume_unique=True)
        equalities = SchurEqualities.symmetric(np.ascontiguousarray(self.schur[np.ix_(outside, outside)]))
        return Outside(inside, outside, equalities, np.ascontiguousarray(self.schur[np.ix_(inside, outside)]))

    def improved(self, forces: np.ndarray, free: np.ndarray, pushed: np.ndarray) -> tuple[np.ndarray, ...]:
        """Forces that close the gaps where given ones say that bodies touch, S times them, and their slack, (n, m).

        Args:
            forces: not negative, (n, m).
            free: slack without forces, (n, m).
            pushed: S times the forces, (n, m).
        """
        slack = free + pushed
        touching = (self.schur.diagonal() * forces >= slack) & ((forces > 0) | (slack < 0))
        found = np.zeros(forces.shape)
        for rows, index in _alike(touching):
            factor = LapackCholesky(self.schur.take(index, axis=0).take(index, axis=1).T)
            found[rows[:, None], index] = factor.solve(-free[rows[:, None], index].T).T
        pulling = found < 0
        found[pulling] = 0.0
        less = found @ self.schur
        slack = free + less
        # round-off where nothing pulled, which the sizes of the answers bound
        slack[touching & ~pulling.any(axis=1, keepdims=True)] = 0.0
        return found, less, slack

    def settled(self, forces: np.ndarray, free: np.ndarray) -> tuple[np.ndarray, float]:
        """Forces whose gaps are closed, from the statuses of given ones, and their error in the S norm at most.

        Where these statuses do not settle, the given ones.

        Args:
            forces: not negative, (m,).
            free: slack without forces, (m,).
        """
        slack = free + self.schur @ forces
        given = forces, float(self.off(slack[None], forces[None])[0])
        touching = (self.schur.diagonal() * forces >= slack) & ((forces > 0) | (slack < 0))
        found = active_set(SchurEqualities.symmetric(self.schur), free, touching)
        if found.status is not Status.CONVERGED:
            return given
        better = np.maximum(found.forces, 0.0)
        off = float(self.off((free + self.schur @ better)[None], better[None])[0])
        return (better, off) if off < given[1] else given

    def off(self, slack: np.ndarray, forces: np.ndarray) -> np.ndarray:
        """|r|_{S^-1} of slacks and forces, (n, m) each: r is the slack where there is a force, or it is negative."""
        left = np.where((forces > 0) | (slack < 0), slack, 0.0)
        if not left.any():
            return np.zeros(len(left))
        found = dtrtrs(self.lower, left.T, lower=1, overwrite_b=1)[0].T
        return np.sqrt((found[:, None, :] @ found[:, :, None])[:, 0, 0])


def _alike(statuses: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Rows that share their statuses, (n, m), and the conditions that touch there; none where nothing touches."""
    groups: dict[bytes, list[int]] = {}
    for k, row in enumerate(statuses):
        groups.setdefault(row.tobytes(), []).append(k)
    for rows in groups.values():
        index = np.flatnonzero(statuses[rows[0]])
        if index.size:
            yield np.array(rows), index
