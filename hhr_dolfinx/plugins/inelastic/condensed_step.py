"""Compiled step of condensed inelastic models: plastic correction g and all contact forces λ, by
Newton's method.

With the elastic response eliminated exactly (see
:mod:`hhr_dolfinx.plugins.inelastic.condensed_flow`), a step is

    ∫ (G V)^T C ε_p(ε) - g = 0,      ε = ε_e + ε_c,      ε_c = E_p g - E_X^T (λ(g) - λ_e),

where λ(g) solves the contact problem with the slack s - B V g + S λ, and λ_e the one without
correction, of strain ε_e. λ is piecewise linear and continuous in g, so that the residual is
continuous and a line search on its norm is meaningful. The few points Z integrate the stress of the
correction in inelastic regions, C (ε_p - dev ε_c). The rest is linear in g and λ, and computed
exactly. Summed over Z, with weights w, that is

    R(g) = sum of w (G V)^T C ε_p - Q g - P (λ - λ_e),
    Q = I - (∫ - sum of w) (G V)^T C dev G V,      P = (∫ - sum of w) (G V)^T C dev G K^-1 B^T,

so that Q and P correct the error of the cubature when ε_p follows dev ε, as in slow creep: the
tangent stays definite there. With Q = I and P = 0 its sign would change with the errors of the
weights. On statuses A, with E_A = E_p - E_X,A^T W and W = S_AA^-1 (B V)_A, the derivative is a sum
over the points with plastic flow,

    J = sum of w (G V)^T C (dε_p/dε) E_A - Q - P_A W,      dε_p/dε = 1 - C^-1 H,

with consistent tangents H. ε_p = ε - C^-1 σ is the inelastic strain of any law, with the elasticity
C of the bodies. The first step of an installation waits for the compiler. It optimises a called
function again for each caller, so calls are few and shallow. Loops are written out: they compile
ten times as fast as expressions of whole arrays.

The sections of this file: arrays of a step and their names (few arguments, since each takes time to
compile), contact forces for one correction, sums over the points, and Newton's method.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hhr_dolfinx.contact.active_set import STATUS_TOLERANCE
from hhr_dolfinx.plugins.inelastic.local_solver import MEMORY, Code, solve_points, subtract
from hhr_dolfinx.plugins.ufl_programs.compiled import compiled

EVALUATE, CONVERGED, STALLED, LIMIT, NOT_FINITE, CONTACT = range(6)
"""Evaluate the laws at the trial point, or the reason to stop."""
ITERATION, MERIT, SHARE, SIZE, COUNT, SWITCHED, LINEAR, NUMBERS = range(8)
"""Indices in ``WorkArrays.numbers``: evaluations of laws, |R| at ``here``, part of the
direction tried, largest |g| so far, active conditions, changes of the inverse; and the state of
J: absent, outdated, or that of ``here``.
"""
NO_TANGENT, OLD_TANGENT, NEW_TANGENT = range(3)


class StepModel(NamedTuple):
    """Arrays of a model at its moduli (n points of c components, ell modes, m conditions, G groups
    of points).
    """

    per_mode: (
        np.ndarray
    )  #: strain of each mode, (ell, c n), by component, so that loops over points vectorise
    tested: np.ndarray  #: weight times the stress C of each, in the moduli of unit energy
    per_force: np.ndarray  #: strain of K^-1 B^T in these moduli, (m, c n)
    scale: np.ndarray  #: factor of the strain of contact forces, (c n,); empty if it is 1
    schur: np.ndarray  #: S, (m, m)
    contact_of_modes: np.ndarray  #: B V, (m, ell)
    modal: np.ndarray  #: Q, (ell, ell)
    coupled: np.ndarray  #: P, (ell, m)
    ends: np.ndarray  #: last point of each group and one, (G,)
    weight: float  #: norm of ``tested``
    single: (
        np.ndarray
    )  #: ``per_mode`` and ``tested`` in single precision, for Newton's matrix, (2, ell, c n)


class StepLoad(NamedTuple):
    """Input of a step."""

    strain: np.ndarray  #: strain without correction and contact forces, (c n,)
    forces: np.ndarray  #: λ_e, (m,)
    slack: np.ndarray  #: slack without correction and contact forces, (m,)
    #: before the step: inelastic strain, its cumulated amount and further variables, (c + 1 + k, n)
    memory: np.ndarray
    dt: float  #: its duration in seconds


class StepLaws(NamedTuple):
    """Laws of the groups, with numbers as constants."""

    code: Code  #: of all laws
    numbers: np.ndarray  #: of the law of each group in ``code``; -1 of an elastic one, (G,)
    constants: np.ndarray  #: E, ν and those of the law of each point, (most, n)
    compliance: np.ndarray  #: C^-1 of each group for the grading 1, (G, c, c)
    grading: np.ndarray  #: factor of C at each point, (n,); empty for 1


class WorkArrays(NamedTuple):
    """Work arrays of a step; ``here`` is the last accepted correction, ``there`` the one that is
    tried.
    """

    here: np.ndarray  #: (ell,), as the next four
    there: np.ndarray
    direction: np.ndarray
    residual: np.ndarray  #: R at ``there``
    left: np.ndarray  #: R at ``here``
    forces: np.ndarray  #: at ``there``, (m,)
    slack: np.ndarray  #: at ``there``, (m,)
    active: np.ndarray  #: its statuses, (m,) bool
    order: np.ndarray  #: active conditions in the order of ``inverse``, (m,)
    inverse: np.ndarray  #: of S_AA in its upper left corner, (m, m)
    rows: np.ndarray  #: E_X,A, (m, c n), with the active conditions first, in this order
    newton: np.ndarray  #: inverse of -J, (ell, ell)
    strain: np.ndarray  #: at ``there``, (c n,)
    stress: np.ndarray  #: at ``there``, (c, n)
    memory: np.ndarray  #: at ``there``, as before the step, (c + 1 + k, n)
    slopes: np.ndarray  #: dε_p/dε at ``here``, (c, c, n), in single precision
    result: np.ndarray  #: of the laws at each point, (n,)
    numbers: np.ndarray  #: iterations and the like, see ``ITERATION``

    @classmethod
    def of(
        cls, modes: int, conditions: int, points: int, components: int, memory: int
    ) -> WorkArrays:
        """Arrays of some sizes, without active conditions.

        Args:
            modes: number of modes.
            conditions: number of contact conditions.
            points: number of points.
            components: components of a strain, 4 or 6.
            memory: rows of the memory.
        """
        # not by shape: two sizes may be the same
        shapes: dict[str, int | tuple[int, ...]] = dict.fromkeys(
            ("here", "there", "direction", "residual", "left"), modes
        )
        shapes |= dict.fromkeys(("forces", "slack"), conditions) | {"newton": (modes, modes)}
        shapes |= {"stress": (components, points), "memory": (memory, points)}
        shapes |= {"strain": components * points, "rows": (conditions, components * points)}
        shapes |= {"inverse": (conditions, conditions), "numbers": NUMBERS}
        arrays = {name: np.zeros(shape) for name, shape in shapes.items()}
        counts = {"order": conditions, "result": points}
        arrays |= {name: np.zeros(count, dtype=np.int64) for name, count in counts.items()}
        arrays |= {"slopes": np.zeros((components, components, points), dtype=np.float32)}
        return cls(**arrays, active=np.zeros(conditions, dtype=bool))


SWITCH_ALL_ITERATIONS = 10
"""Contact iterations that switch all wrong statuses without progress before one is switched at a
time.
"""
UPDATES = 64
"""Updates of the inverse of S_AA after which it is computed again: round-off of as many stays below
1e-12.
"""

COMPILED_STEPS = "steps of condensed flow"
"""Name of the compiled functions, for messages."""


@compiled(dear=COMPILED_STEPS)
def touch(model: StepModel, load: StepLoad, work: WorkArrays) -> bool:
    """Solve for contact forces at ``work.there`` from the present statuses.

    Args:
        model: arrays of the model.
        load: input of the step.
        work: work arrays of the step.

    Returns:
        False if none were found.
    """
    return touched(model, load.slack, work)


@compiled(inner=True)
def touched(model: StepModel, free: np.ndarray, work: WorkArrays) -> bool:
    """Solve as :func:`touch` does, for other compiled functions.

    Args:
        model: arrays of the model.
        free: slack without a correction, (m,).
        work: work arrays of the step.
    """
    slack = work.slack
    for i in range(slack.size):
        slack[i] = free[i]
        for j in range(work.there.size):
            slack[i] -= model.contact_of_modes[i, j] * work.there[j]
    arrays = work.inverse, work.order, work.active, work.rows, work.numbers
    return _search(slack, work.forces, model.schur, model.per_force, *arrays)


@compiled(inner=True)
def _search(
    slack: np.ndarray,
    forces: np.ndarray,
    schur: np.ndarray,
    per_force: np.ndarray,
    inverse: np.ndarray,
    order: np.ndarray,
    active: np.ndarray,
    rows: np.ndarray,
    numbers: np.ndarray,
) -> bool:
    """Solve for the forces under a slack and their statuses.

    All wrong statuses are switched at once as long as that brings progress, then the first wrong
    one alone, which solves P-matrices in finitely many steps (Murty 1974; Júdice and Pires 1994).
    With dependent rows the present statuses may lead to a dead end; the search then begins once
    more with nothing active.
    """
    m = forces.size
    fewest = m + 1
    patience = SWITCH_ALL_ITERATIONS
    local = np.empty(m)
    trial = np.empty(m)
    wrong = np.empty(m, dtype=np.bool_)
    anew = False
    for _ in range(100 * m + 100):
        largest = _forces(slack, forces, trial, local, schur, inverse, order, int(numbers[COUNT]))
        count = _mark(slack, forces, trial, active, largest, wrong)
        if count == 0:
            return bool(np.isfinite(largest))
        if count < fewest:
            fewest = count
            patience = SWITCH_ALL_ITERATIONS
        else:
            patience -= 1
        switched = False
        for i in range(m):
            # skip a condition that depends on active ones
            if wrong[i] and (patience > 0 or not switched):
                if _switch(schur, per_force, inverse, order, active, rows, numbers, i):
                    switched = True
        if not switched:
            if anew:
                return False
            anew = True
            patience = 0
            for i in range(m):
                active[i] = False
            numbers[COUNT] = 0
    return False


@compiled(inner=True)
def _forces(
    slack: np.ndarray,
    forces: np.ndarray,
    found: np.ndarray,
    local: np.ndarray,
    schur: np.ndarray,
    inverse: np.ndarray,
    order: np.ndarray,
    count: int,
) -> float:
    """Compute forces of the active conditions and the slack ``found`` under them.

    Returns the largest force.
    """
    largest = 0.0
    for i in range(forces.size):
        forces[i] = 0.0
        found[i] = slack[i]
    for a in range(count):
        value = 0.0
        for b in range(count):
            value -= inverse[a, b] * slack[order[b]]
        local[a] = value
        forces[order[a]] = value
        largest = max(largest, abs(value))
    for a in range(count):
        value = local[a]
        for i in range(forces.size):
            found[i] += value * schur[order[a], i]
    return largest


@compiled(inner=True)
def _mark(
    slack: np.ndarray,
    forces: np.ndarray,
    found: np.ndarray,
    active: np.ndarray,
    largest: float,
    wrong: np.ndarray,
) -> int:
    """Mark the conditions that pull or overlap by more than round-off; returns their number."""
    through = 0.0
    for i in range(wrong.size):
        through = max(through, abs(slack[i]))
    count = 0
    for i in range(wrong.size):
        if active[i]:
            wrong[i] = forces[i] < -STATUS_TOLERANCE * largest
        else:
            wrong[i] = found[i] < -STATUS_TOLERANCE * through
        count += wrong[i]
    return count


@compiled(inner=True)
def _switch(
    schur: np.ndarray,
    per_force: np.ndarray,
    inverse: np.ndarray,
    order: np.ndarray,
    active: np.ndarray,
    rows: np.ndarray,
    numbers: np.ndarray,
    condition: int,
) -> bool:
    """Change a status and update the inverse of S_AA.

    Returns False and changes nothing if that is singular.
    """
    count = int(numbers[COUNT])
    if active[condition]:
        active[condition] = False
        _leave(inverse, order, rows, condition, count)
        numbers[COUNT] = count - 1
    else:
        # an active condition that the inverse lacks would let bodies overlap from then on
        if not _join(schur, per_force, inverse, order, rows, condition, count):
            return False
        active[condition] = True
        numbers[COUNT] = count + 1
    numbers[SWITCHED] += 1
    if numbers[SWITCHED] > UPDATES:
        numbers[SWITCHED] = 0
        _refresh(schur, inverse, order, int(numbers[COUNT]))
    return True


@compiled(inner=True)
def _join(
    schur: np.ndarray,
    per_force: np.ndarray,
    inverse: np.ndarray,
    order: np.ndarray,
    rows: np.ndarray,
    condition: int,
    count: int,
) -> bool:
    """Border the inverse of S_AA by one condition."""
    column = np.zeros(count)
    for a in range(count):
        value = 0.0
        for b in range(count):
            value += inverse[a, b] * schur[condition, order[b]]
        column[a] = value
    pivot = schur[condition, condition]
    for a in range(count):
        pivot -= schur[condition, order[a]] * column[a]
    if not pivot > 1e-14 * schur[condition, condition]:
        return False
    for a in range(count):
        for b in range(count):
            inverse[a, b] += column[a] * column[b] / pivot
        inverse[a, count] = -column[a] / pivot
        inverse[count, a] = -column[a] / pivot
    inverse[count, count] = 1 / pivot
    order[count] = condition
    for k in range(rows.shape[1]):
        rows[count, k] = per_force[condition, k]
    return True


@compiled(inner=True)
def _leave(
    inverse: np.ndarray, order: np.ndarray, rows: np.ndarray, condition: int, count: int
) -> None:
    """Remove one condition from the inverse of S_AA."""
    position = 0
    while order[position] != condition:
        position += 1
    last = count - 1
    if position != last:
        order[position] = order[last]
        for k in range(rows.shape[1]):
            rows[position, k] = rows[last, k]
        for a in range(count):
            inverse[position, a], inverse[last, a] = inverse[last, a], inverse[position, a]
        for a in range(count):
            inverse[a, position], inverse[a, last] = inverse[a, last], inverse[a, position]
    for a in range(last):
        factor = inverse[a, last] / inverse[last, last]
        for b in range(last):
            inverse[a, b] -= factor * inverse[last, b]


@compiled(inner=True)
def _refresh(schur: np.ndarray, inverse: np.ndarray, order: np.ndarray, count: int) -> None:
    """Compute the inverse of S_AA from S."""
    if count == 0:
        return
    block = np.empty((count, count))
    for a in range(count):
        for b in range(count):
            block[a, b] = schur[order[a], order[b]]
    inverted = _inverse_of(block)
    for a in range(count):
        for b in range(count):
            inverse[a, b] = inverted[a, b]


@compiled(inner=True)
def _inverse_of(matrix: np.ndarray) -> np.ndarray:
    """The inverse of a matrix; LinAlgError for a singular one."""
    return np.linalg.inv(matrix)


ANY_ORDER = {"reassoc", "contract"}
"""Sums in any order, so that they vectorise; non-finite values stay so."""


@compiled(inner=True, fastmath=ANY_ORDER)
def _set_strain(
    strain: np.ndarray,
    free: np.ndarray,
    forces: np.ndarray,
    order: np.ndarray,
    count: int,
    rows: np.ndarray,
    scale: np.ndarray,
    there: np.ndarray,
    per_mode: np.ndarray,
) -> None:
    """Compute the strain that the laws see, at ``there`` under the forces there."""
    for k in range(strain.size):
        strain[k] = 0.0
    for a in range(count):
        force = forces[order[a]]
        for k in range(strain.size):
            strain[k] -= force * rows[a, k]
    for k in range(scale.size):
        strain[k] *= scale[k]
    for k in range(strain.size):
        strain[k] += free[k]
    for j in range(there.size):
        share = there[j]
        for k in range(strain.size):
            strain[k] += share * per_mode[j, k]


@compiled(inner=True)
def _evaluate(
    ends: np.ndarray, load: StepLoad, laws: StepLaws, work: WorkArrays, tangent: bool
) -> None:
    """Evaluate the laws at the strain in ``work``: stress, memory, and with ``tangent`` slopes of
    inelastic strain.
    """
    components, points = work.stress.shape
    strain = work.strain.reshape((components, points))
    tangents = np.empty((components, components, points if tangent else 0))
    start = 0
    for group in range(ends.size):
        end = ends[group]
        law = laws.numbers[group]
        if law >= 0:  # else memory and slopes stay 0
            numbers = laws.constants, laws.compliance[group], laws.grading
            results = work.stress, work.memory, tangents, work.result
            solve_points(
                laws.code, law, start, end, strain, load.memory, load.dt, *numbers, *results
            )
            for i in range(laws.code.sizes[law, MEMORY], len(work.memory)):
                work.memory[i, start:end] = load.memory[i, start:end]
            if tangent:
                _store_slopes(work.slopes, tangents, numbers[1], laws.grading, start, end)
        start = end


@compiled(inner=True)
def _store_slopes(
    slopes: np.ndarray,
    tangents: np.ndarray,
    compliance: np.ndarray,
    grading: np.ndarray,
    start: int,
    end: int,
) -> None:
    """1 - C^-1 H at the points of a group."""
    for i in range(len(compliance)):
        for j in range(len(compliance)):
            to = slopes[i, j, start:end]
            to[:] = 1.0 if i == j else 0.0
            for m in range(len(compliance)):
                share = compliance[i, m]
                if share != 0.0:
                    subtract(share, tangents[m, j, start:end], grading[start:end], to)


@compiled(inner=True)
def _flows(memory: np.ndarray, old: np.ndarray, components: int) -> bool:
    """True if the inelastic strain of any point changes in the step."""
    for i in range(components):
        for k in range(memory.shape[1]):
            if memory[i, k] != old[i, k]:
                return True
    return False


@compiled(inner=True)
def _possible(result: np.ndarray) -> bool:
    """True if all laws have an answer."""
    for k in range(result.size):
        if result[k] != 0:
            return False
    return True


@compiled(inner=True, fastmath=ANY_ORDER)
def _set_residual(
    tested: np.ndarray,
    memory: np.ndarray,
    components: int,
    modal: np.ndarray,
    there: np.ndarray,
    coupled: np.ndarray,
    forces: np.ndarray,
    elastic: np.ndarray,
    residual: np.ndarray,
) -> float:
    """Compute R; returns the sum of its entries, which is finite if all are."""
    flat = memory[:components].reshape(-1)
    total = 0.0
    for j in range(residual.size):
        value = 0.0
        for k in range(flat.size):
            value += tested[j, k] * flat[k]
        for i in range(there.size):
            value -= modal[j, i] * there[i]
        for i in range(forces.size):
            value -= coupled[j, i] * (forces[i] - elastic[i])
        residual[j] = value
        total += value
    return total


@compiled(inner=True, fastmath=ANY_ORDER)
def _flowing_of(tested: np.ndarray, slopes: np.ndarray) -> np.ndarray:
    """w (G V)^T C dε_p/dε, (ell, c n)."""
    # indices that are no sums, as loops over others do not vectorise
    weights = tested.reshape((len(tested), len(slopes), slopes.shape[2]))
    products = np.empty(weights.shape, dtype=np.float32)
    total = np.empty(slopes.shape[2], dtype=np.float32)
    for j in range(len(products)):
        for i in range(len(slopes)):
            total[:] = 0.0
            for m in range(len(slopes)):
                for k in range(total.size):
                    total[k] += weights[j, m, k] * slopes[m, i, k]
            for k in range(total.size):
                products[j, i, k] = total[k]
    return products.reshape(tested.shape)


LEAST_NEWTON_SHARE = 1 / 256
"""Smallest part of a Newton step that the line search tries."""
DECREASE = 1e-4
"""Least part of the decrease of |R| predicted by the linear model that a step must bring
(Armijo).
"""
TERMS_ROUND_OFF = 1e-14
"""Part of the terms of the residual that counts as round-off."""
SLOW = 0.35
"""Factor by which |R| must fall in each iteration for an outdated J to be kept."""


@compiled(dear=COMPILED_STEPS)
def solve(
    model: StepModel, load: StepLoad, work: WorkArrays, laws: StepLaws, tolerance: float, most: int
) -> int:
    """Solve a step from the correction in ``work.there`` and the statuses in ``work``.

    Args:
        model: arrays of the model.
        load: input of the step.
        work: work arrays of the step.
        laws: laws of the groups of points.
        tolerance: tolerance of |R| over the size of the correction.
        most: limit of the evaluations of the laws.
    """
    numbers = work.numbers
    numbers[ITERATION] = 0.0
    numbers[SHARE] = 1.0
    numbers[MERIT] = np.inf
    numbers[LINEAR] = min(numbers[LINEAR], OLD_TANGENT)
    code = EVALUATE
    while code == EVALUATE:
        if not touched(model, load.slack, work):
            return CONTACT
        active = work.forces, work.order, int(numbers[COUNT]), work.rows
        _set_strain(work.strain, load.strain, *active, model.scale, work.there, model.per_mode)
        _evaluate(model.ends, load, laws, work, False)
        code = _judge(model, load, work, laws, tolerance, most)
    return code


@compiled(inner=True)
def _judge(
    model: StepModel, load: StepLoad, work: WorkArrays, laws: StepLaws, tolerance: float, most: int
) -> int:
    numbers = work.numbers
    numbers[ITERATION] += 1
    first = numbers[MERIT] == np.inf
    if first:
        # the residual of a correction as small as this is round-off, as when the first point is
        # about to yield
        numbers[SIZE] = max(
            numbers[SIZE], TERMS_ROUND_OFF * model.weight * _norm(work.strain) / tolerance
        )
    fine = _possible(work.result)
    if fine:
        coupling = model.coupled, work.forces, load.forces
        tested = model.tested, work.memory, work.stress.shape[0]
        total = _set_residual(*tested, model.modal, work.there, *coupling, work.residual)
        fine = bool(np.isfinite(total))
    if not fine:
        # the correction is too large: a law has no answer there
        return NOT_FINITE if first else _nearer(work, most)
    merit = _norm(work.residual)
    solved = merit <= tolerance * max(_norm(work.there), numbers[SIZE])
    if not (solved or first or merit <= (1 - DECREASE * numbers[SHARE]) * numbers[MERIT]):
        return _nearer(work, most)
    slow = merit > SLOW * numbers[MERIT]
    if not first:
        _learn(work.there, work.here, work.newton, work.left, work.residual)
    for j in range(work.here.size):
        work.here[j] = work.there[j]
        work.left[j] = work.residual[j]
    numbers[MERIT] = merit
    if solved:
        return CONVERGED
    if numbers[ITERATION] >= most:
        return LIMIT
    if numbers[LINEAR] == NO_TANGENT or (slow and not first):
        if not _linearise(model, load, work, laws):
            return STALLED
    else:
        numbers[LINEAR] = OLD_TANGENT
    return _go(work)


@compiled(inner=True, fastmath=ANY_ORDER)
def _norm(values: np.ndarray) -> float:
    total = 0.0
    for value in values:
        total += value * value
    return np.sqrt(total)


@compiled(inner=True)
def _learn(
    there: np.ndarray, here: np.ndarray, newton: np.ndarray, left: np.ndarray, residual: np.ndarray
) -> None:
    """Update the inverse of -J by the step just made (Broyden 1965, the first of his updates)."""
    ell = here.size
    missed = np.empty(ell)
    turned = np.zeros(ell)
    along = 0.0
    length = 0.0
    for i in range(ell):
        step = there[i] - here[i]
        answered = 0.0
        for j in range(ell):
            answered += newton[i, j] * (left[j] - residual[j])
            turned[j] += step * newton[i, j]
        missed[i] = step - answered
        along += step * answered
        length += step * step
    if abs(along) > 0.1 * length:
        for i in range(ell):
            for j in range(ell):
                newton[i, j] += missed[i] * turned[j] / along


@compiled(inner=True)
def _go(work: WorkArrays) -> int:
    """Make a full Newton step from ``here``."""
    total = 0.0
    for i in range(work.here.size):
        value = 0.0
        for j in range(work.here.size):
            value += work.newton[i, j] * work.left[j]
        work.direction[i] = value
        work.there[i] = work.here[i] + value
        total += value
    work.numbers[SHARE] = 1.0
    return EVALUATE if np.isfinite(total) else STALLED


@compiled(inner=True)
def _nearer(work: WorkArrays, most: int) -> int:
    """Recompute J at ``here`` if it is outdated; otherwise halve the step."""
    numbers = work.numbers
    if numbers[ITERATION] >= most:
        return LIMIT
    if numbers[LINEAR] == OLD_TANGENT:
        # the values of the laws at ``here`` were overwritten: evaluate them again
        numbers[LINEAR] = NO_TANGENT
        numbers[MERIT] = np.inf
        for j in range(work.here.size):
            work.there[j] = work.here[j]
        return EVALUATE
    numbers[SHARE] *= 0.5
    if numbers[SHARE] < LEAST_NEWTON_SHARE:
        return STALLED
    for j in range(work.here.size):
        work.there[j] = work.here[j] + numbers[SHARE] * work.direction[j]
    return EVALUATE


@compiled(inner=True)
def _linearise(model: StepModel, load: StepLoad, work: WorkArrays, laws: StepLaws) -> bool:
    """Compute the inverse of -J at ``work.here`` from laws, strain and statuses there.

    Returns False if J is singular.

    The plastic part is in single precision: an inaccurate J costs iterations at most, not accuracy.
    """
    count = int(work.numbers[COUNT])
    ell = work.here.size
    responses = np.empty((count, ell))
    coupled = np.empty((ell, count))
    inverse = np.empty((count, count))
    for a in range(count):
        for j in range(ell):
            responses[a, j] = model.contact_of_modes[work.order[a], j]
            coupled[j, a] = model.coupled[j, work.order[a]]
        for b in range(count):
            inverse[a, b] = work.inverse[a, b]
    # W
    responses = np.dot(inverse, responses)
    jacobian = np.dot(coupled, responses)
    for i in range(ell):
        for j in range(ell):
            jacobian[i, j] += model.modal[i, j]
    if _flows(work.memory, load.memory, work.stress.shape[0]):
        _evaluate(model.ends, load, laws, work, True)
        _add_flowing(model, work, responses, jacobian)
    inverted = _inverse_of(jacobian)
    total = 0.0
    for i in range(ell):
        for j in range(ell):
            work.newton[i, j] = inverted[i, j]
            total += inverted[i, j]
    # a singular J marked as outdated would stop all steps to come
    regular = bool(np.isfinite(total))
    work.numbers[LINEAR] = NEW_TANGENT if regular else NO_TANGENT
    return regular


@compiled(inner=True)
def _add_flowing(
    model: StepModel, work: WorkArrays, responses: np.ndarray, jacobian: np.ndarray
) -> None:
    """Add the plastic part of -J, by W."""
    count, ell = responses.shape
    flowing = _flowing_of(model.single[1], work.slopes)
    direct = np.dot(flowing, model.single[0].T)
    for j in range(ell):
        for k in range(model.scale.size):
            flowing[j, k] *= model.scale[k]
    rows = np.empty((count, flowing.shape[1]), dtype=np.float32)
    for a in range(count):
        for k in range(flowing.shape[1]):
            rows[a, k] = work.rows[a, k]
    pressed = np.dot(flowing, rows.T)
    for i in range(ell):
        for j in range(ell):
            jacobian[i, j] -= direct[i, j]
        for a in range(count):
            for j in range(ell):
                jacobian[i, j] += pressed[i, a] * responses[a, j]
