"""Bounds of errors if the stiffness or the shape depends on parameters: their arrays are
interpolated.

With f = loads θ - B^T λ the field in equilibrium with forces λ is K^-1 f. Bounds need arrays with
the size of the contact surface: S, the slack, and its energy f^T K^-1 f. All are blocks of one
matrix P^T K^-1 P, P = (loads, B^T), which condensation interpolates between few parameters
(:mod:`hhr_dolfinx.plugins.moduli.interpolated`). The error of a reduced field V γ is

    |V γ - K^-1 f|_K^2 = γ^T V^T K V γ - 2 γ^T V^T f + f^T K^-1 f,

whose first terms are small matrices. Its root is meaningful above the root of the error of the
interpolation. docs/bounds_dependence.md states when that error is proved; otherwise the result is
called an estimate.

The error of forces follows from the solution of the contact problem on S, found from the statuses
of the answer. With the field u in equilibrium with any λ >= 0, its slack s, and r = s where λ > 0
or s < 0, else 0, the exact (U, Λ) has
|λ - Λ|_S = |u - U|_K <= |r|_{S^-1}. Another field, with the slack ŝ and its r̂, and the difference
a from u in energy, has an error x of at most a + |r|_{S^-1}, and
x^2 <= a x + |λ - Λ|_S |r̂|_{S^-1}: docs/bounds_proofs.md has the proof.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, NamedTuple

import numpy as np
from scipy.linalg import LinAlgError

from hhr_dolfinx.declared import Floats
from hhr_dolfinx.errors import BoundError, ConvergenceError
from hhr_dolfinx.models.bound import BOUND_ROUND_OFF, ForceScale, Thetas, estimates_of, lengths
from hhr_dolfinx.models.eliminations.block import ModeBlock, blocks_of
from hhr_dolfinx.models.eliminations.projected import ReducedProblem
from hhr_dolfinx.models.estimates import Estimates
from hhr_dolfinx.parameters import is_number
from hhr_dolfinx.plain import Rebuilt
from hhr_dolfinx.plugins.moduli.interpolated import Compliances, ManyContacts
from hhr_dolfinx.plugins.moduli.known_forces import many_weights
from hhr_dolfinx.plugins.moduli.least_response import LeastResponse, ManyResponses

if TYPE_CHECKING:
    from hhr_dolfinx.models.gradient import Gradient
    from hhr_dolfinx.plugins.moduli.interpolation import Interpolant
    from hhr_dolfinx.plugins.moduli.shaped import InterpolatedProblem

OF_ENERGY = 1e-13
"""Part of an energy that is round-off of its sums."""
UNIMPROVED_FORCES = 0.01
"""Part of the bound of a field up to which the bound of its forces is not improved."""


@dataclass(frozen=True)
class PartEnergy:
    """Energies of one part of a scene for the factor 1, as modes of its compliance."""

    #: modes of P^T K^-1 P, where P are the terms with forces, followed by K lift of those with
    #: lifts, (r, T, T)
    work: Annotated[Floats, "modes", "terms of it", "terms of it"]
    lifted: Annotated[Floats, "modes", "lifted", "lifted"]  #: modes of lift^T K lift, (r, T_L, T_L)


@dataclass(frozen=True)
class VaryingBound(Rebuilt):
    """See :class:`hhr_dolfinx.models.bound.Bound` (m conditions, ell modes)."""

    compliances: Compliances  #: S and the free slack of all conditions
    energies: tuple[PartEnergy, ...]  #: energies of its parts
    #: V^T K V, V^T loads and the other arrays of the reduced basis on the whole mesh
    whole: ReducedProblem | InterpolatedProblem
    inexact: float  #: relative error of the interpolation, in the order of energies
    proved: bool  #: that error is proved, not only observed
    middle: Annotated[Floats, "P"]  #: of the box, (P,)
    #: areas, least: see :class:`~hhr_dolfinx.models.bound.ForceScale`; S is that of the middle
    areas: Annotated[Floats, "N_lambda"]
    least: Annotated[Floats, "3"]
    reshaped_areas: Interpolant | None = (
        None  # areas if they change with the shape of the bodies; None otherwise
    )

    def __post_init__(self) -> None:
        """Refuse an invalid error."""
        if not (
            is_number(self.inexact) and 0 <= self.inexact < 1 and isinstance(self.proved, bool)
        ):
            raise BoundError(
                f"inexact = {self.inexact!r} of a bound must be a part of energies, proved = "
                f"{self.proved!r}"
            )

    @property
    def kind(self) -> str:
        """A bound, or an estimate if the interpolation is not proved."""
        return "bound" if self.proved else "estimate"

    @cached_property
    def _scale(self) -> ForceScale:
        """Scales of contact forces in the middle of the box."""
        return ForceScale(self.areas, self.least)

    def scale_at(self, points: np.ndarray) -> ForceScale:
        """Scales of contact forces at some points, (n, P)."""
        if self.reshaped_areas is None:
            return self._scale
        areas = self.reshaped_areas.many_along_modes(points) @ self.reshaped_areas.modes.T
        return ForceScale(areas, self.least)

    @property
    def free_slack(self) -> np.ndarray:
        """Slack without contact forces in the middle of the box, (m,)."""
        return self.compliances(self.middle).free_slack

    @property
    def schur(self) -> np.ndarray:
        """S in the middle of the box."""
        return self.compliances(self.middle).schur

    def prepared(self, inside: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See :class:`Bound`: indices of the conditions inside and outside; S is not known yet."""
        return inside, np.setdiff1d(np.arange(self.areas.size), inside, assume_unique=True)

    def at(self, points: np.ndarray, theta: Thetas) -> VaryingThere:
        """See :class:`Bound`.

        Args:
            points: parameters, (n, P).
            theta: θ of each point, (n, 1 + T); not used, since S depends on the point.

        Raises:
            ConvergenceError: if the interpolated S is not definite.
        """
        contacts = self.compliances.many(points)
        try:
            response = self._least.at(contacts)
        except LinAlgError:
            raise ConvergenceError(
                f"S, interpolated between parameters, is not definite at {points.tolist()}: build "
                "the model without a bound, Recipe(bound=False), or condense(..., bound=False)"
            ) from None
        return VaryingThere(self, contacts, response)

    @property
    def together(self) -> int:
        """See :class:`Bound`."""
        return self.compliances.together

    @cached_property
    def _least(self) -> LeastResponse:
        """Lower bounds of S."""
        return LeastResponse(self.compliances, self.middle)

    def slack_of(self, unknown: np.ndarray, points: np.ndarray, theta: np.ndarray) -> np.ndarray:
        """Slack of fields V γ, (n, m).

        Args:
            unknown: γ, (n, ell).
            points: parameters, (n, P).
            theta: θ, (n, 1 + T).
        """
        if isinstance(self.whole, ReducedProblem):
            return theta @ self.whole.gaps.T - unknown @ self.whole.contact_trial.T
        problems = map(self.whole, points)
        return np.array(
            [
                problem.gaps @ theta_of_point - problem.contact_trial @ gamma
                for problem, theta_of_point, gamma in zip(problems, theta, unknown, strict=True)
            ]
        )

    @cached_property
    def _blocks(self) -> list[ModeBlock]:
        """Modes that share entries of V^T K V: those of one body."""
        assert isinstance(self.whole, ReducedProblem)
        return blocks_of(self.whole)

    def fields(
        self, unknown: np.ndarray, points: np.ndarray, theta: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Energies, work of loads and contact motions of fields V γ.

        Args:
            unknown: γ, (n, ell).
            points: parameters, (n, P).
            theta: θ, (n, 1 + T).

        Returns:
            γ^T V^T K V γ, (n,), γ^T V^T loads θ, (n,), and B V γ, (n, m).
        """
        projected = self.whole
        if not isinstance(projected, ReducedProblem):
            problems = zip(map(projected, points), unknown, theta, strict=True)
            products = [
                (
                    u @ problem.stiffness @ u,
                    u @ problem.loads @ theta_of_point,
                    problem.contact_trial @ u,
                )
                for problem, u, theta_of_point in problems
            ]
            rows = zip(*products, strict=True)
            return tuple(np.array(values) for values in rows)  # type: ignore[return-value]
        assert projected.terms is not None
        weights = many_weights(projected.terms.moduli, points)
        energies = np.zeros(len(points))
        for block in self._blocks:
            theta_of_point = unknown[:, block.modes]
            for index, entries in zip(block.parts, block.entries, strict=True):
                energies += weights[:, index] * np.sum(
                    theta_of_point @ entries.reshape(len(block.modes), -1) * theta_of_point, axis=1
                )
        pulled = np.sum(theta @ projected.terms.forces.T * unknown, axis=1)
        for weight, lifts in zip(weights.T, projected.terms.lifts, strict=True):
            pulled -= weight * np.sum(theta @ lifts.T * unknown, axis=1)
        return energies, pulled, unknown @ projected.contact_trial.T


class _Energies(NamedTuple):
    """Energies of fields in equilibrium, (n,) each."""

    homogeneous: np.ndarray  #: of the part that vanishes on imposed dofs, f^T K^-1 f
    size: np.ndarray  #: of the whole field, including the lift
    scale: np.ndarray  #: of the sums of their terms, which determines round-off


class VaryingThere(NamedTuple):
    """See :class:`hhr_dolfinx.models.bound.BoundThere`."""

    owner: VaryingBound  #: the interpolated arrays
    found: ManyContacts  #: S and the free slack at each point
    response: ManyResponses  #: S with its lower bounds

    def slack(self, forces: np.ndarray) -> np.ndarray:
        """See :class:`BoundThere`."""
        return self.found.free_slack + self.response.schur_times(forces)

    def completed(self, own: np.ndarray, outside: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
        """See :class:`BoundThere`.

        Args:
            own: forces on the conditions inside, (n, k).
            outside: indices of the conditions inside and outside, see
                :meth:`VaryingBound.prepared`.
        """
        free = self.found.free_slack[:, None]
        return np.concatenate(
            [
                self.response[k].outside(*outside).completed(own[k, None], free[k])
                for k in range(len(own))
            ]
        )

    def force_changes(
        self,
        forces: np.ndarray,
        outside: tuple[np.ndarray, np.ndarray],
        gradient: Gradient,
        changes: np.ndarray,
    ) -> np.ndarray:
        """See :class:`BoundThere`.

        Args:
            forces: completed forces, (m,).
            outside: indices of the conditions inside and outside.
            gradient: derivatives of the forces inside.
            changes: derivatives of θ, (1 + T, P); not used, since S depends on the point.
        """
        fixed, _ = self.found[0].at_fixed_forces(forces, np.zeros(0))
        return self.response[0].outside(*outside).changes(forces, gradient.multipliers, fixed)

    def of(
        self, unknown: np.ndarray, forces: np.ndarray, slack: Callable[[], np.ndarray]
    ) -> Estimates:
        """See :class:`BoundThere`, for forces >= 0.

        The proof holds for any forces. Those of the contact problem on S are the exact ones up to
        round-off and the error of S, δ in the S norm: errors are differences from them. A remaining
        error e has |e| <= |L^-1| δ and
        |e_i| <= (S^-1)_ii^1/2 δ.

        Args:
            unknown: γ, (n, ell).
            forces: returned contact forces, (n, m).
            slack: returns the slack of the fields V γ, (n, m).
        """
        response = self.response
        inexact = self.owner.inexact
        scale = self.owner.scale_at(self.found.points)
        product = response.schur_times(forces)
        better, less, nearer = response.settled(forces, self.found.free_slack, product)
        off = forces - better
        unbalanced, size, balanced = self._norms(unknown, better)
        # one product for many rows: each call has an overhead
        vectors = np.array((forces, better, off, off, better))
        images = np.array((product, less, product - less, off, better))
        sizes, exact, apart, apart_euclid, exact_euclid = lengths(vectors, images)
        noise = max(inexact, BOUND_ROUND_OFF) * (sizes + exact + balanced)
        primal = unbalanced + nearer
        if (rows := np.flatnonzero(nearer > UNIMPROVED_FORCES * unbalanced)).size:
            alone = unbalanced[rows]
            residuals = response.off(slack()[rows], better[rows], rows)
            primal[rows] = np.minimum(
                primal[rows], (alone + np.sqrt(alone**2 + 4 * nearer[rows] * residuals)) / 2
            )
        # S and its inverse are accurate to a factor of 1 + ε or 1 - ε
        wider = 1 + 2 * inexact
        longest, most = response.amplified
        amplified = np.array((np.ones_like(longest), longest, (most * scale.per_area).max(axis=-1)))
        further = amplified * ((nearer + noise) * wider**2)
        pressures = scale.peak(np.array((np.abs(off), better)))
        errors = further + np.array((apart * wider, apart_euclid, pressures[0]))
        least = np.maximum(
            np.array((exact / wider, exact_euclid, pressures[1])) - further, scale.least[:, None]
        )
        primal = (primal + BOUND_ROUND_OFF * size + noise) * wider
        return estimates_of(
            self.owner.kind, np.array((primal, *errors)), np.array((size - primal, *least))
        )

    def _norms(
        self, unknown: np.ndarray, forces: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Energy norms of the errors of fields V γ, and of fields in equilibrium, (n,) each.

        Errors are differences from the fields in equilibrium with forces. The norms of these are
        those with and without the lift.
        """
        energies_of_fields, loaded, pressed = self.owner.fields(
            unknown, self.found.points, self.found.theta
        )
        pulled = loaded - np.sum(forces * pressed, axis=1)
        energies = self._energies(forces)
        noise = self.owner.inexact * energies.homogeneous + OF_ENERGY * (
            energies_of_fields + 2 * np.abs(pulled) + energies.scale
        )
        remaining = np.maximum(energies_of_fields - 2 * pulled + energies.homogeneous, 0.0) + noise
        return np.sqrt(remaining), np.sqrt(energies.size), np.sqrt(energies.homogeneous)

    def _energies(self, forces: np.ndarray) -> _Energies:
        """Energies of the fields in equilibrium with forces, (n, m)."""
        contacts = self.found
        driven, held, lifted = np.zeros((3, len(forces)))
        for energy, component, along, sizes in zip(
            self.owner.energies,
            contacts.owner.parts,
            contacts.along,
            contacts.compliances,
            strict=True,
        ):
            # the force of a lift L is -K L, and K scales inversely to K^-1
            roots = np.sqrt(sizes)[:, None]
            weights = contacts.theta[:, component.terms]
            lifts = np.arange(weights.shape[1]) >= component.forced.size
            weights = np.where(lifts, -weights / roots, weights * roots)
            # of hundreds of columns of a partial pressure three act: indices of these, padded to
            # the same number
            count = int(np.count_nonzero(weights, axis=1).max(initial=0))
            used = np.argsort(weights == 0, axis=1, kind="stable")[:, :count]
            acting = np.take_along_axis(weights, used, 1)
            # mode by mode, to limit memory
            pairs = used[:, :, None], used[:, None, :]
            work = sum(
                share[:, None, None] * mode[pairs]
                for share, mode in zip(along.T, energy.work, strict=True)
            )
            done = np.einsum("nst,nt->ns", work, acting)
            driven += np.sum(acting * done, axis=1)
            held -= np.sum(acting * lifts[used] * done, axis=1)
            if component.lifted.size:
                lifting = contacts.theta[:, component.lifted]
                lift_work = np.einsum(
                    "nr,tmr,nm->nt",
                    along,
                    component.columns[component.forced.size :],
                    forces[:, component.where],
                )
                held -= np.sum(lifting * lift_work, axis=1)
                lift_weights = weights[:, lifts]
                lifted += np.einsum(
                    "ns,nr,rst,nt->n",
                    lift_weights,
                    along,
                    energy.lifted,
                    lift_weights,
                    optimize=True,
                )
        closed = contacts.owner.many_driven(contacts.points, contacts.theta) - contacts.free_slack
        pulled = np.sum(closed * forces, axis=1)
        work_of_forces = np.sum(self.response.schur_times(forces) * forces, axis=1)
        homogeneous = np.maximum(driven - 2 * pulled + work_of_forces, 0.0)
        return _Energies(
            homogeneous,
            np.maximum(homogeneous + 2 * held + lifted, 0.0),
            driven + 2 * np.abs(pulled) + work_of_forces,
        )
