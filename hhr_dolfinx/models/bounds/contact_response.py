"""What contact conditions do to each other through the bodies, S = B K^-1 B^T, where it is known at a parameter.

Forces λ then make the slack free + S λ of the field in equilibrium with them, whatever model they come from: all that
is asked here has the size of the contact surface. Several answers at once, (n, m), share the factors of S where their
statuses are the same.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg.lapack import dtrtri, dtrtrs

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
    """S and its factor (m conditions).

    Attributes:
        schur: S, symmetric and positive definite, (m, m).
        lower: its Cholesky factor, (m, m); or L of a matrix which times ``least`` is at most S.
        least: see there; 1 for the factor of S itself.
        known: :func:`amplified_by` L; None where it is not known yet.
    """

    schur: np.ndarray
    lower: np.ndarray
    least: float = 1.0
    known: tuple[float, np.ndarray] | None = None

    def pushed(self, forces: np.ndarray) -> np.ndarray:
        """S times forces, (n, m) each."""
        return forces @ self.schur

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

    @cached_property
    def amplified(self) -> tuple[float, np.ndarray]:
        """The most that forces of S norm 1 have in the Euclidean norm, and at each condition, (m,)."""
        longest, sizes = amplified_by(self.lower) if self.known is None else self.known
        scale = math.sqrt(self.least)
        return longest / scale, sizes / scale

    def settled(self, forces: np.ndarray, free: np.ndarray, pushed: np.ndarray) -> tuple[np.ndarray, ...]:
        """Forces that solve the contact problem on S, S times them, (n, m) each, and their error in the S norm, (n,).

        The search starts from the statuses of given forces, which stay where it does not settle. Gaps that are closed
        count as closed: round-off there is bounded by the sizes of the answers.

        Args:
            forces: not negative, (n, m).
            free: slack without forces, (n, m).
            pushed: S times the forces, (n, m).
        """
        found = np.empty(forces.shape)
        left = list(range(len(forces)))
        touching = self._stiffness * forces > free + pushed
        if len(forces) > 1:
            found, _, left = settled(self.schur, free, touching, LapackCholesky)
        closed = np.ones(len(forces), dtype=bool)
        for k in left:
            alone = active_set(self.equalities, free[k], touching[k])
            closed[k] = alone.status is Status.CONVERGED
            found[k] = alone.forces if closed[k] else forces[k]
        return kept(found, closed, free, self)

    @cached_property
    def _stiffness(self) -> np.ndarray:
        """Diagonal of S, (m,)."""
        return self.schur.diagonal().copy()

    def off(self, slack: np.ndarray, forces: np.ndarray, _: Any = None) -> np.ndarray:
        """|r|_{S^-1} of slacks and forces, (n, m) each: r is the slack where there is a force, or it is negative."""
        left = np.where((forces > 0) | (slack < 0), slack, 0.0)
        if not left.any():
            return np.zeros(len(left))
        found = dtrtrs(self.lower, left.T, lower=1, overwrite_b=1)[0].T
        return np.sqrt((found[:, None, :] @ found[:, :, None])[:, 0, 0] / self.least)


def kept(found: np.ndarray, closed: np.ndarray, free: np.ndarray, response: Any) -> tuple[np.ndarray, ...]:
    """Forces that a search found, without negative ones, S times them, (n, m) each, and their error, (n,).

    Args:
        found: by the search, (n, m).
        closed: whether it settled, so that gaps are closed where there are forces, (n,) bool.
        free: slack without forces, (n, m).
        response: S of the answers.
    """
    better = np.maximum(found, 0.0)
    less = response.pushed(better)
    slack = free + less
    # a force that was cut off leaves gaps open elsewhere
    closed &= found.min(axis=1) >= 0
    slack[(better > 0) & closed[:, None]] = 0.0
    off = np.zeros(len(found))
    rows = np.flatnonzero(~(closed & (slack.min(axis=1) >= 0)))
    if rows.size:
        off[rows] = response.off(slack[rows], better[rows], rows)
    return better, less, off


def amplified_by(lower: np.ndarray) -> tuple[float, np.ndarray]:
    """The most that x with |L^T x| = 1 has in the Euclidean norm, and in each place, (m,).

    Of the second ((L L^T)^-1)_ii^1/2 is the exact value. The first, |L^-1|, is at most the Frobenius norm, and at most
    the root of the largest column sum times the largest row sum.
    """
    inverse = dtrtri(lower, lower=1)[0]
    np.abs(inverse, out=inverse)
    sizes = np.sqrt(np.einsum("ij,ij->j", inverse, inverse))
    sums = float(inverse.sum(axis=0).max() * inverse.sum(axis=1).max())
    return math.sqrt(min(sums, float(sizes @ sizes))), sizes
