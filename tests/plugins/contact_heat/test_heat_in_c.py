"""Models with heat as C headers and units, compiled and asked beside Python."""

import numpy as np
import pytest
from compiled_models import NO_ANSWER, OUTSIDE, Instance, at, built, compiled
from heated_pairs import FED, GIVEN, SLIDING, blocks, heat, rod_scene
from shell import invoke

import hhr_dolfinx as hhr
from hhr_dolfinx.geometries.two_blocks import FIRST, SECOND, side
from hhr_dolfinx.plugins.exporters.fmu import write_fmu

pytestmark = compiled
STEADY = """
#include "press.h"
int ask(int count, int anew, const double *points, double *forces, double *outputs,
        double *slopes) {
    press_work *work = press_new();
    int status = PRESS_DONE;
    for (int k = 0; k < count && !status; k++) {
        const double *point = points + k * PRESS_PARAMETERS;
        if (anew) press_forget(work);
        status = press_solve(work, point, forces + k * PRESS_CONDITIONS,
                             outputs + k * PRESS_OUTPUTS);
        double *own = slopes + k * PRESS_OUTPUTS * PRESS_PARAMETERS;
        if (!status) status = press_derivatives(work, point, own);
    }
    press_free(work);
    return status;
}
"""
IN_TIME = """
#include "press.h"
int ask(int count, const double *lengths, const double *points, double *forces,
        double *outputs) {
    press_path *path = press_path_new();
    int status = press_begin(path, points, NULL, outputs);
    for (int k = 0; k < count && !status; k++) {
        path->seconds = lengths[k];
        status = press_go(path, points + k * PRESS_PARAMETERS, forces + k * PRESS_CONDITIONS,
                          outputs + (k + 1) * PRESS_OUTPUTS);
    }
    press_path_free(path);
    return status;
}
"""


def asked(folder, model, points, anew=True):
    """Status, forces, outputs and slopes of a header."""
    points = np.ascontiguousarray(points, dtype=float)
    names = list(model.solve(points[0], both=False).outputs().values)
    shapes = (model.conditions,), (len(names),), (len(names), points.shape[1])
    found = [np.full((len(points), *shape), np.nan) for shape in shapes]
    ask = built(folder, model, STEADY).ask
    return ask(len(points), anew, *at(points, *found)), *found


@pytest.mark.filterwarnings("ignore:parameters")
@pytest.mark.parametrize(("hypothesis", "given"), GIVEN)
def test_a_header_answers_as_python_does(hypothesis, given, tmp_path):
    """To round-off; slopes by differences of steps of 1e-5 of the box, exact ones in Python."""
    model = hhr.condense_heat(blocks(hypothesis), heat(**given))
    points = model.parameters.random(12, 3)
    status, forces, outputs, slopes = asked(tmp_path, model, points)
    assert status == 0
    for k, point in enumerate(points):
        answer = model.solve(point, both=False)
        size = answer.forces().max()
        np.testing.assert_allclose(forces[k], answer.forces(), rtol=0, atol=1e-11 * size)
        expected = answer.outputs().values
        np.testing.assert_allclose(outputs[k], list(expected.values()), rtol=1e-10)
        gradient = model.outputs(point, gradient=True).gradient
        for name, slope in zip(expected, slopes[k], strict=True):
            np.testing.assert_allclose(slope, gradient[name], rtol=1e-5, err_msg=name)


def rods(conductance, cold, warm, gap):
    fixed = [
        hhr.FixedTemperature(side(FIRST, 1, False), cold),
        hhr.FixedTemperature(side(SECOND, 1, True), warm),
    ]
    given = {"conductivity": {FIRST: 20.0, SECOND: 50.0}, "expansion": {FIRST: 2e-5}}
    return hhr.condense_heat(
        rod_scene(gap), hhr.Heat(**given, conductance={0: conductance}, temperatures=fixed)
    )


def test_a_header_stays_with_its_balance_or_starts_anew(tmp_path):
    """Barber's rod: pushed together and let go it stays warm, anew it is cold."""
    model = rods("1e4 * p / (p + 1e-6)", 0.0, "T", 0.0005)
    pushes = np.concatenate([np.linspace(0, 0.001, 5), np.linspace(0.001, 0, 5)])
    points = np.column_stack([pushes, np.full(pushes.size, 90.0)])
    status, forces, *_ = asked(tmp_path, model, points, anew=False)
    expected = np.array([answer.forces() for answer in model.march(points)])
    assert status == 0 and forces[-1].all() and not forces[0].any()
    np.testing.assert_allclose(forces, expected, rtol=1e-9)
    (tmp_path / "anew").mkdir()
    assert not asked(tmp_path / "anew", model, points)[1][-1].any()


def test_a_header_finds_the_edge_of_contact(tmp_path):
    """By gaps that conduct less and less, see test_contact_heat."""
    model = rods("1e4 * p / (p + 1e-6)", "T", 0.0, 0.0015)
    status, forces, outputs, _ = asked(tmp_path, model, [[0.0, 100.0]])
    flow = (100.0 - 0.0015 / 2e-5) * 2 * 20
    assert status == 0 and outputs[0, 1] == pytest.approx(flow, rel=1e-6)
    np.testing.assert_allclose(forces[0], model.solve([0.0, 100.0]).forces(), rtol=1e-6)


def test_statuses_of_a_header(tmp_path):
    fed = hhr.condense_heat(
        rod_scene(0.0005),
        hhr.Heat(
            conductivity={FIRST: 20.0, SECOND: 50.0},
            conductance={0: "3 * p**0.95"},
            temperatures=[hhr.FixedTemperature(side(FIRST, 1, False), 0.0)],
            supplies=[hhr.HeatSource(SECOND, "T")],
        ),
    )
    points = np.array([[0.0, 100.0]])
    shapes = (1, fed.conditions), (1, 2), (1, 2, 2)
    found = [np.zeros(shape) for shape in shapes]
    ask = built(tmp_path, fed, STEADY).ask
    assert ask(1, 1, *at(points, *found)) == NO_ANSWER
    assert ask(1, 1, *at(np.array([[0.02, 0.0]]), *found)) == OUTSIDE


@pytest.mark.filterwarnings("ignore:parameters")
@pytest.mark.parametrize("given", [{}, FED, {**FED, "sliding": SLIDING}])
def test_a_header_steps_in_time_as_python_does(given, tmp_path):
    """Steps of several lengths; the answer at the start has its temperature."""
    model = hhr.condense_transient_heat(blocks(), heat(**given))
    times = np.array([0.003, 0.006, 0.01, 0.02, 0.04, 0.1])
    points = model.parameters.random(times.size, 3)
    answers = model.march(points, times, 15.0)
    names = list(answers[0].outputs().values)
    forces = np.full((times.size, model.conditions), np.nan)
    outputs = np.full((times.size + 1, len(names)), np.nan)
    lengths, wide = np.diff(times, prepend=0.0), np.column_stack([points, np.full(6, 15.0)])
    ask = built(tmp_path, model, IN_TIME).ask
    assert ask(times.size, *at(lengths, wide, forces, outputs)) == 0
    for k, answer in enumerate(answers):
        size = answer.forces().max()
        np.testing.assert_allclose(forces[k], answer.forces(), rtol=0, atol=1e-11 * size)
        expected = list(answer.outputs().values.values())
        np.testing.assert_allclose(outputs[k + 1], expected, rtol=1e-9)
    shortly = model.march(points[0], [1e-12], 15.0)[0].outputs().values
    np.testing.assert_allclose(outputs[0], list(shortly.values()), rtol=1e-6)


@pytest.mark.parametrize("build", [hhr.condense_heat, hhr.condense_transient_heat])
def test_a_unit_of_a_file(build, tmp_path):
    """``hhr embed`` reads its file; of a unit in time the start is a parameter."""
    model = build(blocks(), heat())
    hhr.save_heat_model(tmp_path / "warm.npz", model)
    code, said = invoke("embed", tmp_path / "warm.npz", "--out", tmp_path / "warm.h")
    assert code == 0 and "warm_mechanics_solve" in (tmp_path / "warm.h").read_text(), said
    write_fmu(tmp_path / "warm.fmu", model)
    unit = Instance(tmp_path, tmp_path / "warm.fmu")
    in_time = build is hhr.condense_transient_heat
    kinds = [item.get("causality") for item in unit.variables]
    assert kinds.count("parameter") == in_time
    point = [0.006, 100.0]
    assert unit.put([*point, *[15.0] * in_time]) == 0 and unit.begin() == 0
    for k in range(3):
        assert unit.step(k) == 0
    answer = model.march(point, [1.0, 2.0, 3.0], 15.0)[-1] if in_time else model.solve(point)
    expected = list(answer.outputs().values.values())
    np.testing.assert_allclose(unit.read(), expected, rtol=1e-9)


def test_a_unit_that_is_reset_starts_anew(tmp_path):
    """A rod that has been warm and closed is cold and open, as in a fresh unit."""
    model = rods("1e4 * p / (p + 1e-6)", 0.0, "T", 0.0005)
    unit = Instance(tmp_path, write_fmu(tmp_path / "rods.fmu", model))
    there = np.linspace(0.0, 0.001, 5)
    for pushes in ([*there, *there[::-1]], [0.0]):
        for number, push in enumerate(pushes):
            assert unit.put([push, 90.0]) == 0
            assert (unit.step(number) if number else unit.begin()) == 0
        warm = unit.read()[-1] < -1000.0
        assert warm == (len(pushes) > 1)
        unit.made.fmi3Reset(unit.at)


def test_time_passes_in_steps_of_a_unit(tmp_path):
    model = hhr.condense_transient_heat(blocks(), heat())
    unit = Instance(tmp_path, write_fmu(tmp_path / "warm.fmu", model))
    assert unit.put([0.006, 100.0, 15.0]) == 0 and unit.begin() == 0
    before = unit.read()
    assert unit.step(0, 0.0) != 0
    np.testing.assert_array_equal(unit.read(), before)
