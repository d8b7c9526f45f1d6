"""The machine that evaluates programs at many points at once, compiled once for all of them."""

from __future__ import annotations

import numpy as np

from hhr_dolfinx.plugins.ufl_programs.compiled import compiled
from hhr_dolfinx.plugins.ufl_programs.graph import LARGEST_POWER
from hhr_dolfinx.plugins.ufl_programs.program import CODES, Program

POINTS_IN_CACHE = 256
"""Most points that are evaluated together: their registers stay in the cache of the processor."""
BITS = LARGEST_POWER.bit_length()
ADD, SUB, MUL, DIV, NEG = (CODES[name] for name in ("add", "sub", "mul", "div", "neg"))
SQRT, EXP, LOG, POW, ABS = (CODES[name] for name in ("sqrt", "exp", "log", "pow", "abs"))
SIN, COS, TAN, ASIN, ACOS, ATAN = (
    CODES[name] for name in ("sin", "cos", "tan", "asin", "acos", "atan")
)
SINH, COSH, TANH, ATAN2, MAX, MIN = (
    CODES[name] for name in ("sinh", "cosh", "tanh", "atan2", "max", "min")
)
LT, LE, EQ, AND, OR, NOT, SELECT = (
    CODES[name] for name in ("lt", "le", "eq", "and", "or", "not", "select")
)


@compiled(inner=True, error_model="numpy")
def _powers(bases: np.ndarray, exponents: np.ndarray, to: np.ndarray) -> None:
    """Set ``to`` to powers.

    By products, which are quicker, if all exponents are the same small whole number.
    """
    shared = exponents[0]
    same = 0
    for exponent in exponents:
        same += exponent == shared
    if same < to.size or shared != np.floor(shared) or not 0 <= shared <= LARGEST_POWER:
        for k in range(to.size):
            to[k] = bases[k] ** exponents[k]
        return
    for k in range(to.size):
        bits = int(shared)
        square = bases[k]
        result = 1.0
        for _ in range(
            BITS
        ):  # unrolled, and without branches, so that the loop over points vectorises
            result = result * square if bits & 1 else result
            square *= square
            bits >>= 1
        to[k] = result


@compiled(inner=True, error_model="numpy")
def _rare(code: int, x: float, y: float) -> float:
    """Operations that call a function of the C library, and rare ones.

    The former spend most of their time in that function.
    """
    if code == EXP:
        return np.exp(x)
    if code == LOG:
        return np.log(x)
    if code == SIN:
        return np.sin(x)
    if code == COS:
        return np.cos(x)
    if code == TAN:
        return np.tan(x)
    if code == ASIN:
        return np.arcsin(x)
    if code == ACOS:
        return np.arccos(x)
    if code == ATAN:
        return np.arctan(x)
    if code == SINH:
        return np.sinh(x)
    if code == COSH:
        return np.cosh(x)
    if code == TANH:
        return np.tanh(x)
    if code == ATAN2:
        return np.arctan2(x, y)
    if code == ABS:
        return abs(x)
    if code == MAX:
        return max(x, y)
    if code == MIN:
        return min(x, y)
    if code == LE:
        return 1.0 if x <= y else 0.0
    if code == EQ:
        return 1.0 if x == y else 0.0
    if code == AND:
        return 1.0 if x != 0 and y != 0 else 0.0
    if code == OR:
        return 1.0 if x != 0 or y != 0 else 0.0
    return 1.0 if x == 0 else 0.0


@compiled(inner=True, error_model="numpy")
def run(rows: np.ndarray, start: int, end: int, work: np.ndarray) -> None:
    """Execute rows on registers, with inputs and numbers set.

    Args:
        rows: code, result and operands of each, (rows, 5).
        start: first row.
        end: row after the last.
        work: registers, (registers, points).
    """
    count = work.shape[1]
    for row in range(start, end):
        code = rows[row, 0]
        to = rows[row, 1]
        a = rows[row, 2]
        b = rows[row, 3]
        if code == MUL:
            for k in range(count):
                work[to, k] = work[a, k] * work[b, k]
        elif code == ADD:
            for k in range(count):
                work[to, k] = work[a, k] + work[b, k]
        elif code == SUB:
            for k in range(count):
                work[to, k] = work[a, k] - work[b, k]
        elif code == DIV:
            for k in range(count):
                work[to, k] = work[a, k] / work[b, k]
        elif code == NEG:
            for k in range(count):
                work[to, k] = -work[a, k]
        elif code == SQRT:
            for k in range(count):
                work[to, k] = np.sqrt(work[a, k])
        elif code == LT:
            for k in range(count):
                work[to, k] = 1.0 if work[a, k] < work[b, k] else 0.0
        elif code == SELECT:
            c = rows[row, 4]
            for k in range(count):
                yes = work[b, k]  # both are read, so that the loop vectorises
                no = work[c, k]
                work[to, k] = yes if work[a, k] != 0 else no
        elif code == POW:
            _powers(work[a], work[b], work[to])
        else:
            for k in range(count):
                work[to, k] = _rare(code, work[a, k], work[b, k])


@compiled(inner=True)
def set_numbers(numbers: np.ndarray, inputs: int, work: np.ndarray) -> None:
    """Copy constants into the registers after the inputs.

    Args:
        numbers: the constants, (numbers,).
        inputs: number of inputs.
        work: registers, (registers, points).
    """
    for number in range(numbers.size):
        for k in range(work.shape[1]):
            work[inputs + number, k] = numbers[number]


@compiled(error_model="numpy")
def _evaluated(
    rows: np.ndarray,
    spans: np.ndarray,
    numbers: np.ndarray,
    outputs: np.ndarray,
    registers: int,
    given: np.ndarray,
    found: np.ndarray,
):
    inputs, points = given.shape
    work = np.empty((registers, POINTS_IN_CACHE))
    set_numbers(numbers, inputs, work)
    for first in range(0, points, POINTS_IN_CACHE):
        count = min(POINTS_IN_CACHE, points - first)
        for i in range(inputs):
            for k in range(POINTS_IN_CACHE):
                work[i, k] = given[i, first + min(k, count - 1)]
        for span in range(len(spans)):
            run(rows, spans[span, 0], spans[span, 1], work)
        for i in range(outputs.size):
            for k in range(count):
                found[i, first + k] = work[outputs[i], k]


def evaluated(program: Program, given: np.ndarray, *others: int) -> np.ndarray:
    """Outputs of the last of some parts run in turn, (outputs, n).

    Args:
        program: the program.
        given: inputs, (inputs, n).
        others: numbers of the parts; part 0 without any.
    """
    numbers = others or (0,)
    spans = np.array(
        [[program.ends[number - 1] if number else 0, program.ends[number]] for number in numbers]
    )
    first = program.output_ends[numbers[-1] - 1] if numbers[-1] else 0
    outputs = program.outputs[first : program.output_ends[numbers[-1]]]
    values = np.empty((outputs.size, given.shape[1]))
    inputs = np.ascontiguousarray(given, dtype=float)
    _evaluated(program.rows, spans, program.numbers, outputs, program.registers, inputs, values)
    return values
