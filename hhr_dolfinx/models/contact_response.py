"""What contact conditions do to each other through the bodies, S = B K^-1 B^T, where it is known at a parameter.

Forces λ then make the slack free + S λ of the field in equilibrium with them, whatever model they come from: all that
is asked here has the size of the contact surface. Several answers at once, (n, m), share the factors of S where their
statuses are the same.

The displacement where the response to loads is known, and what contact conditions do to each other.

With a constant K the field in equilibrium with forces λ is U0 = X_F θ - K^-1 B^T λ, where X_F = K^-1 loads is exact,
whatever was trained on. Let the columns of C be fields K^-1 B^T w, orthonormal in energy. Then

    û = X_F θ - C G λ,       G = C^T B^T,

is the nearest to U0 in energy that C allows: C G λ is the projection of the part that contact makes. Its coordinates
take a matrix as wide as the contact surface. Where the columns K^-1 B^T themselves are few enough, C is all of them, G
is the identity, and û = U0.

As S = B K^-1 B^T is known, λ are not the forces handed out but those of the contact problem on S, found from the
statuses of the answer. So û penetrates nothing, and

    |û - U|_K <= |λ - Λ|_S + |(1 - C C^T K) K^-1 B^T λ|_K,       |λ - Λ|_S <= |r|_{S^-1},

with r as in :mod:`hhr_dolfinx.models.error_bound`, which is round-off then.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any, NamedTuple

import numpy as np
from scipy.linalg.lapack import dtrtri, dtrtrs
from scipy.sparse import csc_matrix

from hhr_dolfinx.contact.active_set import SchurEqualities, Status, active_set, settled
from hhr_dolfinx.declared import Floats
from hhr_dolfinx.linear.dense import LapackCholesky
from hhr_dolfinx.models.error_bound import CANCELLED, ConstantThere, ErrorBound, Given, bounded, driven, lengths
from hhr_dolfinx.models.estimates import Estimates
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
        lower: its Cholesky factor, (m, m).
    """

    schur: np.ndarray
    lower: np.ndarray

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
        """The most that forces of S norm 1 have in the Euclidean norm, and at each condition, (m,).

        Of the second (S^-1)_ii^1/2 is the exact value. The first, |L^-1|, is at most the Frobenius norm, and at most
        the root of the largest column sum times the largest row sum.
        """
        inverse = np.abs(dtrtri(self.lower, lower=1)[0])
        sizes = np.sqrt((inverse * inverse).sum(axis=0))
        sums = float(inverse.sum(axis=0).max() * inverse.sum(axis=1).max())
        return math.sqrt(min(sums, float(sizes @ sizes))), sizes

    def settled(self, forces: np.ndarray, free: np.ndarray, pushed: np.ndarray) -> tuple[np.ndarray, ...]:
        """Forces that solve the contact problem on S, S times them, (n, m) each, and their error in the S norm, (n,).

        The search starts from the statuses of given forces, which stay where it does not settle. Gaps that are closed
        count as closed: round-off there is bounded by the sizes of the answers.

        Args:
            forces: not negative, (n, m).
            free: slack without forces, (n, m).
            pushed: S times the forces, (n, m).
        """
        found, left = np.empty(forces.shape), list(range(len(forces)))
        touching = self._stiffness * forces > free + pushed
        if len(forces) > 1:
            found, _, left = settled(self.schur, free, touching, LapackCholesky)
        closed = np.ones(len(forces), dtype=bool)
        for k in left:
            alone = active_set(self.equalities, free[k], touching[k])
            closed[k] = alone.status is Status.CONVERGED
            found[k] = alone.forces if closed[k] else forces[k]
        better = np.maximum(found, 0.0)
        less = better @ self.schur
        slack = free + less
        # a force that was cut off leaves gaps open elsewhere
        closed &= found.min(axis=1) >= 0
        slack[(better > 0) & closed[:, None]] = 0.0
        if closed.all() and slack.min() >= 0:
            return better, less, np.zeros(len(forces))
        return better, less, self.off(slack, better)

    @cached_property
    def _stiffness(self) -> np.ndarray:
        """Diagonal of S, (m,)."""
        return self.schur.diagonal().copy()

    def off(self, slack: np.ndarray, forces: np.ndarray) -> np.ndarray:
        """|r|_{S^-1} of slacks and forces, (n, m) each: r is the slack where there is a force, or it is negative."""
        left = np.where((forces > 0) | (slack < 0), slack, 0.0)
        if not left.any():
            return np.zeros(len(left))
        found = dtrtrs(self.lower, left.T, lower=1, overwrite_b=1)[0].T
        return np.sqrt((found[:, None, :] @ found[:, :, None])[:, 0, 0])


@dataclass(frozen=True, eq=False)
class FieldResponse:
    """What loads and forces make of the displacement (N dofs, 1 + T terms, m conditions, c columns).

    Attributes:
        loaded: K^-1 of some loads, (N, k), of which all are combinations.
        loading: how much of each of these loads a term is, so that X_F is the product of both, sparse, (k, 1 + T).
        onto: G, (c, m); None where the columns are those of K^-1 B^T.
    """

    loaded: Annotated[Floats, "N", "loads"]
    loading: Annotated[csc_matrix, "loads", "terms"]
    onto: Annotated[Floats, "kept columns", "N_lambda"] | None = None

    def coordinates(self, there: ConstantThere, forces: np.ndarray) -> np.ndarray:
        """Coordinates in the columns C, (c,), of an answer whose forces are handed out, (m,)."""
        return self._pressed(settled_forces(there, forces))

    def changes(self, there: ConstantThere, forces: np.ndarray, of_forces: Any, of_theta: np.ndarray) -> np.ndarray:
        """Derivatives of these coordinates, (c, P), while the statuses stay.

        Args:
            there: the bound at the answer.
            forces: as they are handed out, (m,).
            of_forces: makes their derivatives, (m, P).
            of_theta: derivatives of θ, (1 + T, P).
        """
        response, found = there.owner.response, settled_forces(there, forces)
        if np.array_equal(found, forces):
            return self._pressed(of_forces())
        none, free = np.zeros(0, dtype=np.int64), there.owner.free_slack @ of_theta
        return self._pressed(response.outside(none).changes(found, free[:0], free))

    def _pressed(self, forces: np.ndarray) -> np.ndarray:
        """Coordinates of forces, (m, ...): (c, ...)."""
        return -forces if self.onto is None else -(self.onto @ forces)


def settled_forces(there: ConstantThere, forces: np.ndarray) -> np.ndarray:
    """Forces of the contact problem on S, (m,), from the statuses of those that are handed out, (m,)."""
    given = forces[None]
    return there.owner.response.settled(given, there.free, given @ there.owner.schur)[0][0]


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
        driving = driven(owner.loads, self.theta)
        lifted = driven(owner.lifts, self.theta) if len(owner.lifts) else None

        def fields(better: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
            pressed, lost = better @ owner.lower, np.zeros(len(better))
            if owner.basis.shape[1]:
                kept = (pressed @ owner.basis) @ owner.basis.T
                lost, pressed = lengths(pressed - kept, pressed - kept), kept
            field = driving.copy()
            field[:, : pressed.shape[1]] -= pressed
            moved = field
            if lifted is not None:
                moved = lifted.copy()
                moved[:, : field.shape[1]] += field
            return lost, lengths(moved, moved), lengths(pressed, pressed) + CANCELLED * lengths(field, field)

        given = Given(forces, None, self.free)
        return bounded(given, owner.response, fields, owner.scale, owner.amplified).estimates()
