"""Switch of wear."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hhr_dolfinx.plugins.wear.pair_laws import ArchardWear

if TYPE_CHECKING:
    from hhr_dolfinx.plugins.conformance.draft import SceneDraft


def wear(draft: SceneDraft, neutral: bool) -> SceneDraft:
    """The blocks wear where they press.

    Args:
        draft: scene to change.
        neutral: take a value without effect.
    """
    return draft.with_contact_law(law=ArchardWear(constant=0.0 if neutral else 1e-3))
