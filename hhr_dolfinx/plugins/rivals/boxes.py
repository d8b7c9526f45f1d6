"""Condensation box by box: contacts that training shows closed, or open, all over a box leave it.

Where a surface has thousands of conditions, S is full and condensation is dear; yet in a small box
of parameters only the rim of the contact changes. Closed conditions C are eliminated as equations,
open ones O are left out,

    σ_R = s_R + S_RR λ_R,    S_RR <- S_RR - S_RC S_CC^-1 S_CR,    s_R <- s_R - S_RC S_CC^-1 s_C,

and the search runs on the uncertain ones, R. Forces on C and slacks on O are looked at in each
answer: with their signs right it is exact; else the full model answers.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from scipy import linalg

from hhr_dolfinx.contact.active_set import SchurEqualities, Status, Statuses, active_set
from hhr_dolfinx.errors import NotOfferedError
from hhr_dolfinx.models.answer import Answer, ElasticFields, Meshed, found_as
from hhr_dolfinx.models.model import AnsweringModel
from hhr_dolfinx.plugins.rivals.projection import check_elastic
from hhr_dolfinx.plugins.studies.study import Rival

if TYPE_CHECKING:
    from hhr_dolfinx.amplitudes import Theta
    from hhr_dolfinx.full_order.full import FullOrderModel
    from hhr_dolfinx.models.answer import CheckedStart
    from hhr_dolfinx.snapshots.records import SnapshotSet
    from hhr_dolfinx.study.training.train import Training

MOST_BOXES = 256
LEFT_OUT = 1e-12
"""Singular values of the influence of uncertain forces on all others, over the largest, that are
left out.
"""
WRONG = 1e-9
"""Pull or overlap over the largest force or slack beyond which the full model answers."""


def boxes(training: Training) -> Iterator[Rival]:
    """Condensation in boxes of parameters, each with the conditions that are uncertain there."""
    yield Rival("condensed by boxes", "uncertain ones", partial(_made, training))


def _made(training: Training) -> BoxwiseModel:
    return BoxwiseModel(training.full_order, training.snapshots)


@dataclass(frozen=True)
class Box:
    """Contact conditions of a box of parameters (m conditions, r uncertain ones)."""

    uncertain: np.ndarray  #: numbers of these, (r,)
    closed: np.ndarray  #: True for closed ones, (m,) bool
    equalities: SchurEqualities | None  #: of the uncertain ones; None without any
    slack: np.ndarray  #: their slack without their forces, (r, 1 + T)
    others: np.ndarray  #: forces of closed and slacks of open ones without these, (m, 1 + T)
    outer: np.ndarray  #: influence of uncertain forces on these, outer @ inner, (m, k)
    inner: np.ndarray  #: (k, r)

    @classmethod
    def of(cls, schur: np.ndarray, slack: np.ndarray, statuses: np.ndarray) -> Box:
        """Box of statuses seen there.

        Args:
            schur: S of all conditions, (m, m).
            slack: slack without forces, (m, 1 + T).
            statuses: known statuses, (m, n) bool.
        """
        closed = statuses.all(axis=1)
        opened = ~statuses.any(axis=1)
        uncertain = np.flatnonzero(~closed & ~opened)
        count = len(uncertain)
        columns = np.hstack([schur[:, uncertain], slack])
        left_over = columns
        if closed.any():
            factor = linalg.cho_factor(schur[np.ix_(closed, closed)])
            eliminated = linalg.cho_solve(factor, columns[closed])
            left_over = columns - schur[:, closed] @ eliminated
            left_over[closed] = -eliminated
        influence = left_over[:, :count].copy()
        influence[uncertain] = 0.0
        outer, inner = _low_rank(influence)
        own = left_over[uncertain, :count]
        equalities = SchurEqualities.symmetric((own + own.T) / 2) if count else None
        own_slack, others = left_over[uncertain, count:], left_over[:, count:]
        others[uncertain] = 0.0
        return cls(uncertain, closed, equalities, own_slack, others, outer, inner)

    def solved(self, theta: Theta) -> tuple[np.ndarray, int, bool]:
        """Forces of all conditions, (m,), equality problems solved, and whether all signs are
        right.
        """
        values = self.others @ theta
        forces = np.where(self.closed, values, 0.0)
        count, right = 0, True
        if self.equalities is not None:
            slack = self.slack @ theta
            found = active_set(self.equalities, slack, slack < 0)
            values = values + self.outer @ (self.inner @ found.forces)
            forces = np.where(self.closed, values, 0.0)
            forces[self.uncertain] = found.forces
            count, right = found.iterations, found.status is Status.CONVERGED
        gaps = values[~self.closed]
        pulled = -forces.min(initial=0.0) > WRONG * forces.max(initial=0.0)
        overlaps = -gaps.min(initial=0.0) > WRONG * gaps.max(initial=0.0)
        return forces, count, right and not pulled and not overlaps


def _low_rank(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Factors of a matrix, (m, r), without singular values that are round-off."""
    left, triangle = linalg.qr(matrix, mode="economic")
    turns, values, right = linalg.svd(triangle, lapack_driver="gesvd")
    kept = values > LEFT_OUT * values.max(initial=0.0)
    return left @ (turns[:, kept] * values[kept]), right[kept]


class BoxwiseModel(AnsweringModel):
    """Exact answers by the uncertain conditions of the box of each point.

    Args:
        full: the full model, on one rank, with a constant stiffness.
        snapshots: known answers.

    Attributes:
        asked: how many answers the full model gave.

    Raises:
        NotOfferedError: see :func:`~hhr_dolfinx.plugins.rivals.projection.check_elastic`, and for
            moduli that are parameters.
    """

    def __init__(self, full: FullOrderModel, snapshots: SnapshotSet):
        check_elastic(full, "condensation by boxes")
        if full.problem.varies:
            raise NotOfferedError("boxes share one S: moduli are parameters")
        self.parameters = space = full.parameters
        self.asked = 0
        self._full = full
        free = full.problem.contact @ full.stiffness.columns(full.problem.loads)
        slack = full.problem.gaps - free
        self._sides = max(int(MOST_BOXES ** (1 / len(space.names)) + 1e-9), 1)
        self._low = np.array(space.lower)
        self._width = (np.array(space.upper) - self._low) / self._sides
        known = (snapshots.points - self._low) / self._width
        places = itertools.product(range(self._sides), repeat=len(space.names))
        self._boxes = {
            place: Box.of(full.schur, slack, snapshots.active[:, _known_in(known, place)])
            for place in places
        }
        self.fields = BackSubstituted(full)
        self.advice: dict[Status, str] = {}

    @property
    def sizes(self) -> tuple[int, int]:
        """Boxes, and most uncertain conditions of one."""
        return len(self._boxes), max(len(box.uncertain) for box in self._boxes.values())

    def _answered(
        self, point: np.ndarray, start: CheckedStart, outside: str, gradient: bool
    ) -> Answer:
        if gradient:
            raise NotOfferedError("rivals have no gradients: ask the full model")
        place = np.clip((point - self._low) / self._width, 0, self._sides - 1).astype(int)
        box = self._boxes[tuple(place.tolist())]
        forces, count, right = box.solved(self._full.problem.amplitudes(point))
        if not right:
            self.asked += 1
            return self._full.solve(point, start=forces > 0, outside="ignore")
        found = Statuses(forces, forces > 0, count, Status.CONVERGED, False)
        return found_as(found, point, np.zeros(0), self.fields)


def _known_in(points: np.ndarray, place: tuple[int, ...]) -> np.ndarray:
    """Numbers of known points in a box, its corners included, and of the 2^P nearest ones.

    Args:
        points: points in units of the boxes, (S, P).
        place: the box.
    """
    off = np.abs(points - (np.array(place) + 0.5))
    inside = np.flatnonzero((off <= 0.5 + 1e-9).all(axis=1))
    nearest = np.argsort((off**2).sum(axis=1), kind="stable")[: 2 ** points.shape[1]]
    return np.union1d(inside, nearest)


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
