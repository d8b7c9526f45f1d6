"""Switch of contact without separation."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hhr_dolfinx.plugins.no_separation.pair_laws import NoSeparation

if TYPE_CHECKING:
    from hhr_dolfinx.plugins.conformance.draft import SceneDraft


def no_separation(draft: SceneDraft) -> SceneDraft:
    """The blocks stay together where they have pressed.

    Args:
        draft: scene to change.
    """
    return draft.with_contact_law(law=NoSeparation())
