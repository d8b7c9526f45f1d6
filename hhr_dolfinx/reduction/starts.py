"""Statuses at training points and their changes there, computed by a small model itself."""

from __future__ import annotations

import numpy as np

from hhr_dolfinx.contact.active_set import Pairs
from hhr_dolfinx.errors import ReductionError
from hhr_dolfinx.group import ALONE, ProcessGroup
from hhr_dolfinx.models.answer import ModelFields
from hhr_dolfinx.models.eliminations.elimination import Elimination, answer_of
from hhr_dolfinx.models.starts import LinearStarts
from hhr_dolfinx.timing import Announce, unannounced

STAGE = "starts"
NO_FIELDS = ModelFields()
"""Fields of answers without fields."""


def linear_starts(
    eliminated: Elimination,
    points: np.ndarray,
    pairs: np.ndarray | None,
    active: np.ndarray | None = None,
    group: ProcessGroup = ALONE,
    announce: Announce = unannounced,
) -> LinearStarts:
    """Starts from answers at some points, with derivatives.

    Points without an answer are left out. Without tabulated answers, searches often take a second
    equality problem: on the pellet 57 of 100 do, and 10 of 100 with derivatives.

    Args:
        eliminated: makes the contact problem of a point.
        points: parameters, (S, P).
        pairs: number of the contact pair of each condition, (m,); None for one pair.
        active: statuses from which the searches start, (S, m) bool; None for the signs of the free
            slack.
        group: processes that share the points.
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
        changes = np.where(
            answer.active[:, None], answer.gradient.multipliers, -answer.gradient.slack
        )
        return point, answer.active, margins, changes

    results = group.shared_out(len(points), start_at, "finding starts")
    solved = [result for result in results if result is not None]
    if not solved:
        raise ReductionError(
            "no point of the box has an answer: contact rows are dependent, or the box is empty"
        )
    return LinearStarts(*(np.array(column) for column in zip(*solved, strict=True)))
