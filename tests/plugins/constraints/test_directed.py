"""Displacements along directions of their own, and about an axis."""

import numpy as np
import pytest
from needs import needs
from scenes import block_scene

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.geometries import block

TURN = np.deg2rad(30.0)


def body(dim, constraints, displacements=(), loads=()):
    """A unit square or cube; a wall at its right side, x = 1, is out of reach."""
    return block_scene(
        "body",
        {"p": (0.1, 1.0)},
        lower=(0.0,) * dim,
        upper=(1.0,) * dim,
        cells=(2,) * dim,
        hypothesis="solid" if dim == 3 else "plane_strain",
        bodies=(hhr.Body(block.SOLID, 100.0, 0.3),),
        contacts=(hhr.Obstacle(block.side(0, upper=True), (1.0,) + (0.0,) * (dim - 1), 1.2),),
        displacements=displacements,
        loads=loads,
        constraints=constraints,
    )


BOTTOM = block.side(1, upper=False)
TOP = block.side(1, upper=True)


@needs("nodal_loads")
def test_a_body_follows_an_inclined_guide():
    """Held along a normal and driven along the guide at two nodes it moves as a whole, without
    strain.
    """
    normal, along = (-np.sin(TURN), np.cos(TURN)), (np.cos(TURN), np.sin(TURN))
    corner, other = (hhr.Nodes.near(place) for place in ((0.0, 0.0), (0.0, 1.0)))
    held = (
        hhr.DirectedDisplacement(corner, normal),
        hhr.DirectedDisplacement(other, normal),
        hhr.DirectedDisplacement(corner, along, "0.01 * p"),
    )
    scene = body(2, held)
    for model in (hhr.FullOrderModel(scene), hhr.condense(scene)):
        moved = model.solve(0.5).displacement().reshape(-1, 2)
        assert moved == pytest.approx(np.tile(0.005 * np.array(along), (len(moved), 1)), abs=1e-12)


@needs("floating", "nodal_loads")
def test_directions_about_an_axis_keep_the_distance():
    """A face that turns about an axis by tangential motions of 0.01 r at all nodes has no radial
    ones.
    """
    about = {"axis_point": (-1.0, 0.0, 0.5), "axis_direction": (0.0, 2.0, 0.0)}
    lower = hhr.Nodes(lambda x: np.isclose(x[1], 0.0))
    held = (
        hhr.DirectedDisplacement(lower, "radial", **about),
        hhr.DirectedDisplacement(lower, "tangential", **about),
    )
    full = hhr.FullOrderModel(
        body(3, held, (hhr.Displacement(BOTTOM, 1),), (hhr.Pressure(TOP, "p"),))
    )
    clamped = hhr.FullOrderModel(
        body(3, (), hhr.Displacement.clamp(BOTTOM, 3), (hhr.Pressure(TOP, "p"),))
    )
    # both directions and the height are all of a node's displacement
    assert full.solve(1.0).displacement() == pytest.approx(
        clamped.solve(1.0).displacement(), abs=1e-12
    )
    free = hhr.FullOrderModel(
        body(3, held[:1], (hhr.Displacement(BOTTOM, 1),), (hhr.Pressure(TOP, "p"),))
    )
    moved, points = free.solve(1.0).displacement().reshape(-1, 3), free.problem.points
    foot = np.isclose(points[:, 1], 0.0)
    away = points[foot] - (-1.0, 0.0, 0.5)
    assert np.abs((moved[foot] * away).sum(axis=1)).max() < 1e-12
    assert np.abs(moved[foot]).max() > 1e-5


@pytest.mark.parametrize(
    ("arguments", "why"),
    [(((0.0, 0.0),), "must be finite numbers, and not all zero"),
     ((("a", 1.0),), "must be finite numbers"),
     (((1.0, 0.0, 0.0),), "must have 2 components"),
     (("radial", 0.0, (0.0, 0.0)), "is on the axis"),
     (("radial", 0.0, (0.0, 0.0, 0.0)), "needs a point of 2 coordinates"),
     (("round",), "direction of the directed displacement")],
)  # fmt: skip
def test_mistakes_are_refused(arguments, why):
    with pytest.raises(SceneError, match=why):
        hhr.FullOrderModel(body(2, (hhr.DirectedDisplacement(BOTTOM, *arguments),)))
