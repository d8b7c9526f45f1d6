"""Stages of the hyper-reduction that inelastic bodies add."""

from __future__ import annotations

from hhr_dolfinx.reduction.build import Draft
from hhr_dolfinx.reduction.flow import check_margin, project_flow, training_tangents


def project_points(draft: Draft) -> None:
    """Gauss points of the RID."""
    shared = draft.shared
    with shared.log.stage("projection", shared.task.announce):
        assert shared.full.equilibrium is not None
        draft.flow = project_flow(shared.full.equilibrium, draft.basis, draft.sets)


def check_tangents(draft: Draft) -> None:
    """Smallest tangent margin at training states; 1, that of the elastic operator, if all states are elastic."""
    shared = draft.shared
    full = shared.full.equilibrium
    step = shared.recipe.tangents
    assert full is not None and step is not None
    with shared.log.stage("training_tangents", shared.task.announce):
        states = shared.once("tangents", lambda: training_tangents(full, shared.snapshots, step.states))
    with shared.log.stage("stability", shared.task.announce):
        draft.tangent_margin = check_margin(draft.model, states, step.least, draft.layers)
