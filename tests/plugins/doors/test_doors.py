"""Doors to other programs, by their own packages: values, gradients, names, what is refused."""

import dataclasses
import http.client
import json
import re
import socket
import subprocess
import sys
import threading
import time
from contextlib import contextmanager
from functools import partial
from unittest.mock import Mock

import contract
import numpy as np
import pytest
from threads import at_once

import hhr_dolfinx as hhr
from hhr_dolfinx.command.main import hhr as command
from hhr_dolfinx.errors import FileError, HHRError, NotOfferedError, OutsideTrainingError, ParameterError
from hhr_dolfinx.plugins.doors import um_bridge
from hhr_dolfinx.plugins.doors.dakota import answer_dakota
from hhr_dolfinx.plugins.doors.function import OutputFunction
from hhr_dolfinx.trained import TrainedRange


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


@pytest.fixture(scope="module")
def narrow(model):
    """The same model, trained in the lower half of its box."""
    lower, upper = np.array(model.parameters.lower), np.array(model.parameters.upper)
    return model.changed(trained=TrainedRange(tuple(model.parameters.names), lower, (lower + upper) / 2))


@pytest.fixture(scope="module")
def beyond(narrow):
    """A point in the box and outside of what was trained, along the first parameter."""
    point = np.array(narrow.trained.lower)
    point[0] = narrow.parameters.upper[0]
    return point


UNTRAINED = r"outside what was trained: push = 0\.06 \(trained 0\.005 to 0\.0325\)"


def test_a_door_refuses_what_was_not_trained(narrow, beyond):
    """Another program sees no warnings of Python."""
    function = OutputFunction(narrow)
    for ask in (function, function.jacobian, function.check, lambda point: function([narrow.trained.lower, point])):
        with pytest.raises(OutsideTrainingError, match=UNTRAINED):
            ask(beyond)
    with pytest.warns(hhr.errors.OutsideTrainingWarning, match=UNTRAINED):
        warned = OutputFunction(narrow, outside="warn")(beyond)
    np.testing.assert_allclose(warned[0], list(narrow.outputs(beyond, outside="ignore").values.values()), rtol=1e-12)


@contextmanager
def serving(folder, model, name, *words):
    """A client of UM-Bridge of a server in a process of its own, which knows nothing but the file of a model."""
    umbridge = pytest.importorskip("umbridge")
    hhr.save_model(folder / "model.npz", model)
    command = "from hhr_dolfinx.command.main import main; main()"
    words = [sys.executable, "-c", command, "serve", str(folder / "model.npz"), "--port", "0", *words]
    server = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        line = server.stdout.readline()
        assert " is served at http://127.0.0.1:" in line, server.stderr.read()
        yield umbridge.HTTPModel(line.split()[5].rstrip(","), name)
    finally:
        server.kill()
        server.communicate()


def test_a_server_of_um_bridge(model, exact, tmp_path):
    """Its own client asks over HTTP; its own checks of sizes stand before the model."""
    point, values, slopes = exact
    with serving(tmp_path, model, "contact", "--name", "contact") as client:
        assert client.get_input_sizes() == [3] and client.get_output_sizes() == [2]
        assert client.supports_evaluate() and client.supports_gradient() and client.supports_apply_jacobian()
        asked = [list(map(float, point))]
        np.testing.assert_allclose(client(asked)[0], values, rtol=1e-10)
        np.testing.assert_allclose(client.gradient(0, 0, asked, [0.5, -2.0]), [0.5, -2.0] @ slopes, rtol=1e-10)
        way = [1.0, 2.0, -1.0]
        np.testing.assert_allclose(client.apply_jacobian(0, 0, asked, way), slopes @ way, rtol=1e-10)
        with pytest.raises(Exception, match=r"InvalidInput: input\[0\] must be a list of length 3 and has 1"):
            client([[1.0]])
        assert not client.supports_apply_hessian()


def test_clients_of_um_bridge_see_why_there_is_no_answer(narrow, beyond, tmp_path):
    with serving(tmp_path, narrow, "forward") as client:
        asked = [beyond.tolist()]
        for ask in (
            lambda: client(asked),
            lambda: client.gradient(0, 0, asked, [1.0, 0.0]),
            lambda: client.apply_jacobian(0, 0, asked, [1.0, 0.0, 0.0]),
        ):
            with pytest.raises(Exception, match=f"InvalidInput: {UNTRAINED}"):
                ask()
        with pytest.raises(Exception, match="InvalidInput: push = 9 is outside"):
            client([[9.0, *asked[0][1:]]])
        inside = np.array(narrow.trained.lower)
        np.testing.assert_allclose(client([inside.tolist()])[0], OutputFunction(narrow)(inside)[0], rtol=1e-12)


@pytest.fixture(scope="module")
def served(narrow):
    """A server in a thread, for requests as no client of UM-Bridge makes them."""
    with um_bridge.Server(narrow, port=0) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield server
        server.shutdown()
        thread.join()


def requested(server, path, body=None, method="POST", **headers):
    """Status and fields of an answer."""
    connection = http.client.HTTPConnection(*server.server_address, timeout=60)
    try:
        connection.request(method, path, body, {name.replace("_", "-"): text for name, text in headers.items()})
        answer = connection.getresponse()
        assert answer.getheader("Content-Type") == "application/json"
        return answer.status, json.loads(answer.read())
    finally:
        connection.close()


GOOD = {"name": "forward", "input": [[0.01, 0.02, 2.0]], "config": {}}
DERIVED = GOOD | {"inWrt": 0, "outWrt": 0, "sens": [1.0, 0.0], "vec": [1.0, 0.0, 0.0]}


@pytest.mark.parametrize(("path", "asked", "status", "kind", "message"), [
    ("/Evaluate", b"{", 400, "InvalidInput", "not JSON"),
    ("/Evaluate", b"", 400, "InvalidInput", "not JSON"),
    ("/Evaluate", b"[" * 100_000, 400, "InvalidInput", "not JSON (RecursionError"),
    ("/Evaluate", [1], 400, "InvalidInput", "must be an object of JSON, and is [1]"),
    ("/Evaluate", {}, 400, "ModelNotFound", "None is not here: the model of this server is 'forward'"),
    ("/InputSizes", {"name": "other"}, 400, "ModelNotFound", "'other' is not here"),
    ("/Evaluate", {"name": "forward"}, 400, "InvalidInput", "input = None must be a list of one list"),
    ("/Evaluate", GOOD | {"input": [1, 2, 3]}, 400, "InvalidInput", "one list"),
    ("/Evaluate", GOOD | {"input": [[1, 2, "3"]]}, 400, "InvalidInput", "numbers alone"),
    ("/Evaluate", GOOD | {"input": [[1, 2, True]]}, 400, "InvalidInput", "numbers alone"),
    ("/Evaluate", GOOD | {"input": [[0, 0, 10**400]]}, 400, "InvalidInput", "too large"),
    ("/Evaluate", GOOD | {"input": [[float("nan"), 0.02, 2.0]]}, 400, "InvalidInput", "finite"),
    ("/Gradient", DERIVED | {"outWrt": 1}, 400, "InvalidInput", "outWrt = 1 must be 0"),
    ("/Gradient", DERIVED | {"sens": [1.0]}, 400, "InvalidInput", "sens must be a list of length 2 and has 1"),
    ("/ApplyJacobian", DERIVED | {"vec": "abc"}, 400, "InvalidInput", "vec must be a list of length 3 and is 'abc'"),
    ("/ApplyHessian", DERIVED, 400, "UnsupportedFeature", "this model has no ApplyHessian"),
    ("/Elsewhere", GOOD, 404, "UnsupportedFeature", "there are /Info, /ModelInfo"),
])  # fmt: skip
def test_errors_are_those_of_the_protocol(served, path, asked, status, kind, message):
    body = asked if isinstance(asked, bytes) else json.dumps(asked)
    found, answer = requested(served, path, body)
    assert found == status and answer["error"]["type"] == kind and message in answer["error"]["message"]
    assert answer.keys() == {"error"} and len(answer["error"]["message"]) < 500
    # and the server goes on
    assert requested(served, "/Evaluate", json.dumps(GOOD))[0] == 200


def test_requests_have_a_limit_of_size(served):
    """One megabyte, whatever is in it; a size that is not given, or given in chunks, is not read."""
    room = um_bridge.MOST_BYTES - len(json.dumps(GOOD | {"config": ""}))
    for more, status in ((0, 200), (1, 413), (3_000_000, 413)):
        found, answer = requested(served, "/Evaluate", json.dumps(GOOD | {"config": "x" * (room + more)}))
        assert found == status and ("error" in answer) == (status != 200)
    assert answer["error"]["message"] == (
        "a request of 4000000 bytes is more than the limit of 1000000: send one point at a time"
    )
    for headers in ({"Transfer_Encoding": "chunked"}, {"Content_Length": "-1"}, {"Content_Length": "1e3"}):
        found, answer = requested(served, "/Evaluate", **headers)
        assert found == 411 and "Content-Length" in answer["error"]["message"]
    assert requested(served, "/Info", method="GET") == (200, {"protocolVersion": 1.0, "models": ["forward"]})
    assert requested(served, "/Info", method="PUT")[0] == 501


def test_a_server_listens_where_it_is_told_to(model, served):
    host, port = served.server_address
    assert host == "127.0.0.1" and served.url == f"http://127.0.0.1:{port}"
    # all of 127.0.0.0/8 is this machine: a server of all addresses would answer there
    with socket.socket() as other, pytest.raises(ConnectionRefusedError):
        other.connect(("127.0.0.2", port))
    with pytest.raises(FileError, match=rf"127\.0\.0\.1 port {port} cannot be served .*take another --host or --port"):
        um_bridge.Server(model, port=port)
    with pytest.raises(FileError, match="cannot be served"):
        um_bridge.Server(model, host="192.0.2.1", port=0)


def test_a_fault_of_a_model_costs_no_client_its_sentence(served, monkeypatch):
    monkeypatch.setitem(served.protocol.posted, "/Evaluate", Mock(side_effect=ZeroDivisionError("by a fault")))
    status, answer = requested(served, "/Evaluate", json.dumps(GOOD))
    assert (status, answer) == (500, {"error": {"type": "InvalidOutput", "message": "ZeroDivisionError: by a fault"}})


def test_a_server_takes_turns_with_all_its_clients(served):
    """Threads share the model, and each client gets its own answer."""
    points = served.protocol.function.model.parameters.random(40, 3)
    points = np.minimum(points, served.protocol.function.model.trained.upper)

    def ask(point):
        return requested(served, "/Evaluate", json.dumps(GOOD | {"input": [point]}))[1]["output"][0]

    found = at_once([partial(ask, point) for point in points.tolist()])
    np.testing.assert_allclose(found, served.protocol.function(points), rtol=1e-10)


def test_a_function_of_openturns(model, narrow, beyond, exact):
    openturns = pytest.importorskip("openturns")
    from hhr_dolfinx.plugins.doors.open_turns import openturns_function

    point, values, slopes = exact
    function = openturns_function(model)
    assert list(function.getInputDescription()) == list(model.parameters.names)
    np.testing.assert_allclose(function(point), values, rtol=1e-10)
    np.testing.assert_allclose(np.array(function.gradient(point)).T, slopes, rtol=1e-10)
    sample = openturns.Sample(model.parameters.random(20, 1).tolist())
    np.testing.assert_allclose(function(sample), OutputFunction(model)(np.array(sample)), rtol=1e-12)
    function = openturns_function(narrow)
    for ask in (function, function.gradient, lambda point: function([narrow.trained.lower, point])):
        with pytest.raises(Exception, match=UNTRAINED):
            ask(beyond)


def test_a_model_of_pymor(model, narrow, beyond, exact):
    pytest.importorskip("pymor")
    from hhr_dolfinx.plugins.doors.py_mor import PyMORModel

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
    made = PyMORModel(narrow)
    mu = made.parameters.parse(dict(zip(narrow.parameters.names, beyond, strict=True)))
    for ask in (made.output, made.solve, made.output_d_mu):
        with pytest.raises(OutsideTrainingError, match=UNTRAINED):
            ask(mu)


def test_a_tesseract(model, exact, tmp_path):
    """By its own client, from a file too; its own check of gradients by differences."""
    core = pytest.importorskip("tesseract_core")
    pytest.importorskip("tesseract_core.runtime")
    from hhr_dolfinx.plugins.doors.tesseract import tesseract_api

    point, values, slopes = exact
    asked = {"parameters": np.array(point, dtype=float)}
    ways = {"parameters": np.array([1.0, 2.0, -1.0])}
    weights = {"outputs": np.array([0.5, -2.0])}
    hhr.save_model(tmp_path / "model.npz", model)
    file = tmp_path / "tesseract_api.py"
    file.write_text(
        "import hhr_dolfinx as hhr\nfrom hhr_dolfinx.plugins.doors.tesseract import tesseract_api\n"
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


def test_a_tesseract_refuses_what_was_not_trained(narrow, beyond):
    """Over HTTP too, in the words of its protocol: those of a schema are the only ones that a client gets."""
    core = pytest.importorskip("tesseract_core")
    pytest.importorskip("tesseract_core.runtime")
    import uvicorn
    from tesseract_core.runtime.serve import create_rest_api

    from hhr_dolfinx.plugins.doors.tesseract import tesseract_api

    api = tesseract_api(narrow)

    def check(made):
        for ask in (made.apply, lambda given: made.jacobian(given, ["parameters"], ["outputs"])):
            with pytest.raises(Exception, match=UNTRAINED):
                ask({"parameters": beyond})

    with core.Tesseract.from_tesseract_api(api) as made:
        check(made)
    server = uvicorn.Server(uvicorn.Config(create_rest_api(api), host="127.0.0.1", port=0, log_level="error"))
    thread = threading.Thread(target=server.run)
    thread.start()
    try:
        while not server.started and thread.is_alive():
            time.sleep(0.01)
        host, port = server.servers[0].sockets[0].getsockname()[:2]
        check(core.Tesseract.from_url(f"http://{host}:{port}"))
    finally:
        server.should_exit = True
        thread.join()


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


def parameters_file(folder, model, point, name="params.in", **changes):
    """What Dakota asks for, and where it wants the results."""
    text = PARAMETERS.format(**dict(zip(model.parameters.names, point, strict=True)) | changes)
    (folder / name).write_text(text)
    return folder / name, (folder / name).with_suffix(".out")


def test_an_evaluation_of_dakota(model, exact, tmp_path):
    """A file as Dakota 6.20 writes it: other orders than ours, a value that is not asked for, two of three slopes."""
    point, values, slopes = exact
    hhr.save_model(tmp_path / "model.npz", model)
    words = [tmp_path / "model.npz", *parameters_file(tmp_path, model, point)]
    with pytest.raises(SystemExit) as ended:
        command(["dakota", *map(str, words)])
    assert ended.value.code == 0
    value, *found = words[-1].read_text().splitlines()
    number, name = value.split()
    assert name == "force" and float(number) == pytest.approx(values[1], rel=1e-12)
    places = [model.parameters.names.index(name) for name in ("load", "push")]
    for line, output in zip(found, (1, 0), strict=True):
        assert line.split()[0] == "[" and line.split()[-1] == "]"
        np.testing.assert_allclose(np.array(line.split()[1:-1], dtype=float), slopes[output, places], rtol=1e-12)


@pytest.mark.parametrize(("old", "new", "message"), [
    (r"push\n", r"puss\n", r"variables \['puss'\] are none of"),
    ("ASV_1:force", "ASV_1:forse", r"functions \['forse'\] are none of"),
    ("3 ASV_1", "7 ASV_1", "no_hessians"),
    ("3 variables", "2 variables", "no parameters file"),
    ("3 variables", "{ DAKOTA_VARS = 3 }", "no parameters file"),
    ("3 DVV_1:load", "9 DVV_1:load", "a derivative along a variable that is not there"),
    (r"\S+ push", "nan push", "no parameters file|finite"),
])  # fmt: skip
def test_what_dakota_asks_for_in_vain(model, exact, tmp_path, old, new, message):
    asked, answered = parameters_file(tmp_path, model, exact[0])
    text, count = re.subn(old, new, asked.read_text(), count=1)
    assert count
    asked.write_text(text)
    with pytest.raises(HHRError, match=message):
        answer_dakota(model, asked, answered)
    # what Dakota may capture is a point, not a study that is set up wrong
    assert answered.exists() == (new == "nan push")


def test_a_point_without_an_answer_fails_as_dakota_captures_it(model, narrow, beyond, exact, tmp_path):
    asked, answered = parameters_file(tmp_path, model, exact[0], push=99.0)
    with pytest.raises(ParameterError, match="push = 99 is outside"):
        answer_dakota(model, asked, answered)
    assert answered.read_text().startswith("fail\n# push = 99 is outside")
    asked, answered = parameters_file(tmp_path, narrow, beyond, "untrained.in")
    with pytest.raises(OutsideTrainingError, match=UNTRAINED):
        answer_dakota(narrow, asked, answered)
    assert re.match(f"fail\n# {UNTRAINED}", answered.read_text())
    asked.write_text("")
    with pytest.raises(HHRError, match="it ends early"):
        answer_dakota(model, asked, answered)
    with pytest.raises(FileError, match="cannot be read"):
        answer_dakota(model, tmp_path / "none.in", answered)


def test_descriptors_have_no_spaces(tmp_path):
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
    list_of_points {points}
variables
  continuous_design = 3
    descriptors 'push' 'E1' 'load'
interface
  analysis_drivers = 'driver.sh'
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
    """Dakota itself, as the package carolina holds it, runs a study of a model by its fork interface.

    It captures a point that was not trained: the word comes first in the file, and the reason after it is for people.
    """
    pytest.importorskip("carolina")
    hhr.save_model(tmp_path / "model.npz", narrow)
    driver = tmp_path / "driver.sh"
    call = f"{sys.executable} -c 'from hhr_dolfinx.command.main import hhr; hhr()'"
    driver.write_text(f'#!/bin/sh\nexec {call} dakota model.npz "$1" "$2"\n')
    driver.chmod(0o755)
    places = [narrow.parameters.names.index(name) for name in ("push", "E1", "load")]
    inside = (2 * np.array(narrow.trained.lower) + narrow.trained.upper) / 3
    points = [repr(value) for value in np.stack([inside, beyond])[:, places].ravel().tolist()]
    (tmp_path / "dakota.in").write_text(STUDY.format(points=" ".join(points)))
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
    assert re.match(f"fail\n# {UNTRAINED}", second)
