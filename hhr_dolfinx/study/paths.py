"""What a reduced model of histories does on paths inside and outside of what it was trained on."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from hhr_dolfinx.certify.accuracy import relative_error, summary
from hhr_dolfinx.errors import HHRError, OutsideTrainingWarning
from hhr_dolfinx.models.march import MarchSettings, march
from hhr_dolfinx.reduction.plastic_trust import largest_errors


@dataclass(frozen=True)
class PathCase:
    """A path to try.

    Attributes:
        name: what it does.
        path: times and parameters, the first ones at rest.
        inside: whether it belongs to the family that was trained.
    """

    name: str
    path: Sequence[tuple[float, np.ndarray]]
    inside: bool


def try_path(full, reduction, case: PathCase, floor: float, settings: MarchSettings) -> dict:
    """Errors and warnings on one path.

    Args:
        full: the full model.
        reduction: the reduced one.
        case: the path.
        floor: force norm below which a relative error means nothing.
        settings: how histories are solved.

    Returns:
        A row with the largest errors of displacement and forces over their largest size in the history, those of
        stress and plastic strain at the last step, whether the model warned, or why it has no answer.
    """
    row = {"name": case.name, "inside": case.inside}
    exact = march(full, case.path, settings)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            answer = march(reduction.model, case.path, settings)
        except HHRError as error:
            return {**row, "warned": True, "failed": str(error)}
    warned = any(issubclass(item.category, OutsideTrainingWarning) for item in caught)
    displacement, forces = largest_errors(full, reduction, answer, exact, floor)
    here, there = answer.points[-1], exact.points[-1]
    trained = reduction.model.trained.imbalance
    imbalance = max(sign.imbalance for sign in answer.signs)
    return {
        **row,
        "warned": warned,
        "displacement": displacement,
        "forces": forces,
        "stress_rr": relative_error(reduction.stress_everywhere(here)[:, 0], there.stress[:, 0]),
        "plastic_strain": relative_error(reduction.plastic_strain_everywhere(here), there.state.cumulated),
        "imbalance": imbalance / trained,
    }


def summarise_paths(rows: Iterable[dict]) -> dict:
    """The ``paths`` part of a report.

    ``silent_worst`` holds the largest errors outside of training that no warning told of, and ``false_alarms`` counts
    the paths inside that were warned of.
    """
    rows = list(rows)
    names = ("displacement", "forces", "stress_rr", "plastic_strain")
    inside, outside = ([row for row in rows if row["inside"] is side] for side in (True, False))
    silent = [row for row in outside if not row["warned"]]
    return {
        "inside": {name: summary([row.get(name, np.inf) for row in inside]) for name in names} if inside else None,
        "false_alarms": sum(row["warned"] for row in inside),
        "outside": {
            "n": len(outside),
            "warned": sum(row["warned"] for row in outside),
            "silent_worst": {name: max((row[name] for row in silent), default=0.0) for name in names[:2]},
        },
        "rows": rows,
    }
