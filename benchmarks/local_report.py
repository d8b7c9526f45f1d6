"""What local models are worth: sizes, time of the choice, and whether errors are larger by the
borders.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from hhr_dolfinx.certify.accuracy import summary
from hhr_dolfinx.plugins.local_models.clustered import sizes_of
from hhr_dolfinx.plugins.local_models.models import LocalModels
from hhr_dolfinx.plugins.studies.points import time_queries

if TYPE_CHECKING:
    from hhr_dolfinx.plugins.studies.measure import MeasuredErrors, References

BORDER = 0.05
"""Part of the width of the part of a model within which a point lies by its border."""


def near_borders(local: LocalModels, points: np.ndarray) -> np.ndarray:
    """Whether points, (n, P), lie by a border between two models, (n,)."""
    space, choice = local.parameters, local.choice
    lower, upper = (np.full((len(local), len(space.names)), end) for end in (np.inf, -np.inf))
    for label, low, high in choice.boxes(space.lower, space.upper):
        lower[label], upper[label] = np.minimum(lower[label], low), np.maximum(upper[label], high)
    own = choice.many(points)[0]
    reach = BORDER * (upper - lower)[own]
    near = np.zeros(len(points), dtype=bool)
    for axis in range(points.shape[1]):
        for side in (-1.0, 1.0):
            beside = points.copy()
            beside[:, axis] += side * reach[:, axis]
            near |= choice.many(beside)[0] != own
    return near


def stripe(local: LocalModels, points: np.ndarray, errors: np.ndarray) -> float:
    """95th percentile of errors, (n,), at points by a border over that elsewhere.

    NaN without points of both kinds.
    """
    near = near_borders(local, points)
    if near.all() or not near.any():
        return float("nan")
    return float(summary(errors[near])["p95"] / summary(errors[~near])["p95"])


def local_part(
    local: LocalModels, references: References, errors: MeasuredErrors, fresh: np.ndarray
) -> dict[str, Any]:
    """The ``local`` part of a report.

    Args:
        local: the models.
        references: exact answers.
        errors: of the models beside them.
        fresh: points at which the choice is timed, (n, P).

    Returns:
        ``K``, ``sizes`` of each model, seconds of the choice, ``choice_s``, and ``stripe``: the
        95th percentile of the errors of the forces by borders over that elsewhere.
    """
    members = [None] * len(local) if local.offline is None else local.offline.members
    rows = [
        dict(zip(("ell_bar", "N_lambda_C"), sizes_of(model), strict=True)) for model in local.models
    ]
    for row, member in zip(rows, members, strict=True):
        if member is not None:
            row |= {"snapshots": len(member.snapshots), "own": member.own, "added": member.added}
    plain = [point.tolist() for point in fresh]
    seconds = time_queries({"choice": lambda k: local.choice.candidates(plain[int(k[0])])},
                           np.arange(len(plain), dtype=float)[:, None])["choice"]  # fmt: skip
    return {
        "K": len(local),
        "sizes": rows,
        "choice_s": float(np.median(seconds)),
        "stripe": stripe(local, references.solutions.points, errors.values["dual_full_floored"]),
        "near_borders": float(near_borders(local, references.solutions.points).mean()),
    }
