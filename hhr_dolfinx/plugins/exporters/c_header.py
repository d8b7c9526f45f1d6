"""A condensed model as one C header: its arrays, and code that solves the contact problem (C99,
libm only).

The data are those of a page, see :mod:`hhr_dolfinx.plugins.pages.records`; ``pages/c/kernel.h`` has
the code.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, cast, runtime_checkable

import numpy as np

from hhr_dolfinx.errors import ModelFileWarning, NotOfferedError
from hhr_dolfinx.files import replacing
from hhr_dolfinx.plugins.pages.arrays import check_model, contact_tree
from hhr_dolfinx.plugins.pages.kernel import (
    FLAGS_OF_PARTS,
    kernel_parts,
    kernel_text,
    prefixed,
)
from hhr_dolfinx.plugins.pages.laws import laws_of
from hhr_dolfinx.plugins.pages.packing import Packed
from hhr_dolfinx.plugins.pages.records import RecordedFormula, Steps, Struct, kernel_data
from hhr_dolfinx.warn import warn

if TYPE_CHECKING:
    from hhr_dolfinx.models.model import KeptModel
    from hhr_dolfinx.plugins.inelastic.condensed_flow import CondensedFlowModel

Tree = dict[str, Any]
"""Numbers and names of a model as JSON, see ``plugins.pages.arrays.contact_tree``."""
MOST_HEADER_NUMBERS = 4_000_000
"""Most numbers of a header: 80 MB of text, such as S of 2,800 conditions."""
_SIGNS = ("+", "-", "*", "/")
_CALLS = {"^": "pow", "min": "model_min", "max": "model_max", "abs": "fabs"}
"""Operations with another name in C."""
RECORDS = {
    "others": "amplitude",
    "limits": "limit",
    "parts": "part",
    "outputs": "output",
    "bodies": "body",
    "moduli": "modulus",
    "laws": "law",
    "ranges": "range",
}
"""Types of the records of a kernel, by their names."""


def write_c_header(path: str | Path, model: KeptModel | OwnHeader) -> Path:
    """Write a condensed model as a C header; its names begin with that of the file.

    Args:
        path: of the header, ``.h``; its stem must be an identifier of C.
        model: of ``hhr.condense``, ``hhr.reduce`` or a file: elastic or condensed inelastic, with
            friction or without; of ``hhr.condense_heat``.

    Returns:
        The path.

    Raises:
        NotOfferedError: for any other model, or one that is too large to be compiled.
        FileError: if the file cannot be written.

    Warns:
        ModelFileWarning: if some outputs cannot be computed in C.
    """
    text, _ = c_header(model, Path(path).stem)
    with replacing(path, text=True) as file:
        file.write(text)
    return Path(path)


@runtime_checkable
class OwnHeader(Protocol):
    """A model of a plug-in that is more than contact, and writes its own header."""

    def header_in_c(self, name: str) -> tuple[str, Tree]:
        """Text of a header, and its names and ends, see :func:`c_header`.

        Args:
            name: identifier in C that the names of the header begin with.
        """


def c_header(
    model: KeptModel | OwnHeader, name: str, *, bounded: int | None = None
) -> tuple[str, Tree]:
    """Text of a header in C, and the tree that it is made from.

    Args:
        model: a condensed model.
        name: identifier in C that the names of the header begin with.
        bounded: number of the first parameters that have ends; None for all.

    Raises:
        NotOfferedError: if the name is no identifier of C, for a model that has no header, or one
            that is too large to be compiled.
    """
    if not re.fullmatch(r"[A-Za-z]\w*", name, re.ASCII):
        raise NotOfferedError(
            f"{name!r} is no identifier of C, from which names of the header are made: name it else"
        )
    if isinstance(model, OwnHeader):
        return model.header_in_c(name)
    check_model(model, "a header")
    arrays = Packed()
    tree = contact_tree(model, arrays)
    if bounded is not None:
        free = len(tree["names"]) - bounded
        largest = sys.float_info.max
        tree["lower"][bounded:] = [-largest] * free
        tree["upper"][bounded:] = [largest] * free
    if tree["flow"]:  # a page may store it with fewer digits
        arrays.put(tree["flow"]["per_force"], cast("CondensedFlowModel", model).flow.per_force)
    count = sum(array.size for array in arrays.arrays.values())
    if count > MOST_HEADER_NUMBERS:
        raise NotOfferedError(
            f"a header of {count} numbers takes a compiler too long, "
            f"{MOST_HEADER_NUMBERS} are the most: "
            "take a coarser mesh"
        )
    if tree["missing"]:
        warn(
            f"the C header has no output {', '.join(tree['missing'])}: only Python computes "
            "outputs that read displacements if stiffness or shape varies, areas if shapes vary, "
            "centres of pressure, stress in many cells or of bodies with laws, and energies of "
            "heated bodies, of those with laws and of those that contact alone holds",
            ModelFileWarning,
        )
    text = kernel_text(kernel_parts(tree), laws_of(model.law, "a header")).replace(
        "MODEL_TITLE", name
    )
    text = text.replace("/*DATA*/", _Data(tree, arrays.arrays).text())
    return prefixed(text, {"model": name}), tree


def declared_array(name: str, values: np.ndarray) -> str:
    """Declaration of an array of numbers.

    Args:
        name: after the beginning ``model_``.
        values: the numbers, row by row; one zero stands for none.
    """
    integer = values.dtype.kind in "iu"
    convert: Callable[[Any], str] = str if integer else repr
    numbers = list(map(convert, values.ravel().tolist())) or ["0"]
    lines = [", ".join(numbers[k : k + 8]) for k in range(0, len(numbers), 8)]
    return (
        f"static const {'int' if integer else 'double'} model_{name}[] = {{\n"
        + ",\n".join(lines)
        + "};"
    )


def declared_texts(name: str, texts: Sequence[str]) -> str:
    """Declaration of names or units.

    Args:
        name: after the beginning ``model_``.
        texts: the names.
    """
    quoted = ", ".join(_quoted(text) for text in texts) or "0"
    return f"static const char *const model_{name}[] = {{{quoted}}};"


def declared_function(name: str, steps: Steps) -> str:
    """Declaration of a formula of parameters ``p``.

    Args:
        name: its whole name.
        steps: see :func:`formula`.
    """
    return f"static double {name}(const double *p) {{ (void)p; return {formula(steps)}; }}"


def box_of(tree: Tree) -> tuple[np.ndarray, np.ndarray]:
    """Ends of the box, (P,) each: of the parameters, or of the training range within it."""
    lower = np.array(tree["lower"])
    upper = np.array(tree["upper"])
    if tree["trained"] is None:
        return lower, upper
    return np.maximum(lower, tree["trained"][0]), np.minimum(upper, tree["trained"][1])


def formula(steps: Steps) -> str:
    """C expression of the parameters ``p``, from operations of
    ``plugins.pages.packing.steps_of``.
    """
    stack: list[str] = []
    for step in steps:
        if isinstance(step, float):
            stack.append(f"({step!r})")
        elif isinstance(step, list) and step[0] == "p":
            stack.append(f"p[{step[1]}]")
        elif isinstance(step, list):
            values = stack[-step[1] :]
            del stack[-step[1] :]
            stack.append(f"model_table({step[1]}, (const double[]){{{', '.join(values)}}})")
        elif step in _SIGNS or step in ("^", "min", "max"):
            second = stack.pop()
            first = stack.pop()
            stack.append(
                f"({first} {step} {second})"
                if step in _SIGNS
                else f"{_CALLS[step]}({first}, {second})"
            )
        else:
            only = stack.pop()
            stack.append(f"(-{only})" if step == "neg" else f"{_CALLS.get(step, step)}({only})")
    return stack[0]


class _Data:
    """Arrays, formulas and records of a header."""

    def __init__(self, tree: Tree, arrays: dict[str, np.ndarray]):
        self.tree = tree
        self.arrays = arrays
        self.kernel = kernel_data(tree, arrays, box_of(tree))
        self.parts: dict[str, str] = {}

    def text(self) -> str:
        """All declarations, in an order that C accepts."""
        declarations = [self._declared(name, value) for name, value in self.kernel.data.items()]
        return "\n".join([*self._sizes(), *self._names(), *self.parts.values(), *declarations])

    def _sizes(self) -> Iterable[str]:
        features = kernel_parts(self.tree)
        sizes = self.kernel.sizes | {
            name: int(feature in features) for feature, name in FLAGS_OF_PARTS.items()
        }
        return [f"#define MODEL_{name} {size}" for name, size in sizes.items()]

    def _names(self) -> Iterable[str]:
        tree = self.tree
        words = {
            "parameter_names": tree["names"],
            "output_names": [output["name"] for output in tree["outputs"]],
            "output_units": [output["unit"] for output in tree["outputs"]],
        }
        return [declared_texts(name, values) for name, values in words.items()]

    def _declared(self, name: str, value: Any) -> str:
        """Declaration of an array, of a record or of several."""
        if isinstance(value, Struct):
            return f"static const model_{value.kind} model_{name} = {self._record(value)};"
        if isinstance(value, list):
            nothing = "{0}" if name == "moduli" else "{.count = 0}"
            records = ",\n".join(self._record(record) for record in value) or nothing
            return f"static const model_{RECORDS[name]} model_{name}[] = {{{records}}};"
        return declared_array(name, np.zeros(1) if value is None else self._values(value))

    def _values(self, value: str | np.ndarray) -> np.ndarray:
        return self.arrays[value] if isinstance(value, str) else value

    def _record(self, record: Struct) -> str:
        """Initialiser of a record; its arrays and functions are declared separately."""
        fields = {
            key: self._field(key, value)
            for key, value in record.fields.items()
            if value is not None
        }
        return "{" + (", ".join(f".{key} = {text}" for key, text in fields.items()) or "0") + "}"

    def _field(self, key: str, value: Any) -> str:
        if isinstance(value, RecordedFormula):
            return self._function(value.steps)
        if isinstance(value, Struct) and key == "interpolant":
            return self._record(value)
        if isinstance(value, Struct):
            text = self._record(value)
            return "&" + self._put(
                key, lambda name: f"static const model_{value.kind} {name} = {text};"
            )
        if isinstance(value, list):
            names = ", ".join(self._function(function.steps) for function in value)
            return self._put(
                key, lambda name: f"static const model_function {name}[] = {{{names}}};"
            )
        if isinstance(value, str):
            self.parts[value] = declared_array(value, self.arrays[value])
            return f"model_{value}"
        if isinstance(value, np.ndarray):
            return self._put(key, lambda name: declared_array(name.removeprefix("model_"), value))
        return "HUGE_VAL" if value == np.inf else repr(value)

    def _put(self, key: str, declared: Callable[[str], str]) -> str:
        """Declare something under a name that nothing else has; returns it."""
        name = f"model_{key}_{len(self.parts)}"
        self.parts[name] = declared(name)
        return name

    def _function(self, steps: Steps | None) -> str:
        """Declare a function of the parameters; returns its name in C."""
        if steps is None:
            return "0"
        return self._put("formula", lambda name: declared_function(name, steps))


def _quoted(text: str) -> str:
    """C string literal in ASCII; other characters are escapes of their bytes, each ending a
    literal.
    """
    escaped = "".join(
        chr(byte) if 32 <= byte < 127 and chr(byte) not in '"\\?' else f'\\x{byte:02x}""'
        for byte in text.encode(errors="replace")
    )
    return f'"{escaped}"'
