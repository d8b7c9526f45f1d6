"""Statuses at known points and how they change there, found by a small model itself."""

from __future__ import annotations

from typing import Any

import numpy as np

from hhr_dolfinx.contact.active_set import Pairs
from hhr_dolfinx.errors import ReductionError
from hhr_dolfinx.models.eliminations.elimination import Elimination, answer_of
from hhr_dolfinx.models.starts import LinearStarts

NO_FIELDS: Any = None
"""Fields of answers that nobody asks for any."""


def linear_starts(
    eliminated: Elimination, points: np.ndarray, pairs: np.ndarray | None, active: np.ndarray | None = None
) -> LinearStarts:
    """Starts at those of some points, (S, P), that have an answer, with derivatives.

    Where no answers can be tabulated, searches often take a second equality problem: on the pellet 57 of 100, and 10 of
    100 along derivatives.

    Args:
        eliminated: makes the contact problem of a point.
        points: (S, P).
        pairs: number of the contact pair of each condition, (m,).
        active: statuses to start from there, (S, m) bool; None for those of the free slack.

    Raises:
        ReductionError: if no point has an answer.
    """
    found = []
    for number, point in enumerate(points):
        contact = eliminated(point)
        start = None if active is None else active[number]
        answer = answer_of(contact, point, start, Pairs.of(pairs), NO_FIELDS, gradient=True)
        if answer.gradient is None:
            continue
        slack = contact.free_slack + contact.schur @ answer.multipliers
        margins = np.where(answer.active, answer.multipliers, -slack)
        changes = np.where(answer.active[:, None], answer.gradient.multipliers, -answer.gradient.slack)
        found.append((point, answer.active, margins, changes))
    if not found:
        raise ReductionError("no point of the box has an answer: contact rows are dependent, or the box is empty")
    return LinearStarts(*(np.array(part) for part in zip(*found, strict=True)))
