"""One step of condensed flow, compiled: plastic correction g and all contact forces λ, by Newton's method.

With the elastic response eliminated exactly (see :mod:`hhr_dolfinx.models.condensed_flow`), a step is

    R(g) = ∫ (G V)^T C ε_p(ε) - g = 0,      ε = ε_e + ε_c,      ε_c = E_p g - E_X^T (λ(g) - λ_e),

where λ(g) solves the contact problem with the slack s - B V g + S λ, and λ_e that without any correction, of strain
ε_e. λ is piecewise linear and continuous in g, so that R is continuous and a line search on its norm has a meaning.
What a few points Z integrate is the stress of the correction where anything flowed; the rest is known exactly:

    R(g) = sum over Z of w (G V)^T 2 μ (ε_p - dev ε_c) - Q g - P (λ - λ_e),
    Q = I - ∫ (G V)^T 2 μ dev G V,      P = ∫ (G V)^T 2 μ dev G K^-1 B^T      (over what flowed).

Where a body creeps at its leisure ε_p follows dev ε, and the sum hardly changes with g: the exact Q keeps the tangent
definite. A cubature of C ε_p alone, with g in the place of all else, has a tangent whose sign turns with the errors of
its weights. On statuses A, with E_A = E_p - E_X,A^T W and W = S_AA^-1 (B V)_A, the derivative is

    J = sum w (G V)^T 2 μ (dε_p/dε - 1) dev E_A - Q - P_A W.

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
ITERATION, MERIT, SHARE, SIZE, COUNT, SWITCHED, PROJECTED, LINEAR, NUMBERS = range(9)
"""Places in ``Work.numbers``: laws evaluated, |R| at ``here``, part of the direction tried, largest |g| so far, active
conditions, changes of the inverse, whether ``projected`` is there; whether J is none, an old one, or of ``here``."""
NO_TANGENT, OLD_TANGENT, NEW_TANGENT = range(3)
SLOW = 0.1
"""An old J serves as long as |R| falls at least by this factor in each iteration."""
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

    Strains lie component by component, so that loops over points run side by side.

    Attributes:
        per_mode: strain of each mode, (ell, c n).
        tested: quadrature weight times 2 μ times the deviator of each, (ell, c n), in the moduli for which modes have
            unit energy.
        per_force: strain of K^-1 B^T in these moduli, (m, c n).
        scale: factor of the strain of contact forces, (c n,); nothing where it is 1.
        schur: S, (m, m).
        moved: B V, (m, ell).
        rest: Q, (ell, ell).
        crossed: P, (ell, m).
        ends: last point of each group and one, (G,).
        shear: of each group, (G,).
    """

    per_mode: np.ndarray
    tested: np.ndarray
    per_force: np.ndarray
    scale: np.ndarray
    schur: np.ndarray
    moved: np.ndarray
    rest: np.ndarray
    crossed: np.ndarray
    ends: np.ndarray
    shear: np.ndarray


class StepLoad(NamedTuple):
    """What a step is given.

    Attributes:
        strain: strain without correction and contact forces, (c n,).
        elastic: ε_e, (c n,).
        forces: λ_e, (m,).
        slack: slack without correction and contact forces, (m,).
        plastic: plastic strain before the step, (c, n).
        cumulated: cumulated plastic strain before it, (n,).
        dt: its length in seconds.
    """

    strain: np.ndarray
    elastic: np.ndarray
    forces: np.ndarray
    slack: np.ndarray
    plastic: np.ndarray
    cumulated: np.ndarray
    dt: float


class Work(NamedTuple):
    """What a step works on; ``here`` is the last accepted correction, ``there`` the one that is tried.

    Attributes:
        here, there, direction, residual, left: corrections, direction, and R at ``there`` and ``here``, (ell,) each.
        forces, slack: of the contact problem at ``there``, (m,) each.
        active: its statuses, (m,) bool.
        index: active conditions in the order of ``inverse``, (m,).
        inverse: of S_AA in its upper left corner, (m, m).
        linear_active: statuses of ``projected``, (m,) bool.
        projected: E_A, (ell, c n).
        crossing: P_A W, (ell, ell).
        newton: inverse of -J, (ell, ell).
        strain: at ``there``, (c n,).
        deviator: of the trial stress, (c, n).
        trial, amount, slope: equivalent trial stress, flow and its slope, (n,) each.
        plastic: plastic strain at ``there``, (c, n).
        numbers: iterations and the like, see ``ITERATION``.
    """

    here: np.ndarray
    there: np.ndarray
    direction: np.ndarray
    residual: np.ndarray
    left: np.ndarray
    forces: np.ndarray
    slack: np.ndarray
    active: np.ndarray
    index: np.ndarray
    inverse: np.ndarray
    linear_active: np.ndarray
    projected: np.ndarray
    crossing: np.ndarray
    newton: np.ndarray
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
        vectors = [np.zeros(ell) for _ in range(5)]
        contact = np.zeros(m), np.zeros(m), np.zeros(m, dtype=bool), np.zeros(m, dtype=np.int64), np.zeros((m, m))
        linear = np.zeros(m, dtype=bool), np.zeros((ell, c * n)), np.zeros((ell, ell)), np.zeros((ell, ell))
        gauss = np.zeros(c * n), np.zeros((c, n)), np.zeros(n), np.zeros(n), np.zeros(n), np.zeros((c, n))
        return cls(*vectors, *contact, *linear, *gauss, np.zeros(NUMBERS))


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
    numbers = work.numbers
    numbers[ITERATION] = 0.0
    numbers[SHARE] = 1.0
    numbers[MERIT] = np.inf
    numbers[LINEAR] = min(numbers[LINEAR], OLD_TANGENT)
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
    first = numbers[MERIT] == np.inf
    if not _residual(model, load, work):
        # a correction too far off, where a law has no answer
        return NOT_FINITE if first else _nearer(model, load, work, most)
    merit = np.sqrt(np.dot(work.residual, work.residual))
    solved = merit <= tolerance * max(np.sqrt(np.dot(work.there, work.there)), numbers[SIZE])
    if not (solved or first or merit <= (1 - DECREASE * numbers[SHARE]) * numbers[MERIT]):
        return _nearer(model, load, work, most)
    slow = merit > SLOW * numbers[MERIT]
    work.here[:] = work.there
    work.left[:] = work.residual
    numbers[MERIT] = merit
    if solved:
        return CONVERGED
    if numbers[ITERATION] >= most:
        return LIMIT
    if numbers[LINEAR] == NO_TANGENT or (slow and not first):
        if not _linearise(model, load, work):
            return STALLED
    else:
        numbers[LINEAR] = OLD_TANGENT
    return _go(model, load, work)


@compiled()
def _go(model, load, work):
    """The whole of Newton's step from ``here``."""
    work.direction[:] = np.dot(work.newton, work.left)
    if not np.isfinite(work.direction.sum()):
        return STALLED
    work.numbers[SHARE] = 1.0
    work.there[:] = work.here + work.direction
    return _try(model, load, work)


@compiled()
def _nearer(model, load, work, most):
    """A new J at ``here`` where that at hand is old, else half of the part of the direction that was tried last."""
    numbers = work.numbers
    if numbers[ITERATION] >= most:
        return LIMIT
    if numbers[LINEAR] == OLD_TANGENT:
        # what the laws say at ``here`` was overwritten: they are asked again
        numbers[LINEAR] = NO_TANGENT
        numbers[MERIT] = np.inf
        work.there[:] = work.here
        return _try(model, load, work)
    numbers[SHARE] *= 0.5
    if numbers[SHARE] < LEAST_SHARE:
        return STALLED
    work.there[:] = work.here + numbers[SHARE] * work.direction
    return _try(model, load, work)


@compiled(fastmath=True)
def _try(model, load, work):
    """Contact forces, strain and trial stress at ``work.there``."""
    if not touch(model, load, work):
        return CONTACT
    _strain(model, load, work)
    components, points = load.plastic.shape
    strain = work.strain.reshape(components, points)
    deviator = work.deviator
    start = 0
    for group in range(model.ends.size):
        twice = 2 * model.shear[group]
        end = model.ends[group]
        for k in range(start, end):
            mean = (strain[0, k] + strain[1, k] + strain[2, k]) / 3
            for i in range(3):
                deviator[i, k] = twice * (strain[i, k] - load.plastic[i, k] - mean)
            work.trial[k] = deviator[0, k] ** 2 + deviator[1, k] ** 2 + deviator[2, k] ** 2
        for i in range(3, components):
            for k in range(start, end):
                value = twice * (strain[i, k] - load.plastic[i, k])
                deviator[i, k] = value
                work.trial[k] += value * value
        start = end
    for k in range(points):
        work.trial[k] = np.sqrt(1.5 * work.trial[k])
    return EVALUATE


@compiled(fastmath=True)
def _strain(model, load, work):
    """Strain at ``work.there`` under the forces there."""
    strain = work.strain
    strain[:] = 0.0
    for a in range(int(work.numbers[COUNT])):
        force = work.forces[work.index[a]]
        row = model.per_force[work.index[a]]
        for i in range(strain.size):
            strain[i] -= force * row[i]
    if model.scale.size:
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
    slack = work.slack
    slack[:] = load.slack - np.dot(model.moved, work.there)
    fewest = m + 1
    patience = PATIENCE
    local = np.empty(m)
    for _ in range(100 * m + 100):
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
    components = load.plastic.shape[0]
    start = 0
    for group in range(model.ends.size):
        stiff = 3 * model.shear[group]
        end = model.ends[group]
        for k in range(start, end):
            amount = work.amount[k]
            if not (amount >= 0 and stiff * amount <= work.trial[k] * (1 + 1e-9) and np.isfinite(work.slope[k])):
                return False
        start = end
    for i in range(components):
        for k in range(work.amount.size):
            along = 1.5 * work.amount[k] / work.trial[k] if work.amount[k] > 0 else 0.0
            work.plastic[i, k] = load.plastic[i, k] + along * work.deviator[i, k]
    stressed = work.plastic.ravel() - work.strain + load.elastic
    work.residual[:] = np.dot(model.tested, stressed) - np.dot(model.rest, work.there)
    work.residual[:] -= np.dot(model.crossed, work.forces - load.forces)
    return bool(np.isfinite(work.residual.sum()))


@compiled()
def _linearise(model, load, work):
    """The inverse of -J at ``work.here``, of which laws, strain and statuses are those; whether J is regular.

    dε_p/dε = (1 - θ) P + 3/2 (3 μ dΔp/dq - (1 - θ)) s⊗s / q² with 1 - θ = 3 μ Δp / q and the deviatoric projector P.
    """
    _project(model, work)
    components, points = load.plastic.shape
    turned = np.zeros((components, points))
    along = np.zeros(points)
    start = 0
    for group in range(model.ends.size):
        stiff = 3 * model.shear[group]
        end = model.ends[group]
        for k in range(start, end):
            if work.amount[k] > 0:
                trial = work.trial[k]
                turned[0, k] = stiff * work.amount[k] / trial
                along[k] = 1.5 * (stiff * work.slope[k] - turned[0, k]) / (trial * trial)
        start = end
    turned[1:] = turned[0]
    scaled = model.tested * (1 - turned.ravel())
    onto = _along(model.tested, work.deviator)
    jacobian = model.rest + work.crossing + np.dot(scaled, work.projected.T)
    jacobian -= np.dot(onto * along, _along(work.projected, work.deviator).T)
    work.newton[:] = np.linalg.inv(jacobian)
    work.numbers[LINEAR] = NEW_TANGENT
    return bool(np.isfinite(work.newton.sum()))


@compiled(fastmath=True)
def _along(rows, deviator):
    """Products of strains, (ell, c n), with a deviator at each point, (ell, n)."""
    components, points = deviator.shape
    found = np.zeros((len(rows), points))
    for j in range(len(rows)):
        for i in range(components):
            for k in range(points):
                found[j, k] += rows[j, i * points + k] * deviator[i, k]
    return found


@compiled()
def _project(model, work):
    """E_p - E_X,A^T S_AA^-1 (B V)_A for the statuses at hand."""
    if work.numbers[PROJECTED] and not np.any(work.linear_active != work.active):
        return
    work.numbers[PROJECTED] = 1.0
    work.linear_active[:] = work.active
    count = int(work.numbers[COUNT])
    if count == 0:
        work.projected[:] = model.per_mode
        work.crossing[:] = 0.0
        return
    index = work.index[:count]
    weights = np.dot(np.ascontiguousarray(work.inverse[:count, :count]), model.moved[index])
    work.crossing[:] = np.dot(model.crossed[:, index], weights)
    taken = np.dot(weights.T, model.per_force[index])
    if model.scale.size:
        taken *= model.scale
    work.projected[:] = model.per_mode - taken
