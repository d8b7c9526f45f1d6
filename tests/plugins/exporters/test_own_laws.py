"""Laws of users in the kernel, alone and next to others: pages, C headers and units of their
scenes, as in Python.
"""

import dataclasses

import numpy as np
import pytest
from compiled_models import DONE, Instance, at, built, compiled
from libraries import ZIG
from mpi4py import MPI
from my_contact_law import KERNEL, Wear
from my_gasket import Gasket
from needs import needs
from page_scenes import TOUR, in_space
from pages_in_node import (
    CHROMIUM,
    ENDED,
    LOADED,
    MODEL,
    THERE,
    data_of,
    dumped,
    in_node,
    node,
    rows_of,
    said,
    shown,
)
from sheared_blocks import SECOND
from stacked_pairs import PATH, stacked, with_plugins

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import NotOfferedError
from hhr_dolfinx.geometries import two_blocks
from hhr_dolfinx.geometries.two_blocks import side
from hhr_dolfinx.plugins.contact_laws.interface import ranged
from hhr_dolfinx.plugins.exporters import fmu
from hhr_dolfinx.plugins.pages import page
from hhr_dolfinx.plugins.pages.kernel import page_sources
from hhr_dolfinx.plugins.pages.laws import Laws, check_law

WORN = 0.05
SOFT, SOLID = (
    Gasket("2.0 + push", 50.0),
    Gasket(2.0, 50.0),
)  # constants of friction's scenes do not change on a path
CASES = {
    "wear alone": lambda: stacked(Wear(WORN)),
    "gasket alone": lambda: stacked(SOFT),
    "gasket next to unilateral pairs and wear": lambda: stacked(Wear(WORN), floor=SOFT),
    "friction, gasket, wear": lambda: stacked(hhr.Coulomb(0.3), SOLID, Wear(WORN)),
    "friction with a limit, gasket": lambda: stacked(hhr.Coulomb(0.6, limit=0.02), SOLID),
}
CASES |= {
    "bodies that a gasket and friction hold": lambda: loose(hhr.Coulomb(0.3), SOLID),
    "bodies that a gasket holds": lambda: loose(
        None, SOFT, hhr.Displacement(two_blocks.side(1, 0, False), 0)
    ),
    "friction in space, gasket": lambda: in_space_at_a_wall(),
}
HELD = [
    (0.0, (0.001, 0.0)),
    (1.0, (0.02, 0.0)),
    (2.0, (0.02, 0.001)),
    (3.5, (0.01, -0.001)),
    (4.0, (0.04, 0.001)),
]
NEEDED = {name: [needs("friction")] for name in CASES if "friction" in name}
for name in CASES:
    NEEDED[name] = [*NEEDED.get(name, []), *([needs("floating")] if "hold" in name else [])]
# the wall stands where the upper edge is moved to: no force acts at its nodes
AT_WALL = pytest.mark.filterwarnings(
    "ignore:at 4 places of contacts:hhr_dolfinx.errors.SceneWarning"
)
NEEDED["friction in space, gasket"].append(AT_WALL)
EVERY = [pytest.param(name, marks=NEEDED.get(name, ())) for name in CASES]
with_zig = pytest.mark.skipif(not ZIG, reason="ziglang is not there")
ALONG = (
    LOADED
    + """
const steps = data.tree.path && new hhr.Steps(model), durations = points;
let state = steps && steps.rest(path[0]);
for (const [k, point] of path.slice(1).entries()) {
  state = steps ? steps.reached(state, point, durations[k]) : model.solve(point);
  const slopes = steps ? null : model.slopes(state);
  found.push({ forces: [...state.forces], outputs: model.outputs(state), slopes });
}
const told = ({ point, time, forces }) => ({ point, time, forces: [...forces] });
const begun = steps && steps.begun(path[2]).map(told);
console.log(JSON.stringify({ found, begun }));
"""
    + ENDED
)
IN_C = """
#include "press.h"
int ask(int count, const double *points, const double *seconds, double *forces, double *outputs,
        double *slopes) {
    int status = PRESS_DONE;
#if PRESS_PATHS
    press_path *path = press_path_new();
    (void)slopes;
    status = press_rest(path, points);
    for (int k = 1; k < count && !status; k++) {
#if PRESS_REMEMBERS
        path->seconds = seconds[k - 1];
#endif
        status = press_go(path, points + k * PRESS_PARAMETERS, forces + (k - 1) * PRESS_CONDITIONS,
                          outputs + (k - 1) * PRESS_OUTPUTS);
    }
    press_path_free(path);
#else
    press_work *work = press_new();
    (void)seconds;
    for (int k = 1; k < count && !status; k++) {
        status = press_solve(work, points + k * PRESS_PARAMETERS,
                             forces + (k - 1) * PRESS_CONDITIONS,
                             outputs + (k - 1) * PRESS_OUTPUTS);
        if (!status)
            status = press_derivatives(work, points + k * PRESS_PARAMETERS,
                                       slopes + (k - 1) * PRESS_OUTPUTS * PRESS_PARAMETERS);
    }
    press_free(work);
#endif
    return status;
}
int begin(const double *point, double *forces) {
#if PRESS_PATHS
    press_path *path = press_path_new();
    const int status = press_begin(path, point, forces, NULL);
    press_path_free(path);
    return status;
#else
    (void)point, (void)forces;
    return PRESS_DONE;
#endif
}
"""


def loose(between, floor, *held):
    """The lower block lies on the floor, held by nothing else."""
    scene = stacked(between, floor)
    return dataclasses.replace(
        scene, displacements=(*held, *scene.displacements[2:]), contacts=scene.contacts[:2]
    )


def in_space_at_a_wall():
    """Blocks in space with friction, of which the upper one is pressed against a gasket as it is
    sheared.
    """
    scene = in_space(0.3, cells=3)
    wall = hhr.Obstacle(side(SECOND, 0, True), (1.0, 0.0, 0.0), 1.01, law=SOLID)
    return dataclasses.replace(scene, contacts=(*scene.contacts, wall))


def path_of(name):
    """Times and points of a case."""
    if name == "friction in space, gasket":
        turned = [(push, shear, 0.05 * np.sin(k)) for k, (push, shear) in enumerate(TOUR[:6])]
        return [(float(time), point) for time, point in enumerate(turned)]
    return HELD if "hold" in name else PATH


@pytest.fixture(autouse=True)
def plugins(monkeypatch):
    with_plugins(monkeypatch)


def made(name):
    """Condensed model and scenery of a case, with outputs."""
    scene = CASES[name]()
    way = (0.0, 1.0, 0.0)[: 3 if scene.hypothesis == "solid" else 2]
    outputs = tuple(hhr.ContactForce(f"force {k}", k, way) for k in range(2))
    full = hhr.FullOrderModel(dataclasses.replace(scene, outputs=outputs), MPI.COMM_SELF)
    return hhr.condense(full, fields=True), hhr.scenery_of(full)


def answers_of(model, path):
    """Answers along a path, point by point for laws without memory."""
    if model.law.path_dependent:
        history = model.march(path)
        assert history.cuts == 0
        return history.answers
    return [model.solve(point, gradient=True) for _, point in path[1:]]


def seconds_of(path):
    """Durations of its steps."""
    return np.diff([time for time, _ in path])


def check(model, found, answers):
    """Forces and outputs of a path, to 1e-11 of the largest, where all searches stop.

    Each law is at work.
    """
    largest = max(np.abs(answer.multipliers).max() for answer in answers)
    for part in ranged(model.law, model.conditions).ranges:
        assert (
            max(np.abs(answer.multipliers[part.rows]).max() for answer in answers)
            > 1e-3 * largest
            > 0
        )
    for (forces, outputs), answer in zip(found, answers, strict=True):
        np.testing.assert_allclose(forces, answer.multipliers, rtol=0, atol=1e-11 * largest)
        np.testing.assert_allclose(
            outputs, list(answer.outputs().values.values()), rtol=1e-9, atol=1e-11
        )


@with_zig
@in_node
@pytest.mark.parametrize("name", EVERY)
def test_pages_are_those_of_python(name):
    model, scenery = made(name)
    text = page.page_text(model, scenery)
    path = path_of(name)
    given = {"path": [point for _, point in path], "points": seconds_of(path).tolist()}
    told = node(ALONG, MODEL, page=text, **given)
    answers = answers_of(model, path)
    check(model, [(item["forces"], item["outputs"]) for item in told["found"]], answers)
    assert (
        (data_of(text)["tree"]["path"] is not None)
        == model.law.path_dependent
        == (told["begun"] is not None)
    )
    if told["begun"] is None:
        for item, answer in zip(told["found"], answers, strict=True):
            gradient = np.array([*answer.outputs().gradient.values()])
            # by central differences of answers
            np.testing.assert_allclose(
                item["slopes"], gradient, rtol=0, atol=1e-5 * np.abs(gradient).max()
            )
        return
    # loaded in proportion within a second, in the increments of Python
    exact = model.solve(path[2][1]).multipliers
    last = told["begun"][-1]
    assert last["time"] == pytest.approx(1.0)
    np.testing.assert_allclose(last["forces"], exact, rtol=0, atol=1e-9 * np.abs(exact).max())


@compiled
@pytest.mark.parametrize("name", EVERY)
def test_headers_are_those_of_python(name, tmp_path):
    model, _ = made(name)
    library = built(tmp_path, model, IN_C)
    path = path_of(name)
    points = np.array([point for _, point in path])
    count = len(path) - 1
    forces, outputs, slopes = (
        np.zeros((count, *shape)) for shape in ((model.conditions,), (2,), (2, points.shape[1]))
    )
    assert library.ask(len(path), *at(points, seconds_of(path), forces, outputs, slopes)) == DONE
    answers = answers_of(model, path)
    check(model, zip(forces, outputs, strict=True), answers)
    if not model.law.path_dependent:
        for found, answer in zip(slopes, answers, strict=True):
            gradient = np.array([*answer.outputs().gradient.values()])
            np.testing.assert_allclose(found, gradient, rtol=0, atol=1e-5 * np.abs(gradient).max())
        return
    loaded = np.zeros(model.conditions)
    assert library.begin(*at(points[2], loaded)) == DONE
    exact = model.solve(points[2]).multipliers
    np.testing.assert_allclose(loaded, exact, rtol=0, atol=1e-9 * np.abs(exact).max())


def test_memory_of_wear_changes_answers(tmp_path):
    """Forces fall while a body is held that wears: a kernel that forgets would keep them."""
    model, _ = made("wear alone")
    still = [(0.0, (0.0, 0.0)), *((float(time), (0.03, 0.0)) for time in (1, 2, 3))]
    totals = [answer.multipliers.sum() for answer in model.march(still).answers]
    library = built(tmp_path, model, IN_C)
    points = np.array([point for _, point in still])
    forces, outputs = np.zeros((3, model.conditions)), np.zeros((3, 2))
    assert library.ask(4, *at(points, np.ones(3), forces, outputs, outputs)) == DONE
    np.testing.assert_allclose(forces.sum(axis=1), totals, rtol=1e-10)
    assert totals[2] < 0.999 * totals[0]


@compiled
@pytest.mark.parametrize("name", ["wear alone", "gasket alone"])
def test_a_unit_answers_as_python_does(name, tmp_path):
    """A step of a law with memory is an increment of its seconds."""
    model, _ = made(name)
    unit = Instance(tmp_path, fmu.write_fmu(tmp_path / "unit.fmu", model))
    points = [np.array(point) for _, point in PATH]
    path = list(enumerate(points))
    assert unit.put(points[0]) == 0 and unit.begin() == 0
    remembers = model.law.path_dependent
    answers = (
        model.march(path).answers if remembers else [model.solve(point) for point in points[1:]]
    )
    for number, (point, answer) in enumerate(zip(points[1:], answers, strict=True)):
        assert unit.put(point) == 0 and unit.step(number) == 0
        np.testing.assert_allclose(
            unit.read(), list(answer.outputs().values.values()), rtol=1e-9, atol=1e-12
        )
    unit.made.fmi3FreeInstance(unit.at)


def test_laws_without_c_are_refused(monkeypatch):
    """And inelastic bodies, whose corrections have another contact problem."""
    import my_gasket

    from hhr_dolfinx import registry

    model, scenery = made("gasket alone")
    with pytest.raises(
        NotOfferedError, match=r"a page solves inelastic bodies .* not with a gasket: ask in Python"
    ):
        check_law(model.law, "a page", flows=True)
    bare = dataclasses.replace(my_gasket.PLUGIN, facets={"range": "my_gasket:GasketRange"})
    every = registry.installed() | {"my_gasket": bare}
    monkeypatch.setattr(registry, "installed", lambda: every)
    registry.facet.cache_clear()
    with pytest.raises(
        NotOfferedError, match=r"contacts with a gasket is not built in .* no facet 'kernel'"
    ):
        hhr.write_model_page("never.html", model, scenery)


@with_zig
@pytest.mark.skipif(not THERE, reason="node or its package jsdom is not there")
def test_a_page_of_wear_holds_its_loads():
    """For the seconds that are given, along which forces fall.

    What a page copies is a path of Python.
    """
    model, scenery = made("wear alone")
    acts = (("set", "seconds", "4"), ("click", "hold"), ("click", "keep"))
    first, _, held, copied = shown(page.page_text(model, scenery), "push=0.03&slide=0.01", *acts)
    assert (
        "pace" not in first["hidden"]
        and "What has changed in contacts is remembered" in first["texts"]["memory"]
    )
    lines = [list(map(float, line.split("\t"))) for line in copied["copied"].splitlines()[1:]]
    path = [(time, np.array(point)) for time, *point in lines]
    assert path[-2][0] == pytest.approx(1.0) and path[-1][0] == pytest.approx(5.0)
    answers = model.march(path).answers
    for view, answer in ((first, answers[-2]), (held, answers[-1])):
        assert float(rows_of(view)["force 0"]) == said(answer.outputs()["force 0"])
    assert abs(float(rows_of(held)["force 0"])) < 0.99 * abs(float(rows_of(first)["force 0"]))


@with_zig
@pytest.mark.skipif(CHROMIUM is None, reason="chromium is not there")
def test_a_browser_shows_the_answer_with_a_gasket(tmp_path):
    model, scenery = made("gasket alone")
    target = hhr.write_model_page(tmp_path / "page.html", model, scenery)
    found = dumped(target, "push=0.03&slide=0.01", tmp_path)
    total = said(model.solve((0.03, 0.01)).outputs()["force 0"])
    assert 'data-converged="true"' in found and f"<td>force 0</td><td>{total:.12g}</td>" in found


def test_functions_of_a_law_are_called_by_its_number():
    """Of two laws each has its own; a law without memory is asked for its projection alone."""
    import my_gasket

    text = page_sources(["ranges", "memory"], Laws(None, (KERNEL, my_gasket.KERNEL)))["kernel.h"]
    assert "if (law == 1) return model_my_contact_law_projection(own, y, c, slope);" in text
    assert "if (law == 2) return model_my_gasket_projection(own, y, c, slope);" in text
    assert "if (law == 1) model_my_contact_law_after" in text and "my_gasket_after" not in text
