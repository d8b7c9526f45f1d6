"""Arrays, formulas and modes as a page keeps them: plain numbers by name.

Formulas of parameters go as lists of operations, which a page works off: nothing in it is executed that came out of a
model.
"""

from __future__ import annotations

import ast
import base64
from typing import Any

import numpy as np

from hhr_dolfinx.formulas import FUNCTIONS, Scalar

FIELD = 3e-3
ROOM = 1_330_000
"""Part of the displacements that modes of the picture leave out: a picture shows no more. Bytes of modes at most."""
POOR = 0.03
"""Part of what is drawn that is too much to leave out."""
NOTHING = 1e-9
"""Part of the largest answer that one is round-off of."""
BASE64 = 4 / 3
"""Bytes of text for one of numbers."""
LEVELS = 32767
"""Numbers of a mode of the picture lie on so many levels to either side."""
_OPERATIONS = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.Pow: "^"}


class Packed:
    """Arrays of a model by name, in the kinds of numbers that are kept of them.

    Attributes:
        arrays: little-endian, contiguous.
        kinds: of their numbers, such as ``<f8``.
    """

    def __init__(self) -> None:
        self.arrays: dict[str, np.ndarray] = {}
        self.kinds: dict[str, str] = {}

    def put(self, name: str, array: Any, kind: str = "<f8") -> str:
        """Take an array in; returns its name."""
        self.arrays[name] = np.ascontiguousarray(array, dtype=kind)
        self.kinds[name] = kind
        return name

    @property
    def size(self) -> int:
        """Bytes that they take as text."""
        return int(BASE64 * sum(array.nbytes for array in self.arrays.values()))

    def take(self, others: Packed) -> None:
        """Take arrays of others in."""
        self.arrays |= others.arrays
        self.kinds |= others.kinds

    def texts(self) -> dict[str, dict[str, Any]]:
        """The same as text, base64."""
        return {
            name: {
                "kind": self.kinds[name],
                "shape": list(array.shape),
                "data": base64.b64encode(array.tobytes()).decode(),
            }
            for name, array in self.arrays.items()
        }


def steps_of(scalar: Scalar | None) -> list[Any] | None:
    """A formula as operations on a stack: numbers, ``["p", k]`` for parameter k, names of operators and functions."""
    if scalar is None:
        return None
    found: list[Any] = []

    def walk(node: ast.AST) -> None:
        if isinstance(node, ast.Constant):
            found.append(float(node.value))  # type: ignore[arg-type]
        elif isinstance(node, ast.Name):
            found.append(float(np.pi) if node.id == "pi" else ["p", scalar.names.index(node.id)])
        elif isinstance(node, ast.UnaryOp):
            walk(node.operand)
            if isinstance(node.op, ast.USub):
                found.append("neg")
        elif isinstance(node, ast.BinOp):
            walk(node.left)
            walk(node.right)
            found.append(_OPERATIONS[type(node.op)])
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
            for argument in node.args:
                walk(argument)
            found.append(node.func.id if node.func.id in FUNCTIONS else ["table", len(node.args)])

    walk(ast.parse(scalar.text.strip(), mode="eval").body)
    return found


def half(matrix: np.ndarray) -> np.ndarray:
    """Lower half by rows of a matrix that is symmetric to round-off, (m (m + 1) / 2,)."""
    return ((matrix + matrix.T) / 2)[np.tril_indices(len(matrix))]


def modes_of(seen: np.ndarray, left: float = FIELD, numbers: int = int(ROOM / (2 * BASE64))) -> np.ndarray | None:
    """Modes of what is drawn, (n, k), of answers, (n, S): so many that no more than a part of these is left out.

    Of each as a part of itself, as colours show it; None where nothing moves, or where as many numbers as there may be
    leave more than :data:`POOR` of it out.
    """
    lengths = np.linalg.norm(seen, axis=0)
    moves = lengths > NOTHING * lengths.max(initial=0.0)
    if not moves.any():
        return None
    ways, sizes, _ = np.linalg.svd(seen[:, moves] / lengths[moves], full_matrices=False)
    rest = np.sqrt(np.cumsum(sizes[::-1] ** 2)[::-1])
    count = min(int((rest > left * rest[0]).sum()), max(numbers, 0) // len(seen))
    poor = count < len(rest) and rest[count] > POOR * rest[0]
    return None if poor else ways[:, :count]


def packed_levels(name: str, modes: np.ndarray, arrays: Packed, levels: int = LEVELS) -> dict[str, Any]:
    """Rows, (k, n), as whole numbers and a scale for each: what a picture needs of them, in a part of the room."""
    largest = np.abs(modes).max(axis=1, initial=0.0)
    numbers = np.round(modes / np.where(largest > 0, largest, 1.0)[:, None] * levels)
    kind = "<i1" if levels < 128 else "<i2"
    return {"modes": arrays.put(name, numbers, kind), "scales": (largest / levels).tolist()}


def kept_levels(tree: dict[str, Any], arrays: Packed) -> np.ndarray:
    """Rows as a page has them, of what :func:`packed_levels` said, (k, n)."""
    return arrays.arrays[tree["modes"]] * np.array(tree["scales"])[:, None]
