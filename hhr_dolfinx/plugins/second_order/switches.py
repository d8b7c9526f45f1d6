"""A switch of displacements of second order."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hhr_dolfinx.plugins.conformance.draft import SceneDraft


def second_order(draft: SceneDraft) -> SceneDraft:
    """Displacements of second order."""
    return draft.of_element("second order")
