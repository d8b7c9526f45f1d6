"""Stages of the hyper-reduction that frictional contact adds."""

from __future__ import annotations

from dataclasses import replace

from hhr_dolfinx.certify.trust import check_sticking
from hhr_dolfinx.models.frictional_fields import FrictionalFields
from hhr_dolfinx.reduction.build import Draft
from hhr_dolfinx.reduction.calibration import calibrated


def check_forces(draft: Draft) -> None:
    """Forces of sticking contacts are determined."""
    check_sticking(draft.stability)


def complete_forces(draft: Draft) -> None:
    """Reconstruction of forces and slip outside of the RID."""
    shared = draft.shared
    with shared.log.stage("reconstruction", shared.task.announce):
        modes = shared.completion.force_modes
        fitted = FrictionalFields.fitted(shared.full.problem, draft.sets.A_lambda, modes)
        draft.fields = replace(draft.fields, frictional=fitted)


def calibrate(draft: Draft) -> None:
    """The indicator of forces, calibrated by known histories."""
    shared = draft.shared
    with shared.log.stage("indicator", shared.task.announce):
        known = [item.histories for item in (shared.task.held_out, shared.snapshots) if item is not None]
        (draft.model,) = calibrated(draft.model, known, shared.log)
