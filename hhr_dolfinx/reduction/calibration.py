"""What an indicator of forces says of hyper-reduced contact with friction: told by histories that are known."""

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
"""Part of the known increments whose error the indicator of forces is not below."""
SMALL_FORCE = 1e-3
"""Part of the largest known force below which a relative error of forces says nothing."""
EXPLAINED = 1e-9
"""Part of the forces that modes leave unexplained which is round-off."""
MOST_SHARE = 1e3
"""Error per part of the forces that modes leave unexplained, above which that part is a matter of chance."""
MOST_TRAINING_COMPARED = 50
"""Training solutions compared where none were held out, about."""


def calibrated(model: Any, known: Sequence[Sequence[History]], log: StageLog) -> tuple[ReducedModel, ...]:
    """The models that answer for one, itself or local ones, with what is known of how large errors are.

    Args:
        model: hyper-reduced, or several that take turns, with friction in which nothing flows.
        known: sets of histories of the full order, of which the first that say anything count: those held out, and
            those of training.
        log: told where none do.
    """
    largest = max(np.linalg.norm(answer.multipliers) for item in known for one in item for answer in one.answers)
    depth = 0.0
    shares = list[float]()
    for histories in known:
        for history in histories[:MOST_TRAINING_COMPARED]:
            try:
                found = retraced(model, history)
            except HHRError:  # which the comparison tells of
                continue
            for here, there in zip(found.answers, history.answers, strict=True):
                fields: Any = here.fields
                inside, slack, scale = fields.rubbed(here)
                depth = max(depth, fields.frictional.overlap(slack, scale))
                said = fields.frictional.misfit(inside)
                size = float(np.linalg.norm(there.multipliers))
                if size > SMALL_FORCE * largest and said > EXPLAINED:
                    shares.append(float(np.linalg.norm(here.forces() - there.multipliers)) / size / said)
        if shares:
            break
    else:
        log.skip("calibration", "no known increment has forces that its modes leave unexplained")
    share = float(np.clip(np.quantile(shares, CALIBRATED), 1.0, MOST_SHARE)) if shares else 1.0
    return tuple(_told(one, share, depth) for one in model.members)


def _told(model: ReducedModel, share: float, depth: float) -> ReducedModel:
    """A model whose indicator knows how large errors are."""
    frictional = model.fields.frictional
    assert frictional is not None
    return model.changed(fields=replace(model.fields, frictional=replace(frictional, share=share, depth=depth)))
