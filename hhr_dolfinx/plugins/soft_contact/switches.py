"""Switch of soft contact."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hhr_dolfinx.plugins.soft_contact.pair_laws import SoftContact

if TYPE_CHECKING:
    from hhr_dolfinx.plugins.conformance.draft import SceneDraft


def soft_contact(draft: SceneDraft, neutral: bool) -> SceneDraft:
    """A pressure that grows with the overlap between the blocks.

    Args:
        draft: scene to change.
        neutral: take a value without effect.
    """
    return draft.with_contact_law(law=SoftContact(stiffness=1e13 if neutral else 50.0))
