"""Errors of answers for a constant stiffness: their difference from the exact answer.

S = B K^-1 B^T is then known, and so are the exact forces Λ: the solution of the contact problem on
S, found from the statuses of an answer at the cost of a few equality problems. The exact field is
u0 θ - K^-1 B^T Λ, with u0 the field of loads and imposed displacements. The difference of the field
of an answer is a field of forces alone, whose energy is their S norm; or, for modes V, a
combination of columns expressed in directions of unit energy, since a Gram matrix would lose half
of the digits.

For bodies that only contact holds let R be their rigid motions, on which K is singular, and G = B
R. K is factored with as many dofs pinned as there are motions. Forces that balance the loads, G^T λ
= driving, have no reaction on the pins, so that S and the field of the pinned bodies are correct up
to a motion R q, which the contact problem determines with Λ, see
:mod:`hhr_dolfinx.plugins.floating.statuses`. Energies and estimates do not depend on rigid motions.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, NamedTuple

import numpy as np
from scipy.linalg import LinAlgError, cholesky, solve_triangular

from hhr_dolfinx.contact.active_set import Status
from hhr_dolfinx.declared import Floats
from hhr_dolfinx.models.bound import (
    BOUND_ROUND_OFF,
    ForceScale,
    Thetas,
    driven,
    estimates_of,
    lengths,
)
from hhr_dolfinx.models.estimates import Estimates
from hhr_dolfinx.plain import Rebuilt
from hhr_dolfinx.plugins.exact_errors.contact_response import CANCELLED, ContactResponse, Outside

if TYPE_CHECKING:
    from hhr_dolfinx.models.gradient import Gradient
    from hhr_dolfinx.plugins.floating.statuses import FloatingEqualities

SQUARES = 1e-14
"""Part of squares up to which their difference is round-off."""


class Exact(NamedTuple):
    """Exact forces and rigid motions of n answers.

    Forces, (n, m), motions, (n, r), and True for those that were found, (n,) bool.

    For the others, the forces are those of the answer.
    """

    forces: np.ndarray
    motions: np.ndarray
    found: np.ndarray


def definite(schur: np.ndarray, contact_of_motions: np.ndarray) -> np.ndarray:
    """S + G M G^T, (m, m), equal to S on differences of balanced forces.

    It is definite if S is on these. Motions are scaled like a force on one condition, at the
    condition with the largest effect.

    Args:
        schur: S, (m, m).
        contact_of_motions: G = B R, (m, r), without zero columns; r = 0 if all bodies are held.
    """
    scale = schur.diagonal().mean() / np.abs(contact_of_motions).max(axis=0) ** 2
    return schur + (contact_of_motions * scale) @ contact_of_motions.T


@dataclass(frozen=True)
class ExactDifference(Rebuilt):
    """Arrays of the exact answer (m conditions, 1 + T terms, r motions, ell modes)."""

    free_slack: Annotated[Floats, "N_lambda", "terms"]  #: gaps - B K^-1 loads, (m, 1 + T)
    schur: Annotated[Floats, "N_lambda", "N_lambda"]  #: S, (m, m)
    #: G = B R, (m, r); r = 0 if all bodies are held
    taken: Annotated[Floats, "N_lambda", "motions"]
    driving: Annotated[Floats, "motions", "terms"]  #: loads along the motions, (r, 1 + T)
    given: Annotated[Floats, "terms", "terms"]  #: u0 in directions of unit energy, (1 + T, 1 + T)
    cross: Annotated[Floats, "N_lambda", "terms"]  #: (K^-1 B^T)^T K u0, (m, 1 + T)
    lifting: Annotated[
        Floats, "terms"
    ]  #: energy norms of imposed displacements, whose round-off u0 has, (1 + T,)
    #: areas, least: see :class:`~hhr_dolfinx.models.bound.ForceScale`
    areas: Annotated[Floats, "N_lambda"]
    least: Annotated[Floats, "3"]
    #: projection of K^-1 B^T on the columns of a displacement as a function of forces, orthonormal
    #: after L, the factor of :func:`definite`, (m, c); no columns if they span all of it; None if
    #: the columns are V
    kept: Annotated[Floats, "N_lambda", "kept columns"] | None = None
    #: V in directions of unit energy, of which the first m are those of K^-1 B^T, (k', ell), and
    #: K^-1 loads in the same directions and more, (k'', 1 + T); None if the columns are not V
    modes: Annotated[Floats, "field rows", "ell"] | None = None
    loads: Annotated[Floats, "load rows", "terms"] | None = None

    kind = "bound"

    def faults(self, sizes: Mapping[str, int]) -> Iterator[str]:
        """Invalid S, motions without effect, and missing data of the displacement."""
        if not ((self.areas >= 0).all() and (self.least >= 0).all()):
            yield "areas, or least sizes of forces, of its estimate are negative"
        if not self.taken.any(axis=0).all():
            yield "a motion of its estimate moves no condition"
            return
        skew = np.abs(self.schur - self.schur.T).max(initial=0.0)
        try:
            fine = skew <= BOUND_ROUND_OFF * np.abs(self.schur).max(initial=0.0) and self.lower.size
        except LinAlgError:
            fine = False
        if not fine:
            yield "S of its estimate is not symmetric and positive definite"
        if self.kept is None and (
            self.modes is None
            or self.loads is None
            or not len(self.schur) <= len(self.modes) <= len(self.loads)
        ):
            yield "directions of unit energy of its estimate are not one more than another"

    @property
    def rigid_motions(self) -> int:
        """Number of rigid motions of bodies that contact alone holds."""
        return self.taken.shape[1]

    @property
    def together(self) -> int:
        """See :class:`~hhr_dolfinx.models.bound.Bound`."""
        return 1 if self.rigid_motions else 1024

    @cached_property
    def lower(self) -> np.ndarray:
        """L, Cholesky factor of :func:`definite`, (m, m)."""
        return cholesky(definite(self.schur, self.taken), lower=True)

    @cached_property
    def response(self) -> ContactResponse:
        """S and its equality problems."""
        return ContactResponse(self.schur)

    @cached_property
    def floating(self) -> FloatingEqualities:
        """Equality problems on S with the motions."""
        from hhr_dolfinx.plugins.floating.statuses import FloatingEqualities

        return FloatingEqualities(self.schur, self.taken)

    @cached_property
    def lifts(self) -> np.ndarray:
        """Energy norms of imposed displacements, each in a separate row, (l, 1 + T)."""
        return np.diag(self.lifting)[self.lifting > 0]

    @cached_property
    def scale(self) -> ForceScale:
        """Scales of contact forces."""
        return ForceScale(self.areas, self.least)

    @cached_property
    def balancing(self) -> np.ndarray:
        """Orthonormal directions of G, (m, r)."""
        return np.linalg.qr(self.taken)[0]

    def prepared(self, inside: np.ndarray) -> Outside:
        """See :class:`~hhr_dolfinx.models.bound.Bound`.

        All conditions that hold bodies must be inside.
        """
        return self.response.outside(inside)

    def at(self, points: np.ndarray, theta: Thetas) -> DifferenceThere:
        """See :class:`~hhr_dolfinx.models.bound.Bound`.

        Args:
            points: parameters, (n, P); not used, since S is constant.
            theta: θ of each answer.
        """
        return DifferenceThere(self, theta, driven(self.free_slack, theta))

    def size(self, forces: np.ndarray) -> np.ndarray:
        """S norms of forces, (..., m): (...,)."""
        return lengths(forces, forces @ self.schur)

    def left_out(self, unknown: np.ndarray, exact: np.ndarray, theta: Thetas) -> np.ndarray:
        """Energy norms of the returned fields less the exact ones, (n,).

        Args:
            unknown: γ, (n, ell).
            exact: exact forces, (n, m).
            theta: θ of each answer.
        """
        pressed = exact @ self.lower
        if self.modes is not None and self.loads is not None:
            off = driven(self.loads, theta)
            off[:, : pressed.shape[1]] -= pressed
            off[:, : len(self.modes)] -= unknown @ self.modes.T
            return lengths(off, off)
        if self.kept is None or not self.kept.shape[1]:
            return np.zeros(len(exact))
        remainder = pressed - (pressed @ self.kept) @ self.kept.T
        if not self.rigid_motions:
            return lengths(remainder, remainder)
        # S is less than what L is the factor of
        return self.size(solve_triangular(self.lower, remainder.T, lower=True, trans="T").T)


@dataclass(frozen=True, eq=False)
class DifferenceThere:
    """See :class:`~hhr_dolfinx.models.bound.BoundThere`.

    One answer for bodies that only contact holds.
    """

    owner: ExactDifference  #: the arrays
    theta: Thetas  #: θ of each answer
    free: np.ndarray  #: slack without forces, (n, m)
    #: forces whose exact ones were computed last, and these: an estimate, fields and outputs of one
    #: answer need them
    last: list[tuple[np.ndarray, Exact]] = field(default_factory=list)

    def slack(self, forces: np.ndarray) -> np.ndarray:
        """See :class:`~hhr_dolfinx.models.bound.BoundThere`; for pinned bodies."""
        return self.free + forces @ self.owner.schur

    def completed(self, own: np.ndarray, outside: Outside) -> np.ndarray:
        """See :class:`~hhr_dolfinx.models.bound.BoundThere`.

        Gaps outside are not opened by motions.

        Args:
            own: forces on the conditions inside, (n, k).
            outside: partition of the conditions.
        """
        return outside.completed(own, self.free)

    def force_changes(
        self, forces: np.ndarray, outside: Outside, gradient: Gradient, changes: np.ndarray
    ) -> np.ndarray:
        """See :class:`~hhr_dolfinx.models.bound.BoundThere`.

        Args:
            forces: completed forces, (m,).
            outside: partition of the conditions.
            gradient: derivatives of the forces inside.
            changes: derivatives of θ, (1 + T, P).
        """
        return outside.changes(forces, gradient.multipliers, self.owner.free_slack @ changes)

    def exact(self, forces: np.ndarray) -> Exact:
        """Exact forces and motions, from the statuses of the returned forces, (n, m)."""
        for known, exact in self.last:
            if np.array_equal(known, forces):
                return exact
        exact = self._exact(forces)
        self.last[:] = [(forces, exact)]
        return exact

    def _exact(self, forces: np.ndarray) -> Exact:
        owner = self.owner
        if not owner.rigid_motions:
            solution, settled = owner.response.settled(forces, self.free)
            return Exact(solution, np.zeros((len(solution), 0)), settled)
        from hhr_dolfinx.plugins.floating.statuses import floating_set

        driving = owner.driving @ self.theta
        touching = forces[0] > 0
        statuses, motions = floating_set(owner.floating, self.free[0], driving, touching)
        better = np.maximum(statuses.forces, 0.0)
        if statuses.status is Status.CONVERGED and owner.floating.balanced(better, driving).all():
            return Exact(better[None], motions[None], np.ones(1, dtype=bool))
        # least-squares motions that close the gaps
        opened = self.slack(forces)[0]
        motions = np.linalg.lstsq(owner.taken[touching], opened[touching], rcond=None)[0]
        return Exact(forces, motions[None], np.zeros(1, dtype=bool))

    def exact_changes(
        self, forces: np.ndarray, of_forces: Callable[[], np.ndarray], of_theta: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of the exact forces and motions of one answer, at constant statuses.

        Args:
            forces: the returned forces, (m,).
            of_forces: returns the derivatives of these, (m, P).
            of_theta: derivatives of θ, (1 + T, P).

        Returns:
            The derivatives of the forces, (m, P), and of the motions, (r, P).
        """
        owner = self.owner
        exact = self.exact(forces[None]).forces[0]
        free = owner.free_slack @ of_theta
        if owner.rigid_motions:
            pressing, _, motions = owner.floating.several(exact > 0, free, owner.driving @ of_theta)
            return pressing, motions
        motions = np.zeros((0, of_theta.shape[1]))
        if np.array_equal(exact, forces):
            return of_forces(), motions
        none = np.zeros(0, dtype=np.int64)
        return owner.response.outside(none).changes(exact, free[:0], free), motions

    def of(
        self, unknown: np.ndarray, forces: np.ndarray, slack: Callable[[], np.ndarray]
    ) -> Estimates:
        """See :class:`~hhr_dolfinx.models.bound.BoundThere`: differences, plus their round-off.

        They are infinite if the exact answer was not found.

        Args:
            unknown: γ, (n, ell).
            forces: returned forces, (n, m).
            slack: not used: the exact answer is known.
        """
        owner = self.owner
        exact, _, converged = self.exact(forces)
        # norms of exact forces, errors and returned forces, each in the S norm, the Euclidean one
        # and the largest pressure, (3, n); of all at once: each product has an overhead
        force_sets = np.array((exact, forces - exact, forces))
        norms = np.array(
            (
                owner.size(force_sets),
                lengths(force_sets, force_sets),
                owner.scale.peak(np.abs(force_sets)),
            )
        )
        of_exact, of_error, of_returned = np.moveaxis(norms, 1, 0)
        imposed, lifted = (driven(columns, self.theta) for columns in (owner.given, owner.lifts))
        # |u0 - X L|^2 = |u0|^2 + |L|^2 - 2 L (X^T K u0) with X = K^-1 B^T and exact forces L, the
        # second in the S norm; rounded down, so that relative errors are rounded up
        parts = np.hypot(lengths(imposed, imposed), of_exact[0])
        mixed = np.sum(driven(owner.cross, self.theta) * exact, axis=1)
        energy = np.sqrt(np.maximum((1 - SQUARES) * parts**2 - 2 * mixed, 0.0))
        errors = np.vstack((owner.left_out(unknown, exact, self.theta), of_error))
        round_off = BOUND_ROUND_OFF * np.vstack(
            (energy + CANCELLED * (parts + lengths(lifted, lifted)), of_exact + of_returned)
        )
        sizes = np.vstack((energy, of_exact))
        if owner.rigid_motions:
            # the energy of the self-balancing part of forces: that of the rest would depend on the
            # pins
            sizes[1] = owner.size(exact - (exact @ owner.balancing) @ owner.balancing.T)
        over = np.maximum(sizes - round_off, np.append(0.0, owner.least)[:, None])
        return estimates_of(owner.kind, np.where(converged, errors + round_off, np.inf), over)
