"""Bounds of the error of what is handed out: a field everywhere and contact forces everywhere, however they were found.

Let K be symmetric and positive definite, the rows of B independent, S = B K^-1 B^T, and (U, Λ) the solution of (1.21)
with the slack σ. Given any forces λ >= 0, let u be the field in equilibrium with them, K u + B^T λ = loads θ, let
s = gaps θ - B u be its slack, and r = s where λ > 0 or s < 0, else 0. As λ·σ >= 0, and Λ s >= 0 where r leaves s out,

    |λ - Λ|_S^2 = (λ - Λ)·(s - σ) <= (λ - Λ)·r,      so that      |λ - Λ|_S = |u - U|_K <= |r|_{S^-1}.

Another field û, of the slack ŝ with its r̂, leaves the residual ρ = loads θ - K û - B^T λ of equilibrium. With
a = |ρ|_{K^-1} its error is at most a + |r|_{S^-1}. The same sums for û itself give |û - U|_K^2 <= a |û - U|_K +
|λ - Λ|_S |r̂|_{S^-1}, which is smaller where û takes part in the contact: the smaller one is the bound. docs/bounds.md
has the proof in full. Theorems 3 to 8 of the thesis bound the same errors through inf-sup constants.

Where the response to loads is known the field is made of loads and forces. With a constant K the field in equilibrium
with forces λ is U0 = X_F θ - K^-1 B^T λ, where X_F = K^-1 loads is exact, whatever was trained on. Let the columns of
C be fields K^-1 B^T w, orthonormal in energy. Then

    û = X_F θ - C G λ,       G = C^T B^T,

is the nearest to U0 in energy that C allows: C G λ is the projection of the part that contact makes. Its coordinates
take a matrix as wide as the contact surface. Where the columns K^-1 B^T themselves are few enough, C is all of them, G
is the identity, and û = U0.

As S = B K^-1 B^T is known, λ are not the forces handed out but those of the contact problem on S, found from the
statuses of the answer. So û penetrates nothing, and

    |û - U|_K <= |λ - Λ|_S + |(1 - C C^T K) K^-1 B^T λ|_K,       |λ - Λ|_S <= |r|_{S^-1},

with r, which is round-off then.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple, Protocol

import numpy as np
from scipy.sparse import csc_matrix

from hhr_dolfinx.amplitudes import Theta
from hhr_dolfinx.declared import Floats
from hhr_dolfinx.models.bounds.contact_response import ContactResponse, Outside
from hhr_dolfinx.models.estimates import Estimates

if TYPE_CHECKING:
    from hhr_dolfinx.models.gradient import Gradient

ROUND_OFF = 1e-10
"""Part of an answer that is round-off of the exact one too: nothing is known to be nearer."""


CANCELLED = 1e-3
"""Round-off of a field that a lift cancels, over the round-off of what is left."""
NOTHING = 0.01
"""Part of the bound of a field that a bound of forces adds without being worth a second look."""


@dataclass(frozen=True)
class ForceScale:
    """What contact forces are measured by (m conditions).

    Attributes:
        areas: tributary area of each condition, by which a nodal force is a pressure, (m,); that of one without an
            area is zero, and so is its pressure; of answers on their own shapes (n, m).
        least: S norm, Euclidean norm and peak pressure below which relative errors are taken over these, (3,).
    """

    areas: np.ndarray
    least: np.ndarray

    @cached_property
    def per_area(self) -> np.ndarray:
        """One over the areas, (m,)."""
        return np.divide(1.0, self.areas, out=np.zeros(self.areas.shape), where=self.areas > 0)

    def amplified(self, response: Response) -> np.ndarray:
        """The most that forces of S norm 1 have in the S norm, in the Euclidean norm, and as a pressure, (3, ...)."""
        longest, most = response.amplified
        return np.array((np.ones_like(longest), longest, (most * self.per_area).max(axis=-1)))

    def peak(self, forces: np.ndarray) -> np.ndarray:
        """Largest pressure of forces that are not negative, (..., m): (...,)."""
        return np.maximum.reduce(forces * self.per_area, axis=-1, initial=0.0)


class Response(Protocol):
    """S of n answers, all the same or each its own; see :class:`ContactResponse`."""

    @property
    def amplified(self) -> tuple[Any, np.ndarray]:
        """The most that forces of S norm 1 have in the Euclidean norm, and at each condition."""

    def pushed(self, forces: np.ndarray) -> np.ndarray:
        """S times forces, (n, m) each."""

    def settled(self, forces: np.ndarray, free: np.ndarray, pushed: np.ndarray) -> tuple[np.ndarray, ...]:
        """Forces that solve the contact problem on S, S times them, and their error in the S norm."""

    def off(self, slack: np.ndarray, forces: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """Norms of residuals of some answers, by their numbers, (k,)."""


class Given(NamedTuple):
    """What is bounded (n answers, m conditions).

    Attributes:
        forces: not negative, (n, m).
        slack: makes that of the fields, (n, m), which only some bounds need; None of fields that are in equilibrium.
        free: slack of the fields in equilibrium with no forces, (n, m).
    """

    forces: np.ndarray
    slack: Callable[[], np.ndarray] | None
    free: np.ndarray


class Bounded(NamedTuple):
    """Bounds of n answers.

    Attributes:
        kind: see :class:`~hhr_dolfinx.models.estimates.Estimate`.
        errors: of displacement and forces in energy, of forces in the Euclidean norm, and of pressures, (4, n).
        least: what the exact answers have at least in these norms; of forces a thousandth of the largest ones of
            training at least, (4, n).
    """

    kind: str
    errors: np.ndarray
    least: np.ndarray

    def estimates(self) -> Estimates:
        """With the relative ones: infinite where the exact answer may be nothing, unless nothing is off."""
        if self.least.min(initial=np.inf) > 0:
            shares = self.errors / self.least
        else:
            with np.errstate(divide="ignore", invalid="ignore"):
                shares = np.where(self.errors == 0, 0.0, self.errors / np.maximum(self.least, 0.0))
        return Estimates(self.kind, *self.errors[:2], *shares[:2], *self.errors[2:], *shares[2:])


def bounded(
    given: Given,
    response: Response,
    fields: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]],
    scale: ForceScale,
    amplified: np.ndarray,
    kind: str = "bound",
    inexact: float = ROUND_OFF,
) -> Bounded:
    """Bounds of displacements and forces.

    Any forces may stand in the proof, and those of the contact problem on S are the exact ones up to round-off and to
    what S is off by, δ in the S norm: errors are differences to them. An error e of the rest has |e| <= |L^-1| δ and
    |e_i| <= (S^-1)_ii^1/2 δ.

    Args:
        given: what is bounded.
        response: S.
        fields: maps forces, (n, m), to |ρ|_{K^-1}, to the energy norm of the field, and to that of the field in
            equilibrium with them, as far as this is only known up to ``inexact``, (n,) each.
        scale: what forces are measured by.
        amplified: see :meth:`ForceScale.amplified`, (3,), or (3, n) of answers that have S of their own.
        kind: of the bounds.
        inexact: relative error of S and of the free slack, in the order of energies.
    """
    forces = given.forces
    free = given.free
    pushed = response.pushed(forces)
    better, less, nearer = response.settled(forces, free, pushed)
    off = forces - better
    pulled = pushed - less
    unbalanced, size, balanced = fields(better)
    # products of many rows at once: each call has an overhead
    one = np.array((forces, better, off, off, better))
    other = np.array((pushed, less, pulled, off, better))
    sizes, exact, apart, apart_euclid, exact_euclid = lengths(one, other)
    noise = max(inexact, ROUND_OFF) * (sizes + exact + balanced)
    primal = unbalanced + nearer
    # of those alone that are not in equilibrium
    if given.slack is not None and (rows := np.flatnonzero(nearer > NOTHING * unbalanced)).size:
        alone = unbalanced[rows]
        left = response.off(given.slack()[rows], better[rows], rows)
        primal[rows] = np.minimum(primal[rows], (alone + np.sqrt(alone**2 + 4 * nearer[rows] * left)) / 2)
    # S and its inverse are right to a factor of 1 + ε or 1 - ε
    wider = 1 + 2 * inexact
    further = amplified.reshape(3, -1) * ((nearer + noise) * wider**2)
    pressures = scale.peak(np.array((np.abs(off), better)))
    errors = further + np.array((apart * wider, apart_euclid, pressures[0]))
    least = np.maximum(np.array((exact / wider, exact_euclid, pressures[1])) - further, scale.least[:, None])
    primal = (primal + ROUND_OFF * size + noise) * wider
    return Bounded(kind, np.array((primal, *errors)), np.array((size - primal, *least)))


def lengths(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Square roots of products of rows, (..., m): (...,)."""
    # products of matrices have a fifth of the overhead of sums by indices
    return np.sqrt(np.maximum((one[..., None, :] @ other[..., None])[..., 0, 0], 0.0))


class BoundThere(Protocol):
    """A bound at the parameters of n answers (m conditions, ell modes)."""

    def slack(self, forces: np.ndarray) -> np.ndarray:
        """Slack of the fields in equilibrium with forces, (n, m) each."""

    def completed(self, own: np.ndarray, outside: Any) -> np.ndarray:
        """Forces on all conditions, (n, m), from those on some of them, (n, k): the others close their gaps.

        Args:
            own: forces of the conditions inside.
            outside: what :meth:`Bound.prepared` returned.
        """

    def force_changes(self, forces: np.ndarray, outside: Any, gradient: Gradient, changes: np.ndarray) -> np.ndarray:
        """Derivatives of all forces of one answer, (m, P), while the statuses stay.

        Args:
            forces: completed ones, (m,).
            outside: see :meth:`completed`.
            gradient: derivatives of the forces inside among them.
            changes: those of θ, (1 + T, P).
        """

    def of(self, unknown: np.ndarray, forces: np.ndarray, slack: Callable[[], np.ndarray]) -> Estimates:
        """Bounds of fields and of forces.

        Args:
            unknown: γ, (n, ell).
            forces: not negative, (n, m).
            slack: see :class:`Given`.
        """


class Bound(Protocol):
    """What bounds the errors of the answers of a model."""

    @property
    def together(self) -> int:
        """Answers that are bounded at once, so that what is made on the way stays small."""

    @property
    def kind(self) -> str:
        """See :class:`Estimate`."""

    @property
    def schur(self) -> np.ndarray:
        """S, in the middle of the box where it varies, (m, m)."""

    @property
    def free_slack(self) -> np.ndarray:
        """Slack without contact forces: as terms of θ, (m, 1 + T), or in the middle of the box where S varies, (m,)."""

    def prepared(self, inside: np.ndarray) -> Any:
        """What completes forces of the conditions ``inside``."""

    def at(self, points: np.ndarray, theta: Any) -> BoundThere:
        """At the parameters of some answers, (n, P).

        ``theta`` are θ of each, (n, 1 + T), sparse or not; a :class:`~hhr_dolfinx.amplitudes.Theta` for one.
        """


def factor_faults(bound: Any, schur: np.ndarray) -> Iterator[str]:
    """What is wrong with the factor of S, (m, m), and with the scales of a bound."""
    if not ((bound.areas >= 0).all() and (bound.least >= 0).all()):
        yield "areas, or least sizes of forces, in its bound are negative"
    lower = bound.lower
    off = np.abs(lower @ lower.T - schur).max() / np.abs(schur).max(initial=1e-300)
    if not (off <= ROUND_OFF and (lower.diagonal() > 0).all() and not np.triu(lower, 1).any()):
        yield "the factor of S in its bound is wrong"


@dataclass(frozen=True)
class ErrorBound:
    """Arrays of the bounds where the stiffness is constant (m conditions, 1 + T terms, ell modes).

    Attributes:
        free_slack: gaps - B K^-1 loads, (m, 1 + T).
        schur: S, (m, m).
        lower: its Cholesky factor, (m, m).
        basis: V in directions of unit energy, of which the first m are those of K^-1 B^T, (r, ell).
        loads: K^-1 loads in the same directions and more, (r', 1 + T).
        lifts: imposed motions in these and more, (r'', 1 + T); no rows where nothing is imposed.
        areas, least: see :class:`ForceScale`.
    """

    free_slack: Annotated[Floats, "N_lambda", "terms"]
    schur: Annotated[Floats, "N_lambda", "N_lambda"]
    lower: Annotated[Floats, "N_lambda", "N_lambda"]
    basis: Annotated[Floats, "field rows", "kept columns"]
    loads: Annotated[Floats, "load rows", "terms"]
    lifts: Annotated[Floats, "lift rows", "terms"]
    areas: Annotated[Floats, "N_lambda"]
    least: Annotated[Floats, "3"]

    together = 1024

    def faults(self, sizes: Mapping[str, int]) -> Iterator[str]:
        """A wrong factor of S; directions of unit energy that are not in the order of the sets that they span."""
        yield from factor_faults(self, self.schur)
        ranks = [len(self.schur), len(self.basis), len(self.loads), *([len(self.lifts)] if len(self.lifts) else [])]
        if ranks != sorted(ranks):
            yield f"directions of unit energy in its bound are not one more than another: {ranks}"

    @property
    def kind(self) -> str:
        """It is proved."""
        return "bound"

    @cached_property
    def response(self) -> ContactResponse:
        """S."""
        return ContactResponse(self.schur, self.lower)

    @cached_property
    def scale(self) -> ForceScale:
        """What forces are measured by."""
        return ForceScale(self.areas, self.least)

    @cached_property
    def amplified(self) -> np.ndarray:
        """See :meth:`ForceScale.amplified`."""
        return self.scale.amplified(self.response)

    def prepared(self, inside: np.ndarray) -> Outside:
        """See :class:`Bound`."""
        return self.response.outside(inside)

    def at(self, points: np.ndarray, theta: Any) -> ConstantThere:
        """See :class:`Bound`."""
        return ConstantThere(self, theta, driven(self.free_slack, theta))


class ConstantThere(NamedTuple):
    """See :class:`BoundThere`.

    Attributes:
        owner: the arrays.
        theta: θ of each answer.
        free: slack without forces, (n, m).
    """

    owner: ErrorBound
    theta: Any
    free: np.ndarray

    def slack(self, forces: np.ndarray) -> np.ndarray:
        """See :class:`BoundThere`."""
        return self.free + forces @ self.owner.schur

    def completed(self, own: np.ndarray, outside: Outside) -> np.ndarray:
        """See :class:`BoundThere`."""
        return outside.completed(own, self.free)

    def force_changes(
        self, forces: np.ndarray, outside: Outside, gradient: Gradient, changes: np.ndarray
    ) -> np.ndarray:
        """See :class:`BoundThere`."""
        return outside.changes(forces, gradient.multipliers, self.owner.free_slack @ changes)

    def of(self, unknown: np.ndarray, forces: np.ndarray, slack: Callable[[], np.ndarray]) -> Estimates:
        """See :class:`BoundThere`."""
        owner = self.owner
        m = forces.shape[1]
        # K^-1 B^T λ has coordinates along the first directions only, L^T λ
        field = unknown @ owner.basis.T
        left = driven(owner.loads, self.theta)
        left[:, : field.shape[1]] -= field
        along = left[:, :m]
        across = lengths(left[:, m:], left[:, m:])
        moved = field
        if len(owner.lifts):
            moved = driven(owner.lifts, self.theta)
            moved[:, : field.shape[1]] += field

        def fields(better: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
            pushed = along - better @ owner.lower
            return (
                np.hypot(lengths(pushed, pushed), across),
                lengths(moved, moved),
                CANCELLED * lengths(field, field),
            )

        return bounded(
            Given(forces, slack, self.free), owner.response, fields, owner.scale, owner.amplified
        ).estimates()


def driven(matrix: np.ndarray, theta: Any) -> np.ndarray:
    """Columns of a matrix, (k, 1 + T), for θ of each answer, (n, 1 + T) or one Theta: (n, k)."""
    return (matrix @ theta)[None] if isinstance(theta, Theta) else np.asarray(theta @ matrix.T)


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
        response = there.owner.response
        found = settled_forces(there, forces)
        if np.array_equal(found, forces):
            return self._pressed(of_forces())
        none = np.zeros(0, dtype=np.int64)
        free = there.owner.free_slack @ of_theta
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
            pressed = better @ owner.lower
            lost = np.zeros(len(better))
            if owner.basis.shape[1]:
                kept = (pressed @ owner.basis) @ owner.basis.T
                lost = lengths(pressed - kept, pressed - kept)
                pressed = kept
            field = driving.copy()
            field[:, : pressed.shape[1]] -= pressed
            moved = field
            if lifted is not None:
                moved = lifted.copy()
                moved[:, : field.shape[1]] += field
            return lost, lengths(moved, moved), lengths(pressed, pressed) + CANCELLED * lengths(field, field)

        given = Given(forces, None, self.free)
        return bounded(given, owner.response, fields, owner.scale, owner.amplified).estimates()
