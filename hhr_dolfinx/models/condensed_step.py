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

Laws are evaluated between :func:`prepare` and :func:`judge`, those of the package in the same compiled loop, those of a
user in Python. The first step of an installation waits for the compiler: whatever a function calls is optimised once
more with it, so that calls are few and shallow, and loops are written out, which compile ten times as fast as
expressions of whole arrays.
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
from hhr_dolfinx.models.condensed_contact import STEP, inverse_of, touched
from hhr_dolfinx.models.condensed_points import (
    ANY_ORDER,
    flowing_of,
    possible,
    set_plastic,
    set_residual,
    set_strain,
    set_trial,
)

LEAST_SHARE = 1 / 256
"""Smallest part of a Newton step that the line search tries."""
DECREASE = 1e-4
"""Part of the decrease of |R| that the linear model promises which a step has to bring (Armijo)."""
ROUND_OFF = 1e-14
"""Part of what the residual is made of that is round-off."""
SLOW = 0.35
"""An old J serves as long as |R| falls at least by this factor in each iteration."""


def begin(work: Work) -> None:
    """Before the first iterate of a step."""
    numbers = work.numbers
    numbers[ITERATION] = 0.0
    numbers[SHARE] = 1.0
    numbers[MERIT] = np.inf
    numbers[LINEAR] = min(numbers[LINEAR], OLD_TANGENT)


_begin = compiled(inner=True)(begin)


@compiled(dear=STEP)
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

    ``kinds`` and ``constants`` are those of :mod:`materials.compiled_laws`, (G,) and (G, 2); see :func:`judge`.
    """
    _begin(work)
    code = EVALUATE
    while code == EVALUATE:
        if not touched(model, load.slack, work):
            return CONTACT
        _try(model, load.strain, load.plastic, work)
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
        code = _judge(model, load, work, tolerance, most)
    return code


@compiled()
def prepare(model: StepModel, load: StepLoad, work: Work) -> int:
    """Contact forces, strain and trial stress at ``work.there``."""
    if not touched(model, load.slack, work):
        return CONTACT
    _try(model, load.strain, load.plastic, work)
    return EVALUATE


@compiled()
def judge(model: StepModel, load: StepLoad, work: Work, tolerance: float, most: int) -> int:
    """Take in flows at the trial point, and go on to the next one.

    Args:
        model, load, work: see there.
        tolerance: |R| over the size of the correction at which a step is solved.
        most: evaluations of the laws.
    """
    return _judge(model, load, work, tolerance, most)


@compiled(inner=True)
def _judge(model, load, work, tolerance, most):
    """See :func:`judge`."""
    numbers = work.numbers
    numbers[ITERATION] += 1
    first = numbers[MERIT] == np.inf
    if first:
        # of a correction as small as that, as where the first point is about to yield, there is no more to know
        numbers[SIZE] = max(numbers[SIZE], ROUND_OFF * model.weight * _norm(work.strain) / tolerance)
    fine = possible(model.ends, model.shear, work.amount, work.slope, work.trial)
    if fine:
        set_plastic(load.plastic, work.amount, work.trial, work.deviator, work.plastic)
        pushed = model.coupled, work.forces, load.forces
        left = set_residual(model.tested, work.plastic, model.modal, work.there, *pushed, work.residual)
        fine = bool(np.isfinite(left))
    if not fine:
        # a correction too far off, where a law has no answer
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
        if not _linearise(model, work):
            return STALLED
    else:
        numbers[LINEAR] = OLD_TANGENT
    return _go(work)


@compiled(inner=True, fastmath=ANY_ORDER)
def _norm(values):
    total = 0.0
    for value in values:
        total += value * value
    return np.sqrt(total)


@compiled(inner=True)
def _learn(there, here, newton, left, residual):
    """Make the inverse of -J true of the step just taken (Broyden 1965, the first of his updates)."""
    ell = here.size
    missed, turned = np.empty(ell), np.zeros(ell)
    along, length = 0.0, 0.0
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
def _go(work):
    """The whole of Newton's step from ``here``."""
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
def _nearer(work, most):
    """A new J at ``here`` where that at hand is old, else half of the part of the direction that was tried last."""
    numbers = work.numbers
    if numbers[ITERATION] >= most:
        return LIMIT
    if numbers[LINEAR] == OLD_TANGENT:
        # what the laws say at ``here`` was overwritten: they are asked again
        numbers[LINEAR] = NO_TANGENT
        numbers[MERIT] = np.inf
        for j in range(work.here.size):
            work.there[j] = work.here[j]
        return EVALUATE
    numbers[SHARE] *= 0.5
    if numbers[SHARE] < LEAST_SHARE:
        return STALLED
    for j in range(work.here.size):
        work.there[j] = work.here[j] + numbers[SHARE] * work.direction[j]
    return EVALUATE


@compiled(inner=True)
def _try(model, free, plastic, work):
    """Strain and trial stress at ``work.there`` under the forces there."""
    strain, count = work.strain, int(work.numbers[COUNT])
    set_strain(strain, free, work.forces, work.order, count, work.rows, model.scale, work.there, model.per_mode)
    set_trial(strain, plastic, model.ends, model.shear, work.deviator, work.trial)


@compiled()
def linearise(model: StepModel, work: Work) -> bool:
    """The inverse of -J at ``work.here``, of which laws, strain and statuses are those; whether J is regular.

    What flows is taken in single precision: what J is off by is seen in the number of iterations, if at all.
    """
    return _linearise(model, work)


@compiled(inner=True)
def _linearise(model, work):
    """See :func:`linearise`."""
    count, ell = int(work.numbers[COUNT]), work.here.size
    moved, coupled, inverse = np.empty((count, ell)), np.empty((ell, count)), np.empty((count, count))
    for a in range(count):
        for j in range(ell):
            moved[a, j] = model.moved[work.order[a], j]
            coupled[j, a] = model.coupled[j, work.order[a]]
        for b in range(count):
            inverse[a, b] = work.inverse[a, b]
    # W
    moved = np.dot(inverse, moved)
    jacobian = np.dot(coupled, moved)
    for i in range(ell):
        for j in range(ell):
            jacobian[i, j] += model.modal[i, j]
    if _norm(work.amount) > 0:
        _add_flowing(model, work, moved, jacobian)
    found = inverse_of(jacobian)
    total = 0.0
    for i in range(ell):
        for j in range(ell):
            work.newton[i, j] = found[i, j]
            total += found[i, j]
    # kept for an old one it would stop all steps to come
    regular = bool(np.isfinite(total))
    work.numbers[LINEAR] = NEW_TANGENT if regular else NO_TANGENT
    return regular


@compiled(inner=True)
def _add_flowing(model, work, moved, jacobian):
    """What flows of -J, by W."""
    count, ell = moved.shape
    laws = work.deviator, work.trial, work.amount, work.slope
    flowing = flowing_of(model.tested, model.ends, model.shear, *laws)
    direct = np.dot(flowing, model.single.T)
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
                jacobian[i, j] += pressed[i, a] * moved[a, j]
