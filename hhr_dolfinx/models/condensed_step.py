"""One step of condensed flow, compiled: plastic correction g and contact forces λ of all conditions, by Newton's method.

With the elastic response eliminated exactly (see :mod:`hhr_dolfinx.models.condensed_flow`), a step is

    R(g) = sum over Z of w (G V)^T C ε_p(ε) - g = 0,      ε = ε_F + E_p g - E_X^T λ(g) on Z,

where λ(g) solves the contact problem with the slack s - B V g + S λ: piecewise linear and continuous in g, so that R is
continuous and a line search on its norm has a meaning. On statuses A the derivative is

    J = sum w (G V)^T C (dε_p/dε) (E_p - E_X,A^T S_AA^-1 (B V)_A) - I.

Laws are evaluated between two calls of :func:`advance`, those of the package in the same compiled loop, those of a user
in Python.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hhr_dolfinx.compat import compiled
from hhr_dolfinx.materials.compiled_laws import flow_at

EVALUATE, CONVERGED, STALLED, LIMIT, NOT_FINITE, CONTACT = range(6)
"""What :func:`advance` answers: evaluate the laws at the trial point, or why it stopped."""
ITERATION, MERIT, SHARE, SIZE, COUNT, SWITCHED, SOLUTIONS, PROJECTED = range(8)
"""Places of the numbers in ``Work.numbers``."""
LEAST_SHARE = 1 / 256
"""Smallest part of a Newton step that the line search tries."""
DECREASE = 1e-4
"""Part of the decrease of |R| that the linear model promises which a step has to bring (Armijo)."""
PATIENCE = 10
"""Contact solutions that switch all wrong statuses without getting nearer before one is switched at a time."""
UPDATES = 64
"""Changes of the inverse of S_AA after which it is made anew: round-off of as many stays below 1e-12."""
TOLERANCE = 1e-11
"""Negative forces and slacks below this part of the largest are round-off, as in :mod:`contact.active_set`."""


class StepModel(NamedTuple):
    """Arrays of a model at its moduli (n points of c components, ell modes, m conditions, G groups of points).

    Attributes:
        per_mode: strain of each mode, (ell, n c).
        tested: quadrature weight times 2 μ of each, (ell, n c), in the moduli for which modes have unit energy.
        per_force: strain of K^-1 B^T in the moduli for which modes have unit energy, (m, n c).
        schur: S, (m, m).
        moved: B V, (m, ell).
        scale: factor of the strain of contact forces at each point, (n c,).
        ends: last point of each group and one, (G,).
        shear: of each group, (G,).
    """

    per_mode: np.ndarray
    tested: np.ndarray
    per_force: np.ndarray
    schur: np.ndarray
    moved: np.ndarray
    scale: np.ndarray
    ends: np.ndarray
    shear: np.ndarray


class StepLoad(NamedTuple):
    """What a step is given.

    Attributes:
        strain: strain without correction and contact forces, (n c,).
        slack: slack likewise, (m,).
        plastic: plastic strain before the step, (n, c).
        cumulated: cumulated plastic strain before it, (n,).
        dt: its length in seconds.
    """

    strain: np.ndarray
    slack: np.ndarray
    plastic: np.ndarray
    cumulated: np.ndarray
    dt: float


class Work(NamedTuple):
    """What a step works on; ``here`` is the last accepted correction, ``there`` the one that is tried.

    Attributes:
        here, there, direction, residual: (ell,) each.
        forces: of the contact problem at ``there``, (m,).
        active: its statuses, (m,) bool.
        index: active conditions in the order of ``inverse``, (m,).
        inverse: of S_AA in its upper left corner, (m, m).
        linear_active: statuses of ``projected``, (m,) bool.
        projected: E_p - E_X,A^T S_AA^-1 (B V)_A, (ell, n c).
        strain: at ``there``, (n c,).
        deviator: of the trial stress, (n, c).
        trial, amount, slope: equivalent trial stress, flow and its slope, (n,) each.
        plastic: plastic strain at ``there``, (n, c).
        numbers: iterations and the like, see ``ITERATION``.
    """

    here: np.ndarray
    there: np.ndarray
    direction: np.ndarray
    residual: np.ndarray
    forces: np.ndarray
    active: np.ndarray
    index: np.ndarray
    inverse: np.ndarray
    linear_active: np.ndarray
    projected: np.ndarray
    strain: np.ndarray
    deviator: np.ndarray
    trial: np.ndarray
    amount: np.ndarray
    slope: np.ndarray
    plastic: np.ndarray
    numbers: np.ndarray

    @classmethod
    def of(cls, modes: int, conditions: int, points: int, components: int) -> Work:
        """Arrays of these sizes, with nothing active."""
        ell, m, n, c = modes, conditions, points, components
        vectors = [np.zeros(ell) for _ in range(4)]
        contact = np.zeros(m), np.zeros(m, dtype=bool), np.zeros(m, dtype=np.int64), np.zeros((m, m))
        linear = np.zeros(m, dtype=bool), np.zeros((ell, n * c))
        points_ = np.zeros(n * c), np.zeros((n, c)), np.zeros(n), np.zeros(n), np.zeros(n), np.zeros((n, c))
        return cls(*vectors, *contact, *linear, *points_, np.zeros(8))


@compiled()
def solve(model, load, work, kinds, constants, tolerance, most):
    """The whole step, from the correction in ``work.there`` and the statuses in ``work``, by laws of the package.

    ``kinds`` and ``constants`` are those of :mod:`materials.compiled_laws`, (G,) and (G, 2); see :func:`advance`.
    """
    code = begin(model, load, work)
    while code == EVALUATE:
        start = 0
        for group in range(model.ends.size):
            for k in range(start, model.ends[group]):
                flow = flow_at(
                    kinds[group],
                    constants[group, 0],
                    constants[group, 1],
                    work.trial[k],
                    load.cumulated[k],
                    model.shear[group],
                    load.dt,
                )
                work.amount[k] = flow[0]
                work.slope[k] = flow[1]
            start = model.ends[group]
        code = advance(model, load, work, tolerance, most)
    return code


@compiled()
def begin(model, load, work):
    """Prepare the trial stress of the first iterate."""
    work.numbers[ITERATION] = 0.0
    work.numbers[SHARE] = 1.0
    work.numbers[MERIT] = np.inf
    return _try(model, load, work)


@compiled()
def advance(model, load, work, tolerance, most):
    """Take in flows at the trial point, and go on to the next one.

    Args:
        model, load, work: see there.
        tolerance: |R| over the size of the correction at which a step is solved.
        most: evaluations of the laws.
    """
    numbers = work.numbers
    numbers[ITERATION] += 1
    if not _residual(model, load, work):
        # a correction too far off, where nothing is finite: nearer by half
        return _back(model, load, work, most) if numbers[ITERATION] > 1 else NOT_FINITE
    merit = np.sqrt(np.dot(work.residual, work.residual))
    size = np.sqrt(np.dot(work.there, work.there))
    if numbers[ITERATION] > 1 and not merit <= (1 - DECREASE * numbers[SHARE]) * numbers[MERIT]:
        if merit > tolerance * max(size, numbers[SIZE]):
            return _back(model, load, work, most)
    work.here[:] = work.there
    numbers[MERIT] = merit
    if merit <= tolerance * max(size, numbers[SIZE]):
        return CONVERGED
    if numbers[ITERATION] >= most:
        return LIMIT
    if not _newton(model, load, work):
        return STALLED
    numbers[SHARE] = 1.0
    work.there[:] = work.here + work.direction
    return _try(model, load, work)


@compiled()
def _back(model, load, work, most):
    """Half of the part of the direction that was tried last."""
    numbers = work.numbers
    numbers[SHARE] *= 0.5
    if numbers[SHARE] < LEAST_SHARE:
        return STALLED
    if numbers[ITERATION] >= most:
        return LIMIT
    work.there[:] = work.here + numbers[SHARE] * work.direction
    return _try(model, load, work)


@compiled()
def _try(model, load, work):
    """Contact forces, strain and trial stress at ``work.there``."""
    if not touch(model, load, work):
        return CONTACT
    _strain(model, load, work)
    components = load.plastic.shape[1]
    start = 0
    for group in range(model.ends.size):
        twice = 2 * model.shear[group]
        for k in range(start, model.ends[group]):
            first = k * components
            mean = (work.strain[first] + work.strain[first + 1] + work.strain[first + 2]) / 3
            total = 0.0
            for i in range(components):
                value = twice * (work.strain[first + i] - load.plastic[k, i] - (mean if i < 3 else 0.0))
                work.deviator[k, i] = value
                total += value * value
            work.trial[k] = np.sqrt(1.5 * total)
        start = model.ends[group]
    return EVALUATE


@compiled()
def _strain(model, load, work):
    """Strain at ``work.there`` under the forces there."""
    strain = work.strain
    strain[:] = 0.0
    for j in range(work.forces.size):
        force = work.forces[j]
        if force != 0.0:
            row = model.per_force[j]
            for i in range(strain.size):
                strain[i] -= force * row[i]
    strain *= model.scale
    strain += load.strain
    strain += np.dot(work.there, model.per_mode)


@compiled()
def touch(model, load, work):
    """Contact forces at ``work.there``, from the statuses at hand; whether they were found.

    All wrong statuses are switched at once as long as that leads nearer, then the first wrong one alone, by which a
    P-matrix is solved in finitely many steps (Murty 1974; Júdice and Pires 1994).
    """
    m = work.forces.size
    slack = load.slack - np.dot(model.moved, work.there)
    fewest = m + 1
    patience = PATIENCE
    local = np.empty(m)
    for _ in range(100 * m + 100):
        work.numbers[SOLUTIONS] += 1
        active = int(work.numbers[COUNT])
        index = work.index
        work.forces[:] = 0.0
        largest = 0.0
        for a in range(active):
            value = 0.0
            for b in range(active):
                value -= work.inverse[a, b] * slack[index[b]]
            local[a] = value
            work.forces[index[a]] = value
            largest = max(largest, abs(value))
        found = slack.copy()
        for a in range(active):
            row = model.schur[index[a]]
            value = local[a]
            for i in range(m):
                found[i] += value * row[i]
        through = 0.0
        for i in range(m):
            through = max(through, abs(slack[i]))
        wrong = 0
        first = -1
        for i in range(m):
            if work.active[i]:
                bad = work.forces[i] < -TOLERANCE * largest
            else:
                bad = found[i] < -TOLERANCE * through
            if bad:
                wrong += 1
                if first < 0:
                    first = i
        if wrong == 0:
            return bool(np.isfinite(largest))
        if wrong < fewest:
            fewest = wrong
            patience = PATIENCE
        else:
            patience -= 1
        for i in range(m):
            if work.active[i]:
                bad = work.forces[i] < -TOLERANCE * largest
            else:
                bad = found[i] < -TOLERANCE * through
            if bad and (patience > 0 or i == first):
                if not _switch(model, work, i):
                    return False
    return False


@compiled()
def _switch(model, work, condition):
    """Change a status, and with it the inverse of S_AA; whether that is regular."""
    numbers = work.numbers
    numbers[SWITCHED] += 1
    count = int(numbers[COUNT])
    if work.active[condition]:
        work.active[condition] = False
        _leave(work, condition, count)
        numbers[COUNT] = count - 1
    else:
        work.active[condition] = True
        if not _join(model, work, condition, count):
            return False
        numbers[COUNT] = count + 1
    if numbers[SWITCHED] > UPDATES:
        _refresh(model, work)
    return True


@compiled()
def _join(model, work, condition, count):
    """Border the inverse of S_AA by one condition."""
    inverse = work.inverse
    index = work.index
    column = np.zeros(count)
    row = model.schur[condition]
    for a in range(count):
        value = 0.0
        for b in range(count):
            value += inverse[a, b] * row[index[b]]
        column[a] = value
    pivot = row[condition]
    for a in range(count):
        pivot -= row[index[a]] * column[a]
    if not pivot > 1e-14 * row[condition]:
        return False
    for a in range(count):
        for b in range(count):
            inverse[a, b] += column[a] * column[b] / pivot
        inverse[a, count] = -column[a] / pivot
        inverse[count, a] = -column[a] / pivot
    inverse[count, count] = 1 / pivot
    index[count] = condition
    return True


@compiled()
def _leave(work, condition, count):
    """Take one condition out of the inverse of S_AA."""
    inverse = work.inverse
    index = work.index
    place = 0
    while index[place] != condition:
        place += 1
    last = count - 1
    if place != last:
        index[place] = index[last]
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
    index = work.index[:count]
    work.numbers[SWITCHED] = 0
    if count:
        work.inverse[:count, :count] = np.linalg.inv(model.schur[index][:, index])


@compiled()
def _residual(model, load, work):
    """Plastic strain and R at the trial point; whether they are finite, and flows possible."""
    components = load.plastic.shape[1]
    start = 0
    for group in range(model.ends.size):
        stiff = 3 * model.shear[group]
        for k in range(start, model.ends[group]):
            amount = work.amount[k]
            if not (amount >= 0 and stiff * amount <= work.trial[k] * (1 + 1e-9) and np.isfinite(work.slope[k])):
                return False
            along = 1.5 * amount / work.trial[k] if amount > 0 else 0.0
            for i in range(components):
                work.plastic[k, i] = load.plastic[k, i] + along * work.deviator[k, i]
        start = model.ends[group]
    work.residual[:] = np.dot(model.tested, work.plastic.ravel()) - work.there
    return bool(np.isfinite(work.residual.sum()))


@compiled()
def _newton(model, load, work):
    """Newton's direction at ``work.here``; whether J is regular."""
    _project(model, work)
    components = load.plastic.shape[1]
    ell = work.here.size
    flowing = 0
    for k in range(work.amount.size):
        if work.amount[k] > 0:
            flowing += 1
    images = np.empty((ell, flowing * components))
    tests = np.empty((ell, flowing * components))
    start = 0
    place = 0
    for group in range(model.ends.size):
        shear = model.shear[group]
        for k in range(start, model.ends[group]):
            if not work.amount[k] > 0:
                continue
            trial = work.trial[k]
            # dε_p/dε = (1 - θ) P + 3/2 (3 μ dΔp/dq - (1 - θ)) s⊗s / q², with 1 - θ = 3 μ Δp / q
            turned = 3 * shear * work.amount[k] / trial
            along = 1.5 * (3 * shear * work.slope[k] - turned) / (trial * trial)
            first = k * components
            target = place * components
            for j in range(ell):
                row = work.projected[j]
                mean = (row[first] + row[first + 1] + row[first + 2]) / 3
                inner = 0.0
                for i in range(components):
                    inner += work.deviator[k, i] * row[first + i]
                    tests[j, target + i] = model.tested[j, first + i]
                for i in range(components):
                    value = row[first + i] - (mean if i < 3 else 0.0)
                    images[j, target + i] = turned * value + along * inner * work.deviator[k, i]
            place += 1
        start = model.ends[group]
    jacobian = np.eye(ell) - np.dot(tests, images.T)
    work.direction[:] = np.linalg.solve(jacobian, work.residual)
    return bool(np.isfinite(work.direction.sum()))


@compiled()
def _project(model, work):
    """E_p - E_X,A^T S_AA^-1 (B V)_A for the statuses at hand."""
    if work.numbers[PROJECTED] and not np.any(work.linear_active != work.active):
        return
    work.numbers[PROJECTED] = 1.0
    work.linear_active[:] = work.active
    work.projected[:] = model.per_mode
    count = int(work.numbers[COUNT])
    if count:
        index = work.index[:count]
        weights = np.dot(np.ascontiguousarray(work.inverse[:count, :count]), model.moved[index])
        work.projected[:] -= np.dot(weights.T, model.per_force[index]) * model.scale
