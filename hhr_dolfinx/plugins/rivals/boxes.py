"""Condensation box by box: contacts that are closed, or open, all over a box leave the search.

Where a surface has thousands of conditions, S is full and condensation is dear; yet in a small box
of parameters only the rim of the contact changes. Of the statuses at the corners of a box,
conditions that are always closed, C, are eliminated as equations, always open ones, O, left out,

    σ_R = s_R + S_RR λ_R,    S_RR <- S_RR - S_RC S_CC^-1 S_CR,    s_R <- s_R - S_RC S_CC^-1 s_C,

and the search runs on the uncertain ones, R. An answer counts if it solves the whole problem:
forces on C are >= 0, and slacks on O. With the weights w >= 0 of its point among the corners and
δ = λ_R - Σ w_k λ_R^k a slack is, since loads and gaps are affine,

    σ_i = Σ w_k σ_i^k + Q_i δ  >=  min_k σ_i^k - |Q_i| |δ|,

so that only those are computed for which this does not say it. Else the full model answers.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from scipy import linalg

from hhr_dolfinx.contact.active_set import Pairs, SchurEqualities, Status, Statuses, active_set
from hhr_dolfinx.errors import NotOfferedError
from hhr_dolfinx.models.answer import Answer, ElasticFields, Meshed, found_as
from hhr_dolfinx.plugins.rivals.projection import RivalModel, check_elastic
from hhr_dolfinx.plugins.studies.study import Rival

if TYPE_CHECKING:
    from hhr_dolfinx.amplitudes import Theta
    from hhr_dolfinx.full_order.full import FullOrderModel
    from hhr_dolfinx.study.training.train import Training

WRONG_PART = 1e-9
"""Pull or overlap of a condition over its own terms beyond which the full model answers."""
MOST_FULL_ANSWERS = 10_000
"""Most corners of all boxes, each of which is a full answer."""
TOUCHED = 1e-12
"""Influence of an uncertain force over the largest one below which a closed condition does not feel
it.
"""


def boxes(training: Training) -> Iterator[Rival]:
    """Condensation in boxes of parameters, each with the conditions that are uncertain there."""
    yield Rival("condensed by boxes", "uncertain ones", partial(_made, training))


def _made(training: Training) -> BoxwiseModel:
    return BoxwiseModel(training.full_order, len(training.snapshots.points))


@dataclass(frozen=True)
class ContactBox:
    """Contact conditions of a box of parameters (r uncertain ones, c closed ones, 2^P corners)."""

    uncertain: np.ndarray  #: numbers of these, (r,)
    closed: np.ndarray  #: numbers of closed ones, (c,)
    equalities: SchurEqualities | None  #: of the uncertain ones; None without any
    slack: np.ndarray  #: their slack without their forces, (r, 1 + T)
    corners: np.ndarray  #: their forces at the corners, (r, 2^P)
    held: np.ndarray  #: forces of closed ones without these, (c, 1 + T)
    touched: np.ndarray  #: places among the closed ones that feel uncertain forces, (t,)
    held_per_force: np.ndarray  #: their change with these, (t, r)
    watched: np.ndarray  #: slacks of open ones that might close, without these, (o, 1 + T)
    watched_per_force: np.ndarray  #: their change with these, (o, r)
    reach: float  #: size of δ up to which no other open one closes
    sizes: tuple[np.ndarray, np.ndarray]  #: terms of closed and of watched ones, (c,) and (o,)
    pairs: Pairs | None  #: contact pairs of the uncertain ones; None without any

    @classmethod
    def of(
        cls,
        schur: np.ndarray,
        slack: np.ndarray,
        statuses: np.ndarray,
        forces: np.ndarray,
        amplitudes: np.ndarray,
        pairs: np.ndarray,
    ) -> ContactBox:
        """ContactBox of answers at its corners.

        Args:
            schur: S of all conditions, (m, m).
            slack: slack without forces, (m, 1 + T), and at the corners, (m, 2^P), side by side.
            statuses: statuses at the corners, (m, 2^P) bool.
            forces: forces at the corners, (m, 2^P).
            amplitudes: of loads and gaps at the corners, (1 + T, 2^P).
            pairs: contact pair of each condition, (m,).
        """
        corners = forces.shape[1]
        terms = slack.shape[1] - corners
        closed = np.flatnonzero(statuses.all(axis=1))
        opened = np.flatnonzero(~statuses.any(axis=1))
        uncertain = np.setdiff1d(np.arange(len(slack)), np.concatenate([closed, opened]))
        count = len(uncertain)
        changed = np.hstack([schur[:, uncertain], slack[:, :terms]])
        if closed.size:
            factor = linalg.cho_factor(schur[np.ix_(closed, closed)])
            eliminated = linalg.cho_solve(factor, changed[closed])
            changed = changed - schur[:, closed] @ eliminated
            changed[closed] = -eliminated
        pushes = changed[closed, :count]
        felt = np.abs(pushes).max(axis=1, initial=0.0)
        touched = np.flatnonzero(felt > TOUCHED * felt.max(initial=0.0))
        own = changed[uncertain, :count]
        # slacks at the corners, of the forces there
        least = (slack[opened, terms:] + schur[opened] @ forces).min(axis=1, initial=np.inf)
        lifts = changed[opened, :count]
        sizes = np.linalg.norm(lifts, axis=1)
        reaches = least / np.where(sizes > 0, sizes, np.inf)
        at = forces[uncertain]
        spread = np.linalg.norm(at[:, :, None] - at[:, None, :], axis=0).max(initial=0.0)
        watched = reaches <= spread
        held = changed[closed, count:]
        limits = changed[opened[watched], count:]
        lifting = lifts[watched]
        terms_of = np.abs(amplitudes)
        sizes = tuple(
            (np.abs(alone) @ terms_of + np.abs(change) @ at).max(axis=1, initial=0.0)
            for alone, change in ((held, pushes), (limits, lifting))
        )
        return cls(
            uncertain,
            closed,
            SchurEqualities.symmetric((own + own.T) / 2) if count else None,
            changed[uncertain, count:],
            at,
            held,
            touched,
            pushes[touched],
            limits,
            lifting,
            float(reaches[~watched].min(initial=np.inf)),
            (sizes[0], sizes[1]),
            Pairs(pairs[uncertain]) if count else None,
        )

    def solved(self, theta: Theta, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray, int, bool]:
        """Forces of closed ones, (c,), and of uncertain ones, (r,), equality problems solved, and
        whether the whole problem is solved.

        Args:
            theta: amplitudes of the point.
            weights: of the corners, (2^P,).
        """
        held = self.held @ theta
        if self.equalities is None:
            return held, np.zeros(0), 0, not _negative(held, self.sizes[0])
        slack = self.slack @ theta
        found = active_set(self.equalities, slack, slack < 0, pairs=self.pairs)
        forces = found.forces
        held[self.touched] += self.held_per_force @ forces
        open_slack = self.watched @ theta + self.watched_per_force @ forces
        right = (
            found.status is Status.CONVERGED
            and not _negative(held, self.sizes[0])
            and not _negative(open_slack, self.sizes[1])
            and float(np.linalg.norm(forces - self.corners @ weights)) < self.reach
        )
        return held, forces, found.iterations, right


def _negative(values: np.ndarray, sizes: np.ndarray) -> bool:
    """True if a value is below zero by more than the round-off of its own terms, (n,) each."""
    return bool((values < -WRONG_PART * sizes).any())


class BoxwiseModel(RivalModel):
    """Exact answers by the uncertain conditions of the box of each point.

    Args:
        full: the full model, on one rank, with a constant stiffness; it answers the corners.
        most: most corners, if there are more than two along each parameter.

    Attributes:
        fallbacks: how many answers the full model gave.

    Raises:
        NotOfferedError: see :func:`~hhr_dolfinx.plugins.rivals.projection.check_elastic`, and for
            loads, gaps or moduli that are not affine in the parameters.
    """

    def __init__(self, full: FullOrderModel, most: int):
        check_elastic(full, "condensation by boxes", one_stiffness=True)
        problem = full.problem
        if problem.amplitudes.nonaffine:
            raise NotOfferedError("boxes are for affine loads and gaps")
        self.parameters = space = full.parameters
        self.fallbacks = 0
        self._full = full
        count = len(space.names)
        self._sides = max(int(most ** (1 / count) + 1e-9) - 1, 1)
        if (self._sides + 1) ** count > MOST_FULL_ANSWERS:
            raise NotOfferedError(f"boxes of {count} parameters have too many corners")
        self._low = np.array(space.lower)
        self._width = (np.array(space.upper) - self._low) / self._sides
        steps = list(itertools.product((0, 1), repeat=count))
        #: 0 or 1 for each corner of a box, (2^P, P)
        self._steps = np.array(steps)
        lines = itertools.product(range(self._sides + 1), repeat=count)
        known = {place: full.solve(self._low + np.array(place) * self._width) for place in lines}
        free = problem.contact @ full.stiffness.columns(problem.loads)
        slack = problem.gaps - free
        ones = np.eye(slack.shape[1])
        self._boxes: dict[tuple[int, ...], ContactBox] = {}
        for place in itertools.product(range(self._sides), repeat=count):
            answers = [known[tuple(np.add(place, step).tolist())] for step in steps]
            thetas = [problem.amplitudes(answer.parameter) for answer in answers]
            self._boxes[place] = ContactBox.of(
                full.schur,
                np.column_stack([slack, *(slack @ theta for theta in thetas)]),
                np.column_stack([answer.active for answer in answers]),
                np.column_stack([answer.forces() for answer in answers]),
                np.column_stack([ones @ theta for theta in thetas]),
                problem.contact_pairs,
            )
        self.fields = BackSubstituted(full)
        self.advice: dict[Status, str] = {}

    @property
    def sizes(self) -> tuple[int, int]:
        """Boxes, and most uncertain conditions of one."""
        return len(self._boxes), max(len(box.uncertain) for box in self._boxes.values())

    def answered(self, point: np.ndarray) -> Answer:
        """See :class:`~hhr_dolfinx.plugins.rivals.projection.RivalModel`."""
        problem = self._full.problem
        place = (point - self._low) / self._width
        first = np.clip(place.astype(int), 0, self._sides - 1)
        inside = place - first
        box = self._boxes[tuple(first.tolist())]
        weights = np.where(self._steps, inside, 1 - inside).prod(axis=1)
        held, uncertain, count, right = box.solved(problem.amplitudes(point), weights)
        forces = np.zeros(len(problem.gaps))
        forces[box.closed] = held
        forces[box.uncertain] = uncertain
        if not right or inside.min() < 0 or inside.max() > 1:
            self.fallbacks += 1
            return self._full.solve(point, start=forces > 0, outside="ignore")
        found = Statuses(forces, forces > 0, count, Status.CONVERGED, False)
        return found_as(found, point, np.zeros(0), self.fields)


@dataclass(frozen=True)
class BackSubstituted(ElasticFields):
    """Fields by one solution with the factors of K, see
    :class:`~hhr_dolfinx.models.answer.ModelFields`.
    """

    order: FullOrderModel

    @property
    def full(self) -> Meshed:
        """The full model."""
        return self.order

    def displacement(self, answer: Answer) -> np.ndarray:
        """K^-1 (F - B^T λ) + lift, (N,)."""
        problem = self.order.problem
        theta = problem.amplitudes(answer.parameter)
        loads = problem.loads @ theta - problem.contact.T @ answer.multipliers
        return self.order.stiffness.solve(loads) + problem.lifts @ theta

    def stress(self, answer: Answer) -> np.ndarray:
        """Stress in the middle of each cell, Kelvin's notation, (cells, components)."""
        return self.order.stress_of(self.displacement(answer), answer.parameter)
