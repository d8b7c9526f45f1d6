"""A switch of surfaces that slide by any length."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from hhr_dolfinx.plugins.nonmatching.node_to_surface import NodeToSurface
from hhr_dolfinx.plugins.sliding.slide import slide

if TYPE_CHECKING:
    from hhr_dolfinx.plugins.conformance.draft import SceneDraft


def sliding(draft: SceneDraft) -> SceneDraft:
    """Pairings are made again in each increment."""
    return replace(
        draft.of_other_meshes(),
        usual=NodeToSurface,
        full=lambda scene: slide(scene, condensed=False),
        condensed=slide,
    )
