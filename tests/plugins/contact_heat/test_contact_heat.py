"""Heat through contacts: a coupled full model, closed forms, several balances or none."""

import dataclasses
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from heated_pairs import Coupled, blocks, heat, rod_scene, thick_blocks, thick_heat
from needs import needs
from scipy.optimize import brentq
from shell import invoke

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import (
    ConvergenceError,
    ModelFileError,
    NotOfferedError,
    PairingWarning,
    SceneError,
    SmallStrainWarning,
    StabilityWarning,
)
from hhr_dolfinx.geometries.two_blocks import FIRST, SECOND, side
from hhr_dolfinx.plugins.contact_heat import by_sets


@pytest.mark.filterwarnings("ignore:parameters")  # of the mesh alone, without heat
@pytest.mark.parametrize("hypothesis", ["plane_strain", "axisymmetric"])
def test_answers_are_those_of_a_coupled_full_model(hypothesis):
    """Which shares the mesh alone; both stop at round-off of what they iterate."""
    scene = blocks(hypothesis)
    model = hhr.condense_heat(scene, heat())
    full = hhr.FullOrderModel(blocks(hypothesis))
    reference = Coupled(full.problem, hypothesis)
    places = full.problem.contact_points[:, 0]
    order = np.argsort(reference.points[reference.pairs[:, 0], 0])[np.argsort(np.argsort(places))]
    for push, warm in ((0.002, 20.0), (0.006, 150.0), (0.002, 150.0)):
        answer = model.solve({"push": push, "T": warm})
        forces, flows, temperature = reference.solve(push, warm)
        size = np.abs(forces).max()
        np.testing.assert_allclose(answer.forces(), forces[order], rtol=0, atol=1e-10 * size)
        size = np.abs(flows).max()
        np.testing.assert_allclose(answer.heat, flows[order], rtol=0, atol=1e-10 * size)
        np.testing.assert_allclose(answer.temperature(), temperature, rtol=0, atol=1e-9 * warm)
        assert 0 < np.count_nonzero(forces) <= len(forces)
    assert answer.outputs()["heat 0"] == pytest.approx(flows.sum(), rel=1e-10)
    assert answer.mechanical.converged and "peak" in answer.outputs()


def rods(conductance, cold, warm, expansion=2e-5, scene=None, **more):
    given = {
        "conductivity": {FIRST: 20.0, SECOND: 50.0},
        "conductance": {0: conductance},
        "expansion": {FIRST: expansion},
        "temperatures": [
            hhr.FixedTemperature(side(FIRST, 1, False), cold),
            hhr.FixedTemperature(side(SECOND, 1, True), warm),
        ],
    }
    gap = {"gap": more.pop("gap")} if "gap" in more else {}
    return hhr.condense_heat(scene or rod_scene(**gap), hhr.Heat(**given | more))


IN_SERIES = 0.33831688990, -149.506632510
"""Pressure and heat flow of rods with 3 p^0.95 at push 0.005, T = 150, by the balance below."""


@pytest.mark.parametrize(
    ("cells", "order", "name"),
    [
        ((2, 2), 2, "node"),
        pytest.param((5, 2), 2, "NodeToSurface", marks=needs("nonmatching", "second_order")),
        pytest.param((5, 3), 1, "Mortar", marks=needs("mortar")),
        pytest.param((3, 5), 1, "Mortar", marks=needs("mortar")),
        pytest.param((5, 3), 2, "Mortar", marks=needs("mortar", "second_order")),
    ],
)
@pytest.mark.filterwarnings("ignore")  # of pairings of second order
def test_weights_of_both_signs_pass_the_heat_on(cells, order, name):
    """As cells of second order and dual mortar have them: they sum up to 1 on a surface."""
    pairing = None if name == "node" else getattr(hhr, name)
    model = rods("3 * p**0.95", 0.0, "T", scene=rod_scene(0.0, cells, order, pairing))
    answer = model.solve([0.005, 150.0])
    tolerance = 1e-9 if name != "NodeToSurface" else 0.05  # its pressures oscillate
    assert answer.heat_through(0) == pytest.approx(IN_SERIES[1], rel=tolerance)


@pytest.mark.parametrize("nu", [0.3, 0.48, 0.4999])
@pytest.mark.parametrize("hypothesis", ["plane_strain", "axisymmetric", "plane_stress"])
def test_a_free_body_expands_whatever_its_ratio(nu, hypothesis):
    """Cells of bodies that are nearly incompressible have the mean dilatation of the heat too."""
    ways = [hhr.Displacement(side(tag, 1, tag == SECOND), 1) for tag in (FIRST, SECOND)]
    if hypothesis != "axisymmetric":
        ways += [hhr.Displacement(side(tag, 0, False), 0) for tag in (FIRST, SECOND)]
    scene = rod_scene(
        0.5,
        hypothesis=hypothesis,
        bodies=(hhr.Body(FIRST, 200.0, nu), hhr.Body(SECOND, 100.0, nu)),
        displacements=tuple(ways),
        outputs=(hhr.DisplacementAt("wide", (1.0, 1.0), 0, FIRST),),
    )
    warm = [hhr.FixedTemperature(side(tag, 1, False), 100.0) for tag in (FIRST, SECOND)]
    found = rods(0.0, 0.0, 0.0, scene=scene, temperatures=warm).solve([0.0, 0.0])
    free = 2e-5 * 100.0 * (1 + nu if hypothesis == "plane_strain" else 1.0)
    assert found.outputs()["wide"] == pytest.approx(free, rel=1e-9)


def test_stress_leaves_the_free_expansion_out():
    """σ_yy is -p in both rods, though one is hot; across, the walls hold E α ΔT."""
    model = rods("3 * p**0.95", 0.0, "T")
    answer = model.solve([0.005, 150.0])
    stress = answer.stress()
    np.testing.assert_allclose(stress[:, 1], -IN_SERIES[0], rtol=1e-8)
    assert stress[:, 0].min() == pytest.approx(-200 * 2e-5 * mid_of_last(answer), rel=1e-8)
    with pytest.raises(NotOfferedError, match="outputs read stress"):
        rods(1.0, 0.0, "T", scene=rod_scene(outputs=(hhr.VonMises("most", FIRST),)))


def mid_of_last(answer):
    """Temperature in the middle of the lower rod's last cells."""
    return 7 / 8 * -answer.heat_through(0) / 20


@needs("nonmatching")
def test_a_pairing_both_ways_is_refused():
    scene = rod_scene(0.0, (4, 3), 1, hhr.DoublePass)
    with pytest.raises(NotOfferedError, match="goes both ways"):
        rods(1.0, 0.0, "T", scene=scene)


def test_contact_that_is_held_on_both_sides_is_told_of():
    sides = [side(tag, 0, upper) for tag in (FIRST, SECOND) for upper in (False, True)]
    held = [hhr.Displacement(tag, axis) for tag in sides for axis in (0, 1)]
    with pytest.warns(PairingWarning, match="50% of contact 0 .*no heat passes there"):
        rods(2.0, 0.0, "T", scene=rod_scene(displacements=tuple(held)))


def test_a_conductance_that_is_negative_between_is_refused_where_it_counts():
    model = rods("0.001 + (p - 0.4) * (p - 0.6)", 0.0, "T", expansion=0.0)
    with pytest.raises(SceneError, match=r"conductance of contact 0 is -0\.009 at p = 0\.5"):
        model.solve([0.0075, 150.0])


@needs("nodal_loads")
@pytest.mark.parametrize("stiffness", [1e-3, 1e-6, 1e-9])
def test_soft_springs_hold_bodies_as_refusals_advise(stiffness):
    """Newton's steps end at the round-off of S, which springs of 1e-9 leave 1e-7 of."""
    scene = rod_scene()
    spring = hhr.Springs(side(SECOND, 1, True), 1, 100.0 * stiffness, bedding=True)
    loose = dataclasses.replace(
        scene,
        displacements=scene.displacements[:-1],
        loads=(spring, hhr.Pressure(side(SECOND, 1, True), hhr.Amplitude(slopes={"push": 100.0}))),
    )
    answer = rods("3 * p**0.95", 0.0, "T", scene=loose).solve([0.005, 150.0])
    assert answer.outputs()["peak"] == pytest.approx(0.5, rel=2 * stiffness + 1e-6)


def test_a_balance_between_open_and_closed_is_found():
    """Where Newton's steps from both starts go to and fro."""
    model = rods("50 * p / (p + 1e-3) + 0.1 / (1 + g / 1e-4)", 0.0, "T", gap=0.001)
    answer = model.solve([0.001548, -124.574])
    assert answer.converged


def test_a_fed_body_that_is_open_at_first_warms_until_it_touches():
    model = rods(
        "3 * p**0.95",
        0.0,
        0.0,
        gap=0.0005,
        expansion=0.0,
        temperatures=[hhr.FixedTemperature(side(FIRST, 1, False), 0.0)],
        supplies=[hhr.HeatSource(SECOND, 50.0)],
    )
    grown = hhr.condense_heat(
        rod_scene(0.0005),
        dataclasses.replace(
            hhr.Heat(
                conductivity={FIRST: 20.0, SECOND: 50.0},
                conductance={0: "3 * p**0.95"},
                expansion={SECOND: 2e-5},
                temperatures=[hhr.FixedTemperature(side(FIRST, 1, False), 0.0)],
                supplies=[hhr.HeatSource(SECOND, 50.0)],
            )
        ),
    )
    assert model.balances([0.0, 0.0]) == []  # it does not grow
    answer = grown.solve([0.0, 0.0])
    assert answer.heat_through(0) == pytest.approx(-50.0, rel=1e-9) and answer.forces().all()


@pytest.mark.parametrize("conductance", [{}, {0: 0.0}])
def test_temperatures_that_nothing_determines_are_refused(conductance):
    with pytest.raises(SceneError, match="the temperature of 1 of 2 bodies is not determined"):
        hhr.condense_heat(
            rod_scene(),
            hhr.Heat(
                conductivity={FIRST: 20.0, SECOND: 50.0},
                conductance=conductance,
                temperatures=[hhr.FixedTemperature(side(FIRST, 1, False), 0.0)],
            ),
        )
    with pytest.raises(SceneError, match="the temperature of 2 of 2 bodies"):
        rods("3 * p", 0.0, 0.0, temperatures=[])


@pytest.mark.parametrize("warm", [20.0, 150.0])
def test_rods_in_series(warm):
    """1 / k of the rods and 1 / h(p) between them; p = (push + expansion) / (1 / E1 + 1 / E2)."""
    model = rods("3 * p**0.95", 0.0, "T")
    answer = model.solve([0.005, warm])

    def resistance(pressure):
        return 1 / 20 + 1 / 50 + 1 / (3 * pressure**0.95)

    def balance(pressure):
        flow = warm / resistance(pressure)
        return pressure * (1 / 200 + 1 / 100) - 0.005 - 2e-5 * flow / 20 / 2

    pressure = brentq(balance, 1e-6, 100.0, xtol=1e-15, rtol=1e-15)
    assert answer.outputs()["peak"] == pytest.approx(pressure, rel=1e-10)
    assert answer.heat_through(0) == pytest.approx(-warm / resistance(pressure), rel=1e-10)
    np.testing.assert_allclose(answer.jump, -warm / resistance(pressure) / (3 * pressure**0.95))
    assert not answer.several


def test_heat_that_a_wall_gives_to_a_cold_rod_has_two_balances():
    """Barber's rod: open it stays cold and short, closed it is warm and long enough. Closed at T >=
    gap / (expansion / 2 * 5 / 7), the temperature of the contact with these conductivities.
    """
    model = rods("1e4 * p / (p + 1e-6)", 0.0, "T", gap=0.0005)
    least = 0.0005 / (2e-5 / 2 * 5 / 7)
    assert not model.solve([0.0, 0.99 * least]).several
    with pytest.warns(StabilityWarning, match="several balances"):
        answer = model.solve([0.0, 1.2 * least])
    assert answer.several and not answer.forces().any()
    cold, warm = model.balances([0.0, 1.2 * least])
    assert not cold.heat.any() and warm.heat_through(0) < -100.0
    assert warm.outputs()["peak"] > 0.0


def test_a_history_stays_with_its_balance():
    """Pushed together and let go, the cold rod of the test before stays warm and closed."""
    model = rods("1e4 * p / (p + 1e-6)", 0.0, "T", gap=0.0005)
    pushes = np.concatenate([np.linspace(0, 0.001, 5), np.linspace(0.001, 0, 5)])
    answers = model.march([[push, 90.0] for push in pushes])
    assert not answers[0].forces().any() and answers[-1].forces().all()
    cold, warm = model.balances([0.0, 90.0])
    np.testing.assert_allclose(answers[-1].forces(), warm.forces(), rtol=1e-10)
    assert not cold.forces().any()


def test_space_is_plane_strain_where_nothing_moves_along_the_third_axis():
    """Blocks of one cell across, half as thick: half the forces and half the heat."""
    plane = hhr.condense_heat(blocks(), heat()).solve({"push": 0.006, "T": 150.0})
    answer = hhr.condense_heat(thick_blocks(0.5), thick_heat()).solve({"push": 0.006, "T": 150.0})
    assert answer.forces().sum() == pytest.approx(plane.forces().sum() / 2, rel=1e-9)
    assert answer.heat_through(0) == pytest.approx(plane.heat_through(0) / 2, rel=1e-9)


def test_a_warm_rod_at_a_wall_rests_on_the_edge_of_contact():
    """Open it is warm and too long, closed it is colder and too short: it touches so lightly that
    its heat leaves it as long as the gap, which Newton's steps alone go to and fro about.
    """
    model = rods("1e4 * p / (p + 1e-6)", "T", 0.0, gap=0.0015)
    assert len(model.balances([0.0, 60.0])) == 1 and len(model.balances([0.0, 150.0])) == 1
    answer = model.solve([0.0, 100.0])
    flow = (100.0 - 0.0015 / 2e-5) * 2 * 20
    assert answer.heat_through(0) == pytest.approx(flow, rel=1e-6)
    conducted = flow / (100.0 - flow * (1 / 20 + 1 / 50))
    pressure = 1e-6 * conducted / (1e4 - conducted)
    assert answer.outputs()["peak"] == pytest.approx(pressure, rel=1e-3)
    gas = rods("1e4 * p / (p + 1e-6) + 0.01 / (g + 1e-6)", "T", 0.0, gap=0.0015)
    answer = gas.solve([0.0, 100.0])
    flow = answer.heat_through(0)
    gap = 0.0015 - 2e-5 * (100.0 - flow / 20 / 2)
    assert gap > 0
    assert flow == pytest.approx(100 / (1 / 20 + 1 / 50 + (gap + 1e-6) / 0.01), rel=1e-9)


def test_a_fed_body_that_never_touches_has_no_balance():
    model = rods(
        "3 * p**0.95",
        0.0,
        0.0,
        gap=0.0005,
        temperatures=[hhr.FixedTemperature(side(FIRST, 1, False), 0.0)],
        supplies=[hhr.HeatSource(SECOND, "T")],
    )
    assert model.balances([0.0, 100.0]) == []
    with pytest.raises(ConvergenceError, match="find no balance at push = 0, T = 100"):
        model.solve([0.0, 100.0])
    assert not model.solve([0.0, 100.0], raise_on_failure=False).converged


def test_a_body_that_contact_alone_feeds_passes_on_its_source():
    """Its level follows from the jump that its heat needs; the sum of heat flows is its source."""
    model = rods(
        "3 * p**0.95 + 1",
        0.0,
        0.0,
        temperatures=[hhr.FixedTemperature(side(FIRST, 1, False), 0.0)],
        supplies=[hhr.HeatSource(SECOND, "T"), hhr.HeatFlux(side(SECOND, 1, True), 7.0)],
    )
    answer = model.solve([0.005, 150.0])
    assert answer.heat_through(0) == pytest.approx(-157.0, rel=1e-10)
    pressure = answer.outputs()["peak"]
    bottom = 157.0 / 20 + 157.0 / (3 * pressure**0.95 + 1)
    # a source falls off as a parabola towards the side without heat, a flux as a line
    assert answer.temperature().max() == pytest.approx(bottom + 7 / 50 + 150 / 2 / 50, rel=1e-9)


def test_convection():
    """1 / coefficient in series."""
    model = rods(
        4.0,
        0.0,
        0.0,
        temperatures=[],
        supplies=[
            hhr.Convection(side(FIRST, 1, False), 2.0, 20.0),
            hhr.Convection(side(SECOND, 1, True), 8.0, "T"),
        ],
    )
    flow = model.solve([0.005, 150.0]).heat_through(0)
    series = 1 / 20 + 1 / 50 + 1 / 4 + 1 / 2 + 1 / 8
    assert flow == pytest.approx(-(150.0 - 20.0) / series, rel=1e-10)


def test_gradients_are_those_of_differences():
    """Of outputs of forces, displacements and heat, with a body that contact alone feeds too."""
    fed = {
        "conductance": {0: "(1 + T / 100) * p / (p + 0.5) + 0.05 / (g + 0.001)"},
        "temperatures": [hhr.FixedTemperature(side(FIRST, 1, False), "T / 5")],
        "supplies": [hhr.HeatSource(SECOND, "2 * T + 1e3 * push")],
    }
    for more in ({}, fed):
        model = hhr.condense_heat(blocks(), heat(**more))
        point = np.array([0.006, 100.0])
        gradient = model.outputs(point, gradient=True).gradient
        for axis, step in enumerate((1e-8, 1e-4)):
            up, down = (model.outputs(point + sign * step * np.eye(2)[axis]) for sign in (1, -1))
            for name in ("peak", "corner", "heat 0"):
                slope = (up[name] - down[name]) / (2 * step)
                assert gradient[name][axis] == pytest.approx(slope, rel=1e-5), (name, axis)


def test_both_methods_end_in_the_same_balances(monkeypatch):
    """Forces eliminated for a set of closed contacts, and forces and flows together."""
    model = hhr.condense_heat(blocks(), heat())
    points = model.parameters.random(20, 1)
    fast = model.solve_many(points, both=False)
    monkeypatch.setattr(by_sets, "solved_by_sets", lambda *_: None)
    for one, other in zip(fast, model.solve_many(points, both=False), strict=True):
        size = one.forces().max()
        np.testing.assert_allclose(other.forces(), one.forces(), rtol=0, atol=1e-10 * size)
        size = np.abs(one.heat).max()
        np.testing.assert_allclose(other.heat, one.heat, rtol=0, atol=1e-10 * size)
    assert len({tuple(answer.forces() > 0) for answer in fast}) >= 2


@needs("plots")
@pytest.mark.filterwarnings("ignore:a figure")
def test_the_example_of_the_page_runs_and_has_its_numbers(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    page = (Path(__file__).parents[3] / "docs/heat.md").read_text("utf-8")
    program, in_time, *_ = (part.partition("```")[0] for part in page.split("```python\n")[1:])
    variables = {}
    exec(compile(program, "heat.md", "exec"), variables)
    outputs = variables["answer"].outputs()
    assert f"peak {outputs['peak']:.1f} MPa" in program
    assert f"second: {outputs['heat 0']:.0f} mW/mm" in program
    exec(compile(in_time, "heat.md", "exec"), variables)
    flows = [answer.outputs()["heat 0"] for answer in variables["answers"]]
    assert f"# {flows[0]:.0f}, .., {flows[-1]:.0f} mW/mm" in in_time
    assert f"# {variables['transient'].step_error:.0e}" in in_time
    assert (tmp_path / "warm.npz").is_file() and (tmp_path / "warm.png").is_file()


@pytest.mark.filterwarnings("ignore:displacements are imposed on both sides")
def test_a_contact_without_conditions_passes_no_heat():
    """Displacements hold both of its sides."""
    held = [hhr.Displacement(tag, 1) for tag in (side(FIRST, 1, True), side(SECOND, 1, False))]
    floor = hhr.Obstacle(side(FIRST, 0, True), (1.0, 0.0), 1.0)
    scene = rod_scene()
    scene = dataclasses.replace(
        scene,
        contacts=(*scene.contacts, floor),
        displacements=(*scene.displacements[:2], *scene.displacements[3:], *held),
        outputs=(),
    )
    answer = rods(3.0, 0.0, "T", scene=scene).solve([0.0, 20.0])
    assert answer.heat_through(0) == 0.0 and answer.outputs().values == {"heat 0": 0.0}


def test_heat_of_round_off_is_one_balance():
    """A body that contact alone feeds and nothing supplies is as warm as the other one."""
    fixed = [hhr.FixedTemperature(side(FIRST, 1, False), 293.0)]
    answer = rods("3 * p", 0.0, 0.0, temperatures=fixed).solve([0.005, 100.0])
    assert not answer.several and abs(answer.heat_through(0)) < 1e-9
    np.testing.assert_allclose(answer.temperature(), 293.0, rtol=1e-9)


def test_a_file_has_the_answers(tmp_path):
    model = hhr.condense_heat(blocks(), heat())
    hhr.save_heat_model(tmp_path / "warm.npz", model)
    again = hhr.load_heat_model(tmp_path / "warm.npz")
    point = {"push": 0.006, "T": 150.0}
    one, other = model.solve(point), again.solve(point)
    np.testing.assert_array_equal(other.forces(), one.forces())
    np.testing.assert_array_equal(other.temperature(), one.temperature())
    assert other.outputs() == one.outputs()
    with pytest.raises(NotOfferedError, match="mesh"):
        other.stress()
    whole = tmp_path / "whole warm.npz"
    whole.write_bytes((tmp_path / "warm.npz").read_bytes())
    (tmp_path / "warm.npz").write_bytes((tmp_path / "warm.npz").read_bytes()[:-200])
    with pytest.raises(ModelFileError):
        hhr.load_heat_model(tmp_path / "warm.npz")
    with pytest.raises(ModelFileError, match="there is no model file"):
        hhr.load_heat_model(tmp_path / "cold.npz")
    with pytest.raises(NotOfferedError, match="no model with heat"):
        hhr.save_heat_model(tmp_path / "other.npz", model.mechanical)
    with pytest.raises(ModelFileError, match=r"warm.npz is read by hhr.load_heat_model"):
        hhr.load_model(whole)
    with pytest.raises(NotOfferedError, match=r"take hhr.save_heat_model\(path, model\)"):
        hhr.save_model(tmp_path / "other.npz", model)


def test_several_points_and_a_start_alone():
    model = rods("3 * p**0.95", 0.0, "T")
    points = [[0.005, 20.0], [0.001, 100.0]]
    for both in (True, False):
        answers = model.solve_many(points, both=both)
        expected = [model.solve(point).heat_through(0) for point in points]
        assert [answer.heat_through(0) for answer in answers] == pytest.approx(expected, rel=1e-12)


@needs("tables")
def test_tables_have_outputs_and_heat(tmp_path):
    """In Python and by ``hhr answer``, where a row outside the box does not stop others."""
    model = hhr.condense_heat(blocks(), heat())
    points = model.parameters.random(3, 1)
    answers = hhr.answer_points(model, points, displacement=True)
    assert list(answers.outputs) == ["peak", "corner", "heat 0"] and answers.status == ["ok"] * 3
    for k, point in enumerate(points):
        expected = model.solve(point)
        np.testing.assert_array_equal(answers.forces[k], expected.forces())
        assert answers.outputs["heat 0"][k] == expected.heat_through(0)
    assert not answers.columns["several balances"].any()
    hhr.save_heat_model(tmp_path / "warm.npz", model)
    (tmp_path / "asked.csv").write_text("push,T\n0.005,50\n0.5,3\n")
    out = tmp_path / "found.csv"
    code, said = invoke("answer", tmp_path / "warm.npz", tmp_path / "asked.csv", "--out", out)
    head, first, second = (line.split(",") for line in out.read_text().splitlines())
    assert code == 1 and "1 answers and 1 bad rows" in said
    found = dict(zip(head, first, strict=True))
    assert float(found["heat 0"]) == pytest.approx(model.solve([0.005, 50.0]).heat_through(0))
    assert second[2].startswith('"push = 0.5 is outside')


@needs("tables")
def test_tables_count_rows_of_several_balances():
    model = rods("1e4 * p / (p + 1e-6)", 0.0, "T", gap=0.0005)
    with pytest.warns(StabilityWarning, match="several balances"):
        answers = hhr.answer_points(model, [[0.0, 10.0], [0.0, 90.0]])
    assert answers.columns["several balances"].tolist() == [0.0, 1.0]


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ({"conductivity": {FIRST: 20.0}}, "body 2 needs a conductivity"),
        ({"conductivity": {FIRST: 20.0, SECOND: 5.0, 7: 1.0}}, "heat names a body 7"),
        ({"conductivity": {FIRST: 0.0, SECOND: 5.0}}, "must be positive"),
        ({"conductance": {3: 1.0}}, "contacts 0 to 0"),
        ({"conductance": {0: "p - 1"}}, "is -1 at p = 0, g = 0"),
        ({"conductance": {0: "1 / g"}}, "is inf at p = 0, g = 0"),
        ({"conductance": {0: "p * heat"}}, "heat"),
        ({"expansion": {9: 1e-5}}, "heat names a body 9"),
        ({"temperatures": [hhr.FixedTemperature(99, 1.0)]}, "99"),
        ({"temperatures": [3.0]}, "does not belong to the temperatures"),
        ({"temperatures": 3.0}, "must be a sequence"),
        ({"conductance": 3.0}, "must be a mapping"),
        ({"conductance": {False: 1.0}}, "must be a whole number"),
        ({"conductance": {0: "table(p, 0, 0, 5, 1)"}}, "contact 0 ends at p = 1000"),
        ({"reference": {7: 20.0}}, "names a body 7"),
        ({"reference": {FIRST: 20.0}}, "body 2 expands, and needs a reference"),
        (
            {"temperatures": [hhr.FixedTemperature(side(FIRST, 1, False), "1 / (T - T)")]},
            "temperature of FixedTemperature",
        ),
        ({"reference": float("nan")}, "must be a temperature"),
        ({"supplies": [hhr.HeatSource(SECOND, "W")]}, "W"),
    ],
)
def test_what_does_not_fit_the_scene_is_refused(more, said):
    with pytest.raises(SceneError, match=said):
        hhr.condense_heat(blocks(), heat(**more))


def test_what_is_asked_of_answers_is_checked():
    answer = rods("3 * p**0.95", 0.0, "T").solve({"push": 0.005, "T": 20.0})
    for contact in (5, -1, "0"):
        with pytest.raises(SceneError, match="the scene has contacts"):
            answer.heat_through(contact)
    with pytest.raises(ValueError, match="read-only"):
        answer.heat[:] = 0.0
    named = rod_scene(outputs=(hhr.LargestPressure("heat 0", 0),))
    with pytest.raises(SceneError, match="an output is named 'heat 0'"):
        rods(1.0, 0.0, "T", scene=named)


@needs("plots")
def test_stresses_of_pictures_are_those_of_answers():
    from hhr_dolfinx.plugins.plots.recovery import stress_of_cells

    mechanical = rods("3 * p**0.95", 0.0, "T").solve({"push": 0.005, "T": 20.0}).mechanical
    shown = stress_of_cells(mechanical.fields.full, mechanical)
    np.testing.assert_array_equal(shown, mechanical.stress())


@needs("plots")
def test_a_picture_names_the_parameters_of_the_user(tmp_path):
    answer = rods("3 * p**0.95", 0.0, "T").solve({"push": 0.005, "T": 20.0})
    figure = answer.plot(tmp_path / "rods.png")
    assert (tmp_path / "rods.png").stat().st_size > 10_000
    assert figure.get_suptitle() == "at push = 0.005, T = 20"


@needs("small_strains")
def test_large_strains_are_warned_of_with_parameters_of_the_user():
    """A rod that has come loose shrinks by its expansion times the temperature: 2e-3 times 200."""
    with pytest.warns(SmallStrainWarning, match=r"T = -200: a strain of 0\.4"):
        rods(100.0, "T", "T", expansion=2e-3)


def test_scenes_that_heat_is_not_for_are_refused():
    lawful = blocks()
    faces = side(FIRST, 1, True), side(SECOND, 1, False)
    for changed, said in (
        ({"contacts": (hhr.NodeToNode(*faces, (0.0, 1.0), 0.3),)}, "contacts have laws"),
        ({"bodies": (hhr.Body(FIRST, "100 + T", 0.3), hhr.Body(SECOND, 70.0, 0.2))}, "moduli"),
    ):
        with pytest.raises(NotOfferedError, match=said):
            hhr.condense_heat(dataclasses.replace(lawful, **changed), heat())


def test_a_file_is_read_where_no_mesh_can_be_made(tmp_path):
    model = rods("3 * p**0.95", 0.0, "T")
    hhr.save_heat_model(tmp_path / "rods.npz", model)
    program = (
        "import sys\n"
        "lost = ['dolfinx', 'ufl', 'basix', 'petsc4py', 'mpi4py', 'gmsh']\n"
        "sys.modules.update(dict.fromkeys(lost))\n"
        "import hhr_dolfinx as hhr\n"
        "print(hhr.load_heat_model('rods.npz').solve([0.005, 150.0]).heat_through(0).hex())"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == model.solve([0.005, 150.0]).heat_through(0).hex()
