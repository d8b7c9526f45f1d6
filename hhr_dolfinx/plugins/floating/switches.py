"""A switch of bodies that contact alone holds."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hhr_dolfinx.plugins.conformance.draft import SceneDraft


def floating(draft: SceneDraft) -> SceneDraft:
    """The upper block is pressed by a pressure, and contact alone bears it."""
    return replace(draft, held=False)
