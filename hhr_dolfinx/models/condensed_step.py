"""One step of condensed flow, compiled: plastic correction g and all contact forces λ, by Newton's method.

With the elastic response eliminated exactly (see :mod:`hhr_dolfinx.models.condensed_flow`), a step is

    ∫ (G V)^T C ε_p(ε) - g = 0,      ε = ε_e + ε_c,      ε_c = E_p g - E_X^T (λ(g) - λ_e),

where λ(g) solves the contact problem with the slack s - B V g + S λ, and λ_e that without any correction, of strain
ε_e. λ is piecewise linear and continuous in g, so that the residual is continuous and a line search on its norm has a
meaning. What a few points Z integrate is the stress of the correction where anything flowed, C (ε_p - dev ε_c); the
rest is linear in g and λ, and known exactly. In sum over Z, with w for their weights, that is

    R(g) = sum of w (G V)^T 2 μ ε_p - Q g - P (λ - λ_e),
    Q = I - (∫ - sum of w) (G V)^T 2 μ dev G V,      P = (∫ - sum of w) (G V)^T 2 μ dev G K^-1 B^T,

so that Q and P hold what the cubature does wrong where ε_p follows dev ε, as where a body creeps at its leisure: the
tangent stays definite there. With Q = I and P = 0 its sign turns with the errors of the weights. On statuses A, with
E_A = E_p - E_X,A^T W and W = S_AA^-1 (B V)_A, the derivative is, a sum over the points that flow,

    J = sum of w (G V)^T 2 μ (dε_p/dε) dev E_A - Q - P_A W.

Laws are evaluated between two calls of :func:`advance`, those of the package in the same compiled loop, those of a user
in Python.
"""

from __future__ import annotations

import numpy as np

from hhr_dolfinx.compat import compiled
from hhr_dolfinx.materials.compiled_laws import flow_at
from hhr_dolfinx.models.condensed_arrays import (
    CONTACT,
    CONVERGED,
    COUNT,
    EVALUATE,
    ITERATION,
    LIMIT,
    LINEAR,
    MERIT,
    NEW_TANGENT,
    NO_TANGENT,
    NOT_FINITE,
    OLD_TANGENT,
    SHARE,
    SIZE,
    STALLED,
    StepLoad,
    StepModel,
    Work,
)
from hhr_dolfinx.models.condensed_contact import touch

LEAST_SHARE = 1 / 256
"""Smallest part of a Newton step that the line search tries."""
DECREASE = 1e-4
"""Part of the decrease of |R| that the linear model promises which a step has to bring (Armijo)."""
ROUND_OFF = 1e-14
"""Part of what the residual is made of that is round-off."""
SLOW = 0.35
"""An old J serves as long as |R| falls at least by this factor in each iteration."""


@compiled()
def solve(
    model: StepModel,
    load: StepLoad,
    work: Work,
    kinds: np.ndarray,
    constants: np.ndarray,
    tolerance: float,
    most: int,
) -> int:
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
def begin(model: StepModel, load: StepLoad, work: Work) -> int:
    """Prepare the trial stress of the first iterate."""
    numbers = work.numbers
    numbers[ITERATION] = 0.0
    numbers[SHARE] = 1.0
    numbers[MERIT] = np.inf
    numbers[LINEAR] = min(numbers[LINEAR], OLD_TANGENT)
    return _try(model, load, work)


@compiled()
def advance(model: StepModel, load: StepLoad, work: Work, tolerance: float, most: int) -> int:
    """Take in flows at the trial point, and go on to the next one.

    Args:
        model, load, work: see there.
        tolerance: |R| over the size of the correction at which a step is solved.
        most: evaluations of the laws.
    """
    numbers = work.numbers
    numbers[ITERATION] += 1
    first = numbers[MERIT] == np.inf
    if first:
        # of a correction as small as that, as where the first point is about to yield, there is no more to know
        noise = ROUND_OFF * model.weight * np.sqrt(np.dot(work.strain, work.strain))
        numbers[SIZE] = max(numbers[SIZE], noise / tolerance)
    if not _residual(model, load, work):
        # a correction too far off, where a law has no answer
        return NOT_FINITE if first else _nearer(model, load, work, most)
    merit = np.sqrt(np.dot(work.residual, work.residual))
    solved = merit <= tolerance * max(np.sqrt(np.dot(work.there, work.there)), numbers[SIZE])
    if not (solved or first or merit <= (1 - DECREASE * numbers[SHARE]) * numbers[MERIT]):
        return _nearer(model, load, work, most)
    slow = merit > SLOW * numbers[MERIT]
    if not first:
        _learn(work)
    work.here[:] = work.there
    work.left[:] = work.residual
    numbers[MERIT] = merit
    if solved:
        return CONVERGED
    if numbers[ITERATION] >= most:
        return LIMIT
    if numbers[LINEAR] == NO_TANGENT or (slow and not first):
        if not linearise(model, work):
            return STALLED
    else:
        numbers[LINEAR] = OLD_TANGENT
    return _go(model, load, work)


@compiled()
def _learn(work):
    """Make the inverse of -J true of the step just taken (Broyden 1965, the first of his updates)."""
    step = work.there - work.here
    answered = np.dot(work.newton, work.left - work.residual)
    along = np.dot(step, answered)
    if abs(along) > 0.1 * np.dot(step, step):
        work.newton[:] += np.outer(step - answered, np.dot(step, work.newton)) / along


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
            work.trial[k] = (strain[0, k] + strain[1, k] + strain[2, k]) / 3
        for i in range(components):
            for k in range(start, end):
                mean = work.trial[k] if i < 3 else 0.0
                deviator[i, k] = twice * (strain[i, k] - load.plastic[i, k] - mean)
        start = end
    work.trial[:] = 0.0
    for i in range(components):
        for k in range(points):
            work.trial[k] += deviator[i, k] * deviator[i, k]
    for k in range(points):
        work.trial[k] = np.sqrt(1.5 * work.trial[k])
    return EVALUATE


@compiled()
def _strain(model, load, work):
    """Strain at ``work.there`` under the forces there."""
    count = int(work.numbers[COUNT])
    work.strain[:] = -np.dot(work.forces[work.order[:count]], work.rows[:count])
    if model.scale.size:
        work.strain[:] *= model.scale
    work.strain[:] += load.strain
    work.strain[:] += np.dot(work.there, model.per_mode)


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
    work.residual[:] = np.dot(model.tested, work.plastic.ravel()) - np.dot(model.modal, work.there)
    work.residual[:] -= np.dot(model.coupled, work.forces - load.forces)
    return bool(np.isfinite(work.residual.sum()))


@compiled()
def linearise(model: StepModel, work: Work) -> bool:
    """The inverse of -J at ``work.here``, of which laws, strain and statuses are those; whether J is regular.

    What flows is taken in single precision: what J is off by is seen in the number of iterations, if at all.
    """
    count = int(work.numbers[COUNT])
    index = work.order[:count]
    # W
    moved = np.dot(np.ascontiguousarray(work.inverse[:count, :count]), model.moved[index])
    jacobian = model.modal + np.dot(np.ascontiguousarray(model.coupled[:, index]), moved)
    if np.any(work.amount > 0):
        flowing = _flowing(model, work)
        jacobian -= np.dot(flowing, model.single.T)
        if model.scale.size:
            flowing *= model.scale.astype(np.float32)
        pressed = np.dot(flowing, work.rows[:count].astype(np.float32).T)
        jacobian += np.dot(pressed, moved.astype(np.float32))
    work.newton[:] = np.linalg.inv(jacobian)
    # kept for an old one it would stop all steps to come
    regular = bool(np.isfinite(work.newton.sum()))
    work.numbers[LINEAR] = NEW_TANGENT if regular else NO_TANGENT
    return regular


@compiled(fastmath=True)
def _flowing(model, work):
    """w (G V)^T 2 μ dε_p/dε, (ell, c n).

    dε_p/dε = (1 - θ) P + 3/2 (3 μ dΔp/dq - (1 - θ)) s⊗s / q² with 1 - θ = 3 μ Δp / q and the deviatoric projector P.
    """
    components, points = work.deviator.shape
    turned = np.zeros(points)
    along = np.zeros(points)
    start = 0
    for group in range(model.ends.size):
        stiff = 3 * model.shear[group]
        end = model.ends[group]
        for k in range(start, end):
            if work.amount[k] > 0:
                trial = work.trial[k]
                turned[k] = stiff * work.amount[k] / trial
                along[k] = 1.5 * (stiff * work.slope[k] - turned[k]) / (trial * trial)
        start = end
    found = np.empty(model.tested.shape, dtype=np.float32)
    onto = np.empty(points)
    for j in range(len(found)):
        onto[:] = 0.0
        for i in range(components):
            for k in range(points):
                onto[k] += model.tested[j, i * points + k] * work.deviator[i, k]
        for k in range(points):
            onto[k] *= along[k]
        for i in range(components):
            for k in range(points):
                place = i * points + k
                found[j, place] = model.tested[j, place] * turned[k] + onto[k] * work.deviator[i, k]
    return found
