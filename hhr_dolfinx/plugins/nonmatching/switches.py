"""Switches of contact on meshes that do not match."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hhr_dolfinx.plugins.nonmatching.double_pass import DoublePass
from hhr_dolfinx.plugins.nonmatching.node_to_surface import NodeToSurface

if TYPE_CHECKING:
    from hhr_dolfinx.plugins.conformance.draft import SceneDraft


def node_to_surface(draft: SceneDraft) -> SceneDraft:
    """Nodes of the upper block on facets of the lower one."""
    return draft.with_pairing(NodeToSurface)


def double_pass(draft: SceneDraft) -> SceneDraft:
    """Nodes of both blocks on facets of the other."""
    return draft.with_pairing(DoublePass)
