"""Switches of rigid tools that forces drive."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from hhr_dolfinx import registry
from hhr_dolfinx.geometries.two_blocks import SECOND, side
from hhr_dolfinx.pairings import Pairing
from hhr_dolfinx.plugins.rigid_tools.drive import drive

if TYPE_CHECKING:
    from collections.abc import Callable

    from hhr_dolfinx.plugins.conformance.draft import SceneDraft
    from hhr_dolfinx.scene import Scene

THRUSTS = (0.01, 0.02, 0.05, 0.03, 0.015)
"""Forces on the tool along the path."""
SPAN = 1.1, 1.9
"""Heights of the ends of the tool, between the nodes at the ends of the flank: those are held."""


def driven_tool(draft: SceneDraft) -> SceneDraft:
    """A flat tool that a force presses on the right flank of the upper block, and that may turn."""
    axisymmetric = draft.kind.hypothesis == "axisymmetric"
    draft.exclude(axisymmetric, "a tool moves along the axis, and flanks lie beside it")
    draft.exclude("floating" not in registry.installed(), "where a force drives it, it floats")
    draft.exclude(draft.remade is not None, "matrices of another code have no cell of a tool")
    place = draft.flanks[1]
    number = 1 + len(draft.obstacles)
    at = tuple(float(value) for value in draft.at(place, 1.5))
    turns = 3 * draft.dimension - 4

    def remade(scene: Scene) -> Scene:
        return drive(scene, number, at=at, force={0: "-thrust", turns: 0.0})

    draft = draft.with_parameter("thrust", 0.005, 0.06, THRUSTS)
    draft = draft.with_obstacle(_flat(draft.exclude, place, draft.dimension))
    return replace(draft, remade=remade)


def _flat(exclude: Callable[[bool, str], None], place: float, dim: int) -> Pairing:
    """A flat tool with ends, at a place along the first axis."""
    name = "Profile" if dim == 2 else "RigidMesh"
    public = registry.named("public")
    exclude(name not in public, "tools with ends are curved obstacles")
    surface = side(SECOND, 0, True)
    if dim == 2:
        line = np.array([(place, height) for height in SPAN])
        return registry.load(public[name])(surface, curve=line, smooth=False)
    corners = np.array([(place, y, z) for y in SPAN for z in (-1.0, 2.0)])
    triangles = np.array([(0, 2, 1), (1, 2, 3)])
    return registry.load(public[name])(surface, mesh=(corners, triangles))
