"""Blocks of other codes that constraints hold, and whose surfaces slide: as our own bodies."""

from dataclasses import replace

import pytest
from foreign_formats import FLANK, FLOOR, HIGH, LOW, TOP, own_scene
from needs import needs

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import NotSolvableError

pytestmark = needs("nonmatching")

POINTS = (2.0, 0.1), (15.0, -0.4)


def as_blocks(scene):
    """The scene with the K of its bodies as blocks."""
    system = hhr.ForeignStiffness(*hhr.blocks_of_scene(scene))
    return replace(scene, geometry=system.geometry, bodies=system.bodies, system=system)


def assert_alike(theirs, ours, rel):
    """Numbers of ours are theirs, which also say what they were compared with."""
    assert {name: theirs[name] for name in ours} == pytest.approx(dict(ours), rel=rel)


def tied(**changes):
    """The upper block, which no support holds, is tied to the lower one and pressed on a wall."""
    given = dict(
        contacts=(hhr.Obstacle(FLANK, (1.0, 0.0, 0.0), 2.0001),),
        displacements=hhr.Displacement.clamp(FLOOR, 3),
        constraints=(hhr.Tie(HIGH, LOW),),
        outputs=(
            hhr.ContactForce("force", 0, direction=(-1.0, 0.0, 0.0)),
            hhr.DisplacementAt("moved", (0.0, 0.0, 2.001), 1),
        ),
    )
    return own_scene(**(given | changes))


@needs("constraints", "mortar")
def test_a_block_that_a_tie_holds_is_as_our_own_body():
    ours, theirs = (hhr.FullOrderModel(scene) for scene in (tied(), as_blocks(tied())))
    assert not theirs.problem.held_by_contact
    for point in POINTS:
        expected = ours.outputs(point)
        assert expected["force"] > 0
        assert_alike(theirs.outputs(point), expected, 1e-9)


@needs("constraints", "mortar", "floating")
def test_a_tied_pair_that_contact_alone_holds_has_the_motions_of_one_body():
    """Both blocks stand on a floor, tied: they turn and slide as one, three motions less."""
    floor = hhr.Obstacle(FLOOR, (0.0, 0.0, -1.0), 0.0001)
    on_sides = [hhr.Displacement(FLANK, k) for k in (0, 1)]
    scene = tied(contacts=(floor,), displacements=on_sides, outputs=(
        hhr.ContactForce("force", 0, direction=(0.0, 0.0, 1.0)),
    ))  # fmt: skip
    ours, theirs = (hhr.FullOrderModel(one) for one in (scene, as_blocks(scene)))
    for point in POINTS:
        # four square units of the top are pressed
        assert theirs.outputs(point)["force"] == pytest.approx(4 * point[0], rel=1e-8)
        assert_alike(theirs.outputs(point), ours.outputs(point), 1e-8)


@needs("constraints", "mortar", "floating")
def test_without_the_tie_nothing_holds_the_upper_block():
    scene = as_blocks(tied(constraints=(), contacts=(hhr.Obstacle(FLANK, (1.0, 0, 0), 2.1),)))
    with pytest.raises(NotSolvableError, match=r"block 'body_2' of scene 'own'"):
        hhr.FullOrderModel(scene)


@needs("constraints")
def test_surfaces_of_couplings_travel_with_their_blocks():
    coupled = own_scene(loads=(hhr.CoupledForce(TOP, 2, "-4 * push + pull"),))
    ours, theirs = (hhr.FullOrderModel(one) for one in (coupled, as_blocks(coupled)))
    for point in POINTS:
        assert_alike(theirs.outputs(point), ours.outputs(point), 1e-9)


@needs("sliding", "friction")
@pytest.mark.parametrize("beside", [(), (hhr.Obstacle(FLOOR, (0.0, 0.0, -1.0), 0.001),)])
def test_surfaces_of_blocks_slide_as_ours(beside):
    """Also beside a plane obstacle, whose conditions are no curved tool's."""
    contacts = (hhr.NodeToSurface(HIGH, LOW, friction=0.2), *beside)
    moved = own_scene(contacts=contacts, displacements=(
        *hhr.Displacement.clamp(side_of_lower(), 3),
        hhr.Displacement(FLANK, 0, "0.02 * pull"), *hhr.Displacement.clamp(FLANK, 3)[1:],
    ))  # fmt: skip
    path = [(0.0, (1.0, 0.0)), (1.0, (10.0, 0.2)), (2.0, (20.0, 0.5))]
    ours, theirs = (
        hhr.slide(scene).march(path).answers[-1].outputs() for scene in (moved, as_blocks(moved))
    )
    assert ours["force"] > 0
    assert_alike(theirs, ours, 1e-8)


def side_of_lower():
    """The left flank of the lower block."""
    from hhr_dolfinx.geometries.two_blocks import FIRST, side

    return side(FIRST, 0, False)
