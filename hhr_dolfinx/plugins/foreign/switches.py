"""Switch of foreign stiffness: K of the blocks as another code would write it."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

    from hhr_dolfinx.plugins.conformance.draft import SceneDraft
    from hhr_dolfinx.scene import Scene

DRAFTED = 3
"""Outputs that each draft has."""


def foreign(draft: SceneDraft, neutral: bool) -> SceneDraft:
    """K of both blocks, as another code would write it, times a factor.

    Args:
        draft: draft of the scene.
        neutral: True for the factor 1, which changes no answer.
    """
    draft = draft.of_hypothesis("solid")
    draft.exclude(draft.remade is not None, "the stiffness of a scene is stated once")
    return replace(draft, remade=partial(_remade, draft.exclude, 1.0 if neutral else 1.2))


def _remade(exclude: Callable[[bool, str], None], factor: float, scene: Scene) -> Scene:
    """The scene with the K of its bodies as blocks."""
    from hhr_dolfinx.plugins.foreign.export import blocks_of_scene
    from hhr_dolfinx.plugins.foreign.stiffness import ForeignStiffness

    unsupported = any(
        body.law or body.varies or body.stress or body.grading for body in scene.bodies
    )
    unsupported = unsupported or bool(scene.shapes) or scene.system is not None
    exclude(unsupported, "laws, moduli and shapes of bodies act in elements, of which K is the sum")
    tags = {body.tag for body in scene.bodies}
    loads = [(getattr(load, "tag", None), getattr(load, "bedding", False)) for load in scene.loads]
    integrals = any(tag in tags or bedding for tag, bedding in loads)
    exclude(integrals, "loads on bodies are integrals over elements, of which K is the sum")
    stresses = any(not hasattr(output, "contact") for output in scene.outputs[DRAFTED:])
    exclude(stresses, "outputs of stresses are those of elements, of which K is the sum")
    exclude(scene.order == 2, "cells of second order have faces that blocks of ours have not")
    blocks = [replace(block, factor=factor) for block in blocks_of_scene(scene)]
    system = ForeignStiffness(*blocks)
    return replace(scene, geometry=system.geometry, system=system)
