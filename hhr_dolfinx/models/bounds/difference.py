"""Errors of answers where the stiffness is constant: their difference to the exact answer.

S = B K^-1 B^T is known there, and so are the exact forces Λ: the solution of the contact problem on S, found from the
statuses of an answer at the cost of a few equality problems. The exact field is u0 θ - K^-1 B^T Λ, u0 of loads and
imposed displacements. What the field of an answer leaves out of it is a field of forces alone, whose energy is their
S norm; or, of modes V, a combination of columns that are written in directions of unit energy, as a Gram matrix in
their place would lose half of the digits.

Where contact alone holds bodies let R be their rigid motions, on which K is singular, and G = B R. K is factored with
as many dofs pinned as there are motions. Forces that balance the loads, G^T λ = driving, leave nothing on the pins, so
that S and the field of the pinned bodies are right up to a motion R q, which the contact problem finds beside Λ, see
:mod:`hhr_dolfinx.contact.floating`. Energy knows no rigid motion, nor does an estimate.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, NamedTuple

import numpy as np
from scipy.linalg import LinAlgError, cholesky, solve_triangular

from hhr_dolfinx.contact.active_set import Status
from hhr_dolfinx.contact.floating import FloatingEqualities, floating_set
from hhr_dolfinx.declared import Floats
from hhr_dolfinx.models.bounds.bound import CANCELLED, ROUND_OFF, ForceScale, Thetas, driven, estimates_of, lengths
from hhr_dolfinx.models.bounds.contact_response import ContactResponse, Outside
from hhr_dolfinx.models.estimates import Estimates
from hhr_dolfinx.plain import Rebuilt

if TYPE_CHECKING:
    from hhr_dolfinx.models.gradient import Gradient

SQUARES = 1e-14
"""Part of squares that is round-off of their difference."""


class Exact(NamedTuple):
    """Exact forces of n answers, (n, m), the rigid motions with them, (n, r), and whether they were found, (n,) bool.

    Where they were not, the forces are those of the answer.
    """

    forces: np.ndarray
    motions: np.ndarray
    found: np.ndarray


def definite(schur: np.ndarray, taken: np.ndarray) -> np.ndarray:
    """S + G M G^T, (m, m), which is S on differences of balanced forces, and definite where S is on these.

    Motions count as much as a force on one condition, where they move the conditions most.

    Args:
        schur: S, (m, m).
        taken: G, (m, r), no column of which is zero; r = 0 where all bodies are held.
    """
    scale = schur.diagonal().mean() / np.abs(taken).max(axis=0) ** 2
    return schur + (taken * scale) @ taken.T


@dataclass(frozen=True)
class ExactDifference(Rebuilt):
    """Arrays of the exact answer (m conditions, 1 + T terms, r motions, ell modes).

    Attributes:
        free_slack: gaps - B K^-1 loads, (m, 1 + T).
        schur: S, (m, m).
        taken: G, (m, r); r = 0 where all bodies are held.
        driving: loads along the motions, (r, 1 + T).
        given: u0 in directions of unit energy, (1 + T, 1 + T).
        cross: (K^-1 B^T)^T K u0, (m, 1 + T).
        lifting: energy norms of imposed displacements, whose round-off u0 has, (1 + T,).
        areas, least: see :class:`~hhr_dolfinx.models.bounds.bound.ForceScale`.
        kept: what the columns of a displacement that forces make keep of K^-1 B^T, orthonormal after L, the factor of
            :func:`definite`, (m, c); no columns where they keep all of it; None where the columns are V.
        modes: V in directions of unit energy, of which the first m are those of K^-1 B^T, (k', ell); None where the
            columns are not V.
        loads: K^-1 loads in the same directions and more, (k'', 1 + T); None likewise.
    """

    free_slack: Annotated[Floats, "N_lambda", "terms"]
    schur: Annotated[Floats, "N_lambda", "N_lambda"]
    taken: Annotated[Floats, "N_lambda", "motions"]
    driving: Annotated[Floats, "motions", "terms"]
    given: Annotated[Floats, "terms", "terms"]
    cross: Annotated[Floats, "N_lambda", "terms"]
    lifting: Annotated[Floats, "terms"]
    areas: Annotated[Floats, "N_lambda"]
    least: Annotated[Floats, "3"]
    kept: Annotated[Floats, "N_lambda", "kept columns"] | None = None
    modes: Annotated[Floats, "field rows", "ell"] | None = None
    loads: Annotated[Floats, "load rows", "terms"] | None = None

    kind = "bound"

    def faults(self, sizes: Mapping[str, int]) -> Iterator[str]:
        """An S that is none, motions that move nothing, and a displacement that is not told."""
        if not ((self.areas >= 0).all() and (self.least >= 0).all()):
            yield "areas, or least sizes of forces, of its estimate are negative"
        if not self.taken.any(axis=0).all():
            yield "a motion of its estimate moves no condition"
            return
        skew = np.abs(self.schur - self.schur.T).max(initial=0.0)
        try:
            fine = skew <= ROUND_OFF * np.abs(self.schur).max(initial=0.0) and self.lower.size
        except LinAlgError:
            fine = False
        if not fine:
            yield "S of its estimate is not symmetric and positive definite"
        if self.kept is None and (
            self.modes is None or self.loads is None or not len(self.schur) <= len(self.modes) <= len(self.loads)
        ):
            yield "directions of unit energy of its estimate are not one more than another"

    @property
    def together(self) -> int:
        """See :class:`~hhr_dolfinx.models.bounds.bound.Bound`."""
        return 1 if self.taken.shape[1] else 1024

    @cached_property
    def lower(self) -> np.ndarray:
        """L, Cholesky factor of :func:`definite`, (m, m)."""
        return cholesky(definite(self.schur, self.taken), lower=True)

    @cached_property
    def response(self) -> ContactResponse:
        """S."""
        return ContactResponse(self.schur)

    @cached_property
    def floating(self) -> FloatingEqualities:
        """Equality problems on S with the motions."""
        return FloatingEqualities(self.schur, self.taken)

    @cached_property
    def lifts(self) -> np.ndarray:
        """Energy norms of imposed displacements, each in a row of its own, (l, 1 + T)."""
        return np.diag(self.lifting)[self.lifting > 0]

    @cached_property
    def scale(self) -> ForceScale:
        """What forces are measured by."""
        return ForceScale(self.areas, self.least)

    @cached_property
    def balancing(self) -> np.ndarray:
        """Orthonormal directions of G, (m, r)."""
        return np.linalg.qr(self.taken)[0]

    def prepared(self, inside: np.ndarray) -> Outside:
        """See :class:`~hhr_dolfinx.models.bounds.bound.Bound`; all conditions that hold bodies are inside."""
        return self.response.outside(inside)

    def at(self, points: np.ndarray, theta: Thetas) -> DifferenceThere:
        """See :class:`~hhr_dolfinx.models.bounds.bound.Bound`."""
        return DifferenceThere(self, theta, driven(self.free_slack, theta))

    def size(self, forces: np.ndarray) -> np.ndarray:
        """S norms of forces, (n, m): (n,)."""
        return lengths(forces, forces @ self.schur)

    def sizes(self, forces: np.ndarray) -> np.ndarray:
        """The same, Euclidean norms and largest pressures: (3, n)."""
        return np.array((self.size(forces), lengths(forces, forces), self.scale.peak(np.abs(forces))))

    def left_out(self, unknown: np.ndarray, exact: np.ndarray, theta: Thetas) -> np.ndarray:
        """Energy norms of the fields handed out less the exact ones, of γ, (n, ell), and exact forces, (n, m): (n,)."""
        pressed = exact @ self.lower
        if self.modes is not None and self.loads is not None:
            off = driven(self.loads, theta)
            off[:, : pressed.shape[1]] -= pressed
            off[:, : len(self.modes)] -= unknown @ self.modes.T
            return lengths(off, off)
        if self.kept is None or not self.kept.shape[1]:
            return np.zeros(len(exact))
        rest = pressed - (pressed @ self.kept) @ self.kept.T
        return self.size(solve_triangular(self.lower, rest.T, lower=True, trans="T").T)


class DifferenceThere(NamedTuple):
    """See :class:`~hhr_dolfinx.models.bounds.bound.BoundThere`; of one answer where contact alone holds bodies.

    Attributes:
        owner: the arrays.
        theta: θ of each answer.
        free: slack without forces, (n, m).
    """

    owner: ExactDifference
    theta: Thetas
    free: np.ndarray

    def slack(self, forces: np.ndarray) -> np.ndarray:
        """See :class:`~hhr_dolfinx.models.bounds.bound.BoundThere`; of pinned bodies."""
        return self.free + forces @ self.owner.schur

    def completed(self, own: np.ndarray, outside: Outside) -> np.ndarray:
        """See :class:`~hhr_dolfinx.models.bounds.bound.BoundThere`; no motion opens the gaps outside."""
        return outside.completed(own, self.free)

    def force_changes(
        self, forces: np.ndarray, outside: Outside, gradient: Gradient, changes: np.ndarray
    ) -> np.ndarray:
        """See :class:`~hhr_dolfinx.models.bounds.bound.BoundThere`."""
        return outside.changes(forces, gradient.multipliers, self.owner.free_slack @ changes)

    def exact(self, forces: np.ndarray) -> Exact:
        """Exact forces and motions, from the statuses of forces that are handed out, (n, m)."""
        owner = self.owner
        if not owner.taken.shape[1]:
            found, settled = owner.response.settled(forces, self.free)
            return Exact(found, np.zeros((len(found), 0)), settled)
        driving = owner.driving @ self.theta
        touching = forces[0] > 0
        statuses, motions = floating_set(owner.floating, self.free[0], driving, touching)
        better = np.maximum(statuses.forces, 0.0)
        if statuses.status is Status.CONVERGED and owner.floating.balanced(better, driving).all():
            return Exact(better[None], motions[None], np.ones(1, dtype=bool))
        # motions that close the gaps as well as they can
        opened = self.slack(forces)[0]
        motions = np.linalg.lstsq(owner.taken[touching], opened[touching], rcond=None)[0]
        return Exact(forces, motions[None], np.zeros(1, dtype=bool))

    def exact_changes(
        self, forces: np.ndarray, of_forces: Callable[[], np.ndarray], of_theta: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of the exact forces and motions of one answer, (m, P) and (r, P), while the statuses stay.

        Args:
            forces: as they are handed out, (m,).
            of_forces: makes their derivatives, (m, P).
            of_theta: derivatives of θ, (1 + T, P).
        """
        owner = self.owner
        found = self.exact(forces[None]).forces[0]
        free = owner.free_slack @ of_theta
        if owner.taken.shape[1]:
            pressing, _, motions = owner.floating.several(found > 0, free, owner.driving @ of_theta)
            return pressing, motions
        motions = np.zeros((0, of_theta.shape[1]))
        if np.array_equal(found, forces):
            return of_forces(), motions
        none = np.zeros(0, dtype=np.int64)
        return owner.response.outside(none).changes(found, free[:0], free), motions

    def of(self, unknown: np.ndarray, forces: np.ndarray, slack: Callable[[], np.ndarray]) -> Estimates:
        """See :class:`~hhr_dolfinx.models.bounds.bound.BoundThere`: differences, and the round-off of these.

        Where the exact answer was not found they are infinite.
        """
        owner = self.owner
        exact, _, found = self.exact(forces)
        size = owner.sizes(exact)
        given, lifted = (driven(part, self.theta) for part in (owner.given, owner.lifts))
        parts = np.hypot(lengths(given, given), size[0])
        pulled = np.sum(driven(owner.cross, self.theta) * exact, axis=1)
        energy = np.sqrt(np.maximum((1 - SQUARES) * parts**2 - 2 * pulled, 0.0))
        errors = np.array((owner.left_out(unknown, exact, self.theta), *owner.sizes(forces - exact)))
        round_off = ROUND_OFF * np.array(
            (energy + CANCELLED * (parts + lengths(lifted, lifted)), *(size + owner.sizes(forces)))
        )
        # in energy the part of forces that balances itself is measured: the rest would depend on the pins
        size[0] = owner.size(exact - (exact @ owner.balancing) @ owner.balancing.T)
        least = np.concatenate([[0.0], owner.least])[:, None]
        over = np.maximum(np.array((energy, *size)) - round_off, least)
        return estimates_of(owner.kind, np.where(found, errors + round_off, np.inf), over)
