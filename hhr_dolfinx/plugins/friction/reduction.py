"""Friction in the hyper-reduction: default recipes and stages."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from hhr_dolfinx.certify.constants import Stability
from hhr_dolfinx.certify.trust import TrustLimits
from hhr_dolfinx.contact.problem import DEPENDENT
from hhr_dolfinx.errors import NotSolvableError
from hhr_dolfinx.plugins.friction.calibration import calibrated
from hhr_dolfinx.plugins.friction.fields import FrictionalFields
from hhr_dolfinx.reduction.build import Draft
from hhr_dolfinx.reduction.interface import Reduction
from hhr_dolfinx.reduction.recipe import Deim, Enrich, ForceDeim, LoadNodes, Pod, Recipe, Rid

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


class FrictionReduction(Reduction):
    """See :class:`~hhr_dolfinx.reduction.interface.Reduction`."""

    def recipes(self) -> tuple[Recipe, ...]:
        """With more enrichment if contact rows are dependent."""
        usual = with_friction()
        return usual, replace(usual, enrichment=FURTHER)


REDUCTION = FrictionReduction()


def check_sticking(stability: Stability) -> None:
    """Raise NotSolvableError for a singular S of the RID: forces of sticking contacts are then undetermined.

    Without friction this may be correct for a body that only contact holds; with friction a second solution was found,
    10 % off.
    """
    if abs(stability.contact_definite) < DEPENDENT:
        raise NotSolvableError(
            "the contact rows are dependent on the modes without rigid motions, so that friction has several answers: "
            "enrich the basis further, enrichment=Enrich(2.0), as the usual recipe does where its first enrichment is "
            "too small, or take a condensed model"
        )


def check_forces(draft: Draft) -> None:
    """Forces of sticking contacts are determined."""
    check_sticking(draft.stability)


def complete_forces(draft: Draft) -> None:
    """Reconstruction of forces and slip outside of the RID."""
    shared = draft.shared
    with shared.log.stage("reconstruction", shared.task.announce):
        modes = shared.completion.force_modes
        fitted = FrictionalFields.fitted(shared.full.problem, draft.sets.A_lambda, modes)
        draft.fields = replace(draft.fields, interface=fitted)


def calibrate(draft: Draft) -> None:
    """The indicator of forces, calibrated by known histories."""
    shared = draft.shared
    with shared.log.stage("indicator", shared.task.announce):
        known = [item.histories for item in (shared.task.held_out, shared.snapshots) if item is not None]
        (draft.model,) = calibrated(draft.model, known, shared.log)
