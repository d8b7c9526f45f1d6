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


@compiled()
def touch(model: StepModel, load: StepLoad, work: Work) -> bool:
    """Contact forces at ``work.there``, from the statuses at hand; whether they were found.

    All wrong statuses are switched at once as long as that leads nearer, then the first wrong one alone, by which a
    P-matrix is solved in finitely many steps (Murty 1974; Júdice and Pires 1994). Where rows are dependent the
    statuses at hand may leave no way on: the search then begins once more with nothing active.
    """
    m = work.forces.size
    slack = work.slack
    slack[:] = load.slack - np.dot(model.moved, work.there)
    fewest = m + 1
    patience = PATIENCE
    local = np.empty(m)
    wrong = np.empty(m, dtype=np.bool_)
    anew = False
    for _ in range(100 * m + 100):
        active = int(work.numbers[COUNT])
        order = work.order
        work.forces[:] = 0.0
        largest = 0.0
        for a in range(active):
            value = 0.0
            for b in range(active):
                value -= work.inverse[a, b] * slack[order[b]]
            local[a] = value
            work.forces[order[a]] = value
            largest = max(largest, abs(value))
        found = slack.copy()
        for a in range(active):
            row = model.schur[order[a]]
            value = local[a]
            for i in range(m):
                found[i] += value * row[i]
        count = _mark(work, found, largest, wrong)
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
            if wrong[i] and (patience > 0 or not switched) and _switch(model, work, i):
                switched = True
        if not switched:
            if anew:
                return False
            anew = True
            patience = 0
            work.active[:] = False
            work.numbers[COUNT] = 0
    return False


@compiled()
def _mark(work, found, largest, wrong):
    """Mark the conditions that pull or overlap by more than round-off; how many there are."""
    through = 0.0
    for i in range(wrong.size):
        through = max(through, abs(work.slack[i]))
    count = 0
    for i in range(wrong.size):
        if work.active[i]:
            wrong[i] = work.forces[i] < -TOLERANCE * largest
        else:
            wrong[i] = found[i] < -TOLERANCE * through
        count += wrong[i]
    return count


@compiled()
def _switch(model, work, condition):
    """Change a status, and with it the inverse of S_AA; whether that is regular, else all stays as it is."""
    numbers = work.numbers
    count = int(numbers[COUNT])
    if work.active[condition]:
        work.active[condition] = False
        _leave(work, condition, count)
        numbers[COUNT] = count - 1
    else:
        # one that is called active without a place in the inverse would let bodies overlap from then on
        if not _join(model, work, condition, count):
            return False
        work.active[condition] = True
        numbers[COUNT] = count + 1
    numbers[SWITCHED] += 1
    if numbers[SWITCHED] > UPDATES:
        _refresh(model, work)
    return True


@compiled()
def _join(model, work, condition, count):
    """Border the inverse of S_AA by one condition."""
    inverse = work.inverse
    order = work.order
    column = np.zeros(count)
    row = model.schur[condition]
    for a in range(count):
        value = 0.0
        for b in range(count):
            value += inverse[a, b] * row[order[b]]
        column[a] = value
    pivot = row[condition]
    for a in range(count):
        pivot -= row[order[a]] * column[a]
    if not pivot > 1e-14 * row[condition]:
        return False
    for a in range(count):
        for b in range(count):
            inverse[a, b] += column[a] * column[b] / pivot
        inverse[a, count] = -column[a] / pivot
        inverse[count, a] = -column[a] / pivot
    inverse[count, count] = 1 / pivot
    order[count] = condition
    work.rows[count] = model.per_force[condition]
    return True


@compiled()
def _leave(work, condition, count):
    """Take one condition out of the inverse of S_AA."""
    inverse = work.inverse
    order = work.order
    place = 0
    while order[place] != condition:
        place += 1
    last = count - 1
    if place != last:
        order[place] = order[last]
        work.rows[place] = work.rows[last]
        for a in range(count):
            inverse[place, a], inverse[last, a] = inverse[last, a], inverse[place, a]
        for a in range(count):
            inverse[a, place], inverse[a, last] = inverse[a, last], inverse[a, place]
    for a in range(last):
        factor = inverse[a, last] / inverse[last, last]
        for b in range(last):
            inverse[a, b] -= factor * inverse[last, b]


@compiled()
def _refresh(model, work):
    """The inverse of S_AA from S."""
    count = int(work.numbers[COUNT])
    order = work.order[:count]
    work.numbers[SWITCHED] = 0
    if count:
        work.inverse[:count, :count] = np.linalg.inv(model.schur[order][:, order])
