"""Switches of inelastic bodies."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hhr_dolfinx.plugins.inelastic.laws import Norton, Orthotropic, Voce

if TYPE_CHECKING:
    from hhr_dolfinx.plugins.conformance.draft import SceneDraft

NEVER = 1e6
"""Yield stress that no stress reaches."""


def voce(draft: SceneDraft, neutral: bool) -> SceneDraft:
    """Plasticity with hardening; quadrilaterals of inelastic bodies have a mean dilatation.

    Args:
        draft: scene to change.
        neutral: take a yield stress that is never reached.
    """
    law = Voce(NEVER if neutral else 0.03, 0.03, 20.0, 0.1)
    return (draft.of_simplices() if neutral else draft).with_body_law(law)


def norton(draft: SceneDraft, neutral: bool) -> SceneDraft:
    """Creep.

    Args:
        draft: scene to change.
        neutral: take a resistance against creep that is never overcome.
    """
    law = Norton(NEVER if neutral else 0.2, 3.0)
    return (draft.of_simplices() if neutral else draft).with_body_law(law)


def orthotropic(draft: SceneDraft) -> SceneDraft:
    """Elasticity of wood, along turned axes."""
    axes = (0.8, 0.6, 0.0), (-0.6, 0.8, 0.0), (0.0, 0.0, 1.0)
    return draft.with_body_law(Orthotropic(9.0, 3.0, 1.5, 0.4, 0.3, 0.2, 1.0, 0.8, 0.3, axes))
