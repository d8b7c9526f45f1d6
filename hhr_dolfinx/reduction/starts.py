"""Statuses at training points and their changes there, computed by a small model itself."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from hhr_dolfinx import ranks
from hhr_dolfinx.contact.active_set import Pairs
from hhr_dolfinx.contact.problem import ContactProblem
from hhr_dolfinx.errors import ConvergenceError, ReductionError
from hhr_dolfinx.models.answer import ModelFields
from hhr_dolfinx.models.eliminations.elimination import Elimination, answer_of
from hhr_dolfinx.models.starts import KnownStatuses, LinearStarts
from hhr_dolfinx.timing import Announce, unannounced

if TYPE_CHECKING:
    from mpi4py.MPI import Comm

STAGE = "starts"
ALONG = 4
"""Points along each path that samples the forces of a law that remembers."""
NO_FIELDS: Any = ModelFields()
"""Fields of answers without fields."""


def linear_starts(
    eliminated: Elimination,
    points: np.ndarray,
    pairs: np.ndarray | None,
    active: np.ndarray | None = None,
    comm: Comm | None = None,
    announce: Announce = unannounced,
) -> LinearStarts:
    """Starts from answers at some points, (S, P), with derivatives; points without an answer are left out.

    Without tabulated answers, searches often take a second equality problem: on the pellet 57 of 100 do, and 10 of
    100 with derivatives.

    Args:
        eliminated: makes the contact problem of a point.
        points: (S, P).
        pairs: number of the contact pair of each condition, (m,).
        active: statuses to start from there, (S, m) bool; None for those of the free slack.
        comm: ranks that share the points, if there are several.
        announce: called with the share of the points that are done.

    Raises:
        ReductionError: if no point has an answer.
    """

    def start_at(number: int) -> tuple[np.ndarray, ...] | None:
        """Point, statuses, margins and their changes; None without an answer."""
        announce(STAGE, number / len(points))
        point = points[number]
        contact = eliminated(point)
        start = None if active is None else active[number]
        answer = answer_of(contact, point, start, Pairs.of(pairs), NO_FIELDS, gradient=True)
        if answer.gradient is None:
            return None
        slack = contact.free_slack + contact.schur @ answer.multipliers
        margins = np.where(answer.active, answer.multipliers, -slack)
        changes = np.where(answer.active[:, None], answer.gradient.multipliers, -answer.gradient.slack)
        return point, answer.active, margins, changes

    places = range(len(points))
    every = map(start_at, places) if comm is None else ranks.shared_out(comm, len(points), start_at, "finding starts")
    found = [item for item in every if item is not None]
    if not found:
        raise ReductionError("no point of the box has an answer: contact rows are dependent, or the box is empty")
    return LinearStarts(*(np.array(part) for part in zip(*found, strict=True)))


def starts_of(
    eliminated: Elimination,
    points: np.ndarray,
    problem: ContactProblem,
    comm: Comm | None = None,
    announce: Announce = unannounced,
) -> tuple[KnownStatuses, np.ndarray]:
    """Starts of searches, and typical forces, (S, m), of a condensed model at some points, (S, P).

    With a law that remembers, increments start from the one before, and the forces are those along paths through a few
    points each, which load, unload and reverse; the parameters that stay along a path are those of its first point.
    """
    if not problem.law.remembers:
        known = linear_starts(eliminated, points, problem.contact_pairs, comm=comm, announce=announce)
        return known, np.maximum(known.margins, 0.0)
    return _starts_along_paths(eliminated, points, problem, announce)


def _starts_along_paths(
    eliminated: Elimination, points: np.ndarray, problem: ContactProblem, announce: Announce
) -> tuple[KnownStatuses, np.ndarray]:
    """See :func:`starts_of`."""
    from hhr_dolfinx.models.condensed import CondensedModel

    nothing = KnownStatuses(problem.middle[None], np.zeros((1, len(problem.gaps)), dtype=bool))
    model = CondensedModel(problem.parameters, eliminated, nothing, NO_FIELDS, problem.contact_pairs, law=problem.law)
    fixed = problem.law.fixed
    found = []
    seen = []
    for first in range(0, len(points), ALONG):
        announce(STAGE, first / len(points))
        along = points[first : first + ALONG].copy()
        along[:, fixed] = along[0, fixed]
        rest = np.clip(0.0, problem.parameters.lower, problem.parameters.upper)
        rest[fixed] = along[0, fixed]
        try:
            history = model.march([(0.0, rest), *((1.0 + k, point) for k, point in enumerate(along))])
        except ConvergenceError as stop:
            history = vars(stop)["history"]
        found += [answer.multipliers for answer in history.answers]
        seen += [answer.parameter for answer in history.answers]
    if not found:
        raise ReductionError(
            "no path through the box has an answer: contact rows are dependent, or the law of the contacts admits none"
        )
    return KnownStatuses(np.array(seen), np.array(found) != 0), np.array(found)
