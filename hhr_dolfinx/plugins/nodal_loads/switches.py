"""Switches of springs and forces at nodes."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hhr_dolfinx.amplitudes import Amplitude
from hhr_dolfinx.geometries.two_blocks import FIRST, side
from hhr_dolfinx.plugins.nodal_loads.loads import NodalForce, Nodes, Springs

if TYPE_CHECKING:
    from hhr_dolfinx.plugins.conformance.draft import SceneDraft

NO_STIFFNESS = 1e-12
"""Modulus of springs that resist nothing."""


def bedding(draft: SceneDraft, neutral: bool) -> SceneDraft:
    """A bedding of a flank of the lower block.

    Args:
        draft: the scene so far.
        neutral: add a value that changes nothing.
    """
    modulus = NO_STIFFNESS if neutral else 1.0
    return draft.with_loads(Springs(side(FIRST, 0, True), 0, modulus, bedding=True))


def springs(draft: SceneDraft, neutral: bool) -> SceneDraft:
    """A spring at a corner of the lower block.

    Args:
        draft: the scene so far.
        neutral: add a value that changes nothing.
    """
    corner = Nodes.near(tuple(map(float, draft.at(1.0, 1.0))))
    return draft.with_loads(Springs(corner, 0, NO_STIFFNESS if neutral else 0.5))


def nodal_force(draft: SceneDraft, neutral: bool) -> SceneDraft:
    """A force at a node of a flank of the lower block.

    Args:
        draft: the scene so far.
        neutral: add a value that changes nothing.
    """
    draft = draft.with_load_parameter("pull", 0.01, neutral)
    node = Nodes.near(tuple(map(float, draft.at(1.0, 0.6))))
    vector = draft.vector(-1.0, 0.5)
    return draft.with_loads(NodalForce(node, vector, Amplitude(slopes={"pull": 1.0})))
