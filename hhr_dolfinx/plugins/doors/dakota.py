"""A model as a driver of Dakota, which passes parameters and results to command-line programs in files.

Both have its standard format (Dakota reference manual, sections on parameters files and results files): lines of a
value and a name. For each function a number states the request, by its bits: 1 value, 2 gradient, 4 Hessian.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from hhr_dolfinx.errors import (
    ConvergenceError,
    FileContentError,
    FileError,
    NotOfferedError,
    NotSolvableError,
    ParameterError,
)
from hhr_dolfinx.files import replacing
from hhr_dolfinx.models.model import AnsweringModel
from hhr_dolfinx.plugins.doors.function import OutputFunction

VALUE = 1
GRADIENT = 2
HESSIAN = 4


class Request(NamedTuple):
    """Variables and functions by name, with values and bits, and numbers of the variables of derivatives, from 1."""

    variables: dict[str, float]
    functions: dict[str, int]
    along: list[int]


def answer_dakota(model: AnsweringModel, parameters: str | Path, results: str | Path) -> None:
    """Read a request of Dakota from a file, and write the results to another file, in one piece.

    Variables of Dakota have the names of parameters, and its functions those of outputs. ``_`` may replace a space,
    which descriptors cannot contain. For a point outside the box or the training range, or without an answer, the file
    has ``fail`` and the reason. Dakota captures this failure as its study specifies.

    Raises:
        FileContentError: for a file that is not in Dakota's format.
        ParameterError: if names differ, or a point is outside the box or the training range.
        NotOfferedError: for Hessians.
        ConvergenceError: if there is no answer.
    """
    function = OutputFunction(model)
    request = _named(read_parameters(parameters), function)
    for kind, given, known in (
        ("variables", request.variables, function.names),
        ("functions", request.functions, function.outputs),
    ):
        if strange := [name for name in given if name not in known]:
            raise ParameterError(
                f"Dakota's {kind} {strange} are none of {list(known)}: give its descriptors these names"
            )
    if any(wanted & HESSIAN for wanted in request.functions.values()):
        raise NotOfferedError("Hessians are not built in: no_hessians, or quasi_hessians, in Dakota's responses")
    if missing := [name for name in function.names if name not in request.variables]:
        raise ParameterError(f"Dakota gives no {missing}: make them variables too, or state variables of one value")
    point = np.array([request.variables[name] for name in function.names])
    try:
        lines = _lines(function, request, point)
    except (ConvergenceError, NotSolvableError, ParameterError) as error:
        with replacing(results, text=True) as file:
            # Dakota reads nothing after this word; the reason is for people
            file.write(f"fail\n# {' '.join(str(error).split())}\n")
        raise
    with replacing(results, text=True) as file:
        file.write("\n".join(lines) + "\n")


def _lines(function: OutputFunction, request: Request, point: np.ndarray) -> list[str]:
    values = dict(zip(function.outputs, function(point)[0].tolist(), strict=True))
    slopes: dict[str, np.ndarray] = {}
    if any(wanted & GRADIENT for wanted in request.functions.values()):
        names = list(request.variables)
        places = [function.names.index(names[number - 1]) for number in request.along]
        slopes = dict(zip(function.outputs, function.jacobian(point)[:, places], strict=True))
    lines = [f"{values[name]:.17g} {name}" for name, wanted in request.functions.items() if wanted & VALUE]
    for name, wanted in request.functions.items():
        if wanted & GRADIENT:
            lines.append(f"[ {' '.join(f'{slope:.17g}' for slope in slopes[name])} ]")
    return lines


def _named(request: Request, function: OutputFunction) -> Request:
    own = {"_".join(name.split()): name for name in (*function.names, *function.outputs)}
    variables = {own.get(name, name): value for name, value in request.variables.items()}
    functions = {own.get(name, name): wanted for name, wanted in request.functions.items()}
    return Request(variables, functions, request.along)


def read_parameters(path: str | Path) -> Request:
    """Request of a parameters file; FileContentError for any other file, including one in the format of APREPRO."""
    try:
        lines = iter(Path(path).read_text().splitlines())
    except OSError as error:
        raise FileError(f"the parameters of Dakota, {path}, cannot be read: {error}") from None
    except UnicodeDecodeError:
        lines = iter(())
    try:
        variables = {name: float(value) for value, name in _block(lines, "variables")}
        functions = {name.partition(":")[2]: int(value) for value, name in _block(lines, "functions")}
        along = [int(value) for value, _ in _block(lines, "derivative_variables")]
        if not all(1 <= number <= len(variables) for number in along):
            raise ValueError("a derivative along a variable that is not there")
    except (ValueError, IndexError, StopIteration) as error:
        reason = str(error) if isinstance(error, ValueError) else "it ends early"
        raise FileContentError(
            f"{path} is no parameters file of Dakota's standard format: {reason}. Take its fork or "
            "system interface, without aprepro"
        ) from None
    return Request(variables, functions, along)


def _block(lines: Any, name: str) -> list[tuple[str, str]]:
    """Pairs of a value and a name, from a block that begins with their number."""
    count, found = next(lines).split(maxsplit=1)
    if found.strip() != name:
        raise ValueError(f"{found.strip()!r} where {name!r} is wanted")
    pairs = [next(lines).split(maxsplit=1) for _ in range(int(count))]
    return [(value, text.strip()) for value, text in pairs]
