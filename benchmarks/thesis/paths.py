"""What reduced models of histories do on paths inside and outside of what they were trained on."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from hhr_dolfinx.certify.accuracy import summary
from hhr_dolfinx.errors import HHRError, OutsideTrainingWarning
from hhr_dolfinx.full_order.full import FullOrderModel
from hhr_dolfinx.models.answer import History, Path
from hhr_dolfinx.models.histories.equilibrium import MarchSettings, told_once
from hhr_dolfinx.models.reduced import ReducedModel
from hhr_dolfinx.plugins.inelastic.study import history_errors

if TYPE_CHECKING:
    from hhr_dolfinx.plugins.inelastic.condensed_flow import CondensedFlowModel

    SmallModel = ReducedModel | CondensedFlowModel


@dataclass(frozen=True)
class PathCase:
    """A path to try.

    Attributes:
        name: what it does.
        path: times and parameters, the first ones at rest.
        inside: whether it belongs to the family that was trained.
    """

    name: str
    path: Path
    inside: bool


def try_path(
    full: FullOrderModel,
    models: Mapping[str, SmallModel],
    case: PathCase,
    floor: float,
    settings: MarchSettings,
) -> dict[str, dict[str, Any]]:
    """A row of errors and warnings on one path for each of some models, by name.

    It holds the largest errors of displacement and forces over their largest size in the history,
    those of stress and plastic strain at the last step, whether the model warned, or why it has no
    answer; ``floor`` is a force norm.
    """
    with told_once():
        exact = full.march(case.path, settings)
    return {name: _row(full, model, case, exact, floor, settings) for name, model in models.items()}


def _row(
    full: FullOrderModel,
    model: SmallModel,
    case: PathCase,
    exact: History,
    floor: float,
    settings: MarchSettings,
) -> dict[str, Any]:
    """What one model did on a path."""
    row = {"name": case.name, "inside": case.inside}
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            found = model.march(case.path, settings)
        except HHRError as error:
            return {**row, "warned": True, "failed": str(error)}
    warned = any(issubclass(item.category, OutsideTrainingWarning) for item in caught)
    errors = history_errors(full, model, found, exact, floor)
    trained: Any = model.trained
    return row | {
        "warned": warned,
        "displacement": errors["largest_displacement"],
        "forces": errors["largest_forces"],
        "stress_rr": errors["stress_rr_everywhere"],
        "plastic_strain": errors["plastic_strain_everywhere"],
        "estimate": max(sign.estimate for sign in found.signs) / trained.estimate,
    }


def summarise_paths(rows: Iterable[dict[str, Any]]) -> dict[str, Any]:
    """The ``paths`` part of a report.

    ``silent_worst`` holds the largest errors outside of training that no warning told of, and
    ``false_alarms`` counts the paths inside that were warned of.
    """
    rows = list(rows)
    names = ("displacement", "forces", "stress_rr", "plastic_strain")
    inside, outside = ([row for row in rows if row["inside"] is side] for side in (True, False))
    silent = [row for row in outside if not row["warned"]]
    return {
        "inside": {name: summary([row.get(name, np.inf) for row in inside]) for name in names}
        if inside
        else None,
        "false_alarms": sum(row["warned"] for row in inside),
        "outside": {
            "n": len(outside),
            "warned": sum(row["warned"] for row in outside),
            "silent_worst": {
                name: max((row[name] for row in silent), default=0.0) for name in names[:2]
            },
        },
        "rows": rows,
    }
