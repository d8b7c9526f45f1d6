"""Bounds that a reduced model gets, with the map of the displacement that they are of."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from hhr_dolfinx.certify.bounds import error_bound
from hhr_dolfinx.errors import BoundError
from hhr_dolfinx.models.error_bound import Bound
from hhr_dolfinx.reduction.recipe import Recipe
from hhr_dolfinx.snapshots.records import SnapshotSet
from hhr_dolfinx.timing import StageLog

if TYPE_CHECKING:
    from hhr_dolfinx.certify.field_response import MadeOfForces
    from hhr_dolfinx.models.field_response import FieldResponse


def bound_of(
    full: Any, recipe: Recipe, snapshots: SnapshotSet, basis: np.ndarray, log: StageLog
) -> tuple[Bound | None, np.ndarray, FieldResponse | None]:
    """Bounds of errors, columns that make the displacement, and what makes their coordinates of forces, if anything.

    There are no bounds where they were not asked for, or are not proved, with the reason in the log.
    """
    if not recipe.bound or recipe.indicator is not None:
        return None, basis, None
    try:
        with log.stage("bound"):
            if full.problem.varies and full.equilibrium is None:
                from hhr_dolfinx.reduction.varying_bound import varying_bound

                return varying_bound(full, basis), basis, None
            if recipe.cone:  # forces outside the RID are then those of training
                return error_bound(full, basis), basis, None
            made = _made_of_forces(full)(full, snapshots.forces, basis.shape[1])
            return made.bound, made.columns, made.response
    except BoundError as error:
        log.skip("bound", str(error))
        return None, basis, None


def _made_of_forces(full: Any) -> Callable[[Any, np.ndarray, int], MadeOfForces]:
    """What makes the displacement of forces, with its bounds, of bodies that are held or that contact alone holds."""
    if full.problem.rigid is None or full.equilibrium is not None:
        from hhr_dolfinx.certify.field_response import field_response

        return field_response
    from hhr_dolfinx.certify.floating_bound import floating_bound

    return floating_bound
