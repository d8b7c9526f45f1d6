"""A server of UM-Bridge, protocol 1.0, by which programs of uncertainty quantification evaluate a
model over HTTP.

There is one input, the parameters, and one output, the outputs of the scene. Gradients and products
with the Jacobian are exact. The server needs the standard library alone. It reports every failure
as the protocol requires, ``{"error": {"type": ..., "message": ...}}``.
"""

from __future__ import annotations

import json
import logging
import socket
from collections.abc import Callable, Mapping
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

import numpy as np

from hhr_dolfinx.errors import FileError, HHRError, NotOfferedError, ParameterError
from hhr_dolfinx.models.model import AnsweringModel
from hhr_dolfinx.version import __version__

PROTOCOL_VERSION = 1.0
"""Version of the protocol."""
MOST_REQUEST_BYTES = 1_000_000
"""Largest size of a request: a point of a thousand parameters has some 20,000 bytes."""
MOST_SKIPPED = 50 * MOST_REQUEST_BYTES
"""Bytes of a request above the limit that are read and discarded before it is refused."""
IDLE_SECONDS = 60.0
"""Seconds after which the connection of a client that sends nothing is closed."""
DEFAULT_NAME = "forward"
"""Default name of the model for clients: the protocol's usual word for a map from parameters to
outputs.
"""

_log = logging.getLogger(__name__)
Fields = dict[str, Any]


class RequestError(Exception):
    """Failure of a request, with its HTTP status and its type in the protocol."""

    def __init__(self, status: HTTPStatus, kind: str, message: str):
        super().__init__(message)
        self.status = status
        self.kind = kind


class Protocol:
    """UM-Bridge protocol without HTTP: maps JSON fields of requests to JSON fields of answers.

    Clients see no warnings of Python: a point outside the training range is refused.
    """

    def __init__(self, model: AnsweringModel, name: str = DEFAULT_NAME):
        if model.fields.functionals is None:
            raise NotOfferedError(
                "UM-Bridge needs numbers to hand out: name outputs in the scene, "
                "Scene(..., outputs=(...,)), and build the model again"
            )
        self.name = name
        self.model = model
        self.names = model.parameters.names
        self.outputs = tuple(functional.name for functional in model.fields.functionals.items)
        # answers of inelastic bodies depend on a path, and have no derivatives
        slopes = model.equilibrium is None
        self.supported = {
            "Evaluate": True,
            "Gradient": slopes,
            "ApplyJacobian": slopes,
            "ApplyHessian": False,
        }
        self.posted: Mapping[str, Callable[[Fields], Fields]] = {
            "/ModelInfo": lambda request: {"support": self.supported},
            "/InputSizes": lambda request: {"inputSizes": [len(self.names)]},
            "/OutputSizes": lambda request: {"outputSizes": [len(self.outputs)]},
            "/Evaluate": self._evaluate,
            "/Gradient": self._gradient,
            "/ApplyJacobian": self._jacobian,
        }

    def get(self, path: str) -> Fields:
        """Answer a GET request.

        Raises:
            RequestError: for any path but ``/Info``.
        """
        if path != "/Info":
            raise self._unknown(path)
        return {"protocolVersion": PROTOCOL_VERSION, "models": [self.name]}

    def post(self, path: str, body: bytes) -> Fields:
        """Answer a POST request.

        Args:
            path: path of the request, such as ``/Evaluate``.
            body: its body, JSON.

        Raises:
            RequestError: for an unknown path or model, invalid fields, a refused point, or one
                without an answer.
        """
        if not self.supported.get(path.removeprefix("/"), True):
            raise RequestError(
                HTTPStatus.BAD_REQUEST, "UnsupportedFeature", f"this model has no {path.strip('/')}"
            )
        if path not in self.posted:
            raise self._unknown(path)
        request = _fields(body)
        if request.get("name") != self.name:
            text = (
                f"model {request.get('name')!r} is not here: the model of this server is "
                f"{self.name!r}"
            )
            raise RequestError(HTTPStatus.BAD_REQUEST, "ModelNotFound", text)
        try:
            return self.posted[path](request)
        except ParameterError as error:
            raise _invalid(str(error)) from error
        except NotOfferedError as error:
            raise RequestError(HTTPStatus.BAD_REQUEST, "UnsupportedFeature", str(error)) from error
        except HHRError as error:
            raise RequestError(
                HTTPStatus.INTERNAL_SERVER_ERROR, "InvalidOutput", str(error)
            ) from error

    def _unknown(self, path: str) -> RequestError:
        paths = ", ".join(["/Info", *self.posted])
        return RequestError(
            HTTPStatus.NOT_FOUND,
            "UnsupportedFeature",
            f"there is no {path[:80]!r}: there are {paths}",
        )

    def _evaluate(self, request: Fields) -> Fields:
        """Outputs at a point."""
        outputs = self.model.outputs(self._point(request), outside="refuse")
        return {"output": [[outputs[name] for name in self.outputs]]}

    def _gradient(self, request: Fields) -> Fields:
        """Weights of the outputs times the Jacobian."""
        weights = _vector(request, "sens", len(self.outputs))
        return {"output": (weights @ self._slopes(request)).tolist()}

    def _jacobian(self, request: Fields) -> Fields:
        """The Jacobian times a direction."""
        direction = _vector(request, "vec", len(self.names))
        return {"output": (self._slopes(request) @ direction).tolist()}

    def _slopes(self, request: Fields) -> np.ndarray:
        """Jacobian, (K, P), at the point of a request; its input and output numbers must be 0."""
        for name in ("inWrt", "outWrt"):
            if request.get(name) != 0 or isinstance(request[name], bool):
                raise _invalid(
                    f"{name} = {_shown(request.get(name))} must be 0: there is one input and one "
                    "output"
                )
        gradient = self.model.outputs(
            self._point(request), gradient=True, outside="refuse"
        ).gradient
        assert gradient is not None
        return np.array([gradient[name] for name in self.outputs])

    def _point(self, request: Fields) -> np.ndarray:
        value = request.get("input")
        if not isinstance(value, list) or len(value) != 1:
            raise _invalid(
                f"input = {_shown(value)} must be a list of one list, the parameters {self.names}"
            )
        return _vector({"input[0]": value[0]}, "input[0]", len(self.names))


def _fields(body: bytes) -> Fields:
    try:
        request = json.loads(body)
    except (ValueError, RecursionError) as error:
        raise _invalid(
            f"the request is not JSON ({type(error).__name__}: {str(error)[:200]})"
        ) from error
    if not isinstance(request, dict):
        raise _invalid(f"the request must be an object of JSON, and is {_shown(request)}")
    return request


def _vector(request: Fields, name: str, size: int) -> np.ndarray:
    values = request.get(name)
    if not isinstance(values, list) or len(values) != size:
        count = (
            f" and has {len(values)}" if isinstance(values, list) else f" and is {_shown(values)}"
        )
        raise _invalid(f"{name} must be a list of length {size}{count}")
    if not all(isinstance(value, int | float) and not isinstance(value, bool) for value in values):
        raise _invalid(f"{name} = {_shown(values)} must hold numbers alone")
    try:
        return np.array(values, dtype=float)
    except OverflowError:
        raise _invalid(f"{name} = {_shown(values)} has a number that is too large") from None


def _invalid(message: str) -> RequestError:
    return RequestError(HTTPStatus.BAD_REQUEST, "InvalidInput", message)


def _shown(value: object) -> str:
    """Value for a message, at most 80 characters."""
    text = repr(value)
    return text if len(text) <= 80 else f"{text[:80]}..."


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    server_version = f"hhr_dolfinx/{__version__}"
    sys_version = ""
    timeout = IDLE_SECONDS
    server: Server

    def do_GET(self) -> None:
        self._answer(lambda: self.server.protocol.get(self.path))

    def do_POST(self) -> None:
        self._answer(lambda: self.server.protocol.post(self.path, self._body()))

    def _body(self) -> bytes:
        """Body of a request; its size is checked before it is read."""
        text = self.headers.get("Content-Length", "")
        if "Transfer-Encoding" in self.headers or not (text.isascii() and text.isdigit()):
            raise self._unread(
                HTTPStatus.LENGTH_REQUIRED, "a request must have its Content-Length, and no chunks"
            )
        if len(text) > 9 or int(text) > MOST_REQUEST_BYTES:
            # a client must finish sending to read the reason
            remaining = min(int(text[:9]), MOST_SKIPPED)
            while remaining > 0 and (piece := self.rfile.read(min(remaining, MOST_REQUEST_BYTES))):
                remaining -= len(piece)
            size = f"a request of {text[:20]} bytes is more than the limit of {MOST_REQUEST_BYTES}"
            raise self._unread(
                HTTPStatus.REQUEST_ENTITY_TOO_LARGE, f"{size}: send one point at a time"
            )
        return self.rfile.read(int(text))

    def _unread(self, status: HTTPStatus, message: str) -> RequestError:
        """Error that closes the connection: the bytes that follow are not the next request."""
        self.close_connection = True
        return RequestError(status, "InvalidInput", message)

    def _answer(self, answer: Callable[[], Fields]) -> None:
        status = HTTPStatus.OK
        try:
            body = json.dumps(answer(), allow_nan=False)
        except RequestError as error:
            status = error.status
            body = _described(error.kind, str(error))
        except TimeoutError:
            self.close_connection = True
            return
        except Exception as error:
            # if the model fails, the client must get a message, and the server must go on
            _log.exception("an answer to %s failed", self.path)
            status = HTTPStatus.INTERNAL_SERVER_ERROR
            body = _described("InvalidOutput", f"{type(error).__name__}: {error}")
        self._send(status, body)

    def _send(self, status: int, body: str) -> None:
        data = body.encode()
        self.send_response(status)
        self.send_header("Content-Type", "application/json")
        self.send_header("Content-Length", str(len(data)))
        if self.close_connection:
            self.send_header("Connection", "close")
        self.end_headers()
        self.wfile.write(data)

    def send_error(self, code: int, message: str | None = None, explain: str | None = None) -> None:
        """Send an error of HTTP itself, in the format of the protocol.

        Args:
            code: HTTP status.
            message: its message; None for the usual one.
            explain: not used.
        """
        self.close_connection = True
        self._send(code, _described("InvalidInput", message or HTTPStatus(code).phrase))

    def log_message(self, format: str, *args: Any) -> None:
        """Write to the logger of the package, not to the screen."""
        _log.debug(format, *args)


def _described(kind: str, message: str) -> str:
    return json.dumps({"error": {"type": kind, "message": message}})


class Server(ThreadingHTTPServer):
    """Server of one model; ``serve_forever`` serves it until it is interrupted.

    Args:
        model: of any kind. With friction or inelastic bodies, a point is one step from rest.
        host: address to listen on; the default accepts clients of this machine only.
        port: to listen on; 0 for any free one.
        name: of the model, for clients.

    Attributes:
        url: address for clients.

    Raises:
        NotOfferedError: for a model of a scene without outputs.
        FileError: if the address does not belong to this machine, or the port is in use.
    """

    daemon_threads = True
    # parallel chains connect at the same time; more than Python's default of five would be refused
    request_queue_size = 128

    def __init__(
        self,
        model: AnsweringModel,
        host: str = "127.0.0.1",
        port: int = 4242,
        name: str = DEFAULT_NAME,
    ):
        self.protocol = Protocol(model, name)
        self.address_family = socket.AF_INET6 if ":" in host else socket.AF_INET
        try:
            super().__init__((host, port), _Handler)
        except (OSError, OverflowError) as error:
            reason = getattr(error, "strerror", None) or error
            raise FileError(
                f"{host} port {port} cannot be served ({reason}): take another --host or --port"
            ) from error
        shown = f"[{host}]" if ":" in host else host
        self.url = f"http://{shown}:{self.server_address[1]}"

    def handle_error(self, request: object, client_address: object) -> None:
        """Log a broken connection, not on the screen.

        Args:
            request: the socket, not used.
            client_address: address of the client.
        """
        _log.debug("the connection of %s broke", client_address, exc_info=True)
