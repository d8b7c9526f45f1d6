"""Bounds of errors where the stiffness or the shape depends on parameters: what they need is interpolated.

With f = loads θ - B^T λ the field in equilibrium with forces λ is K^-1 f, and what bounds need of it has the size of
the contact surface: S, the slack, and its energy f^T K^-1 f. All are blocks of one matrix P^T K^-1 P, P = (loads, B^T),
which condensation interpolates between few parameters (:mod:`hhr_dolfinx.models.eliminations.interpolated`). A reduced
field V γ is off by

    |V γ - K^-1 f|_K^2 = γ^T V^T K V γ - 2 γ^T V^T f + f^T K^-1 f,

whose first terms are small matrices. Its root resolves what is above the root of the error of the interpolation.
docs/bounds.md says where that error is proved; elsewhere the estimate is called one.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import numpy as np
from scipy.linalg import LinAlgError, cholesky

from hhr_dolfinx.declared import Floats
from hhr_dolfinx.errors import BoundError, ConvergenceError
from hhr_dolfinx.models.bounds.contact_response import ContactResponse, amplified_by
from hhr_dolfinx.models.bounds.error_bound import ForceScale, Given, bounded
from hhr_dolfinx.models.eliminations.block import Block, blocks_of
from hhr_dolfinx.models.eliminations.elimination import CondensedContact
from hhr_dolfinx.models.eliminations.interpolated import Compliances, InterpolatedStiffness
from hhr_dolfinx.models.eliminations.projected import ReducedProblem
from hhr_dolfinx.models.estimates import Estimates
from hhr_dolfinx.parameters import is_number

if TYPE_CHECKING:
    from hhr_dolfinx.models.eliminations.interpolation import Interpolant
    from hhr_dolfinx.models.eliminations.shaped import InterpolatedProblem
    from hhr_dolfinx.models.gradient import Gradient

ROUND_OFF = 1e-13
"""Part of an energy that is round-off of the sums it is made of."""
FACTORED = 1500
"""Conditions up to which S is factored at each point: with 4761 a bound took 1.8 s so, measured once."""


@dataclass(frozen=True)
class PartEnergy:
    """Energies of one part of a scene for the factor 1, along the modes of its compliance.

    Attributes:
        work: modes of P^T K^-1 P, where P are the terms forced and, behind them, K lift of those lifted, (r, T, T).
        lifted: modes of lift^T K lift, (r, T_L, T_L).
    """

    work: Annotated[Floats, "modes", "terms of it", "terms of it"]
    lifted: Annotated[Floats, "modes", "lifted", "lifted"]


@dataclass(frozen=True)
class VaryingBound:
    """See :class:`hhr_dolfinx.models.bounds.error_bound.Bound` (m conditions, ell modes).

    Attributes:
        compliances: S and the free slack of all conditions.
        energies: of its parts.
        whole: V^T K V, V^T loads and all else of the reduced basis on the whole mesh.
        inexact: relative error of what is interpolated, in the order of energies.
        proved: whether that is more than what was observed.
        middle: of the box, (P,).
        areas, least: see :class:`~hhr_dolfinx.models.bounds.error_bound.ForceScale`; S is that of the middle.
        reshaped_areas: areas where they change with the shape of the bodies; None where they do not.
    """

    compliances: Compliances
    energies: tuple[PartEnergy, ...]
    whole: ReducedProblem | InterpolatedProblem
    inexact: float
    proved: bool
    middle: Annotated[Floats, "P"]
    areas: Annotated[Floats, "N_lambda"]
    least: Annotated[Floats, "3"]
    reshaped_areas: Interpolant | None = None

    def __post_init__(self) -> None:
        """Refuse an impossible error."""
        if not (is_number(self.inexact) and 0 <= self.inexact < 1 and isinstance(self.proved, bool)):
            raise BoundError(
                f"inexact = {self.inexact!r} of a bound must be a part of energies, proved = {self.proved!r}"
            )

    @property
    def kind(self) -> str:
        """A bound, or an estimate where the interpolation is not proved."""
        return "bound" if self.proved else "estimate"

    @cached_property
    def _scale(self) -> ForceScale:
        """What forces are measured by, in the middle of the box."""
        return ForceScale(self.areas, self.least)

    def scale_at(self, point: np.ndarray) -> ForceScale:
        """What forces are measured by at a point."""
        return self._scale if self.reshaped_areas is None else ForceScale(self.reshaped_areas.value(point), self.least)

    @property
    def free_slack(self) -> np.ndarray:
        """Slack without contact forces in the middle of the box, (m,)."""
        return self.compliances(self.middle).free_slack

    @property
    def schur(self) -> np.ndarray:
        """S in the middle of the box."""
        return self.compliances(self.middle).schur

    def prepared(self, inside: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See :class:`Bound`: S is not known yet, but which conditions are inside and outside."""
        return inside, np.setdiff1d(np.arange(self.areas.size), inside, assume_unique=True)

    def at(self, points: np.ndarray, theta: Any) -> VaryingThere:
        """See :class:`Bound`; for one answer."""
        point = points[0]
        stiffness = self.compliances.stiffness(point)
        try:
            response = self._response_at(point, stiffness.schur)
        except LinAlgError:
            raise ConvergenceError(
                f"S, interpolated between parameters, is not definite at {point.tolist()}: build the model without "
                "a bound, Recipe(bound=False), or condense(..., bound=False)"
            ) from None
        contact = self.compliances(point, stiffness)
        return VaryingThere(self, point, stiffness, contact, response)

    def _response_at(self, point: np.ndarray, schur: np.ndarray) -> ContactResponse:
        """S at a point and its factor; of large ones that differ by factors of their parts that of the middle."""
        parts = self.compliances.parts
        if len(schur) <= FACTORED or any(part.interpolant.axes.size for part in parts):
            return ContactResponse(schur, cholesky(schur, lower=True))
        least = min(part.compliance(point) / part.compliance(self.middle) for part in parts)
        lower, amplified = self._of_middle
        return ContactResponse(schur, lower, least, amplified)

    @cached_property
    def _of_middle(self) -> tuple[np.ndarray, tuple[float, np.ndarray]]:
        """Cholesky factor of S in the middle of the box, and what it amplifies."""
        lower = np.asfortranarray(cholesky(self.schur, lower=True))
        return lower, amplified_by(lower)

    def problem_at(self, point: np.ndarray) -> ReducedProblem:
        """The reduced problem of the whole mesh at a point, whose stiffness is constant."""
        if not isinstance(self.whole, ReducedProblem):
            return self.whole(point)
        return self.whole if self.whole.terms is None else self.whole.weighted(self.whole.terms.weights(point))

    @cached_property
    def _blocks(self) -> list[Block]:
        """Modes that share entries of V^T K V: those of one body."""
        assert isinstance(self.whole, ReducedProblem)
        return blocks_of(self.whole)

    def field(self, gamma: np.ndarray, point: np.ndarray, theta: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        """γ^T V^T K V γ, V^T loads θ, (ell,), and B V, (m, ell), at a point; parts of K are not added up."""
        if not isinstance(self.whole, ReducedProblem) or self.whole.terms is None:
            problem = self.problem_at(point)
            return float(gamma @ problem.stiffness @ gamma), problem.loads @ theta, problem.contact_trial
        terms = self.whole.terms
        energy = 0.0
        weights = terms.weights(point)
        for block in self._blocks:
            own = gamma[block.modes]
            parts = (block.entries.reshape(-1, own.size) @ own).reshape(-1, own.size) @ own
            energy += float(weights[block.parts] @ parts)
        loads = terms.forces @ theta - weights @ (terms.lifts @ theta)
        return energy, loads, self.whole.contact_trial


class _Energies(NamedTuple):
    """Energies of a field in equilibrium.

    Attributes:
        moved: of what is free to move, f^T K^-1 f.
        size: of all of it, the lift with it.
        scale: of the sums that make them, of which part is round-off.
    """

    moved: float
    size: float
    scale: float


class VaryingThere(NamedTuple):
    """See :class:`hhr_dolfinx.models.bounds.error_bound.BoundThere`; of one answer.

    Attributes:
        owner: what is interpolated.
        point: the parameter, (P,).
        stiffness: S there, and what it is made of.
        found: S and the free slack there.
        response: S with its factor.
    """

    owner: VaryingBound
    point: np.ndarray
    stiffness: InterpolatedStiffness
    found: CondensedContact
    response: ContactResponse

    def slack(self, forces: np.ndarray) -> np.ndarray:
        """See :class:`BoundThere`."""
        return self.found.free_slack + forces @ self.found.schur

    def completed(self, own: np.ndarray, outside: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
        """See :class:`BoundThere`."""
        return self.response.outside(*outside).completed(own, self.found.free_slack[None])

    def force_changes(
        self, forces: np.ndarray, outside: tuple[np.ndarray, np.ndarray], gradient: Gradient, changes: np.ndarray
    ) -> np.ndarray:
        """See :class:`BoundThere`."""
        fixed, _ = self.found.at_fixed_forces(forces, np.zeros(0))
        return self.response.outside(*outside).changes(forces, gradient.multipliers, fixed)

    def of(self, unknown: np.ndarray, forces: np.ndarray, slack: Callable[[], np.ndarray]) -> Estimates:
        """See :class:`BoundThere`."""
        gamma = unknown[0]
        found = self.found
        inexact = self.owner.inexact
        theta = self.owner.compliances.theta(self.point)
        own, loads, contact = self.owner.field(gamma, self.point, theta)

        def fields(better: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
            pulled = float(gamma @ (loads - better[0] @ contact))
            energies = self._energies(better[0], theta)
            noise = inexact * energies.moved + ROUND_OFF * (own + 2 * abs(pulled) + energies.scale)
            left = max(own - 2 * pulled + energies.moved, 0.0) + noise
            norms = np.sqrt([[left], [energies.size], [energies.moved]])
            return norms[0], norms[1], norms[2]

        given = Given(forces, slack, found.free_slack[None])
        scale = self.owner.scale_at(self.point)
        how = scale, scale.amplified(self.response), self.owner.kind, inexact
        return bounded(given, self.response, fields, *how).estimates()

    def _energies(self, forces: np.ndarray, theta: np.ndarray) -> _Energies:
        """Of the field in equilibrium with forces, (m,)."""
        found = self.found
        driven = 0.0
        held = 0.0
        lifted = 0.0
        for energy, (part, along, compliance) in zip(self.owner.energies, self.stiffness.parts, strict=True):
            count = part.forced.size
            weights = theta[part.terms]
            # of a lift L forces feel -K L, and K is as much larger as K^-1 is smaller
            weights = np.append(weights[:count] * math.sqrt(compliance), -weights[count:] / math.sqrt(compliance))
            used = np.flatnonzero(weights)
            work = np.tensordot(along, energy.work[:, used[:, None], used], 1)
            driven += float(weights[used] @ work @ weights[used])
            if (lifts := used >= count).any():
                pulling = np.where(lifts, -weights[used], 0.0)
                moved = part.columns[part.forced.size :] @ along @ forces[part.where]
                held += float(pulling @ work @ weights[used]) - float(theta[part.lifted] @ moved)
                own = weights[count:]
                lifted += float(own @ np.tensordot(along, energy.lifted, 1) @ own)
        closed = self.owner.compliances.gaps_at(self.point) @ theta - found.free_slack
        pulled = float(closed @ forces)
        pushed = float(forces @ found.schur @ forces)
        moved = max(driven - 2 * pulled + pushed, 0.0)
        return _Energies(moved, max(moved + 2 * held + lifted, 0.0), driven + 2 * abs(pulled) + pushed)
