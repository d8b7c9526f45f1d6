"""Shapes beside constraints, springs and moving tools, of which some act on the body that
changes.
"""

import dataclasses

import numpy as np
import pytest
from needs import needs

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import NotOfferedError, SceneError, ShapeError
from hhr_dolfinx.geometries.two_blocks import FIRST, SECOND, side, two_blocks

POINTS = ([0.04, 0.02, 0.006], [0.05, 0.0, -0.005], [0.03, 0.03, 0.01])
BY_RULE = 1e-7
"""The stiffness of a body with a shape has a rule of fewer points than that of other bodies."""

INTERPOLATED = 1e-5
"""Part of the largest force by which S between few shapes is off at most, also without what stands
beside it.
"""


def along(name, slope=1.0):
    return hhr.Amplitude(slopes={name: slope})


def at_flank(x):
    return hhr.Nodes(
        lambda points: np.isclose(points[0], x) & (points[1] > 1.6) & (points[1] < 1.9)
    )


PARTS = {
    "equation": {
        "constraints": (hhr.Equation(((at_flank(0.5), 0, 1.0), (at_flank(2.5), 0, -1.0))),)
    },
    "springs": {"loads": (hhr.Springs(side(SECOND, 0, True), 0, 1.0, bedding=True),)},
    "bedding of the shape": {"loads": (hhr.Springs(side(FIRST, 0, True), 0, 1.0, bedding=True),)},
    "equation of the shape": {
        "constraints": (
            hhr.Equation(
                ((hhr.Nodes.near((0.0, 2 / 3)), 0, 1.0), (hhr.Nodes.near((3.0, 2 / 3)), 0, -1.0))
            ),
        )
    },
    "tool": {
        "tools": (hhr.Circle(side(SECOND, 0, True), center=("3.495 - drag", 1.5), radius=1.0),)
    },
    "fixed tool at the shape": {
        "tools": (hhr.Circle(side(FIRST, 0, True), center=(3.998, 0.5), radius=1.0),)
    },
}


def crowned(crown=None, tools=(), **parts):
    """A block on another one, whose upper side has a crown that is a parameter, or of the mesh."""
    box = {"push": (0.0, 0.06), "drag": (0.0, 0.03)}
    if crown is None:
        box["crown"] = (-0.007, 0.01)
        parts["shapes"] = (hhr.Shape(FIRST, ("x", "y - crown * y * (x - 1.5)**2")),)

    def warped(points, tag):
        moved = points.copy()
        if tag == FIRST and crown is not None:
            moved[:, 1] -= crown * points[:, 1] * (points[:, 0] - 1.5) ** 2
        return moved

    blocks = ((0.0, 0.0), (3.0, 1.0), (9, 3)), ((0.5, 1.0), (2.5, 2.0), (7, 3))
    top = side(SECOND, 1, True)
    return hhr.Scene(
        name="crowned",
        geometry=lambda comm: two_blocks(comm, first=blocks[0], second=blocks[1], warp=warped),
        hypothesis="plane_strain",
        bodies=(hhr.Body(FIRST, 3.0, 0.3), hhr.Body(SECOND, 5.0, 0.3)),
        contacts=(hhr.NodeToSurface(side(SECOND, 1, False), side(FIRST, 1, True)), *tools),
        displacements=(
            *hhr.Displacement.clamp(side(FIRST, 1, False), 2),
            hhr.Displacement(top, 0, along("drag")),
            hhr.Displacement(top, 1, along("push", -1.0)),
        ),
        parameters=hhr.ParameterSpace(tuple(box), *map(list, zip(*box.values(), strict=True))),
        outputs=(hhr.ContactForce("force", 0, (0.0, 1.0)),),
        **parts,
    )


@needs("constraints", "nonmatching", "obstacles", "nodal_loads")
@pytest.mark.parametrize("name", PARTS)
def test_the_answer_is_that_of_a_mesh_of_this_shape(name):
    """In full and condensed, and with the derivatives of differences."""
    full = hhr.FullOrderModel(crowned(**PARTS[name]))
    mesh = hhr.FullOrderModel(crowned(POINTS[0][2], **PARTS[name]))
    answer, other = full.solve(POINTS[0]), mesh.solve(POINTS[0][:2])
    assert np.count_nonzero(answer.forces()) > 3
    assert answer.forces() == pytest.approx(other.forces(), abs=BY_RULE * other.forces().max())
    assert answer.displacement() == pytest.approx(other.displacement(), abs=BY_RULE * 0.04)
    condensed = hhr.condense(full, fields=True)
    for point in POINTS:
        exact, found = full.solve(point), condensed.solve(point)
        assert found.forces() == pytest.approx(
            exact.forces(), abs=INTERPOLATED * exact.forces().max()
        )
        assert found.displacement() == pytest.approx(exact.displacement(), abs=INTERPOLATED * 0.04)
    steps = 1e-3 * np.ptp([full.parameters.lower, full.parameters.upper], axis=0)
    gradient = full.solve(POINTS[0], gradient=True).outputs().gradient["force"]
    for slope, step in zip(gradient, np.diag(steps), strict=True):
        up, down = (
            full.solve(np.array(POINTS[0]) + sign * step).outputs()["force"] for sign in (1, -1)
        )
        assert slope == pytest.approx(
            (up - down) / (2 * step.max()), abs=1e-5 * np.abs(gradient).max()
        )


@needs("constraints", "nonmatching", "obstacles", "nodal_loads", "friction")
@pytest.mark.filterwarnings("ignore:4 of 10 nodes of slave surface")
def test_what_changes_with_a_shape_is_refused_by_name():
    rigid = hhr.RigidMotion(
        hhr.Nodes(lambda points: (points[0] > 2.5) & (points[1] > 0.2) & (points[1] < 1.1))
    )
    with pytest.raises(
        SceneError, match="coefficients of constraints are others than in the middle"
    ):
        hhr.FullOrderModel(crowned(constraints=(rigid,)))
    chosen = hhr.Nodes(lambda points: (points[1] > 0.996) & (points[1] < 1.001))
    model = hhr.FullOrderModel(crowned(loads=(hhr.Springs(chosen, 0, 1.0),)))
    with pytest.raises(ShapeError, match="springs are at other nodes than in the middle"):
        model.solve(POINTS[2])
    friction = hhr.NodeToSurface(side(FIRST, 1, True), side(SECOND, 1, False), law=hhr.Tresca(0.1))
    with pytest.raises(SceneError, match="have friction, which reads the areas of slave nodes"):
        hhr.FullOrderModel(dataclasses.replace(crowned(), contacts=(friction,)))
    tool = hhr.Circle(side(FIRST, 0, True), center=("4 - drag", 0.5), radius=1.0)
    with pytest.raises(
        NotOfferedError, match="contact 1 of scene 'crowned' is with a curved obstacle"
    ):
        hhr.FullOrderModel(crowned(tools=(tool,)))
