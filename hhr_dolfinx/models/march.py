"""Quasi-static histories of contact between bodies that flow, thesis Alg. 6.1 and 6.2: one loop for full and reduced.

Each iteration linearises the stress, solves the contact problem of that linearisation to the end, (6.16) or (6.17), and
updates the material. The operator of the linearisation is the consistent tangent, or the elastic one (6.21) with
Anderson's acceleration. A step that does not converge is tried with new tangents in each iteration, then cut in halves;
nothing unconverged is ever kept. Loads, imposed displacements, gaps, and constants of laws that are formulas are those
at the end of a step or of a part of it.
"""

from __future__ import annotations

import logging
import warnings
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from threadpoolctl import threadpool_limits

from hhr_dolfinx.contact.active_set import Status
from hhr_dolfinx.errors import ConvergenceError, LawWarning, NotSolvableError
from hhr_dolfinx.linear.anderson import Anderson
from hhr_dolfinx.models.answer import Answer, GaussState, History, Path, found_as
from hhr_dolfinx.models.equilibrium import Equilibrium, Linearisation
from hhr_dolfinx.models.path import DEFAULT_MARCH, MarchSettings, check_settings
from hhr_dolfinx.trained import Watch

_log = logging.getLogger(__name__)

ROUND_OFF_STRAIN = 1e-13
"""A strain this small is round-off of displacements that strain nothing, as where a gap closes without stress."""
MOST_STRAIN = 100.0
"""A strain this large is a runaway, whatever the residual. At the corner of a punch single points reach a few units."""
PATIENCE = 5
"""A frozen tangent is kept for the next step if this one took no more iterations."""


class _Diverged(Exception):
    """A step did not converge: why, and the Gauss point that moves or flows most, if that is known."""

    def __init__(self, why, worst=None):
        super().__init__(why)
        self.worst = worst


# threads of BLAS slow small blocks down: a projected tangent of 70 modes took 7.8 ms on two of them, 3.1 ms on one
@threadpool_limits.wrap(limits=1, user_api="blas")
def march(
    model: Equilibrium,
    path: Path,
    settings: MarchSettings = DEFAULT_MARCH,
    *,
    known: Sequence[Answer] = (),
    keep: Callable[[Answer], None] = lambda answer: None,
) -> History:
    """Solve a history from rest.

    Args:
        model: equilibrium of a full or a reduced model.
        path: times and parameters, as :func:`checked_path` returns them; parameters are linear between them.
        settings: how.
        known: answers to the first steps, solved before; the history goes on behind them.
        keep: told of each answer as soon as it is there.

    Raises:
        ParameterError: for settings that are none.
        OutsideTrainingError: if a step is outside what was trained, and ``settings`` say to refuse that.
        ConvergenceError: with the step, the time and the worst point.
        Whatever ends a history, an interrupt from the keyboard too, has an attribute ``history`` with the steps before.

    Warns:
        OutsideTrainingWarning: if a step is outside what was trained, and ``settings`` do not say otherwise.
        LawWarning: if the slope of a law is not the derivative of its flow.
    """
    check_settings(settings)
    history = History(*path[0])
    try:
        with model.lock:
            _march(model, path, settings, history, known, keep)
    except _Diverged as failure:
        step = len(history.answers) + 1
        error = ConvergenceError(
            f"step {step} to t = {path[step][0]:g} s did not converge: {failure}{_place(model, failure.worst)}. "
            f"Take smaller steps; the {step - 1} steps before are kept"
        )
        error.history = history  # type: ignore[attr-defined]
        raise error from None
    except BaseException as stop:  # a law may raise anything, and a user may stop it
        with suppress(AttributeError):
            stop.history = history  # type: ignore[attr-defined]
        raise
    if settings.gradient:
        from hhr_dolfinx.models.history_gradient import with_gradients

        with_gradients(model, history)
    return history


def _march(
    model: Equilibrium,
    path: Path,
    settings: MarchSettings,
    history: History,
    known: Sequence[Answer],
    keep: Callable[[Answer], None],
) -> None:
    """Solve the steps of a checked path into a history."""
    trail: tuple[Answer, ...] = (_at_rest(model, *path[0]),)
    slopes_seen = False
    memory, watch = _Memory(), Watch(model.trained, settings.outside)
    for number, (time, target) in enumerate(path[1:], start=1):
        watch.before(number, trail[-1].time, time, trail[-1].parameter, target)
        if number <= len(known):
            after, cut = known[number - 1], False
            memory.learn(model, after)
        else:
            after, cut = _advance(model, trail, _Goal(time, target), settings, memory)
            slopes_seen = slopes_seen or _check_slopes(model, trail[-1], after)
        signs = model.signs(after)
        # a step that is refused is not kept
        watch.after(number, time, signs)
        history.answers.append(after)
        history.signs.append(signs)
        history.cuts += cut
        _log.info("step %d of %d, t = %g s: %d iterations", number, len(path) - 1, time, after.iterations)
        if number > len(known):
            keep(after)
        trail = (*trail[-2:], after)


def _check_slopes(model: Equilibrium, before: Answer, after: Answer) -> bool:
    """Warn of laws with a wrong slope; whether the step flowed enough to tell."""
    if not after.state().state.cumulated.max(initial=0.0) > 0:
        return False
    strain = model.strain(after.unknown, model.amplitudes(after.parameter))
    material = model.material.at(after.parameter)
    try:
        complaints = material.wrong_slopes(strain, before.state().state, after.time - before.time)
    except ConvergenceError:  # the whole of a step that was cut, for which a law may find no flow
        return False
    for complaint in complaints or ():
        warnings.warn(complaint, LawWarning, stacklevel=4)
    return complaints is not None


class _Goal(NamedTuple):
    """Time and parameter to reach."""

    time: float
    parameter: np.ndarray


def _at_rest(model: Equilibrium, time: float, parameter: np.ndarray) -> Answer:
    active, material = np.zeros(model.conditions, dtype=bool), model.material
    gauss = GaussState(np.zeros((material.gauss_points, material.components)), material.at_rest())
    nothing = np.zeros(model.size), np.zeros(active.size), active
    return Answer(parameter, *nothing, 0, Status.CONVERGED, False, model.fields, time, gauss)


def _place(model, worst):
    """Where in the full mesh a Gauss point of the model lies, in words."""
    if worst is None:
        return ""
    number = int(model.points[worst])
    return f"; worst at Gauss point {number}, in cell {number // model.per_cell}"


def _advance(
    model: Equilibrium, trail: tuple[Answer, ...], goal: _Goal, settings: MarchSettings, memory: _Memory
) -> tuple[Answer, bool]:
    """One step as asked for, then in 2, 4, ... parts, each of which is tried like a step of its own.

    ``trail`` holds the last answers, at most three, the present one at the end. Returned are the answer, with the
    iterations of all attempts, and whether the step was cut.
    """
    here, spent = trail[-1], 0
    for parts in (2**halvings for halvings in range(settings.cuts + 1)):
        last = trail
        try:
            for share in np.arange(1, parts + 1) / parts:
                time = here.time + share * (goal.time - here.time)
                part = _Goal(time, (1 - share) * here.parameter + share * goal.parameter)
                after = _tried(model, last, part, settings, memory)
                spent += after.iterations
                last = (*last[-2:], after)
            return after._replace(iterations=spent), parts > 1
        except _Diverged as error:
            failure = error
            spent += settings.iterations
    raise failure


def _tried(
    model: Equilibrium, trail: tuple[Answer, ...], goal: _Goal, settings: MarchSettings, memory: _Memory
) -> Answer:
    """A step from the extrapolation of the answers before; if that fails, with new tangents from an elastic start."""
    careful = replace(settings, search="tangent") if settings.search == "frozen" else settings
    try:
        return _step(model, trail, goal, settings, memory)
    except (_Diverged, ConvergenceError):
        memory.linearisation = None
    try:
        after = _step(model, trail[-1:], goal, careful, memory)
    except ConvergenceError as error:
        raise _Diverged(str(error)) from error
    return after._replace(iterations=settings.iterations + after.iterations)


@dataclass
class _Memory:
    """The linearisation of the last step, if it served well, and the largest forces and stress (mean square) so far."""

    linearisation: Linearisation | None = None
    forces: np.ndarray | float = 0.0
    stress: float = 0.0

    def learn(self, model: Equilibrium, answer: Answer) -> None:
        """Take in a step that was solved before, by what it left behind."""
        _, scale = model.residual(answer.state().stress, model.amplitudes(answer.parameter))
        self.grow(scale, _root_mean_square(answer.state().stress))

    def grow(self, forces: np.ndarray, stress: float) -> None:
        """Take in the forces and the stress of one more step."""
        self.forces, self.stress = np.maximum(forces, self.forces), max(self.stress, stress)


def _root_mean_square(stress: np.ndarray) -> float:
    return float(np.sqrt(np.mean(stress**2)))


def _step(
    model: Equilibrium, trail: tuple[Answer, ...], goal: _Goal, settings: MarchSettings, memory: _Memory
) -> Answer:
    """One step from the end of ``trail``: from the extrapolation of its answers, or an elastic start from one alone."""
    here, dt = trail[-1], goal.time - trail[-1].time
    theta, material = model.amplitudes(goal.parameter), model.material.at(goal.parameter)
    x = _extrapolated(trail, goal.time) if len(trail) > 1 else _elastic_start(model, here, theta)
    flows = material.flows and settings.search != "elastic"
    mixing = Anderson() if material.flows and settings.search != "tangent" else None
    active, noise = here.active, model.round_off(x, theta)
    linear: Any = memory.linearisation if flows else model.elastic
    for iteration in range(1, settings.iterations + 1):
        renew = flows and (linear is None or settings.search == "tangent")
        strain = model.strain(x, theta)
        update = material.update(strain, here.state().state, dt, tangent=renew)
        if not np.isfinite(update.stress).all():
            raise _Diverged("the stress is not finite", int(np.argmin(np.isfinite(update.stress).all(axis=1))))
        residual, scale = model.residual(update.stress, theta)
        flowing = int((update.state.cumulated - here.state().state.cumulated).argmax())
        try:
            linear = model.linearised(update.tangents) if renew else linear
            change, found = linear.correct(residual, x, theta, active)
        except (NotSolvableError, np.linalg.LinAlgError) as error:
            raise _Diverged(f"{error}, a singular tangent", flowing) from None
        if found.status is not Status.CONVERGED:
            why = f"of the linearised contact problem, {found.status.value}, or the load is more than is borne"
            raise _Diverged(why, flowing)
        left = model.norms(residual - model.contact_load(found.forces))
        # each body by its own forces, and where it is unloaded by those it bore before
        if (left <= settings.relative_force * np.maximum(scale, memory.forces) + noise).all():
            # the dearer of the two criteria is asked last
            moved = _moves(linear, model.strain_of(change))
            largest = max(memory.stress, _root_mean_square(update.stress))
            floor = max(settings.floor_stress * largest, ROUND_OFF_STRAIN * linear.moduli.max())
            if (moved - settings.relative_stress * np.abs(update.stress)).max() <= floor:
                _check_small(strain)
                slow = settings.search == "tangent" or iteration > PATIENCE
                memory.linearisation = None if slow else linear
                memory.grow(scale, largest)
                gauss = GaussState(update.stress, update.state)
                found = found._replace(iterations=iteration)
                return found_as(found, goal.parameter, x, model.fields)._replace(time=goal.time, gauss=gauss)
        active = found.active
        x = x + change if mixing is None else mixing(x, change)
    moved = _moves(linear, model.strain_of(change)).max(axis=1)
    why = f"after {settings.iterations} iterations the stress still moves by {moved.max():.3g}"
    raise _Diverged(why, int(moved.argmax()))


def _elastic_start(model, here, theta):
    """The unknown if nothing flowed in the step.

    Imposed displacements move the boundary alone: left where they are, the points behind it would strain and flow by
    all of the motion, even a rigid one.
    """
    x, before = here.unknown, model.amplitudes(here.parameter)
    change = model.strain(x, theta) - model.strain(x, before)
    if not change.any():
        return x
    stress = here.state().stress + np.einsum("nij,nj->ni", model.material.elastic, change)
    residual, _ = model.residual(stress, theta)
    try:
        change, found = model.elastic.correct(residual, x, theta, here.active)
    except NotSolvableError:
        return x
    return x + change if found.status is Status.CONVERGED else x


def _check_small(strain):
    """A runaway is no answer: beyond its limit load a body is in balance to round-off, which grows with it."""
    sizes = np.abs(strain).max(axis=1)
    if sizes.max() > MOST_STRAIN:
        why = f"a strain of {sizes.max():.3g} is no small strain: the load is more than is borne"
        raise _Diverged(why, int(sizes.argmax()))


def _moves(linear: Linearisation, strain: np.ndarray) -> np.ndarray:
    """By how much the linearisation still moves the stress, |H : ε(δ)|, in the place of R_σ in (6.19)."""
    return np.abs(np.einsum("nij,nj->ni", linear.moduli, strain))


def _extrapolated(trail: tuple[Answer, ...], time: float) -> np.ndarray:
    """The polynomial through the unknowns of some answers, at a later time."""
    times = np.array([answer.time for answer in trail])
    x = np.zeros_like(trail[0].unknown)
    for k, answer in enumerate(trail):
        others = np.delete(times, k)
        x += np.prod((time - others) / (times[k] - others)) * answer.unknown
    return x
