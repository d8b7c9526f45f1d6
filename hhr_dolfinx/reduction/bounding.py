"""Bounds that a reduced model gets, with the map of the displacement that they are of."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from hhr_dolfinx.certify.bounds import error_bound
from hhr_dolfinx.errors import BoundError
from hhr_dolfinx.models.error_bound import Bound
from hhr_dolfinx.models.estimates import NOT_ASKED
from hhr_dolfinx.reduction.recipe import Recipe
from hhr_dolfinx.snapshots.records import SnapshotSet
from hhr_dolfinx.timing import StageLog

if TYPE_CHECKING:
    from hhr_dolfinx.certify.field_response import MadeOfForces
    from hhr_dolfinx.models.contact_response import FieldResponse


class Bounding(NamedTuple):
    """Bounds of errors, and the displacement that they are of.

    Attributes:
        bound: None where there is none.
        columns: those that make the displacement, (N, c).
        response: makes their coordinates of forces; None where these are gamma.
        unbounded: why there is no bound; empty where there is one.
    """

    bound: Bound | None
    columns: np.ndarray
    response: FieldResponse | None = None
    unbounded: str = ""


def bound_of(full: Any, recipe: Recipe, snapshots: SnapshotSet, basis: np.ndarray, log: StageLog) -> Bounding:
    """Bounds for a recipe, with a basis, (N, ell); none where not asked for or not proved, as the log says too."""
    if not recipe.bound or recipe.indicator is not None:
        return Bounding(None, basis, unbounded=NOT_ASKED)
    forces = snapshots.forces
    try:
        with log.stage("bound"):
            if full.problem.varies and full.equilibrium is None:
                from hhr_dolfinx.reduction.varying_bound import varying_bound

                return Bounding(varying_bound(full, basis, forces), basis)
            if recipe.cone:  # forces outside the RID are then those of training
                return Bounding(error_bound(full, basis, forces), basis)
            made = _made_of_forces(full)(full, forces, basis.shape[1])
            return Bounding(made.bound, made.columns, made.response)
    except BoundError as error:
        log.skip("bound", str(error))
        return Bounding(None, basis, unbounded=str(error))


def _made_of_forces(full: Any) -> Callable[[Any, np.ndarray, int], MadeOfForces]:
    """The displacement made of forces, with its bounds, of bodies that are held or that contact alone holds."""
    if full.problem.rigid is None or full.equilibrium is not None:
        from hhr_dolfinx.certify.field_response import field_response

        return field_response
    from hhr_dolfinx.certify.floating_bound import floating_bound

    return floating_bound
