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
