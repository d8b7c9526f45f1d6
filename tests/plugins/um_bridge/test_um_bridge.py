"""The server of UM-Bridge: values, gradients, names, what is refused."""

import dataclasses
import http.client
import json
import socket
import subprocess
import sys
import threading
from contextlib import contextmanager
from functools import partial
from unittest.mock import Mock

import contract
import numpy as np
import pytest
from threads import at_once

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import FileError, NotOfferedError
from hhr_dolfinx.plugins.um_bridge import server as um_bridge
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
    return (
        point,
        np.array([found[name] for name in names]),
        np.array([found.gradient[n] for n in names]),
    )


def test_a_model_without_outputs_is_not_served():
    bare = hhr.condense(dataclasses.replace(contract.blocks(), outputs=()))
    with pytest.raises(NotOfferedError, match="name outputs in the scene"):
        um_bridge.Protocol(bare)


@pytest.fixture(scope="module")
def narrow(model):
    """The same model, trained in the lower half of its box."""
    lower, upper = np.array(model.parameters.lower), np.array(model.parameters.upper)
    return model.changed(
        trained=TrainedRange(tuple(model.parameters.names), lower, (lower + upper) / 2)
    )


@pytest.fixture(scope="module")
def beyond(narrow):
    """A point in the box and outside of what was trained, along the first parameter."""
    point = np.array(narrow.trained.lower)
    point[0] = narrow.parameters.upper[0]
    return point


UNTRAINED = r"outside what was trained: push = 0\.06 \(trained 0\.005 to 0\.0325\)"


@contextmanager
def serving(folder, model, name, *words):
    """A client of UM-Bridge of a server in a process of its own, which knows nothing but the file
    of a model.
    """
    umbridge = pytest.importorskip("umbridge")
    hhr.save_model(folder / "model.npz", model)
    command = "from hhr_dolfinx.command.main import main; main()"
    words = [
        sys.executable,
        "-c",
        command,
        "serve",
        str(folder / "model.npz"),
        "--port",
        "0",
        *words,
    ]
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
        assert (
            client.supports_evaluate()
            and client.supports_gradient()
            and client.supports_apply_jacobian()
        )
        asked = [list(map(float, point))]
        np.testing.assert_allclose(client(asked)[0], values, rtol=1e-10)
        np.testing.assert_allclose(
            client.gradient(0, 0, asked, [0.5, -2.0]), [0.5, -2.0] @ slopes, rtol=1e-10
        )
        way = [1.0, 2.0, -1.0]
        np.testing.assert_allclose(
            client.apply_jacobian(0, 0, asked, way), slopes @ way, rtol=1e-10
        )
        with pytest.raises(
            Exception, match=r"InvalidInput: input\[0\] must be a list of length 3 and has 1"
        ):
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
        known = list(narrow.outputs(inside).values.values())
        np.testing.assert_allclose(client([inside.tolist()])[0], known, rtol=1e-12)


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
        connection.request(
            method, path, body, {name.replace("_", "-"): text for name, text in headers.items()}
        )
        answer = connection.getresponse()
        assert answer.getheader("Content-Type") == "application/json"
        return answer.status, json.loads(answer.read())
    finally:
        connection.close()


GOOD = {"name": "forward", "input": [[0.01, 0.02, 2.0]], "config": {}}
DERIVED = GOOD | {"inWrt": 0, "outWrt": 0, "sens": [1.0, 0.0], "vec": [1.0, 0.0, 0.0]}


@pytest.mark.parametrize(
    ("path", "asked", "status", "kind", "message"),
    [
        ("/Evaluate", b"{", 400, "InvalidInput", "not JSON"),
        ("/Evaluate", b"", 400, "InvalidInput", "not JSON"),
        ("/Evaluate", b"[" * 100_000, 400, "InvalidInput", "not JSON (RecursionError"),
        ("/Evaluate", [1], 400, "InvalidInput", "must be an object of JSON, and is [1]"),
        (
            "/Evaluate",
            {},
            400,
            "ModelNotFound",
            "None is not here: the model of this server is 'forward'",
        ),
        ("/InputSizes", {"name": "other"}, 400, "ModelNotFound", "'other' is not here"),
        (
            "/Evaluate",
            {"name": "forward"},
            400,
            "InvalidInput",
            "input = None must be a list of one list",
        ),
        ("/Evaluate", GOOD | {"input": [1, 2, 3]}, 400, "InvalidInput", "one list"),
        ("/Evaluate", GOOD | {"input": [[1, 2, "3"]]}, 400, "InvalidInput", "numbers alone"),
        ("/Evaluate", GOOD | {"input": [[1, 2, True]]}, 400, "InvalidInput", "numbers alone"),
        ("/Evaluate", GOOD | {"input": [[0, 0, 10**400]]}, 400, "InvalidInput", "too large"),
        ("/Evaluate", GOOD | {"input": [[float("nan"), 0.02, 2.0]]}, 400, "InvalidInput", "finite"),
        ("/Gradient", DERIVED | {"outWrt": 1}, 400, "InvalidInput", "outWrt = 1 must be 0"),
        (
            "/Gradient",
            DERIVED | {"sens": [1.0]},
            400,
            "InvalidInput",
            "sens must be a list of length 2 and has 1",
        ),
        (
            "/ApplyJacobian",
            DERIVED | {"vec": "abc"},
            400,
            "InvalidInput",
            "vec must be a list of length 3 and is 'abc'",
        ),
        ("/ApplyHessian", DERIVED, 400, "UnsupportedFeature", "this model has no ApplyHessian"),
        ("/Elsewhere", GOOD, 404, "UnsupportedFeature", "there are /Info, /ModelInfo"),
    ],
)
def test_errors_are_those_of_the_protocol(served, path, asked, status, kind, message):
    body = asked if isinstance(asked, bytes) else json.dumps(asked)
    found, answer = requested(served, path, body)
    assert (
        found == status
        and answer["error"]["type"] == kind
        and message in answer["error"]["message"]
    )
    assert answer.keys() == {"error"} and len(answer["error"]["message"]) < 500
    # and the server goes on
    assert requested(served, "/Evaluate", json.dumps(GOOD))[0] == 200


def test_requests_have_a_limit_of_size(served):
    """One megabyte, whatever is in it; a size that is not given, or given in chunks, is not
    read.
    """
    room = um_bridge.MOST_REQUEST_BYTES - len(json.dumps(GOOD | {"config": ""}))
    for more, status in ((0, 200), (1, 413), (3_000_000, 413)):
        found, answer = requested(
            served, "/Evaluate", json.dumps(GOOD | {"config": "x" * (room + more)})
        )
        assert found == status and ("error" in answer) == (status != 200)
    assert answer["error"]["message"] == (
        "a request of 4000000 bytes is more than the limit of 1000000: send one point at a time"
    )
    for headers in (
        {"Transfer_Encoding": "chunked"},
        {"Content_Length": "-1"},
        {"Content_Length": "1e3"},
    ):
        found, answer = requested(served, "/Evaluate", **headers)
        assert found == 411 and "Content-Length" in answer["error"]["message"]
    assert requested(served, "/Info", method="GET") == (
        200,
        {"protocolVersion": 1.0, "models": ["forward"]},
    )
    assert requested(served, "/Info", method="PUT")[0] == 501


def test_a_server_listens_where_it_is_told_to(model, served):
    host, port = served.server_address
    assert host == "127.0.0.1" and served.url == f"http://127.0.0.1:{port}"
    # all of 127.0.0.0/8 is this machine: a server of all addresses would answer there
    with socket.socket() as other, pytest.raises(ConnectionRefusedError):
        other.connect(("127.0.0.2", port))
    with pytest.raises(
        FileError,
        match=rf"127\.0\.0\.1 port {port} cannot be served .*take another --host or --port",
    ):
        um_bridge.Server(model, port=port)
    with pytest.raises(FileError, match="cannot be served"):
        um_bridge.Server(model, host="192.0.2.1", port=0)


def test_a_fault_of_a_model_costs_no_client_its_sentence(served, monkeypatch):
    monkeypatch.setitem(
        served.protocol.posted, "/Evaluate", Mock(side_effect=ZeroDivisionError("by a fault"))
    )
    status, answer = requested(served, "/Evaluate", json.dumps(GOOD))
    assert (status, answer) == (
        500,
        {"error": {"type": "InvalidOutput", "message": "ZeroDivisionError: by a fault"}},
    )


def test_a_server_takes_turns_with_all_its_clients(served):
    """Threads share the model, and each client gets its own answer."""
    model = served.protocol.model
    points = np.minimum(model.parameters.random(40, 3), model.trained.upper)

    def ask(point):
        return requested(served, "/Evaluate", json.dumps(GOOD | {"input": [point]}))[1]["output"][0]

    found = at_once([partial(ask, point) for point in points.tolist()])
    known = model.solve_many(points).outputs()
    np.testing.assert_allclose(found, np.column_stack([known["peak"], known["force"]]), rtol=1e-10)
