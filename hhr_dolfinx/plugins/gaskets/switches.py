"""Switch of gaskets."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hhr_dolfinx.plugins.gaskets.pair_laws import GasketLayer

if TYPE_CHECKING:
    from hhr_dolfinx.plugins.conformance.draft import SceneDraft


def gasket(draft: SceneDraft, neutral: bool) -> SceneDraft:
    """A thin gasket between the blocks, that yields.

    Args:
        draft: scene to change.
        neutral: take a value without effect.
    """
    loading = ((0.0, 0.0), (1.0, 1e13)) if neutral else ((0.0, 0.0), (0.01, 0.5), (0.05, 1.0))
    return draft.with_contact_law(law=GasketLayer(loading=loading))
