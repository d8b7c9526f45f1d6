"""Doors to other programs, by their own packages: values, gradients, names, what is refused."""

import dataclasses
import socket
import subprocess
import sys
import time
from contextlib import suppress

import contract
import numpy as np
import pytest

import hhr_dolfinx as hhr
from hhr_dolfinx.doors.function import OutputFunction
from hhr_dolfinx.errors import NotOfferedError


@pytest.fixture(scope="module")
def model():
    return hhr.condense(contract.blocks(("E1", 0.3), box=contract.MODULI), fields=True)


@pytest.fixture(scope="module")
def exact(model):
    """A point, outputs there, and their derivatives along the parameters, (K, P)."""
    point = [contract.VARIED[name] for name in model.parameters.names]
    found = model.outputs(point, gradient=True)
    names = list(found)
    return point, np.array([found[name] for name in names]), np.array([found.gradient[n] for n in names])


def test_outputs_as_a_function_of_vectors(model, exact):
    point, values, slopes = exact
    function = OutputFunction(model)
    assert function.names == tuple(model.parameters.names) and function.outputs == ("peak", "force")
    np.testing.assert_allclose(function([point, point]), [values, values], rtol=1e-10)
    np.testing.assert_allclose(function.jacobian(point), slopes, rtol=1e-10)


def test_a_model_without_outputs_has_no_door():
    bare = hhr.condense(dataclasses.replace(contract.blocks(), outputs=()))
    with pytest.raises(NotOfferedError, match="name outputs in the scene"):
        OutputFunction(bare)


SERVER = """
import sys
import umbridge
import hhr_dolfinx as hhr
from hhr_dolfinx.doors.um_bridge import UMBridgeModel
umbridge.serve_models([UMBridgeModel(hhr.load_model(sys.argv[1]), "contact")], int(sys.argv[2]))
"""


@pytest.fixture
def client(model, tmp_path):
    """A client of a server in a process of its own, which knows nothing but the file of a model."""
    umbridge = pytest.importorskip("umbridge")
    hhr.save_model(tmp_path / "model.npz", model)
    with socket.socket() as free:
        free.bind(("localhost", 0))
        port = free.getsockname()[1]
    words = [sys.executable, "-c", SERVER, str(tmp_path / "model.npz"), str(port)]
    server = subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        for _ in range(300):
            with suppress(requests_errors()):
                yield umbridge.HTTPModel(f"http://localhost:{port}", "contact")
                return
            time.sleep(0.1)
        raise AssertionError("the server did not start")
    finally:
        server.kill()
        server.wait()


def requests_errors():
    """What a client meets before a server is there."""
    import requests

    return requests.exceptions.ConnectionError


def test_a_server_of_um_bridge(client, exact):
    """Its own client asks over HTTP; its own checks of sizes stand before the model."""
    point, values, slopes = exact
    assert client.get_input_sizes() == [3] and client.get_output_sizes() == [2]
    assert client.supports_evaluate() and client.supports_gradient() and client.supports_apply_jacobian()
    asked = [list(map(float, point))]
    np.testing.assert_allclose(client(asked)[0], values, rtol=1e-10)
    np.testing.assert_allclose(client.gradient(0, 0, asked, [0.5, -2.0]), [0.5, -2.0] @ slopes, rtol=1e-10)
    way = [1.0, 2.0, -1.0]
    np.testing.assert_allclose(client.apply_jacobian(0, 0, asked, way), slopes @ way, rtol=1e-10)
    with pytest.raises(Exception, match="length"):
        client([[1.0]])


def test_a_function_of_openturns(model, exact):
    openturns = pytest.importorskip("openturns")
    from hhr_dolfinx.doors.open_turns import openturns_function

    point, values, slopes = exact
    function = openturns_function(model)
    assert list(function.getInputDescription()) == list(model.parameters.names)
    np.testing.assert_allclose(function(point), values, rtol=1e-10)
    np.testing.assert_allclose(np.array(function.gradient(point)).T, slopes, rtol=1e-10)
    sample = openturns.Sample(model.parameters.random(20, 1).tolist())
    np.testing.assert_allclose(function(sample), OutputFunction(model)(np.array(sample)), rtol=1e-12)


def test_a_model_of_pymor(model, exact):
    pytest.importorskip("pymor")
    from hhr_dolfinx.doors.py_mor import PyMORModel

    point, values, slopes = exact
    made = PyMORModel(model)
    mu = made.parameters.parse(dict(zip(model.parameters.names, point, strict=True)))
    assert made.parameters.dim == len(point) and made.dim_output == 2
    np.testing.assert_allclose(made.output(mu)[:, 0], values, rtol=1e-10)
    # pyMOR sorts parameters by name
    order = np.argsort(model.parameters.names)
    np.testing.assert_allclose(made.output_d_mu(mu).to_numpy()[:, 0], slopes[:, order], rtol=1e-10)
    answer = model.solve(point)
    np.testing.assert_array_equal(made.solve(mu).to_numpy().ravel(), answer.displacement())
    _, known = made.solve(mu, return_error_estimate=True)
    assert known[0] == pytest.approx(answer.estimate().primal)
    _, of_outputs = made.output(mu, return_error_estimate=True)
    assert of_outputs.shape == (2, 1)


def test_a_tesseract(model, exact, tmp_path):
    """By its own client, from a file too; its own check of gradients by differences."""
    core = pytest.importorskip("tesseract_core")
    pytest.importorskip("tesseract_core.runtime")
    from hhr_dolfinx.doors.tesseract import tesseract_api

    point, values, slopes = exact
    asked = {"parameters": np.array(point, dtype=float)}
    ways = {"parameters": np.array([1.0, 2.0, -1.0])}
    weights = {"outputs": np.array([0.5, -2.0])}
    hhr.save_model(tmp_path / "model.npz", model)
    file = tmp_path / "tesseract_api.py"
    file.write_text(
        "import hhr_dolfinx as hhr\nfrom hhr_dolfinx.doors.tesseract import tesseract_api\n"
        f"globals().update(vars(tesseract_api(hhr.load_model({str(tmp_path / 'model.npz')!r}))))\n"
    )
    for api in (tesseract_api(model), file):
        with core.Tesseract.from_tesseract_api(api) as made:
            np.testing.assert_allclose(made.apply(asked)["outputs"], values, rtol=1e-10)
            found = made.jacobian(asked, ["parameters"], ["outputs"])
            np.testing.assert_allclose(found["outputs"]["parameters"], slopes, rtol=1e-10)
            found = made.jacobian_vector_product(asked, ["parameters"], ["outputs"], ways)
            np.testing.assert_allclose(found["outputs"], slopes @ ways["parameters"], rtol=1e-10)
            found = made.vector_jacobian_product(asked, ["parameters"], ["outputs"], weights)
            np.testing.assert_allclose(found["parameters"], weights["outputs"] @ slopes, rtol=1e-10)
            shapes = made.abstract_eval({"parameters": {"shape": [3], "dtype": "float64"}})
            assert tuple(shapes["outputs"]["shape"]) == (2,)


PARAMETERS = """                                          3 variables
                      {push:.15e} push
                      {E1:.15e} E1
                      {load:.15e} load
                                          2 functions
                                          3 ASV_1:force
                                          2 ASV_2:peak
                                          2 derivative_variables
                                          3 DVV_1:load
                                          1 DVV_2:push
                                          0 analysis_components
                                          1 eval_id
                                          0 metadata
"""


def test_an_evaluation_of_dakota(model, exact, tmp_path):
    """A file as Dakota 6.20 writes it: other orders than ours, a value that is not asked for, two of three slopes."""
    from hhr_dolfinx.command.main import hhr as command

    point, values, slopes = exact
    hhr.save_model(tmp_path / "model.npz", model)
    given = dict(zip(model.parameters.names, point, strict=True))
    (tmp_path / "params.in").write_text(PARAMETERS.format(**given))
    words = [str(tmp_path / name) for name in ("model.npz", "params.in", "results.out")]
    with pytest.raises(SystemExit) as ended:
        command(["dakota", *words])
    assert ended.value.code == 0
    value, *found = (tmp_path / "results.out").read_text().splitlines()
    number, name = value.split()
    assert name == "force" and float(number) == pytest.approx(values[1], rel=1e-12)
    places = [model.parameters.names.index(name) for name in ("load", "push")]
    for line, output in zip(found, (1, 0), strict=True):
        assert line.split()[0] == "[" and line.split()[-1] == "]"
        np.testing.assert_allclose(np.array(line.split()[1:-1], dtype=float), slopes[output, places], rtol=1e-12)


@pytest.mark.parametrize(("old", "new", "message"), [
    ("push\n", "puss\n", r"variables \['puss'\] are none of"),
    ("ASV_1:force", "ASV_1:forse", r"functions \['forse'\] are none of"),
    ("3 ASV_1", "7 ASV_1", "no_hessians"),
    ("3 variables", "2 variables", "no parameters file"),
    ("3 variables", "{ DAKOTA_VARS = 3 }", "no parameters file"),
    ("3 DVV_1:load", "9 DVV_1:load", "a derivative along a variable that is not there"),
    ("0.1", "nan", "no parameters file|finite"),
])  # fmt: skip
def test_what_dakota_asks_for_in_vain(model, exact, tmp_path, old, new, message):
    from hhr_dolfinx.doors.dakota import answer_dakota
    from hhr_dolfinx.errors import HHRError

    given = dict(zip(model.parameters.names, exact[0], strict=True))
    text = PARAMETERS.format(**given)
    if old == "0.1":
        old = f"{given['load']:.15e}"
    assert old in text
    (tmp_path / "params.in").write_text(text.replace(old, new, 1))
    with pytest.raises(HHRError, match=message):
        answer_dakota(model, tmp_path / "params.in", tmp_path / "results.out")
    # what Dakota may capture is a point, not a study that is set up wrong
    assert (tmp_path / "results.out").exists() == (new == "nan")


def test_a_point_without_an_answer_fails_as_dakota_captures_it(model, exact, tmp_path):
    from hhr_dolfinx.doors.dakota import answer_dakota
    from hhr_dolfinx.errors import FileError, HHRError, ParameterError

    given = dict(zip(model.parameters.names, exact[0], strict=True)) | {"push": 99.0}
    (tmp_path / "params.in").write_text(PARAMETERS.format(**given))
    with pytest.raises(ParameterError, match="push = 99 is outside"):
        answer_dakota(model, tmp_path / "params.in", tmp_path / "results.out")
    assert (tmp_path / "results.out").read_text() == "fail\n"
    (tmp_path / "empty.in").write_text("")
    with pytest.raises(HHRError, match="it ends early"):
        answer_dakota(model, tmp_path / "empty.in", tmp_path / "other.out")
    with pytest.raises(FileError, match="cannot be read"):
        answer_dakota(model, tmp_path / "none.in", tmp_path / "other.out")


def test_descriptors_have_no_spaces(tmp_path):
    from hhr_dolfinx.doors.dakota import answer_dakota

    named = dataclasses.replace(contract.blocks(), outputs=(hhr.LargestPressure("peak pressure", 0),))
    model = hhr.condense(named)
    text = "2 variables\n0.03 push\n0.05 load\n1 functions\n1 ASV_1:peak_pressure\n0 derivative_variables\n"
    (tmp_path / "params.in").write_text(text)
    answer_dakota(model, tmp_path / "params.in", tmp_path / "results.out")
    value = float((tmp_path / "results.out").read_text().split()[0])
    assert value == pytest.approx(model.outputs([0.03, 0.05])["peak pressure"], rel=1e-12)


STUDY = """
environment
  tabular_data
    tabular_data_file = 'table.dat'
method
  list_parameter_study
    list_of_points {point}
variables
  continuous_design = 3
    descriptors 'push' 'E1' 'load'
interface
  analysis_drivers = 'driver.sh'
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


def test_a_study_of_dakota(model, exact, tmp_path):
    """Dakota itself, as the package carolina holds it, asks by its fork interface, gradients too."""
    pytest.importorskip("carolina")
    point, values, slopes = exact
    hhr.save_model(tmp_path / "model.npz", model)
    driver = tmp_path / "driver.sh"
    call = f"{sys.executable} -c 'from hhr_dolfinx.command.main import hhr; hhr()'"
    driver.write_text(f'#!/bin/sh\nexec {call} dakota model.npz "$1" "$2"\n')
    driver.chmod(0o755)
    names = ("push", "E1", "load")
    places = [model.parameters.names.index(name) for name in names]
    first = " ".join(repr(float(point[place])) for place in places)
    (tmp_path / "dakota.in").write_text(STUDY.format(point=first))
    study = [sys.executable, "-c", "import dakota; dakota.run_dakota('dakota.in')"]
    done = subprocess.run(study, cwd=tmp_path, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    row = (tmp_path / "table.dat").read_text().splitlines()[1].split()
    np.testing.assert_allclose([float(item) for item in row[-2:]], values, rtol=1e-9)
    gradients = [line.split()[1:-1] for line in (tmp_path / "results.out.1").read_text().splitlines()[2:]]
    np.testing.assert_allclose(np.array(gradients, dtype=float), slopes[:, places], rtol=1e-12)
