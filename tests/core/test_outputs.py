"""Outputs by name: closed forms, one value from every model, exact derivatives, files, tables and
the door.
"""

import dataclasses
import pickle

import numpy as np
import pytest
from bare_problem import read_csv
from my_output import MyOutput
from needs import needs, present
from pellet_outputs import OUTPUTS, small_pellet
from scenes import output_slopes, pressed_block, pressed_pair, space, stacked

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import HHRError, SceneError, SceneWarning
from hhr_dolfinx.geometries import block
from hhr_dolfinx.geometries import pellet_cladding as geometry
from hhr_dolfinx.geometries.two_blocks import FIRST, SECOND
from hhr_dolfinx.materials.elasticity import von_mises

PRESSURE, YOUNG = 2.0, 50.0
POINT = {"P1": 100.0, "h1": 3.07, "E1": 190e3, "nu1": 0.3, "E2": 78e3, "nu2": 0.34}


WRONG_STRESSES = []
if present("stress"):
    WRONG_STRESSES = [
        (hhr.VonMises("a", 77), "output 'a': the cell tag 77 is not among the bodies"),
        (
            hhr.VonMises("a", geometry.PELLET, where=((9.0, 9.0), (9.5, 9.5))),
            "no cell of body .* enlarge the box",
        ),
        (hhr.VonMises("a", geometry.PELLET, where=((9.0,), (9.5,))), "must have 2 coordinates"),
    ]


@pytest.fixture(scope="module")
def varying():
    """The same with the elasticity of both bodies as parameters."""
    box = hhr.ParameterSpace(
        tuple(POINT), (5, 0.6, 100e3, 0.2, 60e3, 0.25), (200, 6, 250e3, 0.4, 100e3, 0.4)
    )
    bodies = (hhr.Body(geometry.PELLET, "E1", "nu1"), hhr.Body(geometry.CLADDING, "E2", "nu2"))
    return hhr.train(small_pellet(bodies=bodies, parameters=box), hhr.Sobol(120), held_out=5)


@pytest.fixture(scope="module")
def constant():
    return hhr.train(small_pellet(), (8, 6), held_out=5)


def pressed_stack(dim, outputs):
    """Two blocks whose contact is everywhere under the pressure p; the upper one is twice as
    stiff.
    """
    bodies, hypothesis = ((YOUNG, 0.3), (2 * YOUNG, 0.3)), "plane_stress" if dim == 2 else "solid"
    return stacked(
        dim, bodies=bodies, hypothesis=hypothesis, parameters=space(p=(0.5, 4.0)), outputs=outputs
    )


@needs("floating")
@pytest.mark.parametrize("dim", [2, 3])
def test_uniform_pressure_in_closed_form(dim):
    upwards, middle = np.eye(dim)[dim - 1], np.full(dim, 0.5)
    axis, place = ({}, (1.0,)) if dim == 2 else ({"axis": (0.0, 1.0, 0.0)}, (1.0, 1.0))
    outputs = (
        hhr.LargestPressure("peak", 0),
        MyOutput("average", 0),
        hhr.ContactForce("force", 0, tuple(3 * upwards)),
        hhr.ContactMoment("moment", 0, (0.0,) * dim, **axis),
        hhr.ContactMoment("centred", 0, tuple(middle), **axis),
        hhr.ContactWidth("width", 0),
        hhr.LostContact("lost", 0),
        hhr.GapAt("gap", 0, (*middle[1:], 1.0)),
        hhr.DisplacementAt("top", (*place, 2.0), dim - 1),
        hhr.DisplacementAt("between", (*place, 1.0), dim - 1, tag=SECOND),
        hhr.VonMises("mises", FIRST),
        hhr.VonMises("mean", SECOND, "mean"),
        hhr.ElasticEnergy("energy"),
    )
    found = hhr.FullOrderModel(pressed_stack(dim, outputs)).outputs(PRESSURE, gradient=True)
    closed = {
        "peak": PRESSURE,
        "average": PRESSURE,
        "force": -PRESSURE,
        "moment": (0.5 if dim == 3 else -0.5) * PRESSURE,
        "centred": 0.0,
        "width": 1.0,
        "lost": 0.0,
        "gap": 0.0,
        "top": -1.5 * PRESSURE / YOUNG,
        "between": -PRESSURE / YOUNG,
        "mises": PRESSURE,
        "mean": PRESSURE,
        "energy": 0.75 * PRESSURE**2 / YOUNG,
    }
    assert (
        dict(found) == pytest.approx(closed, rel=1e-11, abs=1e-12) and found.one_sided
    )  # pressures are all equal
    assert found.gradient["energy"] == pytest.approx(1.5 * PRESSURE / YOUNG, rel=1e-10)
    assert found.gradient["force"] == pytest.approx(-1.0, rel=1e-10)


@pytest.mark.parametrize("hypothesis", ["plane_strain", "plane_stress", "solid"])
def test_energy_counts_imposed_displacements(hypothesis):
    outputs = (hhr.ElasticEnergy("energy"), hhr.VonMises("mises", block.SOLID))
    full = hhr.FullOrderModel(dataclasses.replace(pressed_block(hypothesis), outputs=outputs))
    for push in (0.005, 0.06):
        answer = full.solve(push, gradient=True)
        field, found = answer.displacement(), answer.outputs()
        assert found["energy"] == pytest.approx(
            field @ (full.problem.stiffness @ field) / 2, rel=1e-10, abs=1e-15
        )
        assert found["mises"] == pytest.approx(
            von_mises(answer.stress()).max(), rel=1e-12, abs=1e-14
        )
        slopes = output_slopes(full, [push], "energy", step=1e-5)
        assert found.gradient["energy"] == pytest.approx(slopes["energy"], rel=1e-6, abs=1e-9)


@needs("floating", "friction")
@pytest.mark.parametrize("turn", [(0.0, 0.0, 1.0), (1.0, 2.0, -0.5), (1.0, 0.0, 0.0)])
@pytest.mark.parametrize("height", [1.0, 0.25])
def test_torque_in_closed_form(turn, height):
    """A uniform pressure on a unit square: friction times the mean of |(a x r)_t|, the velocity of
    a turning body along the square.
    """
    outputs = (
        hhr.Torque("torque", 0, 0.2, (0.5, 0.5, height), turn),
        hhr.LargestPressure("peak", 0),
    )
    full = hhr.FullOrderModel(pressed_stack(3, outputs))
    problem, answer = full.problem, full.solve(PRESSURE)
    axis = np.array(turn) / np.linalg.norm(turn)
    velocity = np.cross(axis, problem.contact_points - (0.5, 0.5, height))
    mean = problem.contact_areas @ np.linalg.norm(velocity[:, :2], axis=1)
    assert answer.outputs()["torque"] == pytest.approx(0.2 * PRESSURE * mean, rel=1e-11, abs=1e-15)


@needs("friction")
def test_torque_in_the_plane_is_friction_times_the_distance_of_the_surface():
    """On a flat surface all forces of friction have one arm, the height of the axis above it."""
    for height in (0.0, 0.7):
        outputs = (
            hhr.Torque("torque", 0, 0.3, (0.2, 1.0 + height)),
            hhr.ContactForce("force", 0, (0.0, -1.0)),
        )
        scene = pressed_pair("plane_strain", ((3.0, 0.3), (5.0, 0.3)), outputs=outputs)
        found = hhr.FullOrderModel(scene).solve(scene.parameters.upper).outputs()
        assert found["force"] > 0.01
        assert found["torque"] == pytest.approx(0.3 * found["force"] * height, abs=1e-12)


def test_stress_is_that_of_the_full_model_with_mean_dilatation_and_grading():
    outputs = (hhr.VonMises("nearly", block.SOLID), hhr.VonMises("mean", block.SOLID, "mean"))
    scene = dataclasses.replace(pressed_block("plane_strain", poisson=0.49), outputs=outputs)
    graded = hhr.Body(block.SOLID, 3.0, 0.3, grading=lambda x: 1 + x[1])
    for own in (scene, dataclasses.replace(scene, bodies=(graded,))):
        answer = hhr.FullOrderModel(own).solve(0.05)
        values = von_mises(answer.stress())
        assert answer.outputs()["nearly"] == pytest.approx(values.max(), rel=1e-12)
        assert answer.outputs()["mean"] == pytest.approx(
            values.mean(), rel=1e-12
        )  # cells of one size


def test_values_are_those_of_the_fields(varying):
    full, answer = varying.full_order, varying.full_order.solve(POINT)
    found, field, forces = answer.outputs(), answer.displacement(), answer.forces()
    problem, values = full.problem.at(POINT), von_mises(answer.stress())
    bodies, side = full.discretisation.cell_bodies(), problem.contact_pairs == 0
    assert found["peak"] == pytest.approx((forces / problem.contact_areas)[side].max(), rel=1e-14)
    assert found["radial"] == pytest.approx(-forces[side].sum(), rel=1e-12)
    if present("friction"):
        assert found["torque"] == pytest.approx(
            0.3 * problem.contact_points[side, 0] @ forces[side], rel=1e-12
        )
    assert found["energy"] == pytest.approx(field @ (problem.stiffness @ field) / 2, rel=1e-11)
    assert found["largest"] == pytest.approx(values[bodies == 1].max(), rel=1e-12)
    assert 0 < found["lost"] < 1 and found.units["peak"] == "MPa" and found.gradient is None
    assert len(found) == len(OUTPUTS) and "peak" in found


VARYING = [pytest.param(name, marks=needs("moduli")) for name in ("reduced", "interpolated")]


@pytest.mark.parametrize(
    "name", ["full", "full, constant", "exact", "exact with fields", "copied", *VARYING]
)
def test_derivatives_are_those_of_the_model_itself(name, varying, constant):
    known = constant.snapshots.known_statuses()
    models = {
        "full": lambda: varying.full_order,
        "full, constant": lambda: constant.full_order,
        "reduced": varying.build,
        "interpolated": varying.condense,
        "exact": lambda: hhr.exact_condensation(constant.full_order, known, field=False),
        "exact with fields": lambda: hhr.exact_condensation(constant.full_order, known),
        "copied": lambda: pickle.loads(pickle.dumps(constant.build())),
    }
    model = models[name]()
    middle = np.array([POINT[key] for key in model.parameters.names])
    found = model.outputs(middle, gradient=True)
    exact = (varying if len(middle) == 6 else constant).full_order.outputs(middle)
    assert not found.one_sided and not np.any(found.gradient["area"])
    slopes = output_slopes(model, middle, *found.values, step=1e-5)
    for key, value in found.values.items():
        assert value == pytest.approx(exact[key], rel=0.1)
        assert (np.abs(slopes[key] - found.gradient[key]) * middle < 1e-6 * abs(value)).all(), key


@needs("tables")
def test_a_table_names_outputs_with_their_units(constant, tmp_path):
    model, points = constant.build(), constant.full_order.parameters.random(3, seed=1)
    answers = hhr.answer_points(model, np.vstack([points, [1e9, 1.0]]))
    assert hhr.write_answers(tmp_path / "answers.csv", model.parameters, answers) == 1
    rows = read_csv(tmp_path / "answers.csv")
    assert float(rows[0]["peak [MPa]"]) == pytest.approx(
        model.outputs(points[0])["peak"], rel=1e-10
    )
    assert rows[3]["energy"] == "" and rows[3]["status"] != "ok"


@needs("studies")
def test_a_study_reports_their_errors(constant):
    study = hhr.run_study(constant, hhr.StudySettings((8, 6), tests=5, queries=2, naive=False))
    row = study.report["outputs"]["peak"]
    assert row["unit"] == "MPa" and row["largest"] > 50 and row["max"] < 0.1


@needs("inelastic", "nonmatching")
def test_bodies_that_flow_answer_at_every_step():
    import pellet_cladding_plastic as plastic
    from flowing import SMALL_MESH, STEPS, TRAINING

    outputs = (
        hhr.LargestPressure("peak", 0),
        hhr.VonMises("mises", geometry.PELLET),
        hhr.VonMises("mean", geometry.PELLET, "mean"),
        hhr.DisplacementAt("u", (4.7, 6.0), 0),
    )
    scene = dataclasses.replace(plastic.scene(**SMALL_MESH), outputs=outputs)
    training = hhr.train(scene, [plastic.path(gap, STEPS) for gap in TRAINING])
    full, bodies = training.full_order, training.full_order.discretisation.cell_bodies()
    points = full.equilibrium.operator.points_of(np.flatnonzero(bodies == 0))
    history = training.snapshots.histories[0]
    for answer, other in zip(
        history.answers, training.build(checked=False).march(history.path).answers, strict=True
    ):
        exact = answer._replace(fields=full).outputs()
        assert exact["mises"] == pytest.approx(
            von_mises(answer.gauss.stress[points]).max(), rel=1e-14
        )
        assert dict(other.outputs()) == pytest.approx(dict(exact), rel=0.05, abs=1e-3)


@pytest.mark.parametrize(
    ("output", "message"),
    [
        (hhr.LargestPressure("a", 5), "output 'a' names contact 5, and the scene has 2"),
        *WRONG_STRESSES,
        (hhr.DisplacementAt("a", (40.0, 3.0), 0), r"nearest point at .*move it"),
        (hhr.DisplacementAt("a", (4.7, 3.0), 2), "has 2 components, none is 2"),
        (hhr.DisplacementAt("a", (4.7, 3.0, 1.0), 0), "must have 2 coordinates"),
        (hhr.GapAt("a", 0, (0.0, 0.0)), "move it"),
        (hhr.ContactForce("a", 0, (1.0, 0.0, 0.0)), "must have 2 components"),
        (hhr.ContactForce("a", 0, (0.0, 0.0)), "must not be zero"),
        (hhr.ContactMoment("a", 0, (0.0, 0.0)), "Ask for the Torque"),
        *(
            [(hhr.Torque("a", 0, 0.1, origin=(0.0, 0.0)), "leave out origin")]
            if present("friction")
            else []
        ),
        (
            hhr.LinearForm("a", lambda a: a.test[0] * a.test[1] * a.dx(geometry.PELLET)),
            "must be linear in v",
        ),
    ],
)
def test_what_the_model_does_not_have_is_refused(output, message):
    with pytest.raises(SceneError, match=message):
        hhr.FullOrderModel(dataclasses.replace(small_pellet(), outputs=(output,)))


@needs("floating")
def test_nodes_of_two_bodies_at_one_place_are_told_apart():
    """Halfway between two nodes of one body its name helps nobody, and the place of one of them
    does.
    """
    with pytest.raises(
        SceneError, match=r"2 nodes, of bodies \[1, 2\], are equally near .*: name the body, tag="
    ):
        hhr.FullOrderModel(pressed_stack(2, (hhr.DisplacementAt("a", (0.0, 1.0), 1),)))
    output = hhr.DisplacementAt("a", (1 / 6, 1.0), 1, tag=SECOND)  # cells are 1/3 wide
    with pytest.raises(SceneError, match=r"2 nodes, of bodies \[2\], are equally near") as refused:
        hhr.FullOrderModel(pressed_stack(2, (output,)))
    assert str(refused.value).endswith(": move the place to one of them, such as (0.0, 1.0)")
    moved = dataclasses.replace(output, place=(0.0, 1.0))
    assert hhr.FullOrderModel(pressed_stack(2, (moved,))).fields.functionals.items[0].name == "a"


@pytest.mark.parametrize(
    ("make", "message"),
    [
        pytest.param(lambda: hhr.Torque("a", 0, -0.1), "friction -0.1", marks=needs("friction")),
        (lambda: hhr.LargestPressure("", 0), "must be a text"),
        (lambda: hhr.LargestPressure("a", 0, unit=3), "the unit 3"),
        (lambda: hhr.LargestPressure("a", -1), "place of a pair"),
        (lambda: hhr.DisplacementAt("a", (0.0, 0.0), 5), "component 5"),
        (lambda: hhr.DisplacementAt("a", ("x", 0.0), 0), "finite numbers"),
        (lambda: hhr.VonMises("a", 1, "least"), "must be 'max' or 'mean'"),
        (lambda: hhr.VonMises("a", 1, where=((0.0, 0.0),)), "must be two corners"),
        (lambda: hhr.LinearForm("a", 3), "must be a function of an Assembler"),
        (lambda: small_pellet(outputs=(OUTPUTS[0], OUTPUTS[0])), "two outputs are called 'peak'"),
        (lambda: small_pellet(outputs=(3,)), r"outputs\[0\] .* must be an output"),
    ],
)
def test_what_is_no_output_is_refused(make, message):
    with pytest.raises((SceneError, TypeError), match=message):
        make()


def test_a_scene_without_outputs_has_none():
    with pytest.raises(HHRError, match="name them in the scene"):
        hhr.FullOrderModel(pressed_block("plane_strain")).solve(0.05).outputs()


@pytest.mark.parametrize(
    ("units", "unit", "own"),
    [
        (("m", "Pa"), "MPa", "Pa"),  # a label only, a million times too small
        (("mm", "MPa"), "Pa", "MPa"),
        (("mm", "MPa"), "N/m", "MPa mm"),
        (("m", "MPa"), "N", "MPa m^2"),
        (("mm", "MPa"), "J", "MPa mm^3"),
        (("m", "Pa"), "mm", "m"),
        (("m", "Pa"), "mm²", "m^2"),
        (("in", "psi"), "N", "psi in^2"),
        *(
            ((length, stress), unit, None)
            for length, stress, unit in (
                ("mm", "MPa", "N"),
                ("mm", "MPa", "N/mm"),
                ("mm", "MPa", "MPa"),
                ("mm", "MPa", "N/mm^2"),
                ("mm", "MPa", "mm2"),
                ("mm", "MPa", "mJ"),
                ("m", "Pa", "J"),
                ("m", "Pa", "N m"),
                ("in", "psi", "lbf"),
                ("m", "Pa", ""),
                ("m", "Pa", "%"),
                ("m", "Pa", "degrees"),
                ("m", "Pa", "1"),
                ("m", "kPa", "kN/m"),
            )
        ),
    ],
)
def test_the_unit_of_an_output_is_compared_with_those_of_the_scene(units, unit, own):
    """Expected by hand: a newton is a pascal times a square metre."""
    assert hhr.Units(*units).conflict(unit) == own


def test_a_scene_warns_of_an_output_in_another_unit():
    outputs = (hhr.LargestPressure("peak", 0, unit="MPa"),)
    with pytest.warns(
        SceneWarning,
        match="output 'peak' has the unit 'MPa', and numbers of scene 'pressed_solid' are",
    ):
        dataclasses.replace(pressed_block("solid"), units=hhr.Units("m", "Pa"), outputs=outputs)
