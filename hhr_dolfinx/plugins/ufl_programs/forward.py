"""Exact derivatives of programs along directions: each row of a program is differentiated as it is
executed.

A value x of a register has K derivatives x'. Comparisons, maxima, minima and absolute values have a
kink where their operands a and b are the same: along a direction they come to it after (b - a) /
(a' - b'), as far as the first derivative says. Derivatives are those of the side that the values
are on.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from hhr_dolfinx.plugins.ufl_programs.graph import OPERATIONS
from hhr_dolfinx.plugins.ufl_programs.program import Program

SIGNIFICANT = 1e-6
"""Part of the sizes of its terms below which the derivative of a distance to a kink is
round-off.
"""
_NAMES = tuple(OPERATIONS)
_KINKS = {"lt", "le", "max", "min", "abs"}


def _truth(test: np.ndarray) -> np.ndarray:
    return test.astype(float)


_VALUES: dict[str, Callable[..., np.ndarray]] = {
    "add": np.add,
    "sub": np.subtract,
    "mul": np.multiply,
    "div": np.divide,
    "neg": np.negative,
    "sqrt": np.sqrt,
    "exp": np.exp,
    "log": np.log,
    "pow": np.power,
    "abs": np.abs,
    "sin": np.sin,
    "cos": np.cos,
    "tan": np.tan,
    "asin": np.arcsin,
    "acos": np.arccos,
    "atan": np.arctan,
    "sinh": np.sinh,
    "cosh": np.cosh,
    "tanh": np.tanh,
    "atan2": np.arctan2,
    "max": np.maximum,
    "min": np.minimum,
    "lt": lambda a, b: _truth(a < b),
    "le": lambda a, b: _truth(a <= b),
    "eq": lambda a, b: _truth(a == b),
    "not": lambda a: _truth(a == 0),
    "and": lambda a, b: _truth((a != 0) & (b != 0)),
    "or": lambda a, b: _truth((a != 0) | (b != 0)),
    "select": lambda a, b, c: np.where(a != 0, b, c),
}
_SLOPES: dict[str, Callable[..., tuple[np.ndarray | float, ...]]] = {
    "add": lambda x, a, b: (1.0, 1.0),
    "sub": lambda x, a, b: (1.0, -1.0),
    "mul": lambda x, a, b: (b, a),
    "div": lambda x, a, b: (1 / b, -x / b),
    "neg": lambda x, a: (-1.0,),
    "sqrt": lambda x, a: (np.where(x > 0, 0.5 / x, 0.0),),  # the size of a tensor that is zero
    "exp": lambda x, a: (x,),
    "log": lambda x, a: (1 / a,),
    "pow": lambda x, a, b: (b * a ** (b - 1), np.where(a > 0, x * np.log(a), 0.0)),
    "abs": lambda x, a: (np.where(a < 0, -1.0, 1.0),),
    "sin": lambda x, a: (np.cos(a),),
    "cos": lambda x, a: (-np.sin(a),),
    "tan": lambda x, a: (1 + x * x,),
    "asin": lambda x, a: (1 / np.sqrt(1 - a * a),),
    "acos": lambda x, a: (-1 / np.sqrt(1 - a * a),),
    "atan": lambda x, a: (1 / (1 + a * a),),
    "sinh": lambda x, a: (np.cosh(a),),
    "cosh": lambda x, a: (np.sinh(a),),
    "tanh": lambda x, a: (1 - x * x,),
    "atan2": lambda x, a, b: (b / (a * a + b * b), -a / (a * a + b * b)),
    "max": lambda x, a, b: (_truth(~(a < b)), _truth(a < b)),
    "min": lambda x, a, b: (_truth(~(b < a)), _truth(b < a)),
    "select": lambda x, a, b, c: (0.0, _truth(a != 0), _truth(a == 0)),
}
"""Derivatives of a result by its operands, from the result and these."""


class Forward:
    """Registers of a program at n points with K derivatives each.

    Args:
        program: the program.
        inputs: values of its inputs, (inputs, n).
        changes: derivatives of these, (inputs, n, K).

    Attributes:
        reach: least distance along each direction to a kink of the parts that were watched, (n, K).
    """

    def __init__(self, program: Program, inputs: np.ndarray, changes: np.ndarray):
        points, ways = changes.shape[1:]
        self._program = program
        self._values: list[np.ndarray] = [np.zeros(points)] * program.registers
        # derivatives, and the sizes of their terms; None is zero
        self._changes: list[np.ndarray | None] = [None] * program.registers
        self._sizes: list[np.ndarray | None] = [None] * program.registers
        self.reach = np.full((points, ways), np.inf)
        for register, number in enumerate(program.numbers.tolist(), start=program.inputs):
            self._values[register] = np.full(points, number)
        self.set(range(program.inputs), inputs, changes)

    def set(self, registers: Sequence[int], values: np.ndarray, changes: np.ndarray) -> None:
        """Set values and derivatives of some registers.

        Args:
            registers: indices of the registers, k of them.
            values: values, (k, n).
            changes: derivatives, (k, n, K).
        """
        for register, value, change in zip(registers, values, changes, strict=True):
            self._values[register] = value
            self._changes[register] = change if change.any() else None
            self._sizes[register] = np.abs(change) if change.any() else None

    def run(self, part: int, *, watch: bool = True) -> None:
        """Execute a part.

        Args:
            part: its number.
            watch: watch its kinks, for which all derivatives of the inputs must be set.
        """
        program = self._program
        start = program.ends[part - 1] if part else 0
        with np.errstate(all="ignore"):
            for code, to, *operands in program.rows[start : program.ends[part]].tolist():
                self._execute(_NAMES[code], to, operands, watch)

    def _execute(self, name: str, to: int, operands: list[int], watch: bool) -> None:
        """Execute one row."""
        evaluate = _VALUES[name]
        operands = operands[: OPERATIONS[name]]
        values = [self._values[register] for register in operands]
        value = evaluate(*values)
        if watch and name in _KINKS:
            self._watch(operands, values)
        change: np.ndarray | None = None
        size: np.ndarray | None = None
        if name in _SLOPES and any(self._changes[register] is not None for register in operands):
            for register, slope in zip(operands, _SLOPES[name](value, *values), strict=True):
                derivative = self._changes[register]
                terms = self._sizes[register]
                if derivative is not None and terms is not None:
                    change = _added(change, slope, derivative)
                    size = _added(size, np.abs(slope), terms)
        self._values[to] = value
        self._changes[to] = change
        self._sizes[to] = size

    def _watch(self, operands: list[int], given: list[np.ndarray]) -> None:
        """Take in the distance to the kink where two operands, or one and zero, are the same."""
        rate = np.zeros_like(self.reach)
        size = np.zeros_like(self.reach)
        for register, sign in zip(operands, (1.0, -1.0), strict=False):
            change = self._changes[register]
            terms = self._sizes[register]
            if change is not None and terms is not None:
                rate += sign * change
                size += terms
        margin = np.abs(given[0] - given[1]) if len(given) > 1 else np.abs(given[0])
        rate = np.abs(rate)
        moves = rate > SIGNIFICANT * size
        distances = np.full_like(self.reach, np.inf)
        np.divide(np.broadcast_to(margin[:, None], rate.shape), rate, out=distances, where=moves)
        np.fmin(self.reach, distances, out=self.reach)

    def watch_sign(self, part: int) -> None:
        """Take in the distance to sign changes of the single output of a part."""
        program = self._program
        register = int(program.outputs[program.output_ends[part] - 1])
        self._watch([register], [self._values[register]])

    def outputs(self, part: int) -> tuple[np.ndarray, np.ndarray]:
        """Values, (k, n), and derivatives, (k, n, K), of the outputs of a part that was run."""
        program = self._program
        registers = program.outputs[
            program.output_ends[part - 1] if part else 0 : program.output_ends[part]
        ].tolist()
        zero = np.zeros_like(self.reach)
        changes = [
            zero if self._changes[register] is None else self._changes[register]
            for register in registers
        ]
        points, ways = self.reach.shape
        values = np.array([self._values[register] for register in registers]).reshape(
            len(registers), points
        )
        return values, np.array(changes).reshape(len(registers), points, ways)


def _added(total: np.ndarray | None, slope: np.ndarray | float, change: np.ndarray) -> np.ndarray:
    """A sum and a slope, (n,) or a number, times a change, (n, K).

    No change stays none under an infinite slope.
    """
    if not isinstance(slope, np.ndarray):
        product = change if slope == 1.0 else slope * change
    else:
        product = np.where(change == 0, 0.0, slope[:, None] * change)
    return product if total is None else total + product
