"""Statuses at known points and how they change there, found by a small model itself."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from hhr_dolfinx.contact.active_set import Pairs
from hhr_dolfinx.errors import ReductionError
from hhr_dolfinx.models.starts import LinearStarts
from hhr_dolfinx.models.varying import Elimination, answer_of

NO_FIELDS: Any = None
"""Fields of answers that nobody asks for any."""


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
            slack = elimination.free_slack + elimination.schur @ answer.multipliers
            margins = np.where(answer.active, answer.multipliers, -slack)
            changes = np.where(answer.active[:, None], answer.gradient.multipliers, -answer.gradient.slack)
            found.append((point, answer.active, margins, changes))
    if not found:
        raise ReductionError("no point of the box has an answer: contact rows are dependent, or the box is empty")
    return LinearStarts(*(np.array(part) for part in zip(*found, strict=True)))
