"""A model as a C header and as a unit for co-simulation: compiled and asked here, beside Python.

What is refused.
"""

import ctypes
import dataclasses
import subprocess
from functools import cache
from xml.etree import ElementTree

import contract
import impossible_moduli
import numpy as np
import page_scenes
import pytest
from compiled_models import (
    CC,
    CHANGED,
    DONE,
    NO_ANSWER,
    OUTSIDE,
    STEPPED,
    Instance,
    at,
    built,
    compiled,
)
from needs import needs
from page_scenes import (
    MORE,
    OF_FRICTION,
    OF_PELLET,
    RUBBING,
    SCENES,
    STRESSES,
    marked,
    rubbed,
    tour_of,
)
from pages_in_node import check_increment
from shell import invoke

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import MissingPackageError, ModelFileWarning, NotOfferedError
from hhr_dolfinx.plugins.exporters import c_header, fmu
from hhr_dolfinx.plugins.pages import stress_outputs
from hhr_dolfinx.plugins.pages.arrays import contact_tree
from hhr_dolfinx.plugins.pages.kernel import kernel_file
from hhr_dolfinx.plugins.pages.packing import Packed, steps_of
from hhr_dolfinx.trained import TrainedRange

CALLED = """
#include "press.h"
int ask(int count, int opened, const double *points, double *forces, double *outputs,
        double *slopes) {
    press_work *work = press_new();
    int status = PRESS_DONE;
    for (int k = 0; k < count && !status; k++) {
        const double *point = points + k * PRESS_PARAMETERS;
        if (opened) memset(work->active, 0, PRESS_CONDITIONS);
        double *own = slopes + k * PRESS_OUTPUTS * PRESS_PARAMETERS;
        status = press_solve(work, point, forces + k * PRESS_CONDITIONS,
                             outputs + k * PRESS_OUTPUTS);
        if (!status) status = press_derivatives(work, point, own);
    }
    press_free(work);
    return status;
}
"""


def outputs_of(model):
    """Names of the outputs that C knows."""
    return [item["name"] for item in contact_tree(model, Packed())["outputs"]]


def library(folder, model):
    """A function of points, (n, P), and of whether contacts are open at first: status, forces,
    outputs, slopes.
    """
    ask, count = built(folder, model, CALLED).ask, len(outputs_of(model))

    def asked(points, opened=False):
        points = np.ascontiguousarray(points, dtype=float)
        n, p = points.shape
        found = [
            np.full(shape, np.nan) for shape in ((n, model.conditions), (n, count), (n, count, p))
        ]
        return ask(n, opened, *at(points, *found)), *found

    return asked


DISCARD = 2
"""What FMI calls an answer that there is not."""


@compiled
@pytest.mark.parametrize(
    "name", marked(*SCENES, "held by contact", "halves", "bed", "moving tool", *STRESSES)
)
def test_a_header_has_the_digits_of_python(name, tmp_path):
    """Whether it starts from the answer before or from open contacts, where springs hold bodies."""
    model = hhr.condense((SCENES | MORE)[name](), fields=True)
    points = np.vstack(
        [model.parameters.random(30, 4), [model.parameters.lower, model.parameters.upper]]
    )
    asked, many = library(tmp_path, model), model.solve_many(points)
    exact = np.array([answer.forces() for answer in many])
    for opened in (True, False):
        status, forces, outputs, slopes = asked(points, opened)
        assert status == DONE
        np.testing.assert_allclose(forces, exact, rtol=0, atol=1e-10 * np.abs(exact).max())
    for k, name_of_output in enumerate(outputs_of(model)):
        known = many.outputs()[name_of_output]
        np.testing.assert_allclose(
            outputs[:, k], known, rtol=1e-8, atol=1e-10 * np.abs(known).max()
        )
        for point, found in zip(points[:5], slopes[:5, k], strict=True):
            gradient = model.outputs(point, gradient=True).gradient[name_of_output]
            # by central differences of a hundred-thousandth of the box
            np.testing.assert_allclose(
                found, gradient, rtol=0, atol=1e-5 * np.abs(gradient).max() + 1e-9
            )


def narrow():
    """A model that was trained in the lower half of its box, and a point of the box beyond."""
    model = hhr.condense(contract.blocks())
    space = model.parameters
    lower, middle = np.array(space.lower), np.array(space.middle)
    return model.changed(trained=TrainedRange(space.names, lower, middle)), np.array(
        [space.upper[0], lower[1]]
    )


@compiled
def test_a_point_that_was_not_trained_is_refused(tmp_path):
    """Within the box, and beyond."""
    model, beyond = narrow()
    asked = library(tmp_path, model)
    assert asked([model.trained.lower])[0] == asked([model.trained.upper])[0] == DONE
    for point in (beyond, np.array(model.parameters.upper) * 1.001, model.trained.upper * np.nan):
        assert asked([point])[0] == OUTSIDE


@compiled
def test_a_unit_says_which_input_it_refuses(tmp_path):
    model, beyond = narrow()
    said = []
    logger = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_int, ctypes.c_char_p, ctypes.c_char_p)
    log = logger(lambda _, status, category, message: said.append((status, message.decode())))
    unit = Instance(tmp_path, fmu.write_fmu(tmp_path / "unit.fmu", model), log)
    said.clear()
    assert unit.put(model.trained.lower) == 0 and unit.begin() == 0 and not said
    assert unit.put(beyond) == 0
    assert unit.begin() == DISCARD
    assert said == [
        (DISCARD, "push = 0.06 is outside of what the model was made for, 0.005 to 0.0325")
    ]


@compiled
def test_formulas_of_all_kinds_mean_the_same_in_c(tmp_path):
    formulas = [c_header.formula(steps_of(scalar)) for scalar in page_scenes.FORMULAS]
    own = "\n".join(
        f"double f{k}(const double *p) {{ return {text}; }}" for k, text in enumerate(formulas)
    )
    helpers = kernel_file("kernel.h").partition("/*DATA*/")[0]
    (tmp_path / "f.c").write_text(f"{helpers}\n{own}\n#endif\n")
    subprocess.run(
        [CC, "-std=c99", "-shared", "-fPIC", "-o", "f.so", "f.c", "-lm"], cwd=tmp_path, check=True
    )
    made = ctypes.CDLL(str(tmp_path / "f.so"))
    points, exact = page_scenes.values_of_formulas()
    for k, known in enumerate(exact.T):
        call = getattr(made, f"f{k}")
        call.restype = ctypes.c_double
        np.testing.assert_allclose([call(*at(point)) for point in points], known, rtol=1e-13)


@needs("tables")
@compiled
def test_what_is_not_finite_has_no_answer(tmp_path, monkeypatch):
    """A formula that nobody has looked at; Python says the same."""
    monkeypatch.setattr("hhr_dolfinx.plugins.tables.matrices.check_over_box", lambda *_: None)
    space = hhr.ParameterSpace(("a", "b"), (0.0, -1.0), (1.0, 1.0))
    given = {
        "stiffness": [[2.0, -1.0], [-1.0, 2.0]],
        "contact": [[0.0, 1.0]],
        "gaps": [[0.1, 0.0]],
        "areas": [1.0],
    }
    for number, text in enumerate(
        ("sqrt(b)", "1 / b", "min(1, sqrt(b))", "exp(1000 * b)", "table(b, 0, 1, 1, 2)")
    ):
        made = hhr.condense_matrices(
            space, loads=[[0.0, 1.0], [0.0, 0.0]], amplitudes=[1.0, text], **given
        )
        folder = tmp_path / str(number)  # a library is loaded once by its path
        folder.mkdir()
        asked = library(folder, made)
        bad = [0.5, 1.0 if "exp" in text else 0.0 if "/" in text else -0.5]
        assert asked([bad])[0] == NO_ANSWER, text
        status, forces, *_ = asked([[0.5, 0.5]])
        assert status == DONE and forces[0] == pytest.approx(
            made.solve([0.5, 0.5]).forces(), rel=1e-12
        )


def test_outputs_that_stay_out_are_named(monkeypatch):
    monkeypatch.setattr(stress_outputs, "STRESS_NUMBERS", 1000)
    with pytest.warns(ModelFileWarning, match="the C header has no output .*stress"):
        text, _ = c_header.c_header(hhr.condense(SCENES["partial pressure"]()), "press")
    assert "#define PRESS_OUTPUTS 4" in text


@needs("moduli", "shapes")
def test_outputs_of_shapes_stay_out():
    shaped = hhr.condense(SCENES["shape"]())
    with (
        pytest.warns(ModelFileWarning, match="the C header has no output peak, force"),
        pytest.raises(NotOfferedError, match="no outputs for it: peak, force"),
    ):
        fmu.write_fmu("never.fmu", shaped)


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("time", "there twice"),
        ("push", "there twice"),
        ("pe\x01ak", "printed"),
        ("pe\nak", "printed"),
    ],
)
def test_names_that_fmi_does_not_know_are_refused(name, said, tmp_path):
    scene = dataclasses.replace(contract.blocks(), outputs=(hhr.LargestPressure(name, 0),))
    with pytest.raises(NotOfferedError, match=said):
        fmu.write_fmu(tmp_path / "press.fmu", hhr.condense(scene))


def test_names_are_those_of_the_file_and_of_the_scene(tmp_path):
    scene = contract.blocks()
    odd = dataclasses.replace(
        scene, outputs=(hhr.LargestPressure('a "peak"\\ of ?? µ', 0, unit="N/mm²"),)
    )
    text, _ = c_header.c_header(hhr.condense(odd), "press")
    assert (
        "press_solve" in text
        and "PRESS_DONE" in text
        and "model_" not in text
        and "MODEL_" not in text
    )
    kept = dataclasses.replace(scene, outputs=(hhr.LargestPressure("model_MODEL_peak", 0),))
    text_of_kept, _ = c_header.c_header(hhr.condense(kept), "my_model")
    assert '"model_MODEL_peak"' in text_of_kept and "my_model_solve" in text_of_kept
    assert text.isascii() and '\\x22""peak\\x22""' in text
    for name in ("1st", "a b", "läge", ""):
        with pytest.raises(NotOfferedError, match="identifier"):
            c_header.c_header(hhr.condense(scene), name)


@needs("floating", "friction")
def test_other_models_are_refused_by_name(monkeypatch):
    with pytest.raises(NotOfferedError, match="FullOrderModel"):
        c_header.c_header(hhr.FullOrderModel(contract.blocks()), "press")
    model = hhr.condense(contract.blocks())
    monkeypatch.setattr(c_header, "MOST_HEADER_NUMBERS", 10)
    with pytest.raises(NotOfferedError, match="coarser mesh"):
        c_header.c_header(model, "press")


UNITS = {
    "pellet": lambda: dataclasses.replace(SCENES["partial pressure"](), outputs=OF_PELLET[:3]),
    "held by contact": MORE["held by contact"],
}


@pytest.fixture(scope="module")
def unit_of(tmp_path_factory):
    """A model by its name, points along the diagonal of its box or a path, and its unit."""

    @cache
    def made(name):
        if name in UNITS:
            model = hhr.condense(UNITS[name](), fields=True)
            lower, upper = np.array([model.parameters.lower, model.parameters.upper])
            path = list(lower + np.linspace(0, 1, 11)[:, None] * (upper - lower))
        else:
            model, path = rubbing_model(name) if name in RUBBING else flowing(name)
        return model, path, fmu.write_fmu(tmp_path_factory.mktemp("unit") / "unit.fmu", model)

    return made


@needs("floating", "elasticity")
@compiled
@pytest.mark.parametrize("name", marked(*UNITS))
def test_a_unit_answers_as_python_does(name, unit_of, tmp_path):
    """Called as an importer does, by its functions alone; by fmpy below."""
    model, _, path = unit_of(name)
    unit, names = Instance(tmp_path, path), list(model.outputs(model.parameters.middle).values)
    assert [item.get("name") for item in unit.variables] == [
        "time",
        *model.parameters.names,
        *names,
    ]
    assert [int(item.get("valueReference")) for item in unit.variables] == [*range(3 + len(names))]
    for point in model.parameters.random(20, 6):
        assert unit.put(point) == 0
        np.testing.assert_allclose(
            unit.read(), list(model.outputs(point).values.values()), rtol=1e-10
        )
    assert unit.put([1e9, 1.0]) == 0
    unit.read(DISCARD)
    unit.made.fmi3FreeInstance(unit.at)


FEW = [pytest.param(name, marks=needs("friction")) for name in ("formula and limit", "in space")]
ACCURACY = dict.fromkeys(UNITS, (1e-10, 1e-10)) | {"outputs": (1e-7, 1e-8)}


@needs("floating", "elasticity")
@compiled
@pytest.mark.parametrize(
    "name", [*marked(*UNITS), *FEW, pytest.param("outputs", marks=needs("inelastic", "moduli"))]
)
def test_a_unit_runs_in_fmpy(name, unit_of):
    """Steps are increments, moduli and laws parameters.

    A step ends with what its inputs were as it began.
    """
    fmpy = pytest.importorskip("fmpy")
    validation = pytest.importorskip("fmpy.validation")
    model, path, unit = unit_of(name)
    assert validation.validate_fmu(str(unit)) == []
    names, fixed = model.parameters.names, model.law.fixed if name in RUBBING else ()
    moving = [place for place in range(len(names)) if place not in fixed]
    kinds = [("time", float), *((names[place], float) for place in moving)]
    signals = np.array(
        [(float(time), *point[moving]) for time, point in enumerate(path)], dtype=kinds
    )
    start = {} if name in UNITS else dict(zip(names, path[0], strict=True))
    stop = float(len(path) - 1)
    found = fmpy.simulate_fmu(
        str(unit), input=signals, start_values=start, stop_time=stop, output_interval=1.0
    )
    if name in UNITS:
        known = [model.outputs(point) for point in path]
    else:
        known = [answer.outputs() for answer in marched(model, path).answers]
    late = len(path) - len(known) + 1
    relative, absolute = ACCURACY.get(name, (1e-8, 1e-10))
    for output in outputs_of(model):
        values = np.array([outputs[output] for outputs in known])
        least = absolute * np.abs(values).max()
        np.testing.assert_allclose(found[output][late:], values[:-1], rtol=relative, atol=least)


def test_a_unit_needs_outputs_and_a_compiler(tmp_path):
    bare = hhr.condense(dataclasses.replace(contract.blocks(), outputs=()))
    with pytest.raises(NotOfferedError, match="has no outputs"):
        fmu.write_fmu(tmp_path / "press.fmu", bare)
    with pytest.raises(MissingPackageError, match="no-such-compiler"):
        fmu.write_fmu(
            tmp_path / "press.fmu", hhr.condense(contract.blocks()), compiler="no-such-compiler"
        )
    assert not list(tmp_path.iterdir())


def test_a_unit_keeps_to_what_was_trained_within_the_box():
    """As the header that it is compiled of does, which refuses the rest."""
    tree = contact_tree(hhr.condense(contract.blocks()), Packed())
    assert tree["names"] == ["push", "load"]
    tree |= {"lower": [0.0, 0.0], "upper": [1.0, 1.0], "trained": [[0.25, -1.0], [2.0, 0.5]]}
    found = ElementTree.fromstring(fmu.description(tree, "press", "token")).find("ModelVariables")
    ends = {
        item.get("name"): [float(item.get(key)) for key in ("min", "max", "start")]
        for item in found
        if item.get("min")
    }
    assert ends == {"push": [0.25, 1.0, 0.625], "load": [0.0, 0.5, 0.25]}


def rubbing_model(name):
    """Condensed, with outputs of forces, and a tour whose first point is at rest."""
    model = hhr.condense(rubbed(name), fields=True)
    return model, tour_of(model)


def flowing(name):
    """Condensed flow, and a path that pushes and lets go."""
    from flowing_pages import cycle, pair, yielding

    if name != "outputs":
        return pair(name)[1], [point for _, point in cycle(2.9)]
    return yielding()[1], [np.array(point) for _, point in contract.path(0.04)]


def marched(model, path):
    """Python's history of what C does, whose steps are not cut."""
    how = () if model.law.plugin else (hhr.MarchSettings(relative_force=1e-11, iterations=200),)
    history = model.march(list(enumerate(path)), *how)
    assert history.cuts == 0
    return history


def increments(folder, model):
    """The functions above, and arrays for nine steps: forces, outputs, slip or cumulated strain,
    and statuses.
    """
    contacts = model.law.normal.size if model.law.plugin else 0
    flows = getattr(model, "flow", None)
    reached = (contacts, 3) if flows is None else (len(flows.parts),)
    room = [
        np.zeros((9, *shape)) for shape in ((model.conditions,), (len(outputs_of(model)),), reached)
    ]
    return built(folder, model, STEPPED), [*room, np.zeros((9, contacts), dtype=np.int32)]


@needs("friction")
@compiled
@pytest.mark.parametrize("name", OF_FRICTION)
def test_increments_in_c_are_those_of_python(name, tmp_path):
    model, tour = rubbing_model(name)
    made, room = increments(tmp_path, model)
    assert made.ask(len(tour), *at(np.array(tour), *room)) == DONE
    forces, outputs, slips, statuses = room
    history = marched(model, tour)
    largest = max(np.abs(answer.multipliers).max() for answer in history.answers)
    for k, answer in enumerate(history.answers):
        found = dict(zip(("path", "work", "wear"), slips[k].T, strict=True))
        found |= {"forces": forces[k], "outputs": outputs[k], "statuses": statuses[k]}
        check_increment(found, answer, largest)
    assert set(statuses.ravel().tolist()) == {0, 1, 2}
    # loaded in proportion, with increments that are halved as those of model.solve are
    for point in model.parameters.random(4, 3):
        assert made.begin(*at(point, forces, outputs)) == DONE
        exact = model.solve(point)
        scale = np.abs(exact.multipliers).max()
        np.testing.assert_allclose(
            forces[0], exact.multipliers, rtol=0, atol=1e-8 * max(scale, 1e-3 * largest)
        )


@needs("friction", "floating", "inelastic")
@compiled
@pytest.mark.parametrize("dimension", [2, 3])
def test_bodies_that_friction_holds_are_in_c_those_of_python(dimension, tmp_path):
    """On springs at the first load, and with motions as unknowns; an output reads the motions."""
    from rubbing_pages import held, loads_of

    model = held(dimension)[0]
    path = loads_of(model)
    made, room = increments(tmp_path, model)
    assert made.ask(len(path), *at(np.array(path), *room)) == DONE
    forces, outputs, slips, statuses = room
    answers = marched(model, path).answers
    largest = max(np.abs(answer.multipliers).max() for answer in answers)
    for k, answer in enumerate(answers):
        found = dict(zip(("path", "work", "wear"), slips[k].T, strict=True))
        check_increment(
            found | {"forces": forces[k], "outputs": outputs[k], "statuses": statuses[k]},
            answer,
            largest,
        )
    assert {1, 2} <= set(statuses.ravel().tolist())
    # loads that friction does not bear have no answer, and those before have one again
    lost = np.array([path[0], path[1], [path[1][0], 0.009, *path[1][2:]]])
    assert made.ask(3, *at(lost, *room)) == NO_ANSWER
    assert made.begin(*at(path[2], forces, outputs)) == DONE
    exact = model.solve(path[2]).multipliers
    assert np.linalg.norm(forces[0] - exact) < 1e-8 * np.linalg.norm(exact)


@needs("friction", "inelastic")
@compiled
@pytest.mark.parametrize("name", ["in the plane", "in space", "creep"])
def test_bodies_that_flow_and_rub_are_in_c_those_of_python(name, tmp_path):
    """Both march with the same residual, to 1e-11 of the correction.

    A law changes with no increment.
    """
    from rubbing_pages import EXACT, rubbing_flow, tour

    model = rubbing_flow(name)[0]
    path = tour(model, 0.9)
    made, room = increments(tmp_path, model)
    assert made.ask(len(path), *at(np.array(path), *room)) == DONE
    forces, told, cumulated, _ = room
    answers = model.march(list(enumerate(path)), EXACT).answers
    largest = max(np.abs(answer.multipliers).max() for answer in answers)
    flowed = max(answer.state().state.cumulated.max() for answer in answers)
    assert flowed > 1e-3
    for k, answer in enumerate(answers):
        np.testing.assert_allclose(forces[k], answer.multipliers, rtol=0, atol=1e-8 * largest)
        np.testing.assert_allclose(
            cumulated[k], answer.state().state.cumulated, rtol=0, atol=1e-8 * flowed
        )
        known = [answer.outputs()[output] for output in outputs_of(model)]
        np.testing.assert_allclose(told[k], known, rtol=1e-8, atol=1e-10)
    if name != "in space":
        points = np.array(path[:3])
        points[2, 2] += 0.1
        assert made.ask(3, *at(points, *room)) == CHANGED


@needs("floating", "inelastic")
@compiled
@pytest.mark.parametrize(
    "rubs", [False, pytest.param(True, marks=needs("friction"))], ids=["smooth", "rough"]
)
@pytest.mark.filterwarnings("ignore:body 2 .* moves along axis 0")
def test_loose_bodies_that_flow_are_in_c_those_of_python(rubs, tmp_path):
    """Motions are unknowns beside corrections and forces; outputs read them."""
    from flowing_pages import FAR, loose, pressing

    model = loose(rubs=rubs)[1]
    path = pressing(6.7)
    made, room = increments(tmp_path, model)
    assert made.ask(len(path), *at(np.array([point for _, point in path]), *room)) == DONE
    forces, told, _, _ = room
    answers = model.march(path, FAR).answers
    largest = max(np.abs(answer.multipliers).max() for answer in answers)
    for k, answer in enumerate(answers):
        np.testing.assert_allclose(forces[k], answer.multipliers, rtol=0, atol=1e-8 * largest)
        known = np.array([answer.outputs()[output] for output in outputs_of(model)])
        np.testing.assert_allclose(told[k], known, rtol=1e-7, atol=1e-8 * np.abs(known[1:]).max())


LAST_LAWS = "infinite slope", "plane stress"
FLOW = pytest.param("flow", marks=needs("inelastic", "moduli"))


@compiled
@pytest.mark.parametrize("name", [FLOW, FEW[0]])
def test_paths_in_c_end_where_those_of_python_do(name, tmp_path):
    """Outside of the box, and where a law or a modulus changes on the way.

    The path stays where it was.
    """
    model, path = flowing("moduli") if name == "flow" else rubbing_model(name)
    place = 1 if name == "flow" else model.law.fixed[0]
    made, room = increments(tmp_path, model)
    for change, status in ((0.1, CHANGED), (50.0, OUTSIDE), (np.nan, OUTSIDE)):
        points = np.array(path[:3])
        points[2, place] += change
        assert made.ask(3, *at(points, *room)) == status
        assert made.begin(*at(points[2], *room[:2])) == (DONE if status == CHANGED else OUTSIDE)
    for value in (np.nan, 1e3):
        points[:, place] = value
        assert made.ask(3, *at(points, *room)) == OUTSIDE


@compiled
@pytest.mark.parametrize("name", FEW)
def test_a_unit_with_friction_steps_as_python_does(name, unit_of, tmp_path):
    """Inputs, a step, outputs; what does not change on the way is a parameter."""
    model, tour, path = unit_of(name)
    unit, fixed = Instance(tmp_path, path), model.law.fixed.size > 0
    kinds = {item.get("name"): item.get("causality") for item in unit.variables}
    outputs = [item.name for item in model.fields.functionals.items]
    words = (
        "independent",
        "input",
        "input",
        "parameter" if fixed else "input",
        *["output"] * len(outputs),
    )
    assert kinds == dict(zip(("time", *model.parameters.names, *outputs), words, strict=True))
    history = model.march(list(enumerate(tour)))
    for _ in range(2):  # a unit that is reset begins anew
        assert unit.put(tour[0]) == 0 and unit.begin() == 0
        for number, (point, answer) in enumerate(zip(tour[1:], history.answers, strict=True)):
            before = unit.read()
            assert unit.put(point) == 0
            np.testing.assert_array_equal(unit.read(), before)  # until the step is made
            assert unit.step(number) == 0
            np.testing.assert_allclose(
                unit.read(), list(answer.outputs().values.values()), rtol=1e-8, atol=1e-11
            )
        if fixed:
            assert unit.put([*tour[-1][:2], 0.6]) == 0 and unit.step(20) == DISCARD  # another law
        assert unit.made.fmi3Reset(unit.at) == 0
    unit.made.fmi3FreeInstance(unit.at)


@needs("inelastic", "moduli")
@compiled
@pytest.mark.parametrize(
    "name",
    [
        "moduli",
        "outputs",
        "back stresses, creep",
        "cone, heat",
        "wood, heat",
        "fibres",
        "graded",
        *LAST_LAWS,
    ],
)
def test_increments_of_flow_in_c_are_those_of_python(name, tmp_path):
    model, path = flowing(name)
    made, room = increments(tmp_path, model)
    assert made.ask(len(path), *at(np.array(path), *room)) == DONE
    forces, told, cumulated, _ = room
    history = marched(model, path)
    largest = max(np.abs(answer.forces()).max() for answer in history.answers)
    flowed = max(answer.state().state.cumulated.max() for answer in history.answers)
    assert flowed > 0
    for k, answer in enumerate(history.answers):
        np.testing.assert_allclose(forces[k], answer.forces(), rtol=0, atol=1e-9 * largest)
        np.testing.assert_allclose(
            cumulated[k], answer.state().state.cumulated, rtol=0, atol=1e-9 * flowed
        )
        known = [answer.outputs()[output] for output in outputs_of(model)]
        np.testing.assert_allclose(told[k], known, rtol=1e-8, atol=1e-10)
    if name == "moduli":  # and a first load in proportion, in increments of a fortieth of the box
        rest, point = np.array([model.parameters.lower[0], 3.1]), np.array([0.04, 3.1])
        assert made.begin(*at(point, forces, told)) == DONE
        last = (
            marched(model, rest + np.linspace(0, 1, 28)[:, None] * (point - rest))
            .answers[-1]
            .forces()
        )
        np.testing.assert_allclose(forces[0], last, rtol=0, atol=1e-9 * last.max())


@needs("inelastic", "moduli")
@compiled
def test_a_unit_creeps_while_its_inputs_stay(unit_of, tmp_path):
    """Steps of a second, after a first load within one."""
    from condensing import FINE

    model, _, made = unit_of("back stresses, creep")
    unit = Instance(tmp_path, made)
    assert unit.put([0.03, 3.0]) == 0 and unit.begin() == 0
    found = [unit.read()[0]]
    for number in range(3):
        assert unit.step(number) == 0
        found.append(unit.read()[0])
    loaded = [
        (k / 20, np.array([0.03 * k / 20, 3.0])) for k in range(21)
    ]  # in fortieths of the box, 0.06
    history = model.march([*loaded, *((1.0 + k, loaded[-1][1]) for k in (1, 2, 3))], FINE)
    exact = [answer.outputs()["force"] for answer in history.answers[-4:]]
    assert found == pytest.approx(exact, rel=1e-6) and np.diff(np.abs(exact)).max() < 0
    unit.made.fmi3FreeInstance(unit.at)


@needs("inelastic", "moduli")
@compiled
def test_a_unit_steps_as_python_does_where_a_law_states_the_elasticity(unit_of, tmp_path):
    model, path, made = unit_of("wood, heat")
    unit = Instance(tmp_path, made)
    assert unit.put(path[0]) == 0 and unit.begin() == 0
    for number, (point, answer) in enumerate(
        zip(path[1:], marched(model, path).answers, strict=True)
    ):
        assert unit.put(point) == 0 and unit.step(number) == 0
        np.testing.assert_allclose(unit.read(), [answer.outputs()["force"]], rtol=1e-8, atol=1e-10)
    unit.made.fmi3FreeInstance(unit.at)


@needs("inelastic", "moduli")
@compiled
def test_flow_in_c_is_without_undefined_behaviour(tmp_path):
    """Under the sanitisers of the compiler, as a program of its own."""
    model, path = flowing("outputs")
    c_header.write_c_header(tmp_path / "press.h", model)
    numbers = ", ".join(repr(value) for value in np.array(path).ravel().tolist())
    count = len(outputs_of(model))
    text = f"""{STEPPED}
int main(void) {{
    static const double points[] = {{{numbers}}};
    static double forces[{len(path) * model.conditions}], outputs[{len(path) * max(count, 1)}];
    static double cumulated[{len(path) * len(model.flow.parts)}];
    int status = ask({len(path)}, points, forces, outputs, cumulated, 0);
    return status + begin(points + {len(path[0])}, forces, outputs);
}}"""
    (tmp_path / "press.c").write_text(text)
    words = ["-std=c99", "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
    words += ["-o", "press", "press.c", "-lm"]
    built = subprocess.run([CC, *words], cwd=tmp_path, capture_output=True, text=True)
    if built.returncode:
        pytest.skip("the compiler has no sanitisers")
    done = subprocess.run([tmp_path / "press"], capture_output=True, text=True)
    assert done.returncode == 0 and not done.stderr, done.stderr[:2000]


@compiled
@pytest.mark.parametrize("name", [FLOW, FEW[0]])
def test_outputs_that_are_read_before_a_path_begins_do_not_begin_it(name, unit_of, tmp_path):
    """In initialization mode inputs may be set and outputs read over and over, laws and moduli
    too.
    """
    _, path, made = unit_of("outputs" if name == "flow" else name)
    unit = Instance(tmp_path, made)
    first, second = path[4], path[2]
    assert unit.put(second) == 0
    expected = unit.read()
    assert unit.made.fmi3Reset(unit.at) == 0
    for point in (first, second):
        assert unit.put(point) == 0
        found = unit.read()
    assert unit.begin() == 0
    np.testing.assert_array_equal(found, expected)
    np.testing.assert_array_equal(unit.read(), expected)
    assert unit.put(first) == 0
    np.testing.assert_array_equal(unit.read(), expected)  # until a step is made


@needs("moduli")
@compiled
@impossible_moduli.BODIES
def test_a_header_has_no_answer_where_an_elastic_constant_is_impossible(bodies, tmp_path):
    """As every model in Python; beside the point both answer."""
    model = hhr.condense(impossible_moduli.scene(*bodies), fields=True)
    point = np.array([list(impossible_moduli.POINT.values())])
    beside = np.add(point, [0.0, 0.0, 1e-3])
    asked = library(tmp_path, model)
    status, forces, *_ = asked(beside)
    assert status == DONE
    np.testing.assert_allclose(
        forces[0], model.solve(beside[0]).forces(), rtol=0, atol=1e-10 * forces.max()
    )
    assert asked(point)[0] == NO_ANSWER and asked(np.vstack([beside, point]))[0] == NO_ANSWER


def test_a_condensed_model_beside_a_refused_one_is_named(tmp_path):
    hhr.save_model(tmp_path / "model.npz", contract.training("constant").build(contract.AS_IT_IS))
    for words in (
        ("page", tmp_path / "model.npz"),
        ("embed", tmp_path / "model.npz", "--out", tmp_path / "m.h"),
    ):
        code, said = invoke(*words)
        assert code == 3 and "condensed.npz" not in said
    hhr.save_model(tmp_path / "condensed.npz", hhr.condense(contract.blocks()))
    code, said = invoke("embed", tmp_path / "model.npz", "--out", tmp_path / "m.h")
    assert code == 3 and str(tmp_path / "condensed.npz") in said.replace("\n", "")
