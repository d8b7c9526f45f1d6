"""The displacement where the response to loads is known, and what contact conditions do to each other.

With a constant K the field in equilibrium with forces λ is U0 = X_F θ - K^-1 B^T λ, where X_F = K^-1 loads is exact,
whatever was trained on. Let the columns of C be fields K^-1 B^T w, orthonormal in energy. Then

    û = X_F θ - C G λ,       G = C^T B^T,

is the nearest to U0 in energy that C allows: C G λ is the projection of the part that contact makes. Its coordinates
take a matrix as wide as the contact surface. Where the columns K^-1 B^T themselves are few enough, C is all of them, G
is the identity, and û = U0.

As S = B K^-1 B^T is known, λ are not the forces handed out but nearer ones: those that close the gaps where the answer
says that bodies touch, one small linear problem. So û penetrates nothing where the statuses are right, and

    |û - U|_K <= |λ - Λ|_S + |(1 - C C^T K) K^-1 B^T λ|_K,       |λ - Λ|_S <= |r|_{S^-1},

with r as in :mod:`hhr_dolfinx.models.error_bound`: what is left of gaps that should be closed, which is round-off then.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy.sparse import csc_matrix

from hhr_dolfinx.models.contact_response import ContactResponse
from hhr_dolfinx.models.error_bound import (
    CANCELLED,
    ROUND_OFF,
    ConstantThere,
    ErrorBound,
    Estimates,
    driven,
    lengths,
    relative,
)


class Nearer(NamedTuple):
    """Forces, (n, m), and how far they are from the exact ones at most in the S norm, (n,)."""

    forces: np.ndarray
    off: np.ndarray


def nearer(response: ContactResponse, forces: np.ndarray, free: np.ndarray) -> Nearer:
    """Forces that close the gaps where given ones say that bodies touch; those given where these are nearer.

    Args:
        response: S.
        forces: not negative, (n, m).
        free: slack without forces, (n, m).
    """
    pushed = forces @ response.schur
    found, _, left = response.improved(forces, free, pushed)
    off = response.off(left, found)
    if off.any():
        given = response.off(free + pushed, forces)
        better = given < off
        found[better], off[better] = forces[better], given[better]
    return Nearer(found, off)


@dataclass(frozen=True, eq=False)
class FieldResponse:
    """What loads and forces make of the displacement (N dofs, 1 + T terms, m conditions, c columns).

    Attributes:
        loaded: K^-1 of some loads, (N, k), of which all are combinations.
        loading: how much of each of these loads a term is, so that X_F is the product of both, sparse, (k, 1 + T).
        onto: G, (c, m); None where the columns are those of K^-1 B^T.
    """

    loaded: np.ndarray
    loading: csc_matrix
    onto: np.ndarray | None = None

    def coordinates(self, there: ConstantThere, forces: np.ndarray) -> np.ndarray:
        """Coordinates in the columns C, (c,), of an answer whose forces are handed out, (m,)."""
        return self._pressed(nearer(there.owner.response, forces[None], there.free).forces[0])

    def changes(self, there: ConstantThere, forces: np.ndarray, of_forces: Any, of_theta: np.ndarray) -> np.ndarray:
        """Derivatives of these coordinates, (c, P), while the statuses stay.

        Args:
            there: the bound at the answer.
            forces: as they are handed out, (m,).
            of_forces: makes their derivatives, (m, P).
            of_theta: derivatives of θ, (1 + T, P).
        """
        response = there.owner.response
        found = nearer(response, forces[None], there.free).forces[0]
        if np.array_equal(found, forces):
            return self._pressed(of_forces())
        none, free = np.zeros(0, dtype=np.int64), there.owner.free_slack @ of_theta
        return self._pressed(response.outside(none).changes(found, free[:0], free))

    def _pressed(self, forces: np.ndarray) -> np.ndarray:
        """Coordinates of forces, (m, ...): (c, ...)."""
        return -forces if self.onto is None else -(self.onto @ forces)


@dataclass(frozen=True)
class ResponseBound(ErrorBound):
    """Bounds of the errors of such fields: what the projection leaves out, and the error of the forces.

    Attributes:
        basis: C in directions of unit energy, those of K^-1 B^T, (m, c); no columns where they span all of these.
        loads, lifts: K^-1 loads and imposed motions, see :class:`ErrorBound`.
    """

    def at(self, points: np.ndarray, theta: Any) -> ResponseThere:
        """See :class:`Bound`."""
        return ResponseThere(self, theta, driven(self.free_slack, theta))


class ResponseThere(ConstantThere):
    """See :class:`BoundThere`."""

    def of(self, unknown: np.ndarray, forces: np.ndarray, slack: Callable[[], np.ndarray]) -> Estimates:
        """Bounds of the fields that loads and these forces make, whatever the unknown is."""
        owner = self.owner
        better, off = nearer(owner.response, forces, self.free)
        own, away = forces @ owner.lower, (better - forces) @ owner.lower
        pressed, lost = own + away, np.zeros(len(forces))
        if owner.basis.shape[1]:
            kept = (pressed @ owner.basis) @ owner.basis.T
            lost, pressed = lengths(pressed - kept, pressed - kept), kept
        field = driven(owner.loads, self.theta)
        field[:, : pressed.shape[1]] -= pressed
        moved = field
        if len(owner.lifts):
            moved = driven(owner.lifts, self.theta)
            moved[:, : field.shape[1]] += field
        size, sizes = lengths(moved, moved), lengths(own, own)
        noise = ROUND_OFF * (sizes + lengths(pressed, pressed) + CANCELLED * lengths(field, field))
        primal, dual = off + lost + noise + ROUND_OFF * size, off + lengths(away, away) + noise
        return Estimates("bound", primal, dual, relative(primal, size), relative(dual, sizes))
