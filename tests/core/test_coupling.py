"""Recipes of docs/coupling.md: each runs with its library, and with a stand-in of it.

Outputs and slopes are compared with those of the model, to round-off: 1e-10 of answers in batches,
1e-12 of the same call.
"""

import importlib
import re
import subprocess
import sys
import threading
import time
from pathlib import Path

import contract
import coupling_stand_ins
import numpy as np
import pytest

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import OutsideTrainingError, ParameterError
from hhr_dolfinx.trained import TrainedRange

PAGE = (Path(__file__).parents[2] / "docs/coupling.md").read_text("utf-8")
BLOCK = re.compile(r"^## (\w+)\n[^#]*?^```python\n(.*?)^```", re.DOTALL | re.MULTILINE)
RECIPES = dict(BLOCK.findall(PAGE))
BOTH = pytest.mark.parametrize("kind", ["stand-in", "library"])
UNTRAINED = r"outside what was trained: push = 0\.06 \(trained 0\.005 to 0\.0325\)"


@pytest.fixture(scope="module")
def model():
    return hhr.condense(contract.blocks(), fields=True)


@pytest.fixture(scope="module")
def exact(model):
    """A point, outputs there, and their derivatives along the parameters, (K, P)."""
    point = [contract.MIDDLE[name] for name in model.parameters.names]
    found = model.outputs(point, gradient=True)
    values, slopes = ([table[name] for name in found] for table in (found, found.gradient))
    return point, np.array(values), np.array(slopes)


@pytest.fixture(scope="module")
def narrow(model):
    """The same model, trained in the lower half of its box."""
    lower, upper = np.array(model.parameters.lower), np.array(model.parameters.upper)
    trained = TrainedRange(tuple(model.parameters.names), lower, (lower + upper) / 2)
    return model.changed(trained=trained)


@pytest.fixture(scope="module")
def beyond(narrow):
    """A point in the box and outside of what was trained, along the first parameter."""
    point = np.array(narrow.trained.lower)
    point[0] = narrow.parameters.upper[0]
    return point


@pytest.fixture
def run(tmp_path, monkeypatch):
    """Run the recipe of a title on a model in a file of this folder, and return its names."""
    monkeypatch.chdir(tmp_path)

    def names_of(title, model):
        hhr.save_model("model.npz", model)
        names = {"__name__": "recipe"}
        exec(compile(RECIPES[title], f"recipe of {title}", "exec"), names)
        return names

    return names_of


@pytest.fixture
def library(kind, monkeypatch):
    """Import a library, or its stand-in."""

    def imported(name, made):
        if kind == "stand-in":
            for key, item in made().items():
                monkeypatch.setitem(sys.modules, key, item)
        return pytest.importorskip(name)

    return imported


def test_the_page_has_short_recipes_of_public_functions():
    """Thirty lines of code at most; of the package they import what users import."""
    assert set(RECIPES) == {"Dakota", "OpenTURNS", "pyMOR", "Tesseract"}
    # and the lines for fields of another program, which tests of that plug-in have
    assert PAGE.count("```python\n") == len(RECIPES) + 1
    for title, text in RECIPES.items():
        lines = [line for line in text.splitlines() if line.strip()]
        assert len(lines) <= 30 and max(map(len, lines)) <= 100, title
        imported = {line.partition(" import ")[0] for line in lines if "hhr_dolfinx" in line}
        assert imported <= {"import hhr_dolfinx as hhr", "from hhr_dolfinx.errors"}, title
        assert not re.search(r"hhr\._|model\._|answer\._", text), title


@BOTH
def test_openturns(kind, library, run, model, narrow, beyond, exact):
    openturns = library("openturns", coupling_stand_ins.openturns)
    point, values, slopes = exact
    function = run("OpenTURNS", model)["function"]
    assert list(function.getInputDescription()) == list(model.parameters.names)
    assert list(function.getOutputDescription()) == ["peak", "force"]
    np.testing.assert_allclose(function(point), values, rtol=1e-10)
    np.testing.assert_allclose(np.array(function.gradient(point)).T, slopes, rtol=1e-10)
    points = model.parameters.random(20, 1)
    found = model.solve_many(points).outputs()
    known = np.column_stack([found["peak"], found["force"]])
    np.testing.assert_allclose(function(openturns.Sample(points.tolist())), known, rtol=1e-10)
    function = run("OpenTURNS", narrow)["function"]
    for ask in (function, function.gradient, lambda at: function([narrow.trained.lower, at])):
        with pytest.raises(Exception, match=UNTRAINED):
            ask(beyond)


@BOTH
def test_pymor(kind, library, run, model, narrow, beyond, exact):
    library("pymor", coupling_stand_ins.pymor)
    point, values, slopes = exact
    made = run("pyMOR", model)["ContactModel"](model)
    mu = made.parameters.parse(dict(zip(model.parameters.names, point, strict=True)))
    assert made.parameters.dim == len(point) and made.dim_output == 2
    np.testing.assert_allclose(made.output(mu)[:, 0], values, rtol=1e-10)
    # pyMOR sorts parameters by name
    order = np.argsort(model.parameters.names)
    found = made.output_d_mu(mu).to_numpy()[:, 0]
    np.testing.assert_allclose(found, slopes[:, order], rtol=1e-10)
    answer = model.solve(point)
    np.testing.assert_array_equal(made.solve(mu).to_numpy().ravel(), answer.displacement())
    _, known = made.solve(mu, return_error_estimate=True)
    assert known[0] == pytest.approx(answer.estimate().primal)
    _, of_outputs = made.output(mu, return_error_estimate=True)
    bounds = answer.estimate().outputs
    assert of_outputs[:, 0].tolist() == [bounds.get(name, np.inf) for name in ("peak", "force")]
    made = run("pyMOR", narrow)["ContactModel"](narrow)
    mu = made.parameters.parse(dict(zip(narrow.parameters.names, beyond, strict=True)))
    for ask in (made.output, made.solve, made.output_d_mu):
        with pytest.raises(OutsideTrainingError, match=UNTRAINED):
            ask(mu)


@pytest.fixture
def written(tmp_path, monkeypatch):
    """Write the recipe of Tesseract, and the file of a model."""
    monkeypatch.chdir(tmp_path)

    def path_of(model):
        hhr.save_model("model.npz", model)
        Path("tesseract_api.py").write_text(RECIPES["Tesseract"])
        return tmp_path / "tesseract_api.py"

    return path_of


@BOTH
def test_tesseract(kind, library, written, model, narrow, beyond, exact):
    core = library("tesseract_core", coupling_stand_ins.tesseract)
    library("tesseract_core.runtime", coupling_stand_ins.tesseract)
    point, values, slopes = exact
    asked = {"parameters": np.array(point, dtype=float)}
    names = ["parameters"], ["outputs"]
    with core.Tesseract.from_tesseract_api(written(model)) as made:
        np.testing.assert_allclose(made.apply(asked)["outputs"], values, rtol=1e-12)
        found = made.jacobian(asked, *names)
        np.testing.assert_allclose(found["outputs"]["parameters"], slopes, rtol=1e-12)
        way = np.array([1.0, 2.0])
        found = made.jacobian_vector_product(asked, *names, {"parameters": way})
        np.testing.assert_allclose(found["outputs"], slopes @ way, rtol=1e-12)
        weights = np.array([0.5, -2.0])
        found = made.vector_jacobian_product(asked, *names, {"outputs": weights})
        np.testing.assert_allclose(found["parameters"], weights @ slopes, rtol=1e-12)
        shapes = made.abstract_eval({"parameters": {"shape": [2], "dtype": "float64"}})
        assert tuple(shapes["outputs"]["shape"]) == (2,)
    with core.Tesseract.from_tesseract_api(written(narrow)) as made:
        refused_by(made, beyond)


def refused_by(made, beyond):
    """A client of a Tesseract sees why a point is refused."""
    for ask in (made.apply, lambda given: made.jacobian(given, ["parameters"], ["outputs"])):
        with pytest.raises(Exception, match=UNTRAINED):
            ask({"parameters": beyond})


def test_clients_of_a_tesseract_over_http_see_the_reason(written, narrow, beyond):
    core = pytest.importorskip("tesseract_core")
    pytest.importorskip("tesseract_core.runtime")
    import uvicorn
    from tesseract_core.runtime.serve import create_rest_api

    spec = importlib.util.spec_from_file_location("tesseract_api", written(narrow))
    api = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(api)
    settings = uvicorn.Config(create_rest_api(api), host="127.0.0.1", port=0, log_level="error")
    server = uvicorn.Server(settings)
    thread = threading.Thread(target=server.run)
    thread.start()
    try:
        while not server.started and thread.is_alive():
            time.sleep(0.01)
        host, port = server.servers[0].sockets[0].getsockname()[:2]
        refused_by(core.Tesseract.from_url(f"http://{host}:{port}"), beyond)
    finally:
        server.should_exit = True
        thread.join()


PARAMETERS = """                                          2 variables
                      {load:.15e} load
                      {push:.15e} push
                                          2 functions
                                          3 ASV_1:force
                                          2 ASV_2:peak
                                          2 derivative_variables
                                          2 DVV_1:push
                                          1 DVV_2:load
                                          0 analysis_components
                                          1 eval_id
                                          0 metadata
"""


@pytest.fixture
def driven(run, monkeypatch):
    """Results of the driver, given a file as Dakota writes it, with one text replaced."""
    monkeypatch.setattr(sys, "argv", ["driver.py", "params.in", "results.out"])

    def results(model, point, old="", new=""):
        text = PARAMETERS.format(**dict(zip(model.parameters.names, point, strict=True)))
        assert old in text
        Path("params.in").write_text(text.replace(old, new, 1))
        run("Dakota", model)
        return Path("results.out").read_text()

    return results


def test_an_evaluation_of_dakota(driven, model, exact):
    """As Dakota 6.20 writes it: orders other than ours, and a value that is not requested."""
    point, values, slopes = exact
    value, *found = driven(model, point).splitlines()
    number, name = value.split()
    assert name == "force" and float(number) == pytest.approx(values[1], rel=1e-12)
    places = [model.parameters.names.index(name) for name in ("push", "load")]
    for line, output in zip(found, (1, 0), strict=True):
        assert line.split()[0] == "[" and line.split()[-1] == "]"
        found = np.array(line.split()[1:-1], dtype=float)
        np.testing.assert_allclose(found, slopes[output, places], rtol=1e-12)


@pytest.mark.parametrize(("old", "new", "error", "message"), [
    ("push\n", "puss\n", SystemExit, r"variables \['load', 'puss'\] must be"),
    ("ASV_1:force", "ASV_1:forse", ParameterError, "there is no output 'forse'"),
    ("3 ASV_1", "7 ASV_1", SystemExit, "no_hessians"),
    ("2 variables", "1 variables", ValueError, "invalid literal"),
    ("2 variables", "{ DAKOTA_VARS = 2 }", ValueError, "invalid literal"),
    ("2 DVV_1:push", "9 DVV_1:push", IndexError, "out of range"),
])  # fmt: skip
def test_a_wrong_study_of_dakota_has_no_results(driven, model, exact, old, new, error, message):
    """What Dakota may capture is a point, not a study that is set up wrong."""
    with pytest.raises(error, match=message):
        driven(model, exact[0], old, new)
    assert not Path("results.out").exists()


def test_a_point_without_an_answer_fails_as_dakota_captures_it(driven, model, narrow, beyond):
    outside = beyond + np.array([1.0, 0.0])
    assert driven(model, outside).startswith("fail\n# push = 1.06 is outside")
    assert re.match(f"fail\n# .*{UNTRAINED}", driven(narrow, beyond))


STUDY = """
environment
  tabular_data
    tabular_data_file = 'table.dat'
method
  list_parameter_study
    list_of_points {points}
variables
  continuous_design = 2
    descriptors 'load' 'push'
interface
  analysis_drivers = '{python} driver.py'
  failure_capture
    recover -7.0 -7.0
  fork
    parameters_file 'params.in'
    results_file 'results.out'
    file_save file_tag
responses
  response_functions = 2
    descriptors 'peak' 'force'
  analytic_gradients
  no_hessians
"""


def test_a_study_of_dakota(narrow, beyond, tmp_path):
    """Dakota itself, of the package carolina, runs the recipe; it captures a refused point."""
    pytest.importorskip("carolina")
    hhr.save_model(tmp_path / "model.npz", narrow)
    (tmp_path / "driver.py").write_text(RECIPES["Dakota"])
    places = [narrow.parameters.names.index(name) for name in ("load", "push")]
    inside = (2 * np.array(narrow.trained.lower) + narrow.trained.upper) / 3
    points = " ".join(map(repr, np.stack([inside, beyond])[:, places].ravel().tolist()))
    (tmp_path / "dakota.in").write_text(STUDY.format(points=points, python=sys.executable))
    study = [sys.executable, "-c", "import dakota; dakota.run_dakota('dakota.in')"]
    done = subprocess.run(study, cwd=tmp_path, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    rows = [line.split()[-2:] for line in (tmp_path / "table.dat").read_text().splitlines()[1:]]
    found, outputs = np.array(rows, dtype=float), narrow.outputs(inside, gradient=True)
    np.testing.assert_allclose(found[0], list(outputs.values.values()), rtol=1e-9)
    assert found[1].tolist() == [-7.0, -7.0]
    first, second = ((tmp_path / f"results.out.{number}").read_text() for number in (1, 2))
    gradients = np.array([line.split()[1:-1] for line in first.splitlines()[2:]], dtype=float)
    exact = np.array([outputs.gradient[name] for name in outputs.values])
    np.testing.assert_allclose(gradients, exact[:, places], rtol=1e-12)
    assert re.match(f"fail\n# .*{UNTRAINED}", second)
