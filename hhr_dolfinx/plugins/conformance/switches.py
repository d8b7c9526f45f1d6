"""Switches of what the core can do by itself."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import ufl

from hhr_dolfinx.amplitudes import Amplitude
from hhr_dolfinx.formulas import Formula
from hhr_dolfinx.geometries.two_blocks import FIRST, SECOND, side
from hhr_dolfinx.loads import Traction
from hhr_dolfinx.pairings.obstacle import Obstacle
from hhr_dolfinx.plugins.conformance.draft import FAR, LEFT_END, RIGHT_END
from hhr_dolfinx.scene import Displacement, Opening

if TYPE_CHECKING:
    from ufl.core.expr import Expr

    from hhr_dolfinx.plugins.conformance.draft import SceneDraft


def young(draft: SceneDraft, neutral: bool) -> SceneDraft:
    """Young's modulus of a block as a parameter.

    The lower block, or one that does not state its modulus itself.

    Args:
        draft: draft of the scene.
        neutral: add the capability with values that change no answer.
    """
    body = draft.hookean
    factor = float(body.young) / 3.0
    values = (2.0 * factor, 5.0 * factor, (3.0 if neutral else 3.9) * factor)
    draft = draft.with_parameter("E1", *values)
    return draft.with_body(body.tag, lambda body: replace(body, young="E1"))


def poisson(draft: SceneDraft, neutral: bool) -> SceneDraft:
    """Poisson's ratio of such a block as a parameter.

    Args:
        draft: draft of the scene.
        neutral: add the capability with values that change no answer.
    """
    draft = draft.with_parameter("nu1", 0.15, 0.4, 0.3 if neutral else 0.23)
    return draft.with_body(draft.hookean.tag, lambda body: replace(body, poisson="nu1"))


def opening(draft: SceneDraft, neutral: bool) -> SceneDraft:
    """A gap between the blocks that grows along the path.

    Args:
        draft: draft of the scene.
        neutral: add the capability with values that change no answer.
    """
    draft = draft.with_load_parameter("gap", 0.01, neutral)
    opened = Opening(0, Amplitude(slopes={"gap": 1.0}))
    return replace(draft, openings=(*draft.openings, opened))


def obstacle(draft: SceneDraft, neutral: bool) -> SceneDraft:
    """A rigid plane beside the lower block.

    Args:
        draft: draft of the scene.
        neutral: add the capability with values that change no answer.
    """
    offset = FAR if neutral else RIGHT_END + 0.0005
    return draft.with_obstacle(Obstacle(side(FIRST, 0, True), draft.vector(1.0, 0.0), offset))


def traction(draft: SceneDraft, neutral: bool) -> SceneDraft:
    """Shear on a flank of the lower block.

    Args:
        draft: draft of the scene.
        neutral: add the capability with values that change no answer.
    """
    draft = draft.with_load_parameter("shear", 0.02, neutral)
    amplitude = Amplitude(slopes={"shear": 1.0})
    return draft.with_loads(Traction(side(FIRST, 0, False), draft.vector(0.0, 1.0), amplitude))


def field_of_motion(draft: SceneDraft) -> SceneDraft:
    """A flank of the lower block is turned, by a formula of the coordinates."""
    draft = draft.with_load_parameter("turn", 0.01, neutral=False)
    turn = Amplitude(slopes={"turn": 1.0})
    height = Formula(draft.coordinates[1])
    turned = Displacement(draft.nodes(LEFT_END, 0.2, 1.1), 0, turn, height)
    return replace(draft, displacements=(*draft.displacements, turned))


def plane_stress(draft: SceneDraft) -> SceneDraft:
    """Plane stress."""
    return draft.of_hypothesis("plane_stress")


def axisymmetric(draft: SceneDraft) -> SceneDraft:
    """Two rings about the axis."""
    return draft.of_hypothesis("axisymmetric")


def solid(draft: SceneDraft) -> SceneDraft:
    """Two blocks in space."""
    return draft.of_hypothesis("solid")


def simplices(draft: SceneDraft) -> SceneDraft:
    """Triangles or tetrahedra."""
    return draft.of_simplices()


def graded(draft: SceneDraft, neutral: bool) -> SceneDraft:
    """A modulus of the lower block that changes across it.

    Args:
        draft: draft of the scene.
        neutral: add the capability with values that change no answer.
    """
    slope = 0.0 if neutral else 0.1

    def factor(x: Expr) -> Expr:
        return 1.0 + slope * (x[0] - LEFT_END)

    return draft.with_body(FIRST, lambda body: replace(body, grading=factor))


def own_elasticity(draft: SceneDraft) -> SceneDraft:
    """Linear elasticity of the upper block by a function of the strain."""

    def stress(strain: Expr) -> Expr:
        return 2.0 * strain + 3.0 * ufl.tr(strain) * ufl.Identity(3)

    return draft.with_body(SECOND, lambda body: replace(body, stress=stress))
