"""A model of bodies that flow beside all histories that are known: its errors, and what it shows there."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from hhr_dolfinx.certify.accuracy import force_floor
from hhr_dolfinx.certify.compare import Comparison, compare_histories, largest_motion
from hhr_dolfinx.certify.trust import OF_A_RID, TrustLimits, check_comparison, check_door
from hhr_dolfinx.errors import HHRError
from hhr_dolfinx.models.answer import Model, Path
from hhr_dolfinx.models.path import MarchSettings
from hhr_dolfinx.trained import Known, Signs, TrainedPaths

if TYPE_CHECKING:
    from hhr_dolfinx.snapshots.records import SnapshotSet

PARTS = 8
"""Of first steps, in which bodies begin to touch and to flow: states that a finer path along a trained one goes through
have estimates up to nine times those of the steps of training."""


def checked_histories(
    full: Any,
    model: Model,
    snapshots: SnapshotSet,
    held_out: SnapshotSet | None,
    limits: TrustLimits | None,
    remedy: str = OF_A_RID,
) -> tuple[Comparison | None, TrainedPaths | None]:
    """What users get beside known histories, and what the model was trained on; None without limits, or any history.

    Raises:
        UnstableModelError: for errors beyond the limits.

    Warns:
        StabilityWarning: for errors, or a door, that are doubtful.
    """
    kept = () if held_out is None else held_out.histories
    trained_ones = {f"trained history {k}": history for k, history in enumerate(snapshots.histories)}
    histories = trained_ones | {f"held-out history {k}": history for k, history in enumerate(kept)}
    comparison, shown = compare_histories(full, model, histories, force_floor(full.problem, snapshots))
    if limits is not None:
        check_comparison(comparison, limits, remedy)
    # what is held out is no training: unlike it, its errors would open the door to all like them
    signs = [shown[label] for label in trained_ones if label in shown]
    if not signs:  # without limits all of them may have failed
        return None, None
    paths = [history.path for history in snapshots.histories]
    known = Known(signs, [_onset(model, path) for path in paths], largest_motion(full, snapshots))
    trained = TrainedPaths.of(paths, full.parameters, known, full.equilibrium.material.rated)
    if limits is not None:
        check_door(trained, limits)
    return (None if limits is None else comparison), trained


def _onset(model: Model, path: Path) -> list[Signs]:
    """Signs along the first step of a path in small parts; none where it does not converge."""
    (start, here), (end, there) = path[:2]
    shares = np.arange(PARTS + 1) / PARTS
    parts = [(start + share * (end - start), here + share * (there - here)) for share in shares]
    try:
        return model.march(parts, MarchSettings(outside="ignore")).signs
    except HHRError:
        return []
