"""Stage of the hyper-reduction of contacts with laws: the indicator of forces, calibrated by known
histories.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from hhr_dolfinx.errors import HHRError
from hhr_dolfinx.models.answer import History
from hhr_dolfinx.models.reduced import ReducedModel
from hhr_dolfinx.plugins.paths.compared import retraced
from hhr_dolfinx.reduction.build import Draft
from hhr_dolfinx.reduction.kinds import MOST_TRAINING_COMPARED
from hhr_dolfinx.timing import StageLog

CALIBRATED = 0.95
"""Part of the training increments whose error lies below the indicator of forces."""
SMALL_FORCE = 1e-3
"""Part of the largest training force below which a relative error of forces is not meaningful."""
UNEXPLAINED_FORCES = 1e-9
"""Part of the forces unexplained by modes that counts as round-off."""
MOST_SHARE = 1e3
"""Error per part of the forces unexplained by modes, above which that part is arbitrary."""


def calibrate(draft: Draft) -> None:
    """Calibrate the indicator of forces by known histories, held out ones before training ones."""
    shared = draft.shared
    with shared.log.stage("indicator", shared.task.announce):
        known = [
            item.histories for item in (shared.task.held_out, shared.snapshots) if item is not None
        ]
        draft.model = _calibrated(draft.model, known, shared.log)


def _calibrated(
    model: ReducedModel, known: Sequence[Sequence[History]], log: StageLog
) -> ReducedModel:
    """The model with a calibrated indicator, by the first set of histories with usable
    increments.
    """
    largest = max(
        np.linalg.norm(answer.multipliers)
        for item in known
        for one in item
        for answer in one.answers
    )
    depth = 0.0
    shares = list[float]()
    for histories in known:
        for history in histories[:MOST_TRAINING_COMPARED]:
            try:
                found = retraced(model, history)
            except HHRError:  # the comparison reports it
                continue
            for here, there in zip(found.answers, history.answers, strict=True):
                fields: Any = here.fields
                inside, *at = fields.indicating(here)
                depth = max(depth, fields.interface.overlap(*at))
                said = fields.interface.misfit(inside)
                size = float(np.linalg.norm(there.multipliers))
                if size > SMALL_FORCE * largest and said > UNEXPLAINED_FORCES:
                    shares.append(
                        float(np.linalg.norm(here.forces() - there.multipliers)) / size / said
                    )
        if shares:
            break
    else:
        log.skip("calibration", "no known increment has forces that its modes leave unexplained")
    share = float(np.clip(np.quantile(shares, CALIBRATED), 1.0, MOST_SHARE)) if shares else 1.0
    own: Any = model.fields.interface
    return model.changed(
        fields=replace(model.fields, interface=replace(own, share=share, depth=depth))
    )
