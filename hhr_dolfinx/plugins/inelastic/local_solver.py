"""Unknowns of laws at many points: Newton's method, compiled once for all laws.

A point is solved when a step changes each unknown by less than :data:`DONE` of the largest unknown
of its kind, and that step was made: what is left is its square. A residual has a unit and says
nothing of the unknown. A slope dr/dy that is infinite or NaN, as of p^n with n < 1 at p = 0, makes
a step of length 0 and solves nothing: the line search rejects such an iterate, and a point that
starts there ends with :data:`NO_SLOPE`. The line search takes Deuflhard's natural test, whether the
last factors make a shorter step of the new residual (Deuflhard 2011, section 3.3): it depends on no
unit either.

Points go through the machine in blocks. In a block all points go on until the last one is solved;
those that are solved, or need no solution, stay as they are.

Arguments of compiled functions, for a block of m points and number ``law`` of the laws in ``code``,
which has c components of strain, u unknowns y and a residual r(y) = 0:

- ``work``: registers of the machine, (registers, m); the first are strain, y, memory, dt, E, ν and
  other constants.
- ``iterate``, ``steps``, ``new``: y, its last accepted Newton step, and the next step or -r, (u,
  m).
- ``factors``, ``pivots``: LU factors of dr/dy, (u, u, m), and rows exchanged, (u, m); later a tuple
  of both and room for (dr/dy)^-1 dr/dε, (c, u, m).
- ``which``: points to work on, (m,), a bool; ``open_``: results, (m,), negative where iterations
  failed.
- ``finite``: points at which all of dr/dy is finite, (m,), a bool.
- ``kinds``: number of the variable that each unknown is a component of, (u,); ``weights``: size of
  each, (u, m).
- ``found``: stress, memory, tangents and results of all n points, see :func:`solve_points`; the
  block has ``count`` of them from number ``first``.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from hhr_dolfinx.plugins.ufl_programs.compiled import compiled
from hhr_dolfinx.plugins.ufl_programs.machine import POINTS_IN_CACHE, run, set_numbers
from hhr_dolfinx.plugins.ufl_programs.program import Program

TRIAL, START, LOCAL, AFTER, SLOPES, REST, REST_SLOPES = range(7)
"""Parts of the program of a law: whether there is something to solve for; first iterate; residual
and its derivatives by the unknowns; stress, memory and limit; their derivatives by strain and
unknowns, and those of the residual by the strain; and both for a point without unknowns.
"""
ITERATIONS = 60
"""Most evaluations of a residual at a point."""
LEAST_LOCAL_SHARE = 1 / 4096
"""Smallest part of a step that the line search tries."""
DONE = 1e-9
STRAIN_ROUND_OFF = 1e-14
"""Part of a strain that counts as its round-off: differences of strains that an equation takes have
some more.
"""
SOLVED, NOT_SOLVED, BEYOND, NO_SLOPE = range(4)
"""Results at a point; ``BEYOND`` is beyond the limit that a law states, ``NO_SLOPE`` has a dr/dy
that is not finite.
"""


class Code(NamedTuple):
    """Programs of G laws one after another, and sizes of their inputs.

    Functions take a law by its number.
    """

    rows: np.ndarray
    numbers: np.ndarray
    outputs: np.ndarray
    starts: np.ndarray  #: of each part in ``rows``, (G, 7), as the next
    ends: np.ndarray
    output_starts: np.ndarray  #: of each part in ``outputs``, (G, 7)
    output_ends: np.ndarray
    number_ends: np.ndarray  #: in ``numbers``, (G + 1,)
    sizes: np.ndarray  #: see below, (G, 6)
    kinds: np.ndarray  #: of each unknown, (G, most unknowns)


STRAINS, UNKNOWNS, MEMORY, CONSTANTS, REGISTERS, LIMITED = range(6)
"""Columns of ``sizes``: components of strain, unknowns, components of memory, constants, registers.

1 with a limit.
"""


@compiled(inner=True, error_model="numpy")
def _factor(factors: np.ndarray, pivots: np.ndarray, which: np.ndarray) -> None:
    """Replace ``factors``, which hold matrices, by LU factors; a singular one has a pivot 0 or
    NaN.
    """
    size = len(factors)
    for k in range(which.size if size > 1 else 0):
        if not which[k]:
            continue
        for i in range(size):
            best = i
            for j in range(i + 1, size):
                if abs(factors[j, i, k]) > abs(factors[best, i, k]):
                    best = j
            pivots[i, k] = best
            if best != i:
                for j in range(size):
                    factors[i, j, k], factors[best, j, k] = factors[best, j, k], factors[i, j, k]
            for j in range(i + 1, size):
                share = factors[j, i, k] / factors[i, i, k]
                factors[j, i, k] = share
                for m in range(i + 1, size):
                    factors[j, m, k] -= share * factors[i, m, k]


@compiled(inner=True, error_model="numpy")
def _solve(factors: np.ndarray, pivots: np.ndarray, which: np.ndarray, vectors: np.ndarray) -> None:
    """Replace right-hand sides ``vectors``, (u, m), by solutions with LU factors."""
    size = len(factors)
    if size == 1:
        for k in range(which.size):
            if which[k]:
                vectors[0, k] /= factors[0, 0, k]
        return
    for k in range(which.size):
        if not which[k]:
            continue
        for i in range(size):
            pivot = pivots[i, k]
            vectors[i, k], vectors[pivot, k] = vectors[pivot, k], vectors[i, k]
        for i in range(1, size):
            for j in range(i):
                vectors[i, k] -= factors[i, j, k] * vectors[j, k]
        for i in range(size - 1, -1, -1):
            for j in range(i + 1, size):
                vectors[i, k] -= factors[i, j, k] * vectors[j, k]
            vectors[i, k] /= factors[i, i, k]


@compiled(inner=True, error_model="numpy")
def _measure(
    steps: np.ndarray, weights: np.ndarray, kinds: np.ndarray, lengths: np.ndarray
) -> None:
    """Set ``lengths``, (m,): largest change of an unknown relative to its kind.

    Infinite if a step is not finite.
    """
    for k in range(lengths.size):
        lengths[k] = 0.0
    for i in range(kinds.size):
        kind = kinds[i]
        for k in range(lengths.size):
            length = abs(steps[i, k]) / weights[kind, k] if steps[i, k] != 0.0 else 0.0
            lengths[k] = max(lengths[k], length if length < np.inf else np.inf)  # NaN too


@compiled(inner=True, error_model="numpy")
def _newton(
    code: Code, law: int, work: np.ndarray, open_: np.ndarray,
    factors: np.ndarray, pivots: np.ndarray,
) -> None:  # fmt: skip
    """Solve for y, in ``work``, at points that are not solved.

    ``open_`` becomes the result at each.
    """
    strains = code.sizes[law, STRAINS]
    size = code.sizes[law, UNKNOWNS]
    kinds = code.kinds[law, :size]
    count = open_.size
    iterate = np.zeros((size, count))
    steps = np.zeros((size, count))
    new = np.zeros((size, count))
    weights = np.ones((size, count))
    last = np.full(count, np.inf)
    length = np.zeros(count)
    share = np.ones(count)
    chosen = np.zeros(count, dtype=np.bool_)
    finite = np.zeros(count, dtype=np.bool_)
    outputs = code.outputs[code.output_starts[law, LOCAL] :]
    for iteration in range(ITERATIONS):
        pending = 0
        for k in range(count):
            chosen[k] = open_[k] == NOT_SOLVED
            pending += chosen[k]
        if pending == 0:
            return
        run(code.rows, code.starts[law, LOCAL], code.ends[law, LOCAL], work)
        _mark_finite(outputs[size:], work, size * size, finite)
        if iteration > 0:
            _negate(outputs, work, chosen, new)
            _solve(factors, pivots, chosen, new)
            _measure(new, weights, kinds, length)
            for k in range(count):
                accepted = finite[k] and length[k] <= (1 - 0.25 * share[k]) * last[k]
                if chosen[k] and not accepted and share[k] > LEAST_LOCAL_SHARE:
                    share[k] *= 0.5
                    chosen[k] = False
                    for i in range(size):
                        work[strains + i, k] = iterate[i, k] + share[k] * steps[i, k]
        _linearise(outputs, work, strains, chosen, factors, iterate)
        _negate(outputs, work, chosen, new)
        _factor(factors, pivots, chosen)
        _solve(factors, pivots, chosen, new)
        _weigh(iterate, new, chosen, kinds, weights)
        _measure(new, weights, kinds, length)
        for i in range(size):
            for k in range(count):
                if chosen[k]:
                    steps[i, k] = new[i, k]
                    work[strains + i, k] = iterate[i, k] + new[i, k]
        for k in range(count):
            if chosen[k]:
                share[k] = 1.0
                last[k] = length[k]
                if not finite[k]:
                    open_[k] = -NO_SLOPE  # no more iterations, as after the next one
                elif not length[k] < np.inf:
                    open_[k] = -NOT_SOLVED
                elif length[k] <= DONE:
                    open_[k] = SOLVED
    _settle(code, law, work, open_, factors, pivots, iterate, steps)


@compiled(inner=True, error_model="numpy")
def _settle(
    code: Code,
    law: int,
    work: np.ndarray,
    open_: np.ndarray,
    factors: np.ndarray,
    pivots: np.ndarray,
    iterate: np.ndarray,
    steps: np.ndarray,
) -> None:
    """Take points as solved whose steps are as small as a change of the strain by round-off makes
    them.

    Where a point is just about to yield, its flow is such a change, and the steps are never small
    beside it.
    """
    strains = code.sizes[law, STRAINS]
    size = len(iterate)
    for i in range(size):
        for k in range(open_.size):
            if open_[k] == NOT_SOLVED:
                work[strains + i, k] = iterate[i, k] + steps[i, k]
    run(code.rows, code.starts[law, AFTER], code.ends[law, SLOPES], work)
    first = code.output_starts[law, SLOPES] + strains * (strains + size)
    which = open_ == NOT_SOLVED
    column = np.zeros((size, open_.size))
    noise = np.zeros((size, open_.size))
    for j in range(strains):
        for i in range(size):
            row = code.outputs[first + i * strains + j]
            for k in range(open_.size):
                column[i, k] = work[row, k]
        _solve(factors, pivots, which, column)
        noise += np.abs(column)
    for k in range(open_.size):
        if which[k]:
            scale = 0.0
            for i in range(strains):
                scale = max(scale, abs(work[i, k]), abs(work[strains + size + i, k]))
            small = True
            for i in range(size):
                small = small and abs(steps[i, k]) <= STRAIN_ROUND_OFF * scale * noise[i, k]
            if small:
                open_[k] = SOLVED


@compiled(inner=True)
def _mark_finite(outputs: np.ndarray, work: np.ndarray, count: int, finite: np.ndarray) -> None:
    """Set ``finite``: true at points where ``count`` outputs of the last run are all finite."""
    finite[:] = True
    for i in range(count):
        row = work[outputs[i]]
        for k in range(finite.size):
            finite[k] = finite[k] and abs(row[k]) < np.inf


@compiled(inner=True)
def _negate(outputs: np.ndarray, work: np.ndarray, which: np.ndarray, new: np.ndarray) -> None:
    """Set ``new`` to -r, which the last run of the machine computed."""
    for i in range(len(new)):
        row = work[outputs[i]]
        for k in range(which.size):
            if which[k]:
                new[i, k] = -row[k]


@compiled(inner=True)
def _linearise(
    outputs: np.ndarray,
    work: np.ndarray,
    strains: int,
    which: np.ndarray,
    factors: np.ndarray,
    iterate: np.ndarray,
) -> None:
    """Set ``factors`` to dr/dy of the last run, and ``iterate`` to its y."""
    size = len(iterate)
    for i in range(size):
        for k in range(which.size):
            if which[k]:
                iterate[i, k] = work[strains + i, k]
        for j in range(size):
            row = work[outputs[size + i * size + j]]
            for k in range(which.size):
                if which[k]:
                    factors[i, j, k] = row[k]


@compiled(inner=True)
def _weigh(
    iterate: np.ndarray, new: np.ndarray, which: np.ndarray, kinds: np.ndarray, weights: np.ndarray
) -> None:
    """Set ``weights``: largest unknown or step of each kind."""
    for i in range(kinds.size):
        for k in range(which.size):
            if which[k]:
                weights[i, k] = 0.0
    for i in range(kinds.size):
        kind = kinds[i]
        for k in range(which.size):
            if which[k]:
                weights[kind, k] = max(weights[kind, k], abs(iterate[i, k]), abs(new[i, k]))


@compiled(inner=True)
def _copy(values: np.ndarray, to: np.ndarray) -> None:
    """Copy a row; loops over rows vectorise, and those with sums as indices do not."""
    for k in range(values.size):
        to[k] = values[k]


@compiled(inner=True)
def _load(
    code: Code,
    law: int,
    work: np.ndarray,
    first: int,
    count: int,
    strain: np.ndarray,
    old: np.ndarray,
    dt: float,
    constants: np.ndarray,
) -> None:
    """Set the inputs of a block from those of :func:`solve_points`.

    Points after the last one repeat it.
    """
    strains = code.sizes[law, STRAINS]
    at_memory = strains + code.sizes[law, UNKNOWNS]
    at_constants = at_memory + code.sizes[law, MEMORY] + 1
    end = at_constants + code.sizes[law, CONSTANTS]
    last = first + count
    for i in range(strains):
        _copy(strain[i, first:last], work[i])
    for i in range(at_memory, at_constants - 1):
        _copy(old[i - at_memory, first:last], work[i])
    work[at_constants - 1] = dt
    for i in range(at_constants, end):
        if constants.shape[1] > 1:
            _copy(constants[i - at_constants, first:last], work[i])
        else:
            work[i] = constants[i - at_constants, 0]
    for i in range(end):
        for k in range(count, work.shape[1]):
            work[i, k] = work[i, count - 1]


@compiled(inner=True)
def _store(
    code: Code,
    law: int,
    work: np.ndarray,
    part: int,
    block: tuple[int, int],
    solved_for: np.ndarray,
    wanted: bool,
    found: tuple[np.ndarray, ...],
) -> None:
    """Store stress, memory and BEYOND at points of a block at which ``solved_for``, (m,), is
    ``wanted``, a bool.
    """
    stress, new, _, result = found
    first, last = block
    outputs = code.outputs[code.output_starts[law, part] :]
    memory = code.sizes[law, MEMORY]
    for i in range(memory):
        to = (stress if i < len(stress) else new)[i, first:last]
        row = work[outputs[i]]
        for k in range(to.size):
            if solved_for[k] == wanted:
                to[k] = row[k]
    if code.sizes[law, LIMITED] and (part == AFTER or code.sizes[law, UNKNOWNS] == 0):
        row = work[outputs[memory]]
        for k in range(last - first):
            if solved_for[k] == wanted and not row[k] >= 0:
                result[first + k] = BEYOND


@compiled(inner=True, error_model="numpy")
def _store_tangents(
    code: Code,
    law: int,
    work: np.ndarray,
    part: int,
    block: tuple[int, int],
    solved_for: np.ndarray,
    wanted: bool,
    tangent: np.ndarray,
    factors: tuple[np.ndarray, ...],
) -> None:
    """Store tangents dσ/dε - dσ/dy (dr/dy)^-1 dr/dε in ``tangent``, (c, c, n), at the points of
    :func:`_store`.
    """
    matrices, pivots, columns = factors
    first, last = block
    strains = code.sizes[law, STRAINS]
    size = code.sizes[law, UNKNOWNS]
    outputs = code.outputs[code.output_starts[law, part] :]
    by_unknown = strains * strains
    of_residual = by_unknown + strains * size
    corrected = size if part == SLOPES else 0
    for j in range(strains if corrected else 0):
        for i in range(size):
            _copy(work[outputs[of_residual + i * strains + j]], columns[j, i])
        _solve(matrices, pivots, solved_for, columns[j])
    for i in range(strains):
        for j in range(strains):
            to = tangent[i, j, first:last]
            row = work[outputs[i * strains + j]]
            for k in range(to.size):
                if solved_for[k] == wanted:
                    to[k] = row[k]
            for a in range(corrected):
                row = work[outputs[by_unknown + i * size + a]]
                for k in range(to.size):
                    if solved_for[k]:
                        to[k] -= row[k] * columns[j, a, k]


@compiled(inner=True)
def _finish(
    code: Code,
    law: int,
    work: np.ndarray,
    part: int,
    block: tuple[int, int],
    solved_for: np.ndarray,
    wanted: bool,
    found: tuple[np.ndarray, ...],
    factors: tuple[np.ndarray, ...],
) -> None:
    """Run :data:`AFTER` or :data:`REST` and store its results at points that were solved for, or at
    the others.
    """
    run(code.rows, code.starts[law, part], code.ends[law, part], work)
    _store(code, law, work, part, block, solved_for, wanted, found)
    tangent = found[2]
    if tangent.size > 0:
        run(code.rows, code.starts[law, part + 1], code.ends[law, part + 1], work)
        _store_tangents(code, law, work, part + 1, block, solved_for, wanted, tangent, factors)


@compiled(inner=True, error_model="numpy")
def _solve_block(
    code: Code,
    law: int,
    work: np.ndarray,
    first: int,
    count: int,
    states: tuple[np.ndarray, np.ndarray],
    found: tuple[np.ndarray, ...],
    factors: tuple[np.ndarray, ...],
) -> None:
    """Solve a block whose inputs are set; ``states`` is room for ``solved_for`` and ``open_``."""
    solved_for, open_ = states
    result = found[3]
    size = code.sizes[law, UNKNOWNS]
    trial = code.output_starts[law, TRIAL]
    tried = code.output_ends[law, TRIAL] > trial
    run(code.rows, code.starts[law, TRIAL], code.ends[law, TRIAL], work)
    active = 0
    for k in range(solved_for.size):
        # NaN is to be solved for, and fails
        solved_for[k] = (
            k < count and size > 0 and (not tried or not work[code.outputs[trial], k] <= 0)
        )
        open_[k] = NOT_SOLVED if solved_for[k] else SOLVED
        active += solved_for[k]
    if active > 0:
        run(code.rows, code.starts[law, START], code.ends[law, START], work)
        for i in range(size):
            register = code.outputs[code.output_starts[law, START] + i]
            for k in range(solved_for.size):
                work[code.sizes[law, STRAINS] + i, k] = work[register, k]
        _newton(code, law, work, open_, factors[0], factors[1])
        _finish(code, law, work, AFTER, (first, first + count), solved_for, True, found, factors)
    for k in range(count):
        result[first + k] = max(result[first + k], abs(open_[k]))
    if active < count:
        _finish(code, law, work, REST, (first, first + count), solved_for, False, found, factors)


@compiled(dear="the update of laws of bodies", error_model="numpy")
def solve_points(
    code: Code,
    law: int,
    start: int,
    end: int,
    strain: np.ndarray,
    old: np.ndarray,
    dt: float,
    constants: np.ndarray,
    compliance: np.ndarray,
    grading: np.ndarray,
    stress: np.ndarray,
    new: np.ndarray,
    tangent: np.ndarray,
    result: np.ndarray,
) -> None:
    """Solve a step of a law at some points.

    Memory and constants may have more rows than the law.

    Args:
        code: programs of laws.
        law: number of the law in ``code``.
        start: first point.
        end: last point and one.
        strain: strain at the end of the step, (c, n).
        old: memory before it, (k, n).
        dt: duration of the step in seconds.
        constants: E, ν and constants, (constants, n), or (constants, 1) if all points share them.
        compliance: C^-1, (c, c), for the grading 1.
        grading: factor of C at each point, (n,); empty for 1.
        stress: set to the stress, (c, n).
        new: set to the memory, (k, n).
        tangent: set to the tangents, (c, c, n); may be empty.
        result: set to :data:`SOLVED` or another code at each point, (n,).
    """
    strains = code.sizes[law, STRAINS]
    size = code.sizes[law, UNKNOWNS]
    blocks = max(
        (end - start + POINTS_IN_CACHE - 1) // POINTS_IN_CACHE, 1
    )  # a rank may have no point of a law
    block = max((end - start + 8 * blocks - 1) // (8 * blocks), 1) * 8
    work = np.empty((code.sizes[law, REGISTERS], block))
    numbers = code.numbers[code.number_ends[law] : code.number_ends[law + 1]]
    set_numbers(
        numbers, strains + size + code.sizes[law, MEMORY] + 1 + code.sizes[law, CONSTANTS], work
    )
    factors = (
        np.empty((size, size, block)),
        np.empty((size, block), dtype=np.int64),
        np.empty((strains, size, block)),
    )
    states = np.zeros(block, dtype=np.bool_), np.zeros(block, dtype=np.int64)
    results = stress, new, tangent, result
    result[start:end] = SOLVED
    for first in range(start, end, block):
        count = min(block, end - first)
        _load(code, law, work, first, count, strain, old, dt, constants)
        _solve_block(code, law, work, first, count, states, results, factors)
    _set_inelastic(start, end, strain, old, (compliance, grading), stress, new)
    for i in range(code.sizes[law, MEMORY]):  # the inelastic strain is NaN if the stress is
        for k in range(start, end):
            if not abs(new[i, k]) < np.inf:
                result[k] = max(result[k], NOT_SOLVED)


@compiled(inner=True)
def subtract(share: float, row: np.ndarray, grading: np.ndarray, to: np.ndarray) -> None:
    """Subtract a share of a row, over the grading if there is any, from another row.

    Args:
        share: factor of the row.
        row: row to subtract, (n,).
        grading: divisor at each point, (n,); empty for 1.
        to: row to change, (n,).
    """
    if grading.size > 0:
        for k in range(to.size):
            to[k] -= share * row[k] / grading[k]
    else:
        for k in range(to.size):
            to[k] -= share * row[k]


@compiled(inner=True)
def _set_inelastic(
    start: int,
    end: int,
    strain: np.ndarray,
    old: np.ndarray,
    elasticity: tuple[np.ndarray, np.ndarray],
    stress: np.ndarray,
    new: np.ndarray,
) -> None:
    """Set the first rows of ``new`` to ε - C^-1 σ, (c, n).

    Where nothing flowed, it does not change by round-off.
    """
    components = len(strain)
    compliance, grading = elasticity
    for i in range(components):
        to = new[i, start:end]
        _copy(strain[i, start:end], to)
        for j in range(components):
            share = compliance[i, j]
            if share != 0.0:
                subtract(share, stress[j, start:end], grading[start:end], to)
    for k in range(start, end):
        if new[components, k] == old[components, k]:
            size = 0.0
            change = 0.0
            for i in range(components):
                size = max(size, abs(strain[i, k]), abs(old[i, k]))
                change = max(change, abs(new[i, k] - old[i, k]))
            if change <= STRAIN_ROUND_OFF * size:
                for i in range(components):
                    new[i, k] = old[i, k]


def code_of(programs: Sequence[tuple[Program, Sequence[int], np.ndarray]]) -> Code:
    """Programs of laws one after another, each with the sizes of :data:`STRAINS` and the kinds of
    its unknowns.
    """
    rows = [program.rows for program, _, _ in programs]
    outputs = [program.outputs for program, _, _ in programs]
    first = np.cumsum([0, *map(len, rows)])
    first_output = np.cumsum([0, *map(len, outputs)])
    ends = np.array([program.ends for program, _, _ in programs]) + first[:-1, None]
    output_ends = (
        np.array([program.output_ends for program, _, _ in programs]) + first_output[:-1, None]
    )
    kinds = np.zeros(
        (len(programs), max(len(unknown_kinds) for _, _, unknown_kinds in programs)), dtype=np.int64
    )
    for row, (_, _, unknown_kinds) in zip(kinds, programs, strict=True):
        row[: len(unknown_kinds)] = unknown_kinds
    arrays = (
        np.vstack(rows),
        np.concatenate([program.numbers for program, _, _ in programs]),
        np.concatenate(outputs),
        np.hstack([first[:-1, None], ends[:, :-1]]),
        ends,
        np.hstack([first_output[:-1, None], output_ends[:, :-1]]),
        output_ends,
        np.cumsum([0, *(len(program.numbers) for program, _, _ in programs)]),
        np.array([sizes for _, sizes, _ in programs], dtype=np.int64),
        kinds,
    )
    return Code(*map(np.ascontiguousarray, arrays))
