"""Contact forces within a compiled step of condensed flow: the statuses for one correction, all loops in one place."""

from __future__ import annotations

import numpy as np

from hhr_dolfinx.compat import compiled
from hhr_dolfinx.models.condensed_arrays import COUNT, SWITCHED, StepLoad, StepModel, Work

PATIENCE = 10
"""Contact solutions that switch all wrong statuses without getting nearer before one is switched at a time."""
UPDATES = 64
"""Changes of the inverse of S_AA after which it is made anew: round-off of as many stays below 1e-12."""
TOLERANCE = 1e-11
"""Negative forces and slacks below this part of the largest are round-off, as in :mod:`contact.active_set`."""

STEP = "steps of condensed flow"
"""What takes long to compile."""


@compiled(dear=STEP)
def touch(model: StepModel, load: StepLoad, work: Work) -> bool:
    """Contact forces at ``work.there``, from the statuses at hand; whether they were found."""
    return touched(model, load.slack, work)


@compiled(inner=True)
def touched(model: StepModel, free: np.ndarray, work: Work) -> bool:
    """See :func:`touch`: from the slack without a correction, for other compiled functions."""
    slack = work.slack
    for i in range(slack.size):
        slack[i] = free[i]
        for j in range(work.there.size):
            slack[i] -= model.moved[i, j] * work.there[j]
    arrays = work.inverse, work.order, work.active, work.rows, work.numbers
    return _search(slack, work.forces, model.schur, model.per_force, *arrays)


@compiled(inner=True)
def _search(slack, forces, schur, per_force, inverse, order, active, rows, numbers):
    """Forces under a slack and their statuses.

    All wrong statuses are switched at once as long as that leads nearer, then the first wrong one alone, by which a
    P-matrix is solved in finitely many steps (Murty 1974; Júdice and Pires 1994). Where rows are dependent the
    statuses at hand may leave no way on: the search then begins once more with nothing active.
    """
    m = forces.size
    fewest = m + 1
    patience = PATIENCE
    local, found = np.empty(m), np.empty(m)
    wrong = np.empty(m, dtype=np.bool_)
    anew = False
    for _ in range(100 * m + 100):
        largest = _forces(slack, forces, found, local, schur, inverse, order, int(numbers[COUNT]))
        count = _mark(slack, forces, found, active, largest, wrong)
        if count == 0:
            return bool(np.isfinite(largest))
        if count < fewest:
            fewest = count
            patience = PATIENCE
        else:
            patience -= 1
        switched = False
        for i in range(m):
            # a condition that depends on active ones is passed over
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
def _forces(slack, forces, found, local, schur, inverse, order, count):
    """Forces of the active conditions, the slack ``found`` under them, and the largest one."""
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
def _mark(slack, forces, found, active, largest, wrong):
    """Mark the conditions that pull or overlap by more than round-off; how many there are."""
    through = 0.0
    for i in range(wrong.size):
        through = max(through, abs(slack[i]))
    count = 0
    for i in range(wrong.size):
        if active[i]:
            wrong[i] = forces[i] < -TOLERANCE * largest
        else:
            wrong[i] = found[i] < -TOLERANCE * through
        count += wrong[i]
    return count


@compiled(inner=True)
def _switch(schur, per_force, inverse, order, active, rows, numbers, condition):
    """Change a status, and with it the inverse of S_AA; whether that is regular, else all stays as it is."""
    count = int(numbers[COUNT])
    if active[condition]:
        active[condition] = False
        _leave(inverse, order, rows, condition, count)
        numbers[COUNT] = count - 1
    else:
        # one that is called active without a place in the inverse would let bodies overlap from then on
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
def _join(schur, per_force, inverse, order, rows, condition, count):
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
def _leave(inverse, order, rows, condition, count):
    """Take one condition out of the inverse of S_AA."""
    place = 0
    while order[place] != condition:
        place += 1
    last = count - 1
    if place != last:
        order[place] = order[last]
        for k in range(rows.shape[1]):
            rows[place, k] = rows[last, k]
        for a in range(count):
            inverse[place, a], inverse[last, a] = inverse[last, a], inverse[place, a]
        for a in range(count):
            inverse[a, place], inverse[a, last] = inverse[a, last], inverse[a, place]
    for a in range(last):
        factor = inverse[a, last] / inverse[last, last]
        for b in range(last):
            inverse[a, b] -= factor * inverse[last, b]


@compiled(inner=True)
def _refresh(schur, inverse, order, count):
    """The inverse of S_AA from S."""
    if count == 0:
        return
    block = np.empty((count, count))
    for a in range(count):
        for b in range(count):
            block[a, b] = schur[order[a], order[b]]
    found = inverse_of(block)
    for a in range(count):
        for b in range(count):
            inverse[a, b] = found[a, b]


@compiled(inner=True)
def inverse_of(matrix: np.ndarray) -> np.ndarray:
    """The inverse of a matrix; LinAlgError for a singular one."""
    return np.linalg.inv(matrix)
