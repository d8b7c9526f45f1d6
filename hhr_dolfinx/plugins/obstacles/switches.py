"""Switches of curved rigid obstacles, beside the flanks of the blocks."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hhr_dolfinx.geometries.two_blocks import FIRST, SECOND, side
from hhr_dolfinx.plugins.obstacles.drawn import Profile, RigidMesh
from hhr_dolfinx.plugins.obstacles.rounds import Circle, Cone, Cylinder

if TYPE_CHECKING:
    from hhr_dolfinx.plugins.conformance.draft import SceneDraft

FAR = 100.0
CYLINDER_AXIS = (0.0, 0.0, 1.0)
"""Direction of the cylinders."""


def circle(draft: SceneDraft, neutral: bool) -> SceneDraft:
    """A circle, in space a cylinder, at the right flank of the upper block.

    Args:
        draft: the scene to extend.
        neutral: True for an obstacle that nothing reaches.
    """
    center = draft.flanks[1] + (1.0 + FAR if neutral else 0.995)
    flank = side(SECOND, 0, True)
    if draft.dimension == 3:
        return draft.with_obstacle(
            Cylinder(flank, point=(center, 1.5, 0.5), axis=CYLINDER_AXIS, radius=1.0)
        )
    return draft.with_obstacle(Circle(flank, center=(center, 1.5), radius=1.0))


def moving_circle(draft: SceneDraft, neutral: bool) -> SceneDraft:
    """A circle or cylinder that is pressed into the left flank of the lower block.

    Args:
        draft: the scene to extend.
        neutral: True for an obstacle that nothing reaches.
    """
    draft = draft.with_load_parameter("depth", 0.015, neutral)
    start = -FAR if neutral else 0.0
    center = f"{start} + depth"
    flank = side(FIRST, 0, False)
    if draft.kind.hypothesis == "axisymmetric":  # radii are positive: around the upper block
        start = draft.flanks[1] + (1.0 + FAR if neutral else 1.0)
        center = f"{start} - depth"
        flank = side(SECOND, 0, True)
    if draft.dimension == 3:
        return draft.with_obstacle(
            Cylinder(flank, point=(center, 0.5, 0.5), axis=CYLINDER_AXIS, radius=1.0)
        )
    height = 1.5 if draft.kind.hypothesis == "axisymmetric" else 0.5
    return draft.with_obstacle(Circle(flank, center=(center, height), radius=1.0))


def cone(draft: SceneDraft, neutral: bool) -> SceneDraft:
    """A cone in space, at the right flank of the upper block.

    Args:
        draft: the scene to extend.
        neutral: True for an obstacle that nothing reaches.
    """
    draft = draft.of_hypothesis("solid")
    tip = (draft.flanks[1] + (FAR if neutral else -0.003), 1.5, 0.5)
    flank = side(SECOND, 0, True)
    return draft.with_obstacle(Cone(flank, tip=tip, axis=(1.0, 0.0, 0.0), angle=75.0))


def profile(draft: SceneDraft, neutral: bool) -> SceneDraft:
    """A curve in the plane, at the right flank of the upper block.

    Args:
        draft: the scene to extend.
        neutral: True for an obstacle that nothing reaches.
    """
    draft.exclude(draft.dimension == 3, "a profile is a curve in the plane")
    height = np.linspace(0.5, 2.5, 21)
    curve = np.column_stack([0.3 * (height - 1.5) ** 2, height])
    shift = (draft.flanks[1] + (FAR if neutral else -0.002), 0.0)
    return draft.with_obstacle(Profile(side(SECOND, 0, True), curve=curve, place=shift))


def rigid_mesh(draft: SceneDraft, neutral: bool) -> SceneDraft:
    """A surface of triangles in space, at the right flank of the upper block.

    Args:
        draft: the scene to extend.
        neutral: True for an obstacle that nothing reaches.
    """
    draft = draft.of_hypothesis("solid")
    ridge = [(0.1 * abs(y - 1.5), y, z) for y in (0.0, 1.5, 3.0) for z in (-1.0, 2.0)]
    points = np.array(ridge)
    triangles = np.array([(0, 2, 1), (1, 2, 3), (2, 4, 3), (3, 4, 5)])
    # rays along its normals miss a mesh that is further away than it is large
    shift = (draft.flanks[1] + (1.0 if neutral else -0.001), 0.0, 0.0)
    flank = side(SECOND, 0, True)
    return draft.with_obstacle(RigidMesh(flank, mesh=(points, triangles), place=shift))
