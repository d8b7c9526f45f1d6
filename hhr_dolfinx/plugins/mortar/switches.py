"""A switch of mortar contact."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hhr_dolfinx.plugins.mortar.pairing import Mortar

if TYPE_CHECKING:
    from hhr_dolfinx.plugins.conformance.draft import SceneDraft


def mortar(draft: SceneDraft) -> SceneDraft:
    """Mortar contact on meshes that do not match."""
    return draft.with_pairing(Mortar)
