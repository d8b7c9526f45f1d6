"""Calibration of the force indicator of hyper-reduced contact with friction, by full-order histories."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from hhr_dolfinx.certify.compare import retraced
from hhr_dolfinx.errors import HHRError
from hhr_dolfinx.models.answer import History
from hhr_dolfinx.models.reduced import ReducedModel
from hhr_dolfinx.timing import StageLog

CALIBRATED = 0.95
"""Part of the training increments whose error lies below the indicator of forces."""
SMALL_FORCE = 1e-3
"""Part of the largest training force below which a relative error of forces is not meaningful."""
EXPLAINED = 1e-9
"""Part of the forces unexplained by modes that counts as round-off."""
MOST_SHARE = 1e3
"""Error per part of the forces unexplained by modes, above which that part is arbitrary."""
MOST_TRAINING_COMPARED = 50
"""Approximate number of training solutions that are compared if none were held out."""


def calibrated(model: Any, known: Sequence[Sequence[History]], log: StageLog) -> tuple[ReducedModel, ...]:
    """Models, the given one or its local ones, with a calibrated indicator of errors.

    Args:
        model: hyper-reduced with friction and elastic bodies, or several such models.
        known: sets of histories of the full model, held out ones before training ones; the first set with usable
            increments counts.
        log: records the skip if no set has any.
    """
    largest = max(np.linalg.norm(answer.multipliers) for item in known for one in item for answer in one.answers)
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
                inside, slack, scale = fields.indicating(here)
                depth = max(depth, fields.interface.overlap(slack, scale))
                said = fields.interface.misfit(inside)
                size = float(np.linalg.norm(there.multipliers))
                if size > SMALL_FORCE * largest and said > EXPLAINED:
                    shares.append(float(np.linalg.norm(here.forces() - there.multipliers)) / size / said)
        if shares:
            break
    else:
        log.skip("calibration", "no known increment has forces that its modes leave unexplained")
    share = float(np.clip(np.quantile(shares, CALIBRATED), 1.0, MOST_SHARE)) if shares else 1.0
    return tuple(_calibrated(one, share, depth) for one in model.members)


def _calibrated(model: ReducedModel, share: float, depth: float) -> ReducedModel:
    """The model with calibrated constants in its indicator."""
    own: Any = model.fields.interface
    return model.changed(fields=replace(model.fields, interface=replace(own, share=share, depth=depth)))
