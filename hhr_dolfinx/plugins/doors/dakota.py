"""A model as a driver of Dakota: parameters and results in the files that it hands to programs of a command line.

Both are of its standard format (Dakota reference manual, sections on parameters files and results files): lines of a
value and a name. Functions are asked for by a number whose bits mean value, 1, gradient, 2, and Hessian, 4.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

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
from hhr_dolfinx.plugins.doors.function import OutputFunction

if TYPE_CHECKING:
    from hhr_dolfinx.models.model import AnsweringModel


VALUE = 1
GRADIENT = 2
HESSIAN = 4


class Asked(NamedTuple):
    """What Dakota asks for.

    Attributes:
        variables: values by name.
        functions: what is asked of each function, by its name.
        along: variables of the derivatives, numbers from 1 on.
    """

    variables: dict[str, float]
    functions: dict[str, int]
    along: list[int]


def answer_dakota(model: AnsweringModel, parameters: str | Path, results: str | Path) -> None:
    """Answer what Dakota asks for in one file in another one, which is whole or not there.

    Variables of Dakota have the names of parameters, and its functions those of outputs, in which ``_`` may stand for a
    space: its descriptors have none. If a point is outside of the box or of what was trained, or has no answer, it says
    ``fail``, which Dakota captures as its study asks for, and the reason after it.

    Raises:
        FileContentError: for a file that is none of Dakota's.
        ParameterError: if names differ, or a point is outside of the box or of what was trained.
        NotOfferedError: for Hessians.
        ConvergenceError: where there is no answer.
    """
    function = OutputFunction(model)
    asked = _named(read_parameters(parameters), function)
    for kind, given, known in (
        ("variables", asked.variables, function.names), ("functions", asked.functions, function.outputs)
    ):  # fmt: skip
        if strange := [name for name in given if name not in known]:
            raise ParameterError(
                f"Dakota's {kind} {strange} are none of {list(known)}: give its descriptors these names"
            )
    if any(wanted & HESSIAN for wanted in asked.functions.values()):
        raise NotOfferedError("Hessians are not built in: no_hessians, or quasi_hessians, in Dakota's responses")
    if missing := [name for name in function.names if name not in asked.variables]:
        raise ParameterError(f"Dakota gives no {missing}: make them variables too, or state variables of one value")
    point = np.array([asked.variables[name] for name in function.names])
    try:
        lines = _lines(function, asked, point)
    except (ConvergenceError, NotSolvableError, ParameterError) as error:
        with replacing(results, text=True) as file:
            # Dakota reads nothing after the word; people who look at the file do
            file.write(f"fail\n# {' '.join(str(error).split())}\n")
        raise
    with replacing(results, text=True) as file:
        file.write("\n".join(lines) + "\n")


def _lines(function: OutputFunction, asked: Asked, point: np.ndarray) -> list[str]:
    """Lines of a results file at a point, (P,)."""
    values = dict(zip(function.outputs, function(point)[0].tolist(), strict=True))
    slopes: dict[str, np.ndarray] = {}
    if any(wanted & GRADIENT for wanted in asked.functions.values()):
        names = list(asked.variables)
        places = [function.names.index(names[number - 1]) for number in asked.along]
        slopes = dict(zip(function.outputs, function.jacobian(point)[:, places], strict=True))
    lines = [f"{values[name]:.17g} {name}" for name, wanted in asked.functions.items() if wanted & VALUE]
    for name, wanted in asked.functions.items():
        if wanted & GRADIENT:
            lines.append(f"[ {' '.join(f'{slope:.17g}' for slope in slopes[name])} ]")
    return lines


def _named(asked: Asked, function: OutputFunction) -> Asked:
    """The same by the names of the model."""
    own = {"_".join(name.split()): name for name in (*function.names, *function.outputs)}
    variables = {own.get(name, name): value for name, value in asked.variables.items()}
    return Asked(variables, {own.get(name, name): wanted for name, wanted in asked.functions.items()}, asked.along)


def read_parameters(path: str | Path) -> Asked:
    """What a parameters file asks for.

    Raises:
        FileContentError: for one that is none, or one of the format of APREPRO.
    """
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
        told = str(error) if isinstance(error, ValueError) else "it ends early"
        raise FileContentError(
            f"{path} is no parameters file of Dakota's standard format: {told}. Take its fork or "
            "system interface, without aprepro"
        ) from None
    return Asked(variables, functions, along)


def _block(lines: Any, name: str) -> list[tuple[str, str]]:
    """Lines of values and names behind their number."""
    count, found = next(lines).split(maxsplit=1)
    if found.strip() != name:
        raise ValueError(f"{found.strip()!r} where {name!r} is wanted")
    pairs = [next(lines).split(maxsplit=1) for _ in range(int(count))]
    return [(value, text.strip()) for value, text in pairs]
