"""Bounds of the error of what is handed out: a field everywhere and contact forces everywhere, however they were found.

Let K be symmetric and positive definite, the rows of B independent, S = B K^-1 B^T, and (U, Λ) the solution of (1.21)
with the slack σ. Given any forces λ >= 0, let u be the field in equilibrium with them, K u + B^T λ = loads θ, let
s = gaps θ - B u be its slack, and r = s where λ > 0 or s < 0, else 0. As λ·σ >= 0, and Λ s >= 0 where r leaves s out,

    |λ - Λ|_S^2 = (λ - Λ)·(s - σ) <= (λ - Λ)·r,      so that      |λ - Λ|_S = |u - U|_K <= |r|_{S^-1}.

Another field û, of the slack ŝ with its r̂, leaves the residual ρ = loads θ - K û - B^T λ of equilibrium. With
a = |ρ|_{K^-1} its error is at most a + |r|_{S^-1}. The same sums for û itself give |û - U|_K^2 <= a |û - U|_K +
|λ - Λ|_S |r̂|_{S^-1}, which is smaller where û takes part in the contact: the smaller one is the bound. docs/bounds.md
has the proof in full. Theorems 3 to 8 of the thesis bound the same errors through inf-sup constants.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np

from hhr_dolfinx.amplitudes import Theta
from hhr_dolfinx.models.contact_response import ContactResponse, Outside

if TYPE_CHECKING:
    from hhr_dolfinx.models.gradient import Gradient

ROUND_OFF = 1e-10
"""Part of an answer that is round-off of the exact one too: nothing is known to be nearer."""


SHARP = 1e-4
"""Part of the forces from which on their bound is made as sharp as it can be; below, it is a third larger at times."""
CANCELLED = 1e-3
"""Round-off of a field that a lift cancels, over the round-off of what is left."""
NOTHING = 0.01
"""Part of the bound of a field that a bound of forces adds without being worth a second look."""
NO_OUTPUTS: Mapping[str, float] = {}
"""Of what has no outputs, or no bounds of them."""


class Estimate(NamedTuple):
    """What is known of the error of an answer.

    Attributes:
        kind: ``bound``, which no error exceeds; ``estimate``, the same but for an interpolation of which nothing is
            proved; or ``indicator``, which follows the error.
        primal: of the displacement in energy, (v^T K v)^1/2.
        dual: of the contact forces, (λ^T S λ)^1/2: the energy of the displacement that they make alone.
            Both are infinite of an indicator, which knows no units.
        primal_relative, dual_relative: over the least that the exact answer can have in these norms; infinite where a
            bound is larger than the answer itself.
        outputs: bounds of the errors of the outputs of the scene, by name; those of which nothing is known are left
            out, see :mod:`hhr_dolfinx.models.output_bound`.
    """

    kind: str
    primal: float
    dual: float
    primal_relative: float
    dual_relative: float
    outputs: Mapping[str, float] = NO_OUTPUTS

    @classmethod
    def indicated(cls, value: float) -> Estimate:
        """What an indicator says, in units of its own, taken as relative."""
        return cls("indicator", math.inf, math.inf, value, value)

    @classmethod
    def exact(cls, functionals: Any) -> Estimate:
        """Of an answer without an error, with the outputs of a scene, or None."""
        items = () if functionals is None else functionals.items
        return cls("bound", 0.0, 0.0, 0.0, 0.0, {item.name: 0.0 for item in items})


@dataclass(frozen=True)
class Estimates:
    """Estimates of many answers; ``estimates[k]`` is the :class:`Estimate` of one.

    Attributes:
        kind: see there.
        primal, dual, primal_relative, dual_relative: see there, (n,) each; NaN without an answer.
    """

    kind: str
    primal: np.ndarray
    dual: np.ndarray
    primal_relative: np.ndarray
    dual_relative: np.ndarray

    def __len__(self) -> int:
        return len(self.primal)

    def __getitem__(self, k: int) -> Estimate:
        """That of one answer."""
        own, relative = (self.primal, self.dual), (self.primal_relative, self.dual_relative)
        return Estimate(self.kind, float(own[0][k]), float(own[1][k]), float(relative[0][k]), float(relative[1][k]))

    @classmethod
    def of(cls, found: list[Estimate | None]) -> Estimates | None:
        """Of estimates found one by one; None where there are none."""
        kinds = {estimate.kind for estimate in found if estimate is not None}
        if not kinds:
            return None
        rows = [(np.nan,) * 4 if estimate is None else estimate[1:5] for estimate in found]
        return cls(" and ".join(sorted(kinds)), *np.array(rows, dtype=float).T)


class Given(NamedTuple):
    """What is bounded (n answers, m conditions).

    Attributes:
        forces: not negative, (n, m).
        slack: makes that of the fields, (n, m), which only some bounds need.
        free: slack of the fields in equilibrium with no forces, (n, m).
    """

    forces: np.ndarray
    slack: Callable[[], np.ndarray]
    free: np.ndarray


def bounded(
    given: Given,
    response: ContactResponse,
    fields: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]],
    inexact: float = ROUND_OFF,
) -> tuple[np.ndarray, ...]:
    """Bounds of displacements and forces, and the sizes that these have, (n,) each.

    Any forces may stand in the proof, so that better ones make the bound sharp; the distance to them is known.

    Args:
        given: what is bounded.
        response: S.
        fields: maps forces, (n, m), to |ρ|_{K^-1}, to the energy norm of the field, and to that of the field in
            equilibrium with them, as far as this is only known up to ``inexact``, (n,) each.
        inexact: relative error of S and of the free slack, in the order of energies.
    """
    forces, free = given.forces, given.free
    pushed = forces @ response.schur
    own = lengths(forces, pushed)
    known = response.off(free + pushed, forces)
    better, nearer, dual, least = forces, known, known, own
    # sharper where it is worth a factor of S
    if (rows := np.flatnonzero(known > SHARP * own)).size:
        found, less, left = response.improved(forces[rows], free[rows], pushed[rows])
        better, nearer, dual, least = forces.copy(), known.copy(), known.copy(), own.copy()
        better[rows], nearer[rows], least[rows] = found, response.off(left, found), lengths(found, less)
        dual[rows] = np.minimum(known[rows], nearer[rows] + lengths(forces[rows] - found, pushed[rows] - less))
    unbalanced, size, balanced = fields(better)
    noise, primal = inexact * (own + least + balanced), unbalanced + nearer
    # row by row, so that a bound is the same in any table
    if (rows := np.flatnonzero(nearer > NOTHING * unbalanced)).size:
        alone, left = unbalanced[rows], response.off(given.slack()[rows], better[rows])
        primal[rows] = np.minimum(primal[rows], (alone + np.sqrt(alone**2 + 4 * nearer[rows] * left)) / 2)
    return primal + ROUND_OFF * size + noise, dual + noise, size, own


def lengths(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Square roots of products of rows, (n,)."""
    # products of matrices have a fifth of the overhead of sums by indices
    return np.sqrt(np.maximum((one[:, None, :] @ other[:, :, None])[:, 0, 0], 0.0))


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
    def kind(self) -> str:
        """See :class:`Estimate`."""

    @property
    def schur(self) -> np.ndarray:
        """S, in the middle of the box where it varies, (m, m)."""

    def prepared(self, inside: np.ndarray) -> Any:
        """What completes forces of the conditions ``inside``."""

    def at(self, points: np.ndarray, theta: Any) -> BoundThere:
        """At the parameters of some answers, (n, P).

        ``theta`` are θ of each, (n, 1 + T), sparse or not; a :class:`~hhr_dolfinx.amplitudes.Theta` for one.
        """


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
    """

    free_slack: np.ndarray
    schur: np.ndarray
    lower: np.ndarray
    basis: np.ndarray
    loads: np.ndarray
    lifts: np.ndarray

    @property
    def kind(self) -> str:
        """It is proved."""
        return "bound"

    @property
    def response(self) -> ContactResponse:
        """S."""
        return ContactResponse(self.schur, self.lower)

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
        owner, m = self.owner, forces.shape[1]
        # K^-1 B^T λ has coordinates along the first directions only, L^T λ
        field, left = unknown @ owner.basis.T, driven(owner.loads, self.theta)
        left[:, : field.shape[1]] -= field
        along, across = left[:, :m], lengths(left[:, m:], left[:, m:])
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

        primal, dual, *sizes = bounded(Given(forces, slack, self.free), self.owner.response, fields)
        return Estimates("bound", primal, dual, relative(primal, sizes[0]), relative(dual, sizes[1]))


def driven(matrix: np.ndarray, theta: Any) -> np.ndarray:
    """Columns of a matrix, (k, 1 + T), for θ of each answer, (n, 1 + T) or one Theta: (n, k)."""
    return (matrix @ theta)[None] if isinstance(theta, Theta) else np.asarray(theta @ matrix.T)


def relative(error: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Errors over the least size of what is exact, that of what was found less the error, (n,)."""
    least = size - error
    if least.min(initial=np.inf) > 0:
        return error / least
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(error == 0, 0.0, error / np.maximum(least, 0.0))
