"""Heat through contacts: a coupled full model, closed forms, several balances or none."""

import dataclasses

import numpy as np
import pytest
from heated_pairs import Coupled, blocks, heat, thick_blocks, thick_heat
from scipy.optimize import brentq

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import ConvergenceError, NotOfferedError, SceneError, StabilityWarning
from hhr_dolfinx.geometries import two_blocks
from hhr_dolfinx.geometries.two_blocks import FIRST, SECOND, side


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


def rods(conductance, cold, warm, gap=0.0, expansion=2e-5, **more):
    """Two rods between walls that hold them aside: nothing depends on the place across."""
    faces = side(FIRST, 1, True), side(SECOND, 1, False)
    sides = [side(tag, 0, upper) for tag in (FIRST, SECOND) for upper in (False, True)]
    push = hhr.Amplitude(slopes={"push": -1.0})
    scene = hhr.Scene(
        name="rods",
        geometry=lambda comm: two_blocks.two_blocks(
            comm,
            first=((0.0, 0.0), (1.0, 1.0), (2, 4)),
            second=((0.0, 1.0 + gap), (1.0, 2.0 + gap), (2, 4)),
        ),
        hypothesis="plane_strain",
        bodies=(hhr.Body(FIRST, 200.0, 0.0), hhr.Body(SECOND, 100.0, 0.0)),
        contacts=(hhr.NodeToNode(*faces, (0.0, 1.0)),),
        parameters=hhr.ParameterSpace(("push", "T"), (-0.01, -200.0), (0.01, 200.0)),
        displacements=(
            hhr.Displacement(side(FIRST, 1, False), 1),
            *(hhr.Displacement(tag, 0) for tag in sides),
            hhr.Displacement(side(SECOND, 1, True), 1, push),
        ),
        outputs=(hhr.LargestPressure("peak", 0),),
    )
    given = {
        "conductivity": {FIRST: 20.0, SECOND: 50.0},
        "conductance": {0: conductance},
        "expansion": {FIRST: expansion},
        "temperatures": [
            hhr.FixedTemperature(side(FIRST, 1, False), cold),
            hhr.FixedTemperature(side(SECOND, 1, True), warm),
        ],
    }
    return hhr.condense_heat(scene, hhr.Heat(**given | more))


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


def test_heat_that_a_warm_rod_gives_to_a_wall_may_have_no_balance():
    """Open it is warm and too long, closed it is colder and too short; a conducting gap has one."""
    model = rods("1e4 * p / (p + 1e-6)", "T", 0.0, gap=0.0015)
    assert len(model.balances([0.0, 60.0])) == 1 and len(model.balances([0.0, 150.0])) == 1
    assert model.balances([0.0, 100.0]) == []
    with pytest.raises(ConvergenceError, match="find no balance at push = 0, T = 100"):
        model.solve([0.0, 100.0])
    assert not model.solve([0.0, 100.0], raise_on_failure=False).converged
    gas = rods("1e4 * p / (p + 1e-6) + 0.01 / (g + 1e-6)", "T", 0.0, gap=0.0015)
    answer = gas.solve([0.0, 100.0])
    flow = answer.heat_through(0)
    length = 2e-5 * (100.0 - flow / 20 / 2)
    gap = 0.0015 - length
    assert gap > 0
    assert flow == pytest.approx(100 / (1 / 20 + 1 / 50 + (gap + 1e-6) / 0.01), rel=1e-9)


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


def test_several_points_and_a_start_alone():
    model = rods("3 * p**0.95", 0.0, "T")
    points = [[0.005, 20.0], [0.001, 100.0]]
    for both in (True, False):
        answers = model.solve_many(points, both=both)
        expected = [model.solve(point).heat_through(0) for point in points]
        assert [answer.heat_through(0) for answer in answers] == pytest.approx(expected, rel=1e-12)


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
        ({"temperatures": [3.0]}, "none of the temperatures"),
        ({"reference": float("nan")}, "must be a temperature"),
        ({"supplies": [hhr.HeatSource(SECOND, "W")]}, "W"),
    ],
)
def test_what_does_not_fit_the_scene_is_refused(more, said):
    with pytest.raises(SceneError, match=said):
        hhr.condense_heat(blocks(), heat(**more))


def test_scenes_that_heat_is_not_for_are_refused():
    lawful = blocks()
    faces = side(FIRST, 1, True), side(SECOND, 1, False)
    for changed, said in (
        ({"contacts": (hhr.NodeToNode(*faces, (0.0, 1.0), 0.3),)}, "contacts have laws"),
        ({"bodies": (hhr.Body(FIRST, "100 + T", 0.3), hhr.Body(SECOND, 70.0, 0.2))}, "moduli"),
    ):
        with pytest.raises(NotOfferedError, match=said):
            hhr.condense_heat(dataclasses.replace(lawful, **changed), heat())
