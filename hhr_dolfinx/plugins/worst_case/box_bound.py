"""Upper bounds of affine functions of forces over a box of parameters.

Solutions at the corners v of a box, interpolated, λ̂ = sum_v α_v λ_v and ŝ = sum_v α_v s_v, satisfy
all of the contact problem but complementarity. Since (λ - λ̂)^T (s - ŝ) <= λ̂^T ŝ, the true forces
are no farther from λ̂ than

    |λ - λ̂|_M <= (λ̂^T ŝ)^(1/2) = (sum_vw α_v α_w λ_v^T s_w)^(1/2),

which vanishes where statuses do not change. M is S without the conditions that are surely closed or
surely open all over the box: what happens at the edge of a contact is felt at its middle no more
than it acts there. Motions of bodies that contact alone holds are eliminated as soon as sure
conditions hold them; before, they are unbounded, and the distance of the forces is the same.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from hhr_dolfinx.plugins.worst_case.affine import AffineContact, Candidates

SHORTEST = 2.0**-40
"""Least length of a side that is divided: there is no double precision for much less."""
NEGLIGIBLE = 1e-9
"""Largest products of corners that differ in one side, over all products, that say nothing of the
parameter to divide.
"""
TINY = 1e-13
"""Slack of closed conditions, relative to its terms, that is round-off and counts as lacking: the
root of its product with the force would be 1e-8 of the value.
"""
PASSES = 3
"""Most rounds in which conditions that turn out to be sure sharpen the bound of the others: later
ones changed nothing in the cases tried.
"""


@dataclass(frozen=True, eq=False)
class Box:
    """Part of the unit cube; sides of length zero are those of faces.

    Attributes:
        lower: (P,).
        upper: (P,).
        closed: conditions that are surely closed in it, (m,) bool.
        open: conditions that are surely open in it, (m,) bool.
    """

    lower: np.ndarray
    upper: np.ndarray
    closed: np.ndarray
    open: np.ndarray

    @cached_property
    def sides(self) -> np.ndarray:
        """Numbers of the parameters along which it has a length, (d,)."""
        return np.flatnonzero(self.upper > self.lower)

    @property
    def divisible(self) -> np.ndarray:
        """Whether each side is long enough to be divided, (P,) bool."""
        return self.upper - self.lower > SHORTEST

    @cached_property
    def corners(self) -> np.ndarray:
        """Its corners, (2^d, P), the last side fastest."""
        ends = [
            (low,) if low == high else (low, high)
            for low, high in zip(self.lower, self.upper, strict=True)
        ]
        return np.array(list(itertools.product(*ends)))

    def halves(self, axis: int) -> tuple[Box, Box]:
        """Two boxes, divided in the middle along an axis."""
        lower = self.lower.copy()
        upper = self.upper.copy()
        lower[axis] = upper[axis] = 0.5 * (self.lower[axis] + self.upper[axis])
        return (
            Box(self.lower, upper, self.closed, self.open),
            Box(lower, self.upper, self.closed, self.open),
        )

    def face(self, signs: np.ndarray) -> Box:
        """The face where rising parameters are at their upper ends and falling ones at the lower.

        Args:
            signs: 1 rising, -1 falling, 0 neither, (P,).
        """
        lower = np.where(signs > 0, self.upper, self.lower)
        upper = np.where(signs < 0, self.lower, self.upper)
        return Box(lower, upper, self.closed, self.open)

    def settled(self, closed: np.ndarray, opened: np.ndarray) -> Box:
        """The box with further conditions that are sure.

        Args:
            closed: conditions that are closed, numbers.
            opened: conditions that are open, numbers.
        """
        both = self.closed.copy(), self.open.copy()
        for known, which in zip(both, (closed, opened), strict=True):
            known[which] = True
        return Box(self.lower, self.upper, *both)


@dataclass(frozen=True, eq=False)
class BoxBound:
    """What is known of candidates over a box.

    Attributes:
        box: the box, with all conditions that are sure now.
        upper: upper bounds of the candidates, (K,).
        slopes: ends of their derivatives along the parameters, (2, K, P).
        axis: parameter along which statuses change most, to divide.
    """

    box: Box
    upper: np.ndarray
    slopes: np.ndarray
    axis: int


def bounded(
    contact: AffineContact, outputs: Candidates, chosen: np.ndarray, box: Box, solutions: np.ndarray
) -> BoxBound:
    """Bounds of some candidates over a box.

    Args:
        contact: the contact problem.
        outputs: the candidates.
        chosen: numbers of those requested, (k,).
        box: the box.
        solutions: forces and motions at its corners, (m + r, 2^d).

    Returns:
        Bounds of the chosen candidates, in their order.
    """
    reduced = Remaining.of(contact, box, solutions)
    for _ in range(PASSES):
        closed, opened = reduced.sure
        if not (closed.any() or opened.any()):
            break
        box = box.settled(reduced.unsure[closed], reduced.unsure[opened])
        reduced = Remaining.of(contact, box, solutions)
    return reduced.bound(outputs, chosen)


@dataclass(frozen=True, eq=False)
class Remaining:
    """The conditions of a box that are not sure, the others eliminated.

    Attributes:
        box: the box.
        eliminated: numbers of the closed conditions and of the motions m + k, (c,); none of them
            as long as they do not hold all bodies.
        unsure: numbers of the conditions that may change, (u,).
        onto: forces and motions of the eliminated ones by [1, t, λ_U], (c, 1 + P + u).
        schur: M, (u, u).
        free: slack of the unsure ones without their forces, [q_0, Q], (u, 1 + P).
        forces: λ_v of the unsure ones, (u, 2^d).
        lifted: part of the slack by motions that are not eliminated, (u, 2^d).
        loose: whether there are such motions.
    """

    box: Box
    eliminated: np.ndarray
    unsure: np.ndarray
    onto: np.ndarray
    schur: np.ndarray
    free: np.ndarray
    forces: np.ndarray
    lifted: np.ndarray
    loose: bool

    @classmethod
    def of(cls, contact: AffineContact, box: Box, solutions: np.ndarray) -> Remaining:
        """Eliminate what is sure in a box.

        Args:
            contact: the contact problem.
            box: the box.
            solutions: forces and motions at its corners, (m + r, 2^d).
        """
        m, count = contact.motions.shape
        sure = np.flatnonzero(box.closed)
        loose = count > 0 and not contact.held_by(sure)
        unsure = np.flatnonzero(~box.open if loose else ~(box.closed | box.open))
        gone = np.zeros(0, dtype=int) if loose else np.concatenate([sure, m + np.arange(count)])
        inner = contact.whole[np.ix_(gone, gone)]
        within = contact.whole[np.ix_(gone, unsure)]
        onto = np.column_stack([contact.terms[gone], within])
        if gone.size:
            onto = -_solved(inner, onto, definite=not count)
        columns = contact.terms.shape[1]
        back = contact.whole[np.ix_(unsure, gone)]
        schur = contact.schur[np.ix_(unsure, unsure)] + back @ onto[:, columns:]
        slack = contact.terms[unsure] + back @ onto[:, :columns]
        lifted = -contact.motions[unsure] @ solutions[m:] if loose else 0.0
        known = np.maximum(solutions[unsure], 0.0)
        return cls(
            box,
            gone,
            unsure,
            onto,
            0.5 * (schur + schur.T),
            slack,
            known,
            np.broadcast_to(lifted, known.shape),
            loose,
        )

    @cached_property
    def inverse(self) -> np.ndarray:
        """M^-1, (u, u)."""
        identity = np.eye(len(self.unsure))
        return identity if not len(identity) else cho_solve(cho_factor(self.schur), identity)

    @cached_property
    def at_corners(self) -> np.ndarray:
        """[1, t] of each corner, (1 + P, 2^d)."""
        corners = self.box.corners
        return np.vstack([np.ones(len(corners)), corners.T])

    @cached_property
    def slack(self) -> np.ndarray:
        """Slack at the corners by these forces, (u, 2^d), negative by round-off."""
        return self.free @ self.at_corners + self.schur @ self.forces + self.lifted

    @cached_property
    def products(self) -> np.ndarray:
        """λ_v^T s_w of all pairs of corners, (2^d, 2^d)."""
        return self.forces.T @ (self.slack - self.lack)

    @cached_property
    def lack(self) -> np.ndarray:
        """Slack that is negative or no more than round-off, else zero, (u, 2^d).

        The distance holds for any part of the slack, as long as the rest is not negative.
        """
        terms = np.abs(self.free) @ np.abs(self.at_corners) + np.abs(self.schur) @ self.forces
        return np.where(self.slack <= TINY * terms, self.slack, 0.0)

    @cached_property
    def along(self) -> np.ndarray:
        """Largest mean of the products of corners that differ in some sides, by these, (2,) * d.

        They are Bernstein's coefficients of λ̂^T ŝ, a square in each parameter.
        """
        sides = len(self.box.sides)
        numbers = np.arange(2**sides)
        means = np.empty((2,) * sides)
        for differing in itertools.product((0, 1), repeat=sides):
            mask = sum(bit << (sides - 1 - k) for k, bit in enumerate(differing))
            pairs = self.products[numbers, numbers ^ mask].reshape((2,) * sides)
            over = tuple(k for k, bit in enumerate(differing) if bit)
            means[differing] = pairs.mean(axis=over).max()
        return means

    @cached_property
    def distance(self) -> float:
        """Bound of |λ - λ̂|_M over the box.

        With p_k = 2 x_k (1 - x_k) <= 1/2, λ̂^T ŝ is at most affine in each p_k: its maximum is
        where these are 0 or 1/2. Slacks of round-off have a residual of their own.
        """
        means = self.along
        for axis in range(means.ndim):
            first, second = np.split(means, 2, axis=axis)
            means = np.concatenate([first, 0.5 * (first + second)], axis=axis)
        lack = self.lack
        residual = np.sqrt(np.einsum("uc,uv,vc->c", lack, self.inverse, lack, optimize=True))
        half = 0.5 * float(residual.max(initial=0.0))
        return half + float(np.sqrt(half**2 + max(means.max(), 0.0)))

    @cached_property
    def sure(self) -> tuple[np.ndarray, np.ndarray]:
        """Conditions that are surely closed and surely open in the whole box, (u,) bool each."""
        of_force = np.sqrt(np.diag(self.inverse)) * self.distance
        of_slack = np.sqrt(np.diag(self.schur)) * self.distance
        closed = self.forces.min(axis=1, initial=np.inf) > of_force
        closed &= ~self.box.closed[self.unsure]
        if self.loose:
            return closed, np.zeros_like(closed)
        opened = self.slack.min(axis=1, initial=np.inf) > of_slack
        return closed & ~opened, opened & ~closed

    def bound(self, outputs: Candidates, chosen: np.ndarray) -> BoxBound:
        """Bounds of the chosen candidates, (k,).

        Slopes are those of the projection of M^-1 Q onto the conditions that are closed, whichever
        these are: it lies on the sphere with the diameter from 0 to M^-1 Q.
        """
        columns = self.free.shape[1]
        own = np.column_stack([outputs.constant[chosen], outputs.slopes[chosen]])
        passed = outputs.weights[np.ix_(chosen, self.eliminated)]
        base = own + passed @ self.onto[:, :columns]
        weights = outputs.weights[np.ix_(chosen, self.unsure)] + passed @ self.onto[:, columns:]
        spread = weights @ self.inverse
        norms = np.sqrt(np.einsum("ku,ku->k", spread, weights).clip(0))
        values = base @ self.at_corners + weights @ self.forces
        full = -self.inverse @ self.free[:, 1:]
        reach = np.sqrt(np.einsum("up,up->p", full, self.schur @ full).clip(0))
        centre = base[:, 1:] + 0.5 * weights @ full
        radius = 0.5 * norms[:, None] * reach
        slopes = np.stack([centre - radius, centre + radius])
        upper = values.max(axis=1) + norms * self.distance
        if self.loose:
            endless = np.full(centre.shape, np.inf)
            slopes = np.stack([-endless, endless])
            moving = outputs.weights[chosen, len(self.box.closed) :].any(axis=1)
            upper = np.where(moving, np.inf, upper)
        return BoxBound(self.box, upper, slopes, self._axis())

    def _axis(self) -> int:
        """The parameter along which the products of corners are largest.

        If corners differ in several sides wherever their products are not zero, the longest side:
        any rule that names the same parameter again and again may never end.
        """
        sides = self.box.sides
        lengths = self.box.upper - self.box.lower
        alone = np.zeros(lengths.size)
        alone[sides] = [self.along[tuple(one)] for one in np.eye(len(sides), dtype=int)]
        alone[~self.box.divisible] = 0.0
        if alone.max(initial=0.0) > NEGLIGIBLE * self.along.max():
            return int(alone.argmax())
        return int(lengths.argmax()) if sides.size else 0


def _solved(inner: np.ndarray, right: np.ndarray, *, definite: bool) -> np.ndarray:
    """Solution of a block of the whole problem; motions make it indefinite."""
    return cho_solve(cho_factor(inner), right) if definite else np.linalg.solve(inner, right)
