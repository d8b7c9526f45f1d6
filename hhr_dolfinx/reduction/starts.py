"""Statuses at known points and how they change there, found by a small model itself."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from hhr_dolfinx.contact.active_set import Pairs
from hhr_dolfinx.errors import ReductionError
from hhr_dolfinx.models.condensed import CondensedModel
from hhr_dolfinx.models.starts import LinearStarts
from hhr_dolfinx.models.varying import Elimination, answer_of

NO_FIELDS: Any = None
"""Fields of answers that nobody asks for any."""


def starts_along(model: CondensedModel) -> LinearStarts:
    """Starts of a condensed model at its known parameters, with derivatives.

    Where amplitudes are not affine no answers can be tabulated, and searches often take a second equality problem: on
    the pellet 57 of 100, and 10 of 100 along derivatives.
    """
    response, schur, _ = model.responses
    found = []
    for point, active in zip(model.known.points, model.known.active, strict=True):
        answer = model.solve(point, start=active, raise_on_failure=False, outside="ignore", gradient=True)
        if answer.gradient is not None:
            slack = response[: len(schur)] @ model.amplitudes(point) + schur @ answer.multipliers
            found.append(_start_of(answer, slack))
    return _starts(found)


def linear_starts(
    eliminated: Callable[[np.ndarray], Elimination], points: np.ndarray, pairs: np.ndarray
) -> LinearStarts:
    """Starts at those of some points, (S, P), that have an answer.

    Raises:
        ReductionError: if none has.
    """
    found = []
    for point in points:
        elimination = eliminated(point)
        answer = answer_of(elimination, point, None, Pairs.of(pairs), NO_FIELDS, gradient=True)
        if answer.gradient is not None:
            found.append(_start_of(answer, elimination.free_slack + elimination.schur @ answer.multipliers))
    return _starts(found)


def _start_of(answer: Any, slack: np.ndarray) -> tuple[np.ndarray, ...]:
    """Point, statuses, margins and slopes of an answer with a gradient and its slack, (m,)."""
    margins = np.where(answer.active, answer.multipliers, -slack)
    changes = np.where(answer.active[:, None], answer.gradient.multipliers, -answer.gradient.slack)
    return answer.parameter, answer.active, margins, changes


def _starts(found: list[tuple[np.ndarray, ...]]) -> LinearStarts:
    if not found:
        raise ReductionError("no point of the box has an answer: contact rows are dependent, or the box is empty")
    return LinearStarts(*(np.array(part) for part in zip(*found, strict=True)))
