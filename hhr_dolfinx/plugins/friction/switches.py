"""Switches of friction."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hhr_dolfinx.plugins.friction.pair_laws import Coulomb, Tresca

if TYPE_CHECKING:
    from hhr_dolfinx.plugins.conformance.draft import SceneDraft


def friction(draft: SceneDraft, neutral: bool) -> SceneDraft:
    """Coulomb's law between the blocks.

    Args:
        draft: scene to change.
        neutral: take a value without effect.
    """
    return draft.with_contact_law(friction=0.0 if neutral else 0.3)


def friction_by_formula(draft: SceneDraft, neutral: bool) -> SceneDraft:
    """Coulomb's coefficient as a parameter.

    Args:
        draft: scene to change.
        neutral: take a value without effect.
    """
    draft = draft.with_parameter("mu", 0.0, 0.4, 0.0 if neutral else 0.25)
    return draft.with_contact_law(friction=Coulomb("mu"))


def tresca(draft: SceneDraft, neutral: bool) -> SceneDraft:
    """Tresca's law between the blocks.

    Args:
        draft: scene to change.
        neutral: take a value without effect.
    """
    return draft.with_contact_law(friction=Tresca(0.0 if neutral else 0.02))
