"""The displacement where the response to loads is known, and what contact conditions do to each other.

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

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from scipy.sparse import csc_matrix

from hhr_dolfinx.declared import Floats
from hhr_dolfinx.models.error_bound import CANCELLED, ConstantThere, ErrorBound, Given, bounded, driven, lengths
from hhr_dolfinx.models.estimates import Estimates


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
        return self._pressed(settled(there, forces))

    def changes(self, there: ConstantThere, forces: np.ndarray, of_forces: Any, of_theta: np.ndarray) -> np.ndarray:
        """Derivatives of these coordinates, (c, P), while the statuses stay.

        Args:
            there: the bound at the answer.
            forces: as they are handed out, (m,).
            of_forces: makes their derivatives, (m, P).
            of_theta: derivatives of θ, (1 + T, P).
        """
        response, found = there.owner.response, settled(there, forces)
        if np.array_equal(found, forces):
            return self._pressed(of_forces())
        none, free = np.zeros(0, dtype=np.int64), there.owner.free_slack @ of_theta
        return self._pressed(response.outside(none).changes(found, free[:0], free))

    def _pressed(self, forces: np.ndarray) -> np.ndarray:
        """Coordinates of forces, (m, ...): (c, ...)."""
        return -forces if self.onto is None else -(self.onto @ forces)


def settled(there: ConstantThere, forces: np.ndarray) -> np.ndarray:
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
