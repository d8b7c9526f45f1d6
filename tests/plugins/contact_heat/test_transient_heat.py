"""Transient heat through contacts: a coupled full model of implicit steps, and closed forms."""

import dataclasses
import functools

import numpy as np
import pytest
from heated_pairs import CAPACITY, Coupled, blocks, heat

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import (
    ConvergenceError,
    OutsideTrainingWarning,
    ParameterError,
    SceneError,
    StabilityWarning,
)
from hhr_dolfinx.geometries import two_blocks
from hhr_dolfinx.geometries.two_blocks import FIRST, SECOND, side
from hhr_dolfinx.plugins.contact_heat import modes

pytestmark = pytest.mark.filterwarnings("ignore:parameters")  # of the mesh alone, without heat

NODES = 98
FREE = 84  # those below the fixed temperatures of both ends
TIMES = [0.002, 0.004, 0.01, 0.02, 0.1]
PATH = np.array([[0.002, 20.0], [0.006, 150.0], [0.006, 150.0], [0.002, 150.0], [0.01, 40.0]])


@pytest.mark.parametrize("hypothesis", ["plane_strain", "axisymmetric"])
def test_all_modes_are_a_coupled_full_model(hypothesis):
    """Which shares the mesh alone, with steps of four lengths; statuses change along the path."""
    scene = blocks(hypothesis)
    model = hhr.condense_transient_heat(scene, heat(), tolerance=0)
    assert model.step_error == 0 and model.rates.size == FREE
    full = hhr.FullOrderModel(blocks(hypothesis))
    reference = Coupled(full.problem, hypothesis)
    places = full.problem.contact_points[:, 0]
    order = np.argsort(reference.points[reference.pairs[:, 0], 0])[np.argsort(np.argsort(places))]
    answers = model.march(PATH, TIMES, start=12.0)
    expected = reference.march(*PATH.T, TIMES, 12.0)
    for answer, (forces, flows, temperature) in zip(answers, expected, strict=True):
        size = np.abs(forces).max()
        np.testing.assert_allclose(answer.forces(), forces[order], rtol=0, atol=1e-10 * size)
        size = np.abs(flows).max()
        np.testing.assert_allclose(answer.heat, flows[order], rtol=0, atol=1e-10 * size)
        np.testing.assert_allclose(answer.temperature(), temperature, rtol=0, atol=1e-9 * 150)
    assert len({tuple(answer.forces() > 0) for answer in answers}) > 1
    # steady temperatures are far from these
    steady = hhr.condense_heat(scene, heat()).solve(PATH[1]).temperature()
    assert np.abs(steady - answers[1].temperature()).max() > 10.0


def test_few_modes_are_near_all_of_them_and_say_how_near():
    """The error of histories falls with the tolerance; rates are those of all modes from above."""
    whole = hhr.condense_transient_heat(blocks(cells=12), heat(), tolerance=0)
    expected = np.array([one.temperature() for one in whole.march(PATH, TIMES, start=12.0)])
    counts = []
    for tolerance in (0.1, 1e-2, 1e-3, 1e-4):
        model = hhr.condense_transient_heat(blocks(cells=12), heat(), tolerance=tolerance)
        found = np.array([one.temperature() for one in model.march(PATH, TIMES, start=12.0)])
        assert np.abs(found - expected).max() < min(3 * tolerance, 0.02) * 150.0
        assert 0 < model.step_error <= tolerance
        counts.append(model.rates.size)
        assert (model.rates > whole.rates[: counts[-1]] * (1 - 1e-9)).all()
        np.testing.assert_allclose(model.rates[0], whole.rates[0], rtol=tolerance)
    assert counts == sorted(counts) and counts[-1] < 0.6 * whole.rates.size


def test_modes_that_only_shorter_steps_need_are_left_out(tmp_path):
    """Histories of longer steps are as near; shorter ones warn, from a file too."""
    times = np.array([0.1, 0.3, 0.5, 0.9, 2.0])
    whole, some = (
        hhr.condense_transient_heat(blocks(cells=12), heat(), shortest=length)
        for length in (0.0, 0.1)
    )
    assert some.rates.size < 0.6 * whole.rates.size and some.step_error <= 1e-3
    expected, found = (
        np.array([one.temperature() for one in model.march(PATH, times, start=12.0)])
        for model in (whole, some)
    )
    assert np.abs(found - expected).max() < 2e-3 * 150.0
    hhr.save_heat_model(tmp_path / "model.npz", some)
    with pytest.warns(OutsideTrainingWarning, match="a step of 0.02 is shorter than 0.1"):
        hhr.load_heat_model(tmp_path / "model.npz").march(PATH[:1], [0.02], start=12.0)
    with pytest.raises(SceneError, match="the shortest step -1"):
        hhr.condense_transient_heat(blocks(), heat(), shortest=-1)


@pytest.mark.parametrize(
    "more",
    [
        {"capacity": {FIRST: 3.0, SECOND: 3e-5}},
        {"temperatures": [], "supplies": [hhr.Convection(side(SECOND, 1, True), 1e-5, 20.0)]},
    ],
    ids=["small capacity", "weak convection"],
)
def test_modes_are_as_near_in_each_body_and_at_its_own_times(more):
    """A body of small capacity, or one that hardly anything cools, so that its mean temperature per
    heat flow is 1e6 times what varies in it.
    """
    given = heat(conductance={0: 30.0}, **more)
    scene = blocks(cells=12)
    model, whole = (hhr.condense_transient_heat(scene, given, one) for one in (1e-3, 0))
    assert model.rates.size < whole.rates.size / 2
    problem = hhr.FullOrderModel(scene).problem
    upper = np.unique(problem.cell_nodes[problem.points[problem.cell_nodes].mean(1)[:, 1] > 1])
    start = np.full(len(problem.points), 20.0)
    start[upper] = 100.0
    for end in (1e-8, 1e-6, 1e-4, 1e-2):
        times = end * np.array([0.1, 1.0])
        found = model.march(PATH[1], times, start)[-1]
        expected = whole.march(PATH[1], times, start)[-1]
        np.testing.assert_allclose(found.temperature(), expected.temperature(), atol=0.02)
        largest = np.abs(expected.heat).max()
        np.testing.assert_allclose(found.heat, expected.heat, rtol=0, atol=1e-5 * largest)


def test_heat_that_warms_a_body_as_a_whole_needs_no_modes():
    sources = [hhr.HeatSource(FIRST, "T"), hhr.HeatSource(SECOND, 1.0)]
    models = [
        hhr.condense_transient_heat(blocks(), heat(temperatures=[], supplies=supplies))
        for supplies in ([], sources)
    ]
    assert models[0].rates.size == models[1].rates.size
    assert not models[1].conduction.temperatures.any()


def test_steps_beside_the_contact_of_long_bodies_are_near():
    """What a short step changes there is a small part of what the whole rod stores."""
    geometry = functools.partial(
        two_blocks.two_blocks,
        first=((0.0, 0.0), (1.0, 40.0), (2, 200)),
        second=((0.0, 40.0), (1.0, 80.0), (2, 200)),
    )
    scene = dataclasses.replace(blocks(), geometry=geometry, outputs=())
    given = heat(conductance={0: 100.0})
    model, whole = (hhr.condense_transient_heat(scene, given, one) for one in (1e-3, 0))
    problem = hhr.FullOrderModel(scene).problem
    start = np.where(problem.points[:, 1] > 40.0, 100.0, 20.0)
    for found, expected in zip(
        *(of.march(PATH[1], TIMES[:3], start) for of in (model, whole)), strict=True
    ):
        np.testing.assert_allclose(found.temperature(), expected.temperature(), atol=0.02)
        np.testing.assert_allclose(found.heat, expected.heat, rtol=1e-5)


def test_a_tolerance_that_is_not_met_is_told_of(monkeypatch):
    monkeypatch.setattr(modes, "PER_DECADE", 0.1)
    monkeypatch.setattr(modes, "DENSER", 0)
    with pytest.warns(StabilityWarning, match="tolerance=0 has all modes"):
        hhr.condense_transient_heat(blocks(cells=12), heat(), 1e-6)


def test_long_steps_end_in_the_steady_balance():
    steady = hhr.condense_heat(blocks(), heat()).solve(PATH[1])
    model = hhr.condense_transient_heat(blocks(), heat(), tolerance=0.01)
    answer = model.march(PATH[1], [1e9], start=0.0)[0]
    np.testing.assert_allclose(answer.heat, steady.heat, rtol=1e-7)
    np.testing.assert_allclose(answer.forces(), steady.forces(), rtol=0, atol=1e-7)
    np.testing.assert_allclose(answer.temperature(), steady.temperature(), rtol=0, atol=1e-6)


def test_two_bodies_of_great_conductivity_even_out():
    """Each is at one temperature; their difference falls by 1 / (1 + rate dt) in each step, with
    rate = h A (1 / C1 + 1 / C2), and what both store stays.
    """
    conducting = {FIRST: 1e7, SECOND: 1e7}
    given = heat(conductivity=conducting, conductance={0: 0.5}, expansion={}, temperatures=[])
    model = hhr.condense_transient_heat(blocks(), given, tolerance=1e-4)
    reference, area, upper = of_the_mesh()
    stored = reference.capacity @ np.ones(NODES)
    low, high = stored[~upper].sum(), stored[upper].sum()
    rate = 0.5 * area * (1 / low + 1 / high)
    answers = model.march([0.01, 20.0], np.linspace(0.1, 2.0, 20), np.where(upper, 80.0, 20.0))
    for number, answer in enumerate(answers, start=1):
        warm = answer.temperature()
        difference = warm[upper].mean() - warm[~upper].mean()
        assert difference == pytest.approx(60.0 * (1 + 0.1 * rate) ** -number, rel=1e-5)
        assert stored @ warm == pytest.approx(low * 20.0 + high * 80.0, rel=1e-12)


def of_the_mesh():
    """The reference, the area of contact, and nodes of the upper block."""
    problem = hhr.FullOrderModel(blocks()).problem
    reference = Coupled(problem, "plane_strain")
    upper = np.zeros(NODES, dtype=bool)
    upper[np.unique(reference.cells[reference.tags == SECOND])] = True
    return reference, problem.contact_areas.sum(), upper


def test_bodies_without_a_temperature_store_what_they_are_given():
    """With the coarsest modes, as levels of the bodies are two of them: a power of 40 in the lower
    one and a flux of 7 through the top; nothing leaves.
    """
    supplies = [hhr.HeatSource(FIRST, "T"), hhr.HeatFlux(side(SECOND, 1, True), 7.0)]
    given = heat(temperatures=[], supplies=supplies)
    model = hhr.condense_transient_heat(blocks(), given, tolerance=0.9)
    reference, *_ = of_the_mesh()
    stored = reference.capacity @ np.ones(NODES)
    answers = model.march([0.006, 40.0], [0.1, 0.3, 1.0], start=5.0)
    for answer, time in zip(answers, (0.1, 0.3, 1.0), strict=True):
        assert stored @ (answer.temperature() - 5.0) == pytest.approx((40 + 7) * time, rel=1e-10)


def test_a_slab_that_is_cooled_at_one_side_is_fouriers():
    """T = sum of 4 / ((2k + 1) pi) sin(..) exp(-..).

    Steps of 4e-3 over the slowest decay are off by .06 of 100, four times as much as twelve cells.
    """
    temperatures = [hhr.FixedTemperature(side(FIRST, 1, False), 0.0)]
    given = heat(conductance={}, expansion={}, temperatures=temperatures)
    model = hhr.condense_transient_heat(blocks(cells=12), given)
    problem = hhr.FullOrderModel(blocks(cells=12)).problem
    height = problem.points[:, 1]
    bottom = height < 1 - 1e-9
    diffusivity = 20.0 / CAPACITY[FIRST]
    times = np.linspace(0.0, 0.1, 401)[1:]
    answer = model.march([0.002, 20.0], times, start=100.0)[-1]
    odd = np.arange(1, 60, 2)[:, None] * np.pi / 2
    series = 100 * 2 / odd * np.sin(odd * height[bottom]) * np.exp(-(odd**2) * diffusivity * 0.1)
    np.testing.assert_allclose(answer.temperature()[bottom], series.sum(axis=0), atol=0.07)
    # the other body keeps its temperature
    np.testing.assert_allclose(answer.temperature()[height > 1.5], 100.0, rtol=1e-12)


def test_a_history_goes_on_where_it_ended():
    model = hhr.condense_transient_heat(blocks(), heat(), tolerance=0)
    whole = model.march(PATH, TIMES, start=12.0)
    first = model.march(PATH[:2], TIMES[:2], start=12.0)
    later = np.array(TIMES[2:]) - TIMES[1]
    rest = model.march(PATH[2:], later, start=first[-1].temperature())
    for one, other in zip(whole, [*first, *rest], strict=True):
        np.testing.assert_allclose(other.heat, one.heat, rtol=1e-9)


@pytest.mark.parametrize("fed", [False, True], ids=["fixed", "fed"])
def test_gradients_are_those_of_differences(fed):
    """Along a change of the parameters in all steps; a fed body stores what it was given."""
    supplies = [hhr.HeatSource(FIRST, "2 * T"), hhr.HeatFlux(side(SECOND, 1, True), 700.0)]
    more = {"temperatures": [], "supplies": supplies} if fed else {}
    conductance = {0: "(20 + 0.1 * T) * p / (p + 0.5) + 0.05 / (g + 0.001)"}
    model = hhr.condense_transient_heat(blocks(), heat(conductance=conductance, **more))
    points = np.array([[0.004, 60.0], [0.006, 90.0], [0.006, 70.0]])
    times = [0.01, 0.03, 0.1]
    found = model.outputs(points, times, 12.0, gradient=True)
    for number, step in enumerate((1e-7, 1e-3)):
        moved = np.eye(2)[number] * step
        up, down = (model.outputs(points + sign * moved, times, 12.0) for sign in (1, -1))
        for here, above, below in zip(found, up, down, strict=True):
            assert set(here.gradient) == set(here.values) >= {"heat 0", "peak", "corner"}
            for name, gradient in here.gradient.items():
                expected = (above[name] - below[name]) / 2 / step
                assert gradient[number] == pytest.approx(expected, rel=2e-5, abs=1e-7)
    assert [one.values for one in found] == [
        one.outputs().values for one in model.march(points, times, 12.0)
    ]


def test_starts_are_warm_bodies_answers_or_warned_of():
    """A body that is warm all over is in the modes; what varies within an element is not."""
    model = hhr.condense_transient_heat(blocks(), heat())
    whole = hhr.condense_transient_heat(blocks(), heat(), tolerance=0)
    _, _, upper = of_the_mesh()
    start = np.where(upper, 300.0, -100.0)
    for one, other in zip(
        model.march(PATH, TIMES, start), whole.march(PATH, TIMES, start), strict=True
    ):
        np.testing.assert_allclose(one.temperature(), other.temperature(), rtol=0, atol=0.4)
    rough = np.random.default_rng(0).uniform(0.0, 100.0, NODES)
    for zero in (0.0, 273.15):  # of the scale
        with pytest.warns(OutsideTrainingWarning, match=r"the start .* modes"):
            model.march(PATH, TIMES, rough + zero)
    whole.march(PATH, TIMES, rough)


def test_a_file_has_the_same_histories(tmp_path):
    model = hhr.condense_transient_heat(blocks(), heat())
    hhr.save_heat_model(tmp_path / "model.npz", model)
    again = hhr.load_heat_model(tmp_path / "model.npz")
    assert "transient" in repr(again) and again.step_error == model.step_error
    for one, other in zip(*(of.march(PATH, TIMES, 12.0) for of in (model, again)), strict=True):
        np.testing.assert_array_equal(one.temperature(), other.temperature())
        assert one.outputs().values == other.outputs().values


@pytest.mark.parametrize(
    ("points", "times", "start", "said"),
    [
        (PATH, TIMES[:4], 12.0, "5 points and 4 times"),
        (PATH[0], [0.0, 1.0], 12.0, "positive and rising"),
        (PATH[0], [1.0, 1.0], 12.0, "positive and rising"),
        (PATH[0], [np.nan], 12.0, "must be finite"),
        (PATH[0], [], 12.0, "no times"),
        (PATH[0], [1.0], np.zeros(3), "the 98 nodes"),
        (PATH[0], [1.0], np.nan, "finite temperature"),
        (PATH[0], [1.0], "warm", "finite temperature"),
        ([0.002, 500.0], [1.0], 12.0, "T = 500"),
        (PATH[0], "soon", 12.0, "must be numbers"),
        ([[0.002], [0.002, 20.0]], [1.0, 2.0], 12.0, "expected 2 parameters"),
    ],
)
def test_what_is_no_history_is_refused(points, times, start, said):
    model = hhr.condense_transient_heat(blocks(), heat(), tolerance=0.1)
    with pytest.raises(ParameterError, match=said):
        model.march(points, times, start)


def test_a_step_that_is_steady_names_the_steady_model():
    """A body that is fed stores so much in it that what passes through contact is lost in that."""
    fixed = [hhr.FixedTemperature(side(FIRST, 1, False), 20.0)]
    supplies = [hhr.HeatSource(SECOND, "3 * T")]
    given = heat(temperatures=fixed, supplies=supplies)
    model = hhr.condense_transient_heat(blocks(), given)
    steady = hhr.condense_heat(blocks(), given).solve([0.005, 60.0])
    long = model.march([0.005, 60.0], [1e6], start=20.0)[0]
    np.testing.assert_allclose(long.heat, steady.heat, rtol=1e-4)
    with pytest.raises(ConvergenceError, match="condense_heat has that"):
        model.march([0.005, 60.0], [1e14], start=20.0)


@pytest.mark.parametrize(
    ("more", "tolerance", "said"),
    [
        ({"capacity": {FIRST: 3.0}}, 1e-3, "body .* needs a capacity"),
        ({"capacity": {FIRST: 3.0, SECOND: 1.0, 77: 1.0}}, 1e-3, "body 77"),
        ({}, 1.0, "must be between 1e-06 and 1"),
        ({}, 1e-12, "must be between 1e-06 and 1"),
        ({}, np.nan, "must be between 1e-06 and 1"),
        ({}, -1e-3, "must be between 1e-06 and 1"),
    ],
)
def test_what_has_no_transient_is_refused(more, tolerance, said):
    with pytest.raises(SceneError, match=said):
        hhr.condense_transient_heat(blocks(), heat(**more), tolerance=tolerance)


@pytest.mark.parametrize("value", [0.0, -1.0, np.nan, "3"])
def test_capacities_are_positive(value):
    with pytest.raises(SceneError, match=r"capacity .* must be positive"):
        heat(capacity={FIRST: value})


def test_a_step_without_a_balance_keeps_those_before(monkeypatch):
    model = hhr.condense_transient_heat(blocks(), heat(), tolerance=0.01)
    whole = model.march(PATH, TIMES, start=12.0)
    formula = model._conducted

    def broken(point, pressures, gaps):
        found = formula(point, pressures, gaps)
        return (
            tuple(np.nan * one for one in found) if point[0] == 0.002 and point[1] > 100 else found
        )

    monkeypatch.setattr(model, "_conducted", broken)
    with pytest.raises(ConvergenceError, match=r"no balance at time 0.02, .* after 3 steps"):
        model.march(PATH, TIMES, start=12.0)
    kept = model.march(PATH, TIMES, start=12.0, raise_on_failure=False)
    assert [one.converged for one in kept] == [True, True, True, False, False]
    np.testing.assert_array_equal(kept[2].heat, whole[2].heat)
    for lost in kept[3:]:
        assert all(np.isnan(part).all() for part in (lost.forces(), lost.heat, lost.gaps))
