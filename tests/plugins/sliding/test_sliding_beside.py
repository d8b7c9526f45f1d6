"""Pairs that slide beside what does not: obstacles and tools, openings, imposed nodes, constraints,
the energy.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import sliding_punch as demo
from mpi4py import MPI
from needs import needs
from scenes import pair_scene, slope
from sliding_scenes import DOWN, LOWER, OPENINGS, ROUND_TRIP, UPPER, mirrored

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import FarSlidingWarning, SceneError, SceneWarning
from hhr_dolfinx.geometries.two_blocks import FIRST, SECOND, side, two_blocks
from hhr_dolfinx.plugins.sliding.repairing import idle_contacts

CELLS = 60
NOTHING = hhr.Amplitude()


def full_order(scene):
    return hhr.FullOrderModel(scene, MPI.COMM_SELF)


@pytest.mark.parametrize(
    ("pairing", "opening", "condensed"),
    [
        (hhr.NodeToSurface, "of the tools", True), (hhr.Mortar, "of the tools", False),
        (hhr.NodeToSurface, "added", False), (hhr.Mortar, "added", True),
        (hhr.NodeToSurface, "overwritten", True), (hhr.Mortar, "overwritten", False),
    ],
)  # fmt: skip
@needs("obstacles", "stress")
def test_what_does_not_slide_has_the_answers_of_the_full_order(
    pairing, opening, condensed, tmp_path
):
    """Images do not slide past each other, so that rows made again are those of the mesh: all
    digits agree.
    """
    scene = mirrored(pairing, openings=OPENINGS[opening])
    full = full_order(scene)
    model = hhr.slide(scene, condensed=condensed)
    if condensed:
        hhr.save_model(tmp_path / "model.npz", model)
        model = hhr.load_model(tmp_path / "model.npz")
    ours, exact = (one.march(ROUND_TRIP).answers for one in (model, full))
    statuses: set[int] = set()
    for found, wanted in zip(ours, exact, strict=True):
        outputs, known = found.outputs(), wanted.outputs()
        for name, value in known.items():
            scale = max(abs(answer.outputs()[name]) for answer in exact)
            assert outputs[name] == pytest.approx(value, abs=1e-10 * scale), name
        field = wanted.displacement()
        np.testing.assert_allclose(found.displacement(), field, atol=1e-11)
        contacts = wanted.slip.path.size
        for name in ("position", "path", "work", "pressure", "bound"):
            expected = getattr(wanted.slip, name)
            got = getattr(found.slip, name)[-expected.size :]
            np.testing.assert_allclose(
                got, expected, atol=1e-10 * max(1e-3, np.abs(expected).max())
            )
        # contacts of both images about to slip may round to either status
        np.testing.assert_array_equal(found.slip.statuses[-contacts:] > 0, wanted.slip.statuses > 0)
        statuses |= set(wanted.slip.statuses.tolist())
        # half u K u, by the stiffness
        energy = 0.5 * float(field @ (full.problem.stiffness @ field))
        assert known["energy"] == pytest.approx(energy, rel=1e-9, abs=1e-12)
        normal = full.problem.pressing & (full.problem.contact_pairs == 0)
        pressures = np.sort(model.pressures(found)[: normal.sum()])
        np.testing.assert_allclose(
            pressures, np.sort(wanted.forces()[normal]), atol=1e-10 * (1 + pressures.max())
        )
        assert model.pressures(found).sum() == pytest.approx(
            wanted.forces()[full.problem.pressing].sum(), rel=1e-9
        )
    assert statuses == {0, 1, 2}
    between = [answer.outputs()["between"] for answer in exact]
    assert min(between) == 0.0 and max(between) > 0.1


def between(scene, way, condensed=True):
    """Outputs of a punch that is pushed, and drawn to a way by steps, without friction."""
    model = hhr.slide(scene, condensed=condensed)
    ways = np.linspace(0.0, way, 5)
    path = [(0.0, (0.0, 0.0)), *((1.0 + k, (demo.PUSH, x)) for k, x in enumerate(ways))]
    return model.march(path).answers[-1].outputs()


def walled(**mesh) -> hhr.Scene:
    """The punch on a block that is pressed between a plane, with friction, and a circle.

    Both far from its start.
    """
    scene = demo.scene(None, cells=CELLS, **mesh)
    plane = hhr.Obstacle(side(FIRST, 0, True), (1.0, 0.0), 6.0, friction=0.2)
    circle = hhr.Circle(side(FIRST, 0, False), center=(-7.0, -1.0), radius=1.0)
    wall = hhr.ContactForce("wall", 1, (1.0, 0.0)), hhr.ContactForce("round", 2, (1.0, 0.0))
    rubs = hhr.ContactForce("rubs", 1, (0.0, 1.0))
    return dataclasses.replace(
        scene, contacts=(*scene.contacts, plane, circle), outputs=(*scene.outputs, *wall, rubs)
    )


@needs("obstacles")
def test_what_stands_beside_a_punch_feels_where_it_has_come_to():
    """A punch meshed there and pushed presses the plane as much, a hundred times what it does where
    it began.

    The circle is left. Rows on the deformed place instead of the mesh differ by 0.13 %.
    """
    way = 8.0
    found = between(walled(), way)
    path = [(0.0, (0.0, 0.0)), (1.0, (demo.PUSH, 0.0))]
    there, here = (
        full_order(walled(start=demo.START + x)).march(path).answers[-1].outputs()
        for x in (way, 0.0)
    )
    assert abs(there["wall"]) > 100 * abs(here["wall"]) and here["round"] > 0.5
    assert found["round"] == there["round"] == 0.0
    for name in ("pressed", "wall", "rubs"):
        assert found[name] == pytest.approx(there[name], rel=3e-3), name
    assert abs(found["rubs"]) == pytest.approx(0.2 * abs(found["wall"]), rel=1e-9)


@needs("obstacles", "stress")
def test_energy_is_that_of_the_displacement():
    """Half u K u, by the stiffness, where surfaces slide with friction and bear forces at a slack
    that is not zero.
    """
    scene = walled()
    pair = dataclasses.replace(scene.contacts[0], friction=0.3)
    outputs = (*scene.outputs, hhr.ElasticEnergy("energy"))
    scene = dataclasses.replace(scene, contacts=(pair, *scene.contacts[1:]), outputs=outputs)
    stiffness = full_order(walled()).problem.stiffness
    for condensed in (True, False):
        for answer in hhr.slide(scene, condensed=condensed).march(demo.path(4)).answers[1:]:
            field = answer.displacement()
            assert answer.outputs()["energy"] == pytest.approx(
                0.5 * field @ (stiffness @ field), rel=1e-9
            )


def opened(scene, *amplitudes, overwrites=False) -> hhr.Scene:
    """The scene with openings of its first contact."""
    made = [
        hhr.Opening(0, amplitude, overwrites=overwrites and not k)
        for k, amplitude in enumerate(amplitudes)
    ]
    return dataclasses.replace(scene, openings=tuple(made))


@pytest.mark.parametrize("pairing", [hhr.NodeToSurface, hhr.Mortar])
@pytest.mark.parametrize("height", [0.01, -0.01])
def test_an_opening_is_a_punch_meshed_higher(height, pairing):
    """Forces change by more than a quarter by the opening, and by 0.1 % as normals are tilted by a
    hundredth.
    """
    plain = demo.scene(None, cells=CELLS)
    plain = dataclasses.replace(plain, contacts=(pairing(*plain.contacts[0].tags),))
    higher = dataclasses.replace(
        plain, geometry=lambda comm: demo.geometry(comm, CELLS, height=height)
    )
    wanted = between(higher, 3.0)["pressed"]
    found = between(opened(plain, hhr.Amplitude(0.4 * height), hhr.Amplitude(0.6 * height)), 3.0)[
        "pressed"
    ]
    assert abs(between(plain, 3.0)["pressed"] - wanted) > 0.25 * wanted
    assert found == pytest.approx(wanted, rel=3e-3)


def flat(height: float) -> hhr.Scene:
    """A punch with a flat end at some height above the block."""
    lower, upper = ((-6.0, -4.0), (6.0, 0.0), (CELLS, 15)), ((-1.0, 0.0), (1.0, 1.0), (12, 6))

    def warp(points, tag):
        return points if tag == FIRST else points + np.array([demo.START, height])

    scene = demo.scene(None)
    return dataclasses.replace(
        scene, geometry=lambda comm: two_blocks(comm, first=lower, second=upper, warp=warp)
    )


def test_an_opening_that_overwrites_is_a_punch_meshed_there():
    """Whatever the mesh has between the surfaces, and wherever they slide, the gap is that of the
    opening.
    """
    wanted = between(flat(0.01), 3.0)["pressed"]
    found = between(
        opened(flat(0.03), hhr.Amplitude(0.004), hhr.Amplitude(0.006), overwrites=True), 3.0
    )["pressed"]
    assert abs(between(flat(0.03), 3.0)["pressed"]) < 1e-3 * wanted
    assert found == pytest.approx(wanted, rel=3e-3)
    beyond = opened(
        dataclasses.replace(flat(0.01), contacts=(hhr.NodeToSurface(LOWER, UPPER),)),
        NOTHING,
        overwrites=True,
    )
    with (
        pytest.warns(match="beyond the edge"),
        pytest.raises(SceneError, match="face nothing as meshed: the gap"),
    ):
        hhr.slide(beyond)


def test_imposed_nodes_of_a_surface_keep_their_motion():
    """A punch all of whose lower side is imposed is a stiff one: a million times stiffer, forces
    agree to 1e-4.
    """
    scene = demo.scene(None, cells=CELLS)
    imposed = tuple(dataclasses.replace(item, tag=UPPER) for item in scene.displacements[2:])
    rigid = dataclasses.replace(scene, displacements=(*scene.displacements, *imposed))
    stiff = dataclasses.replace(scene, bodies=(scene.bodies[0], hhr.Body(SECOND, 1e9, 0.3)))
    wanted = between(stiff, 3.0)["pressed"]
    for condensed in (True, False):
        assert between(rigid, 3.0, condensed)["pressed"] == pytest.approx(wanted, rel=1e-4)
    assert abs(wanted - between(scene, 3.0)["pressed"]) > 0.03 * wanted
    # the same motion by a field, of a formula of the coordinates that is 1 at all nodes
    fields = tuple(dataclasses.replace(item, field="1 + 0 * x") for item in imposed)
    by_field = dataclasses.replace(rigid, displacements=(*scene.displacements, *fields))
    assert between(by_field, 3.0)["pressed"] == pytest.approx(
        between(rigid, 3.0)["pressed"], rel=1e-12
    )


def halves(cells: int, left: float) -> hhr.Scene:
    """A flat block and a round one, whole from -1 or their half from the plane of symmetry, whose
    nodes are imposed.
    """

    def warp(points, tag):
        x, y = points.T
        return points if tag == FIRST else np.column_stack([x, y + 0.1 * x**2 * (2 - y)])

    flanks = (
        [hhr.Displacement(side(body, 0, False), 0) for body in (FIRST, SECOND)]
        if left == 0.0
        else []
    )
    faces = side(SECOND, 1, False), side(FIRST, 1, True)
    return pair_scene(
        "half",
        {"push": (0.0, 0.1)},
        ((left, 0.0), (1.0, 1.0), (cells, 4)),
        ((left, 1.0), (1.0, 2.0), (cells, 4)),
        ((100.0, 0.3), (300.0, 0.3)),
        warp=warp,
        contacts=(hhr.NodeToSurface(*faces, DOWN, friction=0.1),),
        displacements=(
            *flanks,
            *hhr.Displacement.clamp(side(FIRST, 1, False), 2),
            hhr.Displacement(side(SECOND, 1, True), 0),
            hhr.Displacement(side(SECOND, 1, True), 1, slope("push", -1.0)),
        ),
        outputs=(
            hhr.ContactForce("force", 0, (0.0, 1.0)),
            hhr.DisplacementAt("sunk", (0.5, 1.0), 1, tag=FIRST),
        ),
    )


def test_half_a_model_has_half_its_force():
    """Slave and master nodes on the plane of symmetry are imposed along it: their tangential rows
    are.
    """
    path = [(float(k), (0.02 * k,)) for k in range(6)]
    whole, half = (
        hhr.slide(halves(cells, left)).march(path).answers[-1].outputs()
        for cells, left in ((16, -1.0), (8, 0.0))
    )
    assert half["force"] > 1.0
    assert 2 * half["force"] == pytest.approx(whole["force"], rel=1e-8)
    assert half["sunk"] == pytest.approx(whole["sunk"], rel=1e-8)


def test_contacts_without_compliance_are_left_out():
    """Rows of imposed dofs, and repeated ones, whose pressures have no single value.

    Opposite ones are two.
    """
    rows = np.array(
        [[1.0, 0, 0], [0, 0, 0], [0.5, 0.5, 0], [1.0, 0, 0], [-1.0, 0, 0], [0.5, 0.5, 1e-3]]
    )
    spring = np.array([[2.0, 0.3, 0.1], [0.3, 1.0, 0.2], [0.1, 0.2, 3.0]])
    assert idle_contacts(rows @ spring @ rows.T).tolist() == [
        False,
        True,
        False,
        True,
        False,
        False,
    ]


def test_a_punch_beyond_the_edge_bears_trescas_limit_where_it_faces_the_block():
    """Nodes beyond the edge have no row: the limit at any pressure was theirs too, though nothing
    touches there.
    """
    box = hhr.ParameterSpace(("push", "way"), (0.0, 0.0), (0.05, 40.0))
    limit = 0.5
    scene = dataclasses.replace(demo.scene(hhr.Tresca(limit), cells=CELLS), parameters=box)
    model = hhr.slide(scene)
    ways = np.linspace(0.0, 9.5, 20)
    answer = model.march(
        [(0.0, (0.0, 0.0)), *((1.0 + k, (demo.PUSH, x)) for k, x in enumerate(ways))]
    ).answers[-1]
    # the edge moves aside by a hundredth
    beyond = model.slave_points()[:, 0] + answer.parameter[1] - 6.0
    outside, inside = beyond > 0.05, beyond < -0.05
    assert outside.any() and not answer.slip.bound[outside].any()
    np.testing.assert_allclose(
        answer.slip.bound[inside], limit * model.law.area[inside], rtol=1e-12
    )


@needs("obstacles", "shapes", "inelastic")
def test_refusals_name_the_pair_the_body_and_the_reason():
    scene = walled()
    pair, plane, circle = scene.contacts
    double = hhr.DoublePass(*pair.tags)
    box = scene.parameters
    changes = {
        "contact 0 .* DoublePass.* rows of both passes become dependent": {
            "contacts": (double, plane, circle)
        },
        "no contact .* has two surfaces that slide": {"contacts": (plane, circle), "outputs": ()},
        f"shape of body {FIRST} .* depends on parameters": {
            "shapes": (hhr.Shape(FIRST, ("x", "y * (1 + wide)")),),
            "parameters": hhr.ParameterSpace(
                (*box.names, "wide"), (*box.lower, 0.0), (*box.upper, 0.1)
            ),
        },
        "'gap' is not built in": {"outputs": (hhr.GapAt("gap", 0, (0.0, 0.0)),)},
    }
    for message, change in changes.items():
        with pytest.raises(SceneError, match=message):
            hhr.slide(dataclasses.replace(scene, **change))


def test_imposed_nodes_that_penetrate_are_warned_of():
    """No force acts between nodes that are imposed on both sides."""
    scene = demo.scene(None, cells=CELLS)
    imposed = (*scene.displacements[2:], *hhr.Displacement.clamp(LOWER, 2))
    punch = tuple(dataclasses.replace(item, tag=UPPER) for item in scene.displacements[2:])
    held = dataclasses.replace(scene, displacements=(*scene.displacements[:2], *imposed, *punch))
    with pytest.warns(
        SceneWarning, match="at push = 0.03, way = 0: at .* slave nodes .* penetrate, most by 0.03"
    ):
        assert between(held, 0.0)["pressed"] == 0.0


@needs("obstacles")
@pytest.mark.filterwarnings("ignore:at 1 places of contacts")  # the upper corner of the punch
def test_a_body_that_leaves_its_place_along_a_tool_is_warned_of():
    """Rows of a circle are those of the mesh.

    A plane is the same wherever a body has moved along it.
    """
    scene = demo.scene(None, cells=CELLS)
    top = side(SECOND, 0, True)
    box = hhr.ParameterSpace(("push", "way"), (-0.5, -8.0), (0.5, 0.0))
    place = demo.START + 1.0
    circle = hhr.Circle(top, center=(place + 0.999, 0.5), radius=1.0)
    path = [(0.0, (0.0, 0.0)), (1.0, (0.01, 0.0)), (2.0, (0.3, 0.0))]
    for tool, far in ((circle, True), (hhr.Obstacle(top, (1.0, 0.0), place), False)):
        both = dataclasses.replace(scene, contacts=(*scene.contacts, tool), parameters=box)
        model = hhr.slide(both)
        model.march(path[:2])
        if far:
            with pytest.warns(
                FarSlidingWarning, match=r"at push = 0.3.* facets, and its gap and normal are those"
            ):
                model.march(path)
        else:
            model.march(path)
