"""Stage of the hyper-reduction of contacts with laws: the indicator of forces, calibrated by known
histories.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, cast

import numpy as np

from hhr_dolfinx.errors import HHRError
from hhr_dolfinx.models.answer import History
from hhr_dolfinx.models.reduced import ReducedModel
from hhr_dolfinx.plugins.paths.compared import retraced
from hhr_dolfinx.reduction.build import Draft
from hhr_dolfinx.reduction.kinds import MOST_TRAINING_COMPARED
from hhr_dolfinx.timing import StageLog

if TYPE_CHECKING:
    from hhr_dolfinx.models.reconstruct import Reconstruction
    from hhr_dolfinx.plugins.exact_errors.fitted import FittedForces

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
        histories = [
            snapshots.histories
            for snapshots in (shared.task.held_out, shared.snapshots)
            if snapshots is not None
        ]
        draft.model = _calibrated(draft.model, histories, shared.log)


def _calibrated(
    model: ReducedModel, known: Sequence[Sequence[History]], log: StageLog
) -> ReducedModel:
    """The model with a calibrated indicator.

    The first set of histories with usable increments calibrates it.
    """
    largest = max(
        np.linalg.norm(answer.multipliers)
        for set_of_histories in known
        for trajectory in set_of_histories
        for answer in trajectory.answers
    )
    depth = 0.0
    shares = list[float]()
    for histories in known:
        for history in histories[:MOST_TRAINING_COMPARED]:
            try:
                marched = retraced(model, history)
            except HHRError:  # the comparison reports it
                continue
            for predicted, exact in zip(marched.answers, history.answers, strict=True):
                fields = cast("Reconstruction", predicted.fields)
                completion = cast("FittedForces", fields.interface)
                forces_of_rid, slack, scale, memory = fields.indicating(predicted)
                depth = max(depth, completion.overlap(slack, scale, memory))
                misfit = completion.misfit(forces_of_rid)
                size = float(np.linalg.norm(exact.multipliers))
                if size > SMALL_FORCE * largest and misfit > UNEXPLAINED_FORCES:
                    shares.append(
                        float(np.linalg.norm(predicted.forces() - exact.multipliers))
                        / size
                        / misfit
                    )
        if shares:
            break
    else:
        log.skip("calibration", "no known increment has forces that its modes leave unexplained")
    share = float(np.clip(np.quantile(shares, CALIBRATED), 1.0, MOST_SHARE)) if shares else 1.0
    interface = model.fields.interface
    return model.changed(
        fields=replace(model.fields, interface=replace(interface, share=share, depth=depth))
    )
