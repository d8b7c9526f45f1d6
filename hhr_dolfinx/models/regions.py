"""Answers of known statuses as affine maps of the parameters, where the stiffness is constant.

With fixed statuses the solution is affine in the parameters. These maps, the critical regions of multi-parametric
programming (Bemporad, Morari, Dua and Pistikopoulos, Automatica 38, 2002), are tabulated: where the map of the nearest
known statuses gives forces and slacks that are all non-negative, it is the solution, and no problem is solved online.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hhr_dolfinx.contact.active_set import Status
from hhr_dolfinx.errors import SingularError
from hhr_dolfinx.models.answer import Answer, Fields

if TYPE_CHECKING:
    from hhr_dolfinx.models.condensed import KnownStatuses
    from hhr_dolfinx.models.elimination import ConstantElimination

Region = tuple[np.ndarray, np.ndarray] | None

ENTRIES = 2_000_000
"""Numbers (16 MB) that the tabulated critical regions of one model may take; beyond, none are kept."""
PREPARED_BYTES = 16 * 2**20
"""Memory for factors of known statuses where there are no regions: a query that starts from them factors nothing."""


class CriticalRegions:
    """For each known status the affine map mu -> (forces, slacks, unknown); None of a singular set.

    Args:
        known: statuses of solved parameters.
        maps: of each of them, values at mu = 0 and slopes.
    """

    def __init__(self, known: KnownStatuses, maps: list[Region]):
        self._known, self._maps, self._m = known, maps, known.active.shape[1]

    @classmethod
    def of(cls, eliminated: ConstantElimination, known: KnownStatuses) -> CriticalRegions | None:
        """Those of a constant stiffness; None where amplitudes are not affine, or tables would be too large."""
        distinct, which = np.unique(known.active, axis=0, return_inverse=True)
        theta, response, m = eliminated.amplitudes, eliminated.response, known.active.shape[1]
        if theta.nonaffine or len(distinct) * (m + len(response)) * (1 + known.points.shape[1]) > ENTRIES:
            eliminated.equalities.prepare(distinct, PREPARED_BYTES)
            return None
        # columns: the value at mu = 0, then the slope along each parameter
        columns = response @ np.column_stack([theta.constant, theta.slopes])
        regions = [_region(eliminated, active, columns) for active in distinct]
        return cls(known, [regions[k] for k in which.ravel()])

    def answer(self, point: np.ndarray, fields: Fields) -> Answer | None:
        """The answer to a point, (P,); None where the nearest statuses are not its own."""
        nearest = self._known.nearest(point)
        region = self._maps[nearest]
        if region is None:
            return None
        constant, slopes = region
        m, values = self._m, constant + slopes @ point
        # the ufunc itself: its wrapper takes as long again
        if np.minimum.reduce(values[: 2 * m]) >= 0:
            active = self._known.active[nearest]
            return Answer(point, values[2 * m :], values[:m], active, 1, Status.CONVERGED, False, fields)
        return None


def _region(eliminated: ConstantElimination, active: np.ndarray, columns: np.ndarray) -> Region:
    """The map of some statuses."""
    m = len(active)
    try:
        found = [eliminated.equalities(active, column) for column in columns[:m].T]
    except SingularError:  # the active set may find a way round
        return None
    forces, slack = (np.stack(item, axis=1) for item in zip(*found, strict=True))
    values = np.vstack([forces, slack, columns[m:] - eliminated.responses.primal_per_force @ forces])
    return (values[:, 0].copy(), np.ascontiguousarray(values[:, 1:])) if np.isfinite(values).all() else None
