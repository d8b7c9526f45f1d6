"""Many parameters at once.

Points of equal statuses share factors, and are solved by products of matrices.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial import cKDTree

from hhr_dolfinx.amplitudes import Amplitudes
from hhr_dolfinx.contact.active_set import Status, settled
from hhr_dolfinx.models.answer import Answer, ModelFields, SeveralAnswers
from hhr_dolfinx.models.eliminations.elimination import Responses
from hhr_dolfinx.models.estimates import Estimates
from hhr_dolfinx.models.starts import KnownStatuses
from hhr_dolfinx.one_thread import one_thread

if TYPE_CHECKING:
    from hhr_dolfinx.models.condensed import CondensedModel

POINTS_AT_ONCE = 1024
"""Points whose unknown is computed at once, so that temporary arrays stay small compared with the
answers.
"""
FEWEST_POINTS = 4096
"""Fewest points for which some are solved first: fewer start from the statuses that the model
knows."""
STRIDE_OF_STARTS = 16
"""One of so many points is solved first, for the others to start from."""


@dataclass(frozen=True, repr=False)
class ManyAnswers(SeveralAnswers):
    """Answers of one elastic model to many parameters, as arrays."""

    points: np.ndarray  #: parameters, (n, P)
    unknown: np.ndarray  #: unknown of the model, (n, k); NaN without a solution
    multipliers: (
        np.ndarray
    )  #: forces on the contact conditions of the model, (n, m); NaN without a solution
    active: np.ndarray  #: their statuses, (n, m) bool
    status: list[Status]  #: why each search stopped
    iterations: np.ndarray  #: equality problems solved for each, (n,)
    fields: ModelFields  #: completes the answers

    def __getitem__(self, k: int) -> Answer:
        row = self.points[k], self.unknown[k], self.multipliers[k], self.active[k]
        return Answer(*row, int(self.iterations[k]), self.status[k], False, self.fields)

    @classmethod
    def of(cls, answers: list[Answer], fields: ModelFields) -> ManyAnswers:
        """Array form of answers found one by one, one or more.

        Args:
            answers: answers found one by one, one or more.
            fields: fields of the model.
        """
        points, unknown, forces, active = (
            np.array([getattr(answer, name) for answer in answers])
            for name in ("parameter", "unknown", "multipliers", "active")
        )
        status = [answer.status for answer in answers]
        iterations = np.array([answer.iterations for answer in answers])
        return cls(points, unknown, forces, active, status, iterations, fields)

    def take(self, rows: np.ndarray) -> ManyAnswers:
        """Answers of some rows, given by numbers or a mask."""
        selected = self.points[rows], self.unknown[rows], self.multipliers[rows], self.active[rows]
        status = [self.status[k] for k in np.arange(len(self))[rows].tolist()]
        return ManyAnswers(*selected, status, self.iterations[rows], self.fields)

    def estimates(self) -> Estimates | None:
        """Error estimates, as :meth:`Answer.estimate`; None if the model has none."""
        estimates = self.fields.estimates(self)
        return super().estimates() if estimates is None else estimates


@dataclass(frozen=True, repr=False)
class PartedAnswers(SeveralAnswers):
    """Answers of several models to many parameters, each from the model of its point."""

    points: np.ndarray  #: parameters, (n, P)
    model: np.ndarray  #: number of the model that answered each, (n,) int
    status: list[Status]  #: why each search stopped
    iterations: np.ndarray  #: equality problems solved for each, (n,)
    parts: tuple[
        tuple[np.ndarray, SeveralAnswers], ...
    ]  #: rows and answers of each model that is used

    @classmethod
    def of(cls, parts: list[tuple[np.ndarray, SeveralAnswers]], model: np.ndarray) -> PartedAnswers:
        """Combine the answers of each model to its rows.

        Args:
            parts: rows and answers of each model, one or more.
            model: number of the model of each row, (n,) int.
        """
        indices = [rows for rows, _ in parts]
        points, iterations = (
            _at_places(indices, [getattr(many, name) for _, many in parts])
            for name in ("points", "iterations")
        )
        status = {
            row: search_status
            for rows, many in parts
            for row, search_status in zip(rows.tolist(), many.status, strict=True)
        }
        return cls(
            points, model, [status[row] for row in range(len(model))], iterations, tuple(parts)
        )

    def __getitem__(self, k: int) -> Answer:
        k = range(len(self))[k]
        for rows, many in self.parts:
            index = int(np.searchsorted(rows, k))
            if index < rows.size and rows[index] == k:
                return many[index]
        raise IndexError(k)

    def forces(self) -> np.ndarray:
        """See :meth:`SeveralAnswers.forces`."""
        return self._gathered([many.forces() for _, many in self.parts])

    def estimates(self) -> Estimates | None:
        """See :meth:`SeveralAnswers.estimates`."""
        return Estimates.joined([(rows, many.estimates()) for rows, many in self.parts], len(self))

    def outputs(self) -> dict[str, np.ndarray]:
        """See :meth:`ManyAnswers.outputs`."""
        per_model = [many.outputs() for _, many in self.parts]
        return {
            name: self._gathered([outputs[name] for outputs in per_model]) for name in per_model[0]
        }

    def _gathered(self, values: list[np.ndarray]) -> np.ndarray:
        return _at_places([rows for rows, _ in self.parts], values)


def _at_places(indices: list[np.ndarray], values: list[np.ndarray]) -> np.ndarray:
    """Values of parts, (k, ...) each, in the order of all rows; each row belongs to one part."""
    return np.concatenate(values)[np.argsort(np.concatenate(indices))]


# blocks of a hundred conditions: two threads beside another process took 20 times as long, measured
# once
@one_thread
def answers_by_statuses(
    model: CondensedModel,
    amplitudes: Amplitudes,
    responses: Responses,
    response: np.ndarray,
    points: np.ndarray,
    raise_on_failure: bool,
) -> ManyAnswers:
    """Answers of a condensed model of constant stiffness to many points.

    The model solves the points whose batch does not converge.

    Args:
        model: the :class:`~hhr_dolfinx.models.condensed.CondensedModel`.
        amplitudes: θ as a function of the parameters.
        responses: S and the responses to forces.
        response: free slack followed by the free unknown, (m + n, 1 + T).
        points: checked parameters, (n, P).
        raise_on_failure: raise at the first point without a solution.
    """
    schur = responses.schur
    per_force = responses.primal_per_force
    m = len(schur)
    n = len(points)
    theta = amplitudes.of_many(points)
    free_slack = np.asarray(theta @ response[:m].T)
    active = _starts(model.known, schur, points, free_slack)
    forces, iterations, unconverged = settled(schur, free_slack, active)
    unknown = np.empty((n, len(response) - m))
    status = [Status.CONVERGED] * n
    for first in range(0, n, POINTS_AT_ONCE):
        block = slice(first, first + POINTS_AT_ONCE)
        unknown[block] = theta[block] @ response[m:].T
        unknown[block] -= forces[block] @ per_force.T
    for k in unconverged:
        answer = model.solve(
            points[k], start=active[k].copy(), raise_on_failure=raise_on_failure, outside="ignore"
        )
        unknown[k] = answer.unknown
        forces[k] = answer.multipliers
        active[k] = answer.active
        status[k] = answer.status
        iterations[k] += answer.iterations
    return ManyAnswers(points, unknown, forces, active, status, iterations, model.fields)


def _starts(
    known: KnownStatuses, schur: np.ndarray, points: np.ndarray, free_slack: np.ndarray
) -> np.ndarray:
    """Statuses to start from, (n, m) bool; a copy, which the caller may change.

    Of many points one of every so many is solved first. The others start from the nearest of these,
    which mostly has the same statuses.
    """
    if len(points) < FEWEST_POINTS:
        return known.starts(points)
    first = np.arange(0, len(points), STRIDE_OF_STARTS)
    statuses = _starts(known, schur, points[first], free_slack[first])
    settled(schur, free_slack[first], statuses)
    widths = np.ptp(points, axis=0)
    widths[widths == 0] = 1.0
    return statuses[cKDTree(points[first] / widths).query(points / widths)[1]]
