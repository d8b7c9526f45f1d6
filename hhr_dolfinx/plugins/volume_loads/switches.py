"""Switches of loads on whole bodies."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hhr_dolfinx.amplitudes import Amplitude
from hhr_dolfinx.formulas import Formula
from hhr_dolfinx.geometries.two_blocks import FIRST, SECOND
from hhr_dolfinx.plugins.volume_loads.loads import (
    BodyForce,
    Centrifugal,
    Eigenstrain,
    ThermalExpansion,
)

if TYPE_CHECKING:
    from hhr_dolfinx.plugins.conformance.draft import SceneDraft


def body_force(draft: SceneDraft, neutral: bool) -> SceneDraft:
    """Weight of the lower block.

    Args:
        draft: the scene so far.
        neutral: add a value that changes nothing.
    """
    draft = draft.with_load_parameter("weight", 0.02, neutral)
    amplitude = Amplitude(slopes={"weight": 1.0})
    return draft.with_loads(BodyForce(FIRST, draft.vector(0.0, -1.0), amplitude))


def centrifugal(draft: SceneDraft, neutral: bool) -> SceneDraft:
    """Rotation of the lower block.

    Args:
        draft: the scene so far.
        neutral: add a value that changes nothing.
    """
    draft = draft.with_load_parameter("w", 0.02, neutral)
    axis = (0.0, 1.0, 0.0) if draft.dimension == 3 else None
    return draft.with_loads(Centrifugal(FIRST, Formula("w"), axis_direction=axis))


def swelling(draft: SceneDraft, neutral: bool) -> SceneDraft:
    """Swelling of the upper block.

    Args:
        draft: the scene so far.
        neutral: add a value that changes nothing.
    """
    draft = draft.with_load_parameter("swelling", 0.01, neutral)
    return draft.with_loads(Eigenstrain(SECOND, Amplitude(slopes={"swelling": 1.0})))


def thermal(draft: SceneDraft, neutral: bool) -> SceneDraft:
    """Temperature of the lower block.

    Args:
        draft: the scene so far.
        neutral: add a value that changes nothing.
    """
    draft = draft.with_load_parameter("T", 10.0, neutral)
    return draft.with_loads(ThermalExpansion(FIRST, Formula("1e-3"), Formula("T")))
