"""Arrays, formulas and modes in the format of a page: plain numbers by name.

Formulas of parameters are lists of operations, which a page evaluates: it executes no code from a
model.
"""

from __future__ import annotations

import ast
import base64
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, TypeAlias, TypedDict

import numpy as np

from hhr_dolfinx.formulas import FUNCTIONS, Scalar

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

Json: TypeAlias = "bool | int | float | str | Sequence[Json] | Mapping[str, Json] | None"
"""Value that JSON holds."""
Steps = list[float | str | list[Any]]
"""Operations of a formula, see :func:`steps_of`."""
FIELD = 3e-3
"""Relative error of displacements by truncation of the drawn modes, below what a picture shows."""
MODE_BYTES = 1_330_000
"""Most bytes of modes."""
POOR_MODES = 0.03
"""Largest acceptable truncation error of drawn modes."""
DRAWN_ROUND_OFF = 1e-9
"""Size of an answer over the largest one below which it is round-off."""
BASE64 = 4 / 3
"""Bytes of text for each byte of numbers."""
LEVELS = 32767
"""Quantisation levels of a drawn mode, on each side of zero."""
_OPERATIONS = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.Pow: "^"}


class ArrayText(TypedDict):
    """Array as text."""

    kind: str  #: number format, such as ``<f8``
    shape: list[int]
    data: str  #: base64


class Packed:
    """Arrays of a model by name, little-endian and contiguous."""

    def __init__(self) -> None:
        self.arrays: dict[str, np.ndarray] = {}

    def put(self, name: str, array: ArrayLike, kind: str = "<f8") -> str:
        """Add an array; returns its name.

        Args:
            name: name of the array.
            array: numbers.
            kind: dtype of the numbers in the page.
        """
        self.arrays[name] = np.ascontiguousarray(array, dtype=kind)
        return name

    @property
    def size(self) -> int:
        """Bytes of all arrays as text."""
        return int(BASE64 * sum(array.nbytes for array in self.arrays.values()))

    def take(self, others: Packed) -> None:
        """Add the arrays of another collection."""
        self.arrays |= others.arrays

    def texts(self) -> dict[str, ArrayText]:
        """Arrays as text, base64, with their shapes and number formats, such as ``<f8``."""
        return {
            name: {
                "kind": array.dtype.str.replace("|", "<"),
                "shape": list(array.shape),
                "data": base64.b64encode(array.tobytes()).decode(),
            }
            for name, array in self.arrays.items()
        }


def steps_of(scalar: Scalar | None) -> Steps | None:
    """Formula as operations on a stack: numbers, ``["p", k]`` for parameter k, names of operators
    and functions.
    """
    if scalar is None:
        return None
    steps: Steps = []

    def walk(node: ast.AST) -> None:
        if isinstance(node, ast.Constant):
            steps.append(float(node.value))  # type: ignore[arg-type]
        elif isinstance(node, ast.Name):
            steps.append(float(np.pi) if node.id == "pi" else ["p", scalar.names.index(node.id)])
        elif isinstance(node, ast.UnaryOp):
            walk(node.operand)
            if isinstance(node.op, ast.USub):
                steps.append("neg")
        elif isinstance(node, ast.BinOp):
            walk(node.left)
            walk(node.right)
            steps.append(_OPERATIONS[type(node.op)])
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
            for argument in node.args:
                walk(argument)
            steps.append(node.func.id if node.func.id in FUNCTIONS else ["table", len(node.args)])

    walk(ast.parse(scalar.text.strip(), mode="eval").body)
    return steps


def half(matrix: np.ndarray) -> np.ndarray:
    """Lower half by rows of a matrix that is symmetric to round-off, (m (m + 1) / 2,)."""
    return ((matrix + matrix.T) / 2)[np.tril_indices(len(matrix))]


def modes_of(
    seen: np.ndarray, left: float = FIELD, numbers: int = int(MODE_BYTES / (2 * BASE64))
) -> np.ndarray | None:
    """Modes of drawn answers, (n, k), with a relative truncation error up to ``left``.

    Answers are normalised one by one, as colour scales are. None if all are zero, or if the modes
    that fit into ``numbers`` have a truncation error above :data:`POOR_MODES`.

    Args:
        seen: answers, (n, S).
        left: relative truncation error.
        numbers: most numbers of all modes.
    """
    lengths = np.linalg.norm(seen, axis=0)
    moves = lengths > DRAWN_ROUND_OFF * lengths.max(initial=0.0)
    if not moves.any():
        return None
    ways, sizes, _ = np.linalg.svd(seen[:, moves] / lengths[moves], full_matrices=False)
    remaining = np.sqrt(np.cumsum(sizes[::-1] ** 2)[::-1])
    count = min(int((remaining > left * remaining[0]).sum()), max(numbers, 0) // len(seen))
    poor = count < len(remaining) and remaining[count] > POOR_MODES * remaining[0]
    return None if poor else ways[:, :count]


def packed_levels(
    name: str, modes: np.ndarray, arrays: Packed, levels: int = LEVELS
) -> dict[str, Any]:
    """Quantise rows, (k, n), to integers with a scale for each.

    They are accurate enough for a picture, and smaller.

    Args:
        name: name of the array.
        modes: rows, (k, n).
        arrays: packed arrays, to which those of the tree are added.
        levels: largest integer.
    """
    largest = np.abs(modes).max(axis=1, initial=0.0)
    numbers = np.round(modes / np.where(largest > 0, largest, 1.0)[:, None] * levels)
    kind = "<i1" if levels < 128 else "<i2"
    return {"modes": arrays.put(name, numbers, kind), "scales": (largest / levels).tolist()}


def kept_levels(tree: dict[str, Any], arrays: Packed) -> np.ndarray:
    """Rows that a page reconstructs from the tree of :func:`packed_levels`, (k, n).

    Args:
        tree: tree of the rows.
        arrays: packed arrays.
    """
    return arrays.arrays[tree["modes"]] * np.array(tree["scales"])[:, None]
