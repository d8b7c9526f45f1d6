"""Friction in the hyper-reduction: default recipes, stages, and the calibration of the indicator of forces."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from hhr_dolfinx.certify.compare import retraced
from hhr_dolfinx.certify.trust import TrustLimits
from hhr_dolfinx.contact.problem import DEPENDENT
from hhr_dolfinx.errors import HHRError, NotSolvableError
from hhr_dolfinx.models.answer import History
from hhr_dolfinx.models.reduced import ReducedModel
from hhr_dolfinx.plugins.friction.fields import FrictionalFields
from hhr_dolfinx.reduction.build import Draft
from hhr_dolfinx.reduction.interface import Reduction
from hhr_dolfinx.reduction.modes import pod
from hhr_dolfinx.reduction.recipe import Deim, Enrich, ForceDeim, LoadNodes, Pod, Recipe, Rid
from hhr_dolfinx.reduction.reductor import MOST_TRAINING_COMPARED
from hhr_dolfinx.timing import StageLog

FORCES = 1e-6
"""Part of the squared training forces that their modes leave out."""
CALIBRATED = 0.95
"""Part of the training increments whose error lies below the indicator of forces."""
SMALL_FORCE = 1e-3
"""Part of the largest training force below which a relative error of forces is not meaningful."""
EXPLAINED = 1e-9
"""Part of the forces unexplained by modes that counts as round-off."""
MOST_SHARE = 1e3
"""Error per part of the forces unexplained by modes, above which that part is arbitrary."""
FURTHER = Enrich(2.0)
"""Enrichment of the usual recipe if its usual enrichment leaves contact rows dependent: only friction then holds a
body, and forces of sticking contacts need modes without its rigid motions."""


def with_friction(**changes: Any) -> Recipe:
    """Recipe for elastic bodies with friction: slip needs more modes, and a RID with most contacts that have it."""
    usual: dict[str, Any] = {
        "nodes": (Deim(), ForceDeim(1e-4), LoadNodes()),
        "domain": Rid(2, 4),
        "enrichment": Enrich(10.0),
        "trust": TrustLimits.of_histories(),
    }
    return Recipe(**({"basis": Pod(1e-10)} | usual | changes))


class _Reduction(Reduction):
    def recipes(self) -> tuple[Recipe, ...]:
        """With more enrichment if contact rows are dependent."""
        usual = with_friction()
        return usual, replace(usual, enrichment=FURTHER)


REDUCTION = _Reduction()


def check_forces(draft: Draft) -> None:
    """Raise NotSolvableError for a singular S of the RID: forces of sticking contacts are then undetermined.

    Without friction this may be correct for a body that only contact holds; with friction a second solution was found,
    10 % off.
    """
    if abs(draft.stability.contact_definite) < DEPENDENT:
        raise NotSolvableError(
            "the contact rows are dependent on the modes without rigid motions, so that friction has several answers: "
            "enrich the basis further, enrichment=Enrich(2.0), as the usual recipe does where its first enrichment is "
            "too small, or take a condensed model"
        )


def complete_forces(draft: Draft) -> None:
    """Reconstruction of forces and slip outside of the RID."""
    shared = draft.shared
    with shared.log.stage("reconstruction", shared.task.announce):
        modes = shared.once("modes of forces", lambda: pod(shared.snapshots.forces, FORCES)[0])
        fitted = FrictionalFields.fitted(shared.full.problem, draft.sets.A_lambda, modes)
        draft.fields = replace(draft.fields, interface=fitted)


def calibrate(draft: Draft) -> None:
    """Calibrate the indicator of forces by known histories, held out ones before training ones."""
    shared = draft.shared
    with shared.log.stage("indicator", shared.task.announce):
        known = [item.histories for item in (shared.task.held_out, shared.snapshots) if item is not None]
        draft.model = _calibrated(draft.model, known, shared.log)


def _calibrated(model: ReducedModel, known: Sequence[Sequence[History]], log: StageLog) -> ReducedModel:
    """The model with a calibrated indicator, by the first set of histories with usable increments."""
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
    own: Any = model.fields.interface
    return model.changed(fields=replace(model.fields, interface=replace(own, share=share, depth=depth)))
