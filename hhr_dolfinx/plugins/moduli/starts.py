"""Typical contact forces of a condensed model whose contacts have a law that remembers."""

from __future__ import annotations

import numpy as np

from hhr_dolfinx.contact.problem import ContactProblem
from hhr_dolfinx.errors import ConvergenceError, ReductionError
from hhr_dolfinx.models.condensed import CondensedModel
from hhr_dolfinx.models.eliminations.elimination import Elimination
from hhr_dolfinx.models.starts import KnownStatuses
from hhr_dolfinx.reduction.starts import NO_FIELDS, STAGE
from hhr_dolfinx.timing import Announce

ALONG = 4
"""Points along each path that samples the forces of a law that remembers."""


def starts_along_paths(
    eliminated: Elimination, points: np.ndarray, problem: ContactProblem, announce: Announce
) -> tuple[KnownStatuses, np.ndarray]:
    """Starts and typical forces, (S, m), with a law that remembers: increments start from the one before.

    Forces are those along paths through a few of the points, (S, P), each, which load, unload and reverse; parameters
    that stay along a path are those of its first point.
    """
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
