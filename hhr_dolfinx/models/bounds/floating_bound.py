"""Bounds of errors of bodies that nothing but contact holds.

Let R be their rigid motions, on which K is singular, and G = B R. Forces that balance the loads, G^T λ = driving, leave
nothing on the dofs that are pinned for the factors, so that S = B K^-1 B^T and the field -K^-1 B^T λ of the pinned
bodies are right up to a motion R q. Any balanced forces λ >= 0 have a slack s = free + S λ - G q for each q, and

    e = λ - Λ,   G^T e = 0,   |e|_S^2 = e·(s - σ) <= e·r <= |e|_S min_a |r - G a|_{S^-1},

with r as in :mod:`hhr_dolfinx.models.bounds.error_bound`. e·G vanishes, whatever the motions are, and S is definite on
differences of balanced forces. There S + G M G^T is the same for any M, and it is definite everywhere: with its factor
L the minimum is what L^-1 r has across L^-1 G. λ and q are those of the small contact problem on S from the statuses of
the answer, so that r is round-off, and forces λ^ that are handed out are off by |λ^ - λ|_S more at most.

Of the displacement the energy is bounded, which knows no rigid motion: K^-1 loads are exact, and forces make the rest,
see :mod:`hhr_dolfinx.models.bounds.contact_response`. How far a body is moved as a whole is not bounded.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any, NamedTuple

import numpy as np
from scipy.linalg import solve_triangular

from hhr_dolfinx.contact.active_set import Status
from hhr_dolfinx.contact.floating import FloatingEqualities, floating_set
from hhr_dolfinx.declared import Floats
from hhr_dolfinx.models.bounds.contact_response import ContactResponse, Outside
from hhr_dolfinx.models.bounds.error_bound import ROUND_OFF, Bounded, FieldResponse, ForceScale, factor_faults
from hhr_dolfinx.models.estimates import Estimates
from hhr_dolfinx.models.gradient import Gradient
from hhr_dolfinx.plain import Rebuilt


def definite(schur: np.ndarray, taken: np.ndarray) -> np.ndarray:
    """S + G M G^T, (m, m): motions count as much as a force on one condition, where they move the conditions most.

    Args:
        schur: S, (m, m).
        taken: G, (m, r), no column of which is zero.
    """
    scale = schur.diagonal().mean() / np.abs(taken).max(axis=0) ** 2
    return schur + (taken * scale) @ taken.T


class Balanced(NamedTuple):
    """Forces that balance the loads, (m,), the motions with them, (r,), and how far the forces are off at most."""

    forces: np.ndarray
    motions: np.ndarray
    off: float


@dataclass(frozen=True)
class FloatingBound(Rebuilt):
    """Arrays of the bounds where the stiffness is constant (m conditions, 1 + T terms, r motions).

    Attributes:
        free_slack: gaps - B K^-1 loads, (m, 1 + T).
        schur: S of the pinned bodies, (m, m).
        lower: Cholesky factor of S + G M G^T, (m, m).
        taken: G, (m, r).
        driving: loads along the motions, (r, 1 + T).
        basis: what the columns C of the displacement keep of forces, orthonormal after L, (m, c); no columns for all.
        work: energies of the displacement of loads and lifts, (1 + T, 1 + T).
        cross: products of these with K^-1 B^T in energy, (1 + T, m).
        areas, least: see :class:`~models.bounds.error_bound.ForceScale`.
    """

    free_slack: Annotated[Floats, "N_lambda", "terms"]
    schur: Annotated[Floats, "N_lambda", "N_lambda"]
    lower: Annotated[Floats, "N_lambda", "N_lambda"]
    taken: Annotated[Floats, "N_lambda", "motions"]
    driving: Annotated[Floats, "motions", "terms"]
    basis: Annotated[Floats, "N_lambda", "kept columns"]
    work: Annotated[Floats, "terms", "terms"]
    cross: Annotated[Floats, "terms", "N_lambda"]
    areas: Annotated[Floats, "N_lambda"]
    least: Annotated[Floats, "3"]

    together = 1

    def faults(self, sizes: Mapping[str, int]) -> Iterator[str]:
        """A wrong factor of S, and motions that move no condition."""
        if not self.taken.any(axis=0).all():
            yield "a motion of its bound moves no condition"
        else:
            yield from factor_faults(self, definite(self.schur, self.taken))

    @property
    def kind(self) -> str:
        """It is proved."""
        return "bound"

    @cached_property
    def equalities(self) -> FloatingEqualities:
        """On S with the motions."""
        return FloatingEqualities(self.schur, self.taken)

    @cached_property
    def scale(self) -> ForceScale:
        """What forces are measured by."""
        return ForceScale(self.areas, self.least)

    @cached_property
    def amplified(self) -> np.ndarray:
        """See :meth:`~models.bounds.error_bound.ForceScale.amplified`: balanced forces are as long after L."""
        return self.scale.amplified(ContactResponse(self.schur, self.lower))

    @cached_property
    def along(self) -> np.ndarray:
        """Orthonormal directions of L^-1 G, (m, r)."""
        return np.linalg.qr(solve_triangular(self.lower, self.taken, lower=True))[0]

    def prepared(self, inside: np.ndarray) -> Outside:
        """See :class:`~models.bounds.error_bound.Bound`; all conditions that hold bodies are inside."""
        return ContactResponse(self.schur, self.lower).outside(inside)

    def at(self, points: np.ndarray, theta: Any) -> FloatingThere:
        """See :class:`~models.bounds.error_bound.Bound`; of one answer."""
        return FloatingThere(self, theta, self.free_slack @ theta, self.driving @ theta)

    def off(self, slack: np.ndarray, forces: np.ndarray) -> float:
        """How far balanced forces, (m,), are off at most, by their slack, (m,)."""
        left = np.where((forces > 0) | (slack < 0), slack, 0.0)
        found = solve_triangular(self.lower, left, lower=True)
        return float(np.linalg.norm(found - self.along @ (self.along.T @ found)))

    @cached_property
    def balancing(self) -> np.ndarray:
        """Orthonormal directions of G, (m, r)."""
        return np.linalg.qr(self.taken)[0]

    def pressed(self, forces: np.ndarray) -> float:
        """S norm of the part of forces, (m,), that balances itself: of the rest it would depend on the pins."""
        return self.size(forces - self.balancing @ (self.balancing.T @ forces))

    def size(self, forces: np.ndarray) -> float:
        """S norm of forces, (m,)."""
        return math.sqrt(max(float(forces @ (self.schur @ forces)), 0.0))


class FloatingThere(NamedTuple):
    """See :class:`~models.bounds.error_bound.BoundThere`; of one answer.

    Attributes:
        owner: the arrays.
        theta: θ.
        free: slack without forces and motions, (m,).
        driving: loads along the motions, (r,).
    """

    owner: FloatingBound
    theta: Any
    free: np.ndarray
    driving: np.ndarray

    def slack(self, forces: np.ndarray) -> np.ndarray:
        """Slack of the fields of pinned bodies in equilibrium with forces, (1, m) each."""
        return self.free + forces @ self.owner.schur

    def _motions(self, opened: np.ndarray, touching: np.ndarray) -> np.ndarray:
        """Motions that close the gaps, (r,), as well as they can."""
        return np.linalg.lstsq(self.owner.taken[touching], opened[touching], rcond=None)[0]

    def completed(self, own: np.ndarray, outside: Outside) -> np.ndarray:
        """See :class:`~models.bounds.error_bound.BoundThere`; no motion opens the gaps outside."""
        return outside.completed(own, self.free[None])

    def force_changes(
        self, forces: np.ndarray, outside: Outside, gradient: Gradient, changes: np.ndarray
    ) -> np.ndarray:
        """See :class:`~models.bounds.error_bound.BoundThere`."""
        return outside.changes(forces, gradient.multipliers, self.owner.free_slack @ changes)

    def balanced(self, forces: np.ndarray) -> Balanced:
        """Forces of the contact problem on S from the statuses of given ones, (m,); infinitely off without any."""
        owner = self.owner
        touching = forces > 0
        found, motions = floating_set(owner.equalities, self.free, self.driving, touching)
        better = np.maximum(found.forces, 0.0)
        if found.status is not Status.CONVERGED or not owner.equalities.balanced(better, self.driving).all():
            return Balanced(forces, self._motions(self.free + owner.schur @ forces, touching), math.inf)
        slack = self.free + owner.schur @ better - owner.taken @ motions
        return Balanced(better, motions, owner.off(slack, better))

    def of(self, unknown: np.ndarray, forces: np.ndarray, slack: Callable[[], np.ndarray]) -> Estimates:
        """See :class:`~models.bounds.error_bound.BoundThere`; of the fields that loads and these forces make."""
        owner = self.owner
        better, _, off = self.balanced(forces[0])
        away = forces[0] - better
        lost = 0.0
        if owner.basis.shape[1]:
            pressed = better @ owner.lower
            lost = float(np.linalg.norm(pressed - owner.basis @ (owner.basis.T @ pressed)))
        loaded = _dot(self.theta, owner.work @ self.theta)
        exact = owner.size(better)
        energy = loaded - 2 * float((owner.cross.T @ self.theta) @ better) + exact**2
        noise = ROUND_OFF * (owner.size(forces[0]) + exact + math.sqrt(max(loaded, 0.0)))
        primal = off + lost + noise
        further = owner.amplified * (off + noise)
        apart = np.array((owner.size(away), np.linalg.norm(away), owner.scale.peak(np.abs(away))))
        found = np.array((owner.pressed(better), np.linalg.norm(better), owner.scale.peak(better)))
        least = np.maximum(found - further, owner.least)
        field = math.sqrt(max(energy, 0.0)) - lost - primal
        errors = np.array((primal, *(further + apart)))[:, None]
        return Bounded("bound", errors, np.array((field, *least))[:, None]).estimates()


def _dot(theta: Any, values: np.ndarray) -> float:
    """θ times values of all terms, (1 + T,)."""
    return float(values[theta.terms] @ theta.values)


@dataclass(frozen=True, eq=False)
class FloatingResponse(FieldResponse):
    """The same where the last columns are the rigid motions R, whose coordinates are how far these are moved."""

    def coordinates(self, there: Any, forces: np.ndarray) -> np.ndarray:
        """See :class:`FieldResponse`."""
        found = there.balanced(forces)
        return np.concatenate([self._pressed(found.forces), found.motions])

    def changes(self, there: Any, forces: np.ndarray, of_forces: Any, of_theta: np.ndarray) -> np.ndarray:
        """See :class:`FieldResponse`."""
        owner = there.owner
        found = there.balanced(forces)
        given = owner.free_slack @ of_theta, owner.driving @ of_theta
        pressing, _, motions = owner.equalities.several(found.forces > 0, *given)
        return np.vstack([self._pressed(pressing), motions])
