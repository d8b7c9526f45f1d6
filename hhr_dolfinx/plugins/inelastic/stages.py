"""Stages of the hyper-reduction that inelastic bodies add."""

from __future__ import annotations

from hhr_dolfinx.plugins.inelastic.full_order import equilibrium_of
from hhr_dolfinx.plugins.inelastic.project import check_margin, project_flow, training_tangents
from hhr_dolfinx.reduction.build import Draft


def project_points(draft: Draft) -> None:
    """Gauss points of the RID."""
    shared = draft.shared
    with shared.log.stage("projection", shared.task.announce):
        draft.flow = project_flow(equilibrium_of(shared.full), draft.basis, draft.sets)


def check_tangents(draft: Draft) -> None:
    """Smallest tangent margin at training states; 1, that of the elastic operator, if all states are elastic."""
    shared = draft.shared
    full = equilibrium_of(shared.full)
    step = shared.recipe.tangents
    assert step is not None
    with shared.log.stage("training_tangents", shared.task.announce):
        states = shared.once("tangents", lambda: training_tangents(full, shared.snapshots, step.states))
    with shared.log.stage("stability", shared.task.announce):
        draft.tangent_margin = check_margin(draft.model, states, step.least, draft.layers)
