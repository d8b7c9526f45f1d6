"""Conditions that two contacts state on one node are one: patch tests, whose pressure is 10
everywhere.
"""

import dataclasses

import numpy as np
import pytest
import split_interface
from needs import needs
from shell import invoke

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.geometries import block
from hhr_dolfinx.models.starts import KnownStatuses

POINT = {"press": 10.0}
LEFT, RIGHT = (
    hhr.NodeToNode(upper, lower, (0, -1))
    for upper, lower in zip(split_interface.UPPER, split_interface.LOWER, strict=True)
)
TURNED = hhr.NodeToNode(RIGHT.second, RIGHT.first, (0, 1))
"""Slave and master of the right half have changed their roles, and its force is that on the other
body.
"""


def values(answer):
    return dict(answer.outputs().items())


def test_two_contacts_share_the_node_between_them():
    """Nine nodes have nine conditions: two of them at one node would be a pressure of 20."""
    full = hhr.FullOrderModel(split_interface.scene((LEFT, RIGHT)))
    answer = full.solve(POINT)
    assert full.conditions == 9
    assert answer.pressure() == pytest.approx(np.full(9, 10.0), rel=1e-12)
    assert values(answer) == pytest.approx(split_interface.HALVES, abs=1e-12)
    assert full.problem.shares_of(0) + full.problem.shares_of(1) == pytest.approx(np.ones(9))


def test_roles_may_change_from_one_contact_to_the_next():
    found = values(hhr.FullOrderModel(split_interface.scene((LEFT, TURNED))).solve(POINT))
    expected = split_interface.HALVES | {"force 1": -10.0, "moment 1": -15.0}
    assert found == pytest.approx(expected, abs=1e-12)


def test_models_and_their_files_share_as_the_full_model_does(tmp_path):
    full = hhr.FullOrderModel(split_interface.scene((LEFT, RIGHT)))
    known = KnownStatuses(full.problem.middle[None], np.zeros((1, full.conditions), dtype=bool))
    model = hhr.exact_condensation(full, known)
    hhr.save_model(tmp_path / "model.npz", model)
    for item in (model, hhr.load_model(tmp_path / "model.npz")):
        assert values(item.solve(POINT)) == pytest.approx(split_interface.HALVES, abs=1e-11)


def test_the_command_says_the_force_of_each_contact(tmp_path):
    """One of two halves is 10; the parts of a body that is not split are those of its tags."""
    file = tmp_path / "halves.py"
    file.write_text(
        "import split_interface, test_common_conditions as t\n"
        "def scene(): return split_interface.scene((t.LEFT, t.RIGHT))\n"
    )
    code, output = invoke("solve", file, "--at", "press=10")
    assert code == 0, output
    sums = [
        line.rpartition(": ")[2]
        for line in output.splitlines()
        if line.startswith("sum of the forces")
    ]
    assert sums == ["10", "10"]


def test_one_plane_of_two_faces():
    """An obstacle for each half of the lower side of the upper block: the answer is that of one
    obstacle.
    """
    plane = [hhr.Obstacle(tag, (0, -1), 0.0) for tag in split_interface.UPPER]
    found = [
        hhr.FullOrderModel(split_interface.scene(pair, split=len(pair) == 2, outputs=())).solve(
            POINT
        )
        for pair in (plane, plane[:1])
    ]
    assert np.sort(found[0].pressure()) == pytest.approx(np.sort(found[1].pressure()), rel=1e-12)
    assert found[0].pressure() == pytest.approx(np.full(9, 20.0), rel=1e-12)  # E u / h


def test_a_step_and_a_corner_are_two_conditions_of_a_node():
    """Of two heights the higher one holds; planes of two directions hold in both."""
    heights = zip(split_interface.UPPER, (0.0, 0.5), strict=True)
    step = split_interface.scene([hhr.Obstacle(tag, (0, -1), offset) for tag, offset in heights])
    full = hhr.FullOrderModel(dataclasses.replace(step, outputs=()))
    assert full.conditions == 10 and full.problem.shares is None
    sides = {
        (axis, upper): block.side(axis, upper=upper) for axis in (0, 1) for upper in (False, True)
    }
    corner = hhr.Scene(
        name="corner",
        hypothesis="plane_strain",
        geometry=lambda comm: block.block(comm, lower=(0, 0), upper=(2, 1), cells=(4, 2)),
        bodies=(hhr.Body(block.SOLID, young=1e3, poisson=0.0),),
        contacts=(
            hhr.Obstacle(sides[1, False], (0, -1), 0.0),
            hhr.Obstacle(sides[0, False], (-1, 0), 0.0),
        ),
        displacements=(
            hhr.Displacement(sides[1, True], 1, hhr.Amplitude(slopes={"press": -1e-3})),
            hhr.Displacement(sides[0, True], 0, hhr.Amplitude(slopes={"press": -1e-3})),
        ),
        parameters=hhr.ParameterSpace(("press",), (0.0,), (20.0,)),
        outputs=(hhr.LargestPressure("floor", 0), hhr.LargestPressure("wall", 1)),
    )
    full = hhr.FullOrderModel(corner)
    assert full.problem.shares is None
    assert values(full.solve(POINT)) == pytest.approx(
        {"floor": 10.0, "wall": 5.0}
    )  # E u / h, E u / l


def test_openings_of_one_condition():
    """The same opening of both closes as one.

    Different ones contradict each other at the common node.
    """
    opening = hhr.Amplitude(slopes={"press": 2e-3})
    both = tuple(hhr.Opening(k, opening) for k in (0, 1))
    closed = hhr.FullOrderModel(split_interface.scene((LEFT, RIGHT), openings=both)).solve(POINT)
    assert closed.pressure() == pytest.approx(np.zeros(9), abs=1e-10)
    for some in (both[:1], (both[0], hhr.Opening(1, hhr.Amplitude(slopes={"press": 1e-3})))):
        with pytest.raises(
            SceneError,
            match=r"contact 0 of 61, 51 and contact 1 of 62, 52 share .* openings differ",
        ):
            hhr.FullOrderModel(split_interface.scene((LEFT, RIGHT), openings=some))


@needs("friction")
def test_laws_of_one_condition():
    """Both faces with one coefficient slip as one: work and areas of the halves add up to those of
    the whole.
    """
    pull = hhr.Displacement(
        split_interface.side(split_interface.SECOND, 1, upper=True),
        0,
        hhr.Amplitude(slopes={"pull": 1.0}),
    )
    box = hhr.ParameterSpace(("press", "pull"), (0.0, 0.0), (20.0, 0.1))
    path = [(0.0, (0.0, 0.0)), (1.0, (10.0, 0.0)), (2.0, (10.0, 0.05))]

    def marched(contacts, split_tags):
        outputs = [
            output
            for k in range(len(contacts))
            for output in (
                hhr.DissipatedWork(f"work {k}", k),
                hhr.SlipArea(f"slips {k}", k),
                hhr.StickArea(f"sticks {k}", k),
                hhr.FrictionForce(f"force {k}", k, (1.0, 0.0)),
            )
        ]
        scene = split_interface.scene(
            contacts, split=split_tags, parameters=box, outputs=tuple(outputs)
        )
        scene = dataclasses.replace(
            scene, displacements=(*scene.displacements[:2], scene.displacements[3], pull)
        )
        return values(hhr.FullOrderModel(scene).march(path).answers[-1])

    rough = [dataclasses.replace(pair, friction=0.3) for pair in (LEFT, RIGHT)]
    halves, whole = marched(rough, True), marched(rough[:1], False)
    for name in ("work", "slips", "sticks", "force"):
        assert halves[f"{name} 0"] + halves[f"{name} 1"] == pytest.approx(
            whole[f"{name} 0"], rel=1e-9, abs=1e-12
        )
    assert whole["force 0"] == pytest.approx(-6.0) and whole["work 0"] > 0
    with pytest.raises(
        SceneError, match=r"contact 0 of 61, 51 and contact 1 of 62, 52 share .* laws differ"
    ):
        hhr.FullOrderModel(split_interface.scene((rough[0], RIGHT)))


@needs("shapes")
def test_shares_follow_a_shape_of_the_bodies():
    """Blocks (1 + c) times as wide have as many times the forces, and the same pressure."""
    shape = ("x * (1 + c)", "y")
    box = hhr.ParameterSpace(("press", "c"), (0.0, -0.1), (20.0, 0.2))
    shapes = (hhr.Shape(split_interface.FIRST, shape), hhr.Shape(split_interface.SECOND, shape))
    scene = split_interface.scene((LEFT, RIGHT), shapes=shapes, parameters=box)
    found = values(hhr.FullOrderModel(scene).solve({"press": 10.0, "c": 0.2}))
    wide = {"pressure": 1.0, "force": 1.2, "width": 1.2, "lost": 1.0, "moment": 1.44}
    assert found == pytest.approx(
        {name: wide[name[:-2]] * value for name, value in split_interface.HALVES.items()}, abs=1e-10
    )
