"""A switch of outputs of contacts as a whole."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from hhr_dolfinx.plugins.resultants.outputs import ContactArea

if TYPE_CHECKING:
    from hhr_dolfinx.plugins.conformance.draft import SceneDraft


def contact_area(draft: SceneDraft, neutral: bool) -> SceneDraft:
    """The area of the blocks that is in contact, which changes no answer.

    Args:
        draft: the scene to extend.
        neutral: without effect, since an output changes no answer.
    """
    return replace(draft, outputs=(*draft.outputs, ContactArea("area", 0)))
