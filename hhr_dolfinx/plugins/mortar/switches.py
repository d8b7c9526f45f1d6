"""A switch of mortar contact."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hhr_dolfinx.plugins.mortar.pairing import Mortar

if TYPE_CHECKING:
    from hhr_dolfinx.plugins.conformance.draft import Draft


def mortar(draft: Draft) -> Draft:
    """Mortar contact on meshes that do not match."""
    return draft.with_pairing(Mortar)
