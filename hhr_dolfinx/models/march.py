"""Quasi-static histories of contact between bodies that flow, thesis Alg. 6.1 and 6.2: one loop for full and reduced.

Each iteration linearises the stress, solves the contact problem of that linearisation to the end, (6.16) or (6.17), and
updates the material. The operator of the linearisation is the consistent tangent, or the elastic one (6.21) with
Anderson's acceleration. A step that does not converge is tried with new tangents in each iteration, then cut in halves;
nothing unconverged is ever kept.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass, field, replace
from numbers import Real
from typing import NamedTuple

import numpy as np
from threadpoolctl import threadpool_limits

from hhr_dolfinx.contact.problem import Status
from hhr_dolfinx.errors import ConvergenceError, LawWarning, NotSolvableError, ParameterError
from hhr_dolfinx.linear.anderson import Anderson
from hhr_dolfinx.materials.update import State
from hhr_dolfinx.models.equilibrium import Equilibrium, Operator
from hhr_dolfinx.parameters import is_whole
from hhr_dolfinx.trained import OUTSIDE, Signs, Watch

SEARCHES = ("tangent", "frozen", "elastic")
ROUND_OFF_STRAIN = 1e-13
"""A strain this small is round-off of displacements that strain nothing, as where a gap closes without stress."""
MOST_STRAIN = 100.0
"""A strain this large is a runaway, whatever the residual. At the corner of a punch single points reach a few units."""
PATIENCE = 5
"""A frozen tangent is kept for the next step if this one took no more iterations."""


@dataclass(frozen=True)
class MarchSettings:
    """How histories are solved.

    Attributes:
        search: operator of the linearisation: ``tangent``, renewed in each iteration; ``frozen``, the tangent at the
            start of each step; ``elastic``. The latter two with Anderson's acceleration.
        relative_stress: ε_r of (6.19). In the place of R_σ (6.18), by which a prediction was wrong, stands what the
            next one still moves, H : ε(δ).
        floor_stress: ε_a of (6.19) as a fraction of the largest root mean square of the stress so far, without a unit.
        relative_force: residual over the size of the forces; the stress criterion alone sees only how much
            iterates still change.
        iterations: most iterations of a step before it is cut.
        cuts: how often a step may be halved.
        outside: what happens to a step outside what a reduced model was trained on: ``warn``, ``refuse`` or ``ignore``.
    """

    search: str = "frozen"
    relative_stress: float = 1e-5
    floor_stress: float = 5e-3
    relative_force: float = 1e-5
    iterations: int = 60
    cuts: int = 6
    outside: str = "warn"

    def __post_init__(self):
        """Refuse what would be taken for something else, or would never end a step.

        Raises:
            ParameterError: with the value and what is possible.
        """
        for name, choices in (("search", SEARCHES), ("outside", OUTSIDE)):
            if getattr(self, name) not in choices:
                raise ParameterError(f"{name} '{getattr(self, name)}' is unknown, one of {', '.join(choices)}")
        for name in ("relative_stress", "floor_stress", "relative_force"):
            if not (isinstance(getattr(self, name), Real) and 0 < getattr(self, name) < 1):
                raise ParameterError(f"{name} = {getattr(self, name)} must be a fraction in (0, 1)")
        if not (is_whole(self.iterations, 1) and is_whole(self.cuts, 0)):
            raise ParameterError(
                f"iterations = {self.iterations} must be a whole number from 1, and cuts = {self.cuts} one from 0"
            )


class Point(NamedTuple):
    """The model at one time.

    Attributes:
        time: in seconds.
        parameter: mu, (P,).
        unknown: U0 or gamma.
        forces: contact forces.
        active: statuses.
        stress: at the Gauss points, (points, components).
        state: of the material.
    """

    time: float
    parameter: np.ndarray
    unknown: np.ndarray
    forces: np.ndarray
    active: np.ndarray
    stress: np.ndarray
    state: State


@dataclass
class History:
    """A solved history; what converged before a failure is kept in the error's ``history``.

    Attributes:
        start: time at rest, in seconds.
        parameter: the parameter there, (P,).
        points: one per step asked for, the start not among them.
        signs: of each step, by which a reduced model tells that it left what it was trained on.
        iterations: of each step, those of its parts summed; a failed attempt counts as the most allowed.
        cuts: steps that were solved in parts.
    """

    start: float
    parameter: np.ndarray
    points: list[Point] = field(default_factory=list)
    signs: list[Signs] = field(default_factory=list)
    iterations: list[int] = field(default_factory=list)
    cuts: int = 0

    @property
    def path(self) -> list[tuple[float, np.ndarray]]:
        """Times and parameters, the start first: what :func:`march` was given."""
        return [(self.start, self.parameter), *((point.time, point.parameter) for point in self.points)]


class _Diverged(Exception):
    """A step did not converge: why, and the Gauss point that moves or flows most, if that is known."""

    def __init__(self, why, worst=None):
        super().__init__(why)
        self.worst = worst


# threads of BLAS slow small blocks down: a projected tangent of 70 modes took 7.8 ms on two of them, 3.1 ms on one
@threadpool_limits.wrap(limits=1, user_api="blas")
def march(
    model: Equilibrium, path: Iterable[tuple[float, np.ndarray]], settings: MarchSettings = MarchSettings()
) -> History:
    """Solve a history from rest.

    Args:
        model: full or reduced.
        path: times and parameters, the first ones at rest; parameters are linear between them.
        settings: how.

    Raises:
        ParameterError: if the path is empty, a parameter is not finite or outside the box, or times do not increase.
        OutsideTrainingError: if a step is outside what was trained, and ``settings`` say to refuse that.
        ConvergenceError: with the step, the time and the worst point.
        Whatever ends a history, an interrupt from the keyboard too, has an attribute ``history`` with the steps before.

    Warns:
        OutsideTrainingWarning: if a step is outside what was trained, and ``settings`` do not say otherwise.
        LawWarning: if the slope of a law is not the derivative of its flow.
    """
    path = _checked(model, path)
    time, start = path[0]
    history = History(time, start)
    try:
        with model.lock:
            _march(model, path, settings, history)
    except _Diverged as failure:
        step = len(history.points) + 1
        error = ConvergenceError(
            f"step {step} to t = {path[step][0]:g} s did not converge: {failure}{_place(model, failure.worst)}. "
            f"Take smaller steps; the {step - 1} steps before are kept"
        )
        error.history = history
        raise error from None
    except BaseException as stop:  # a law may raise anything, and a user may stop it
        with suppress(AttributeError):
            stop.history = history
        raise
    return history


def _checked(model, path) -> list[tuple[float, np.ndarray]]:
    """The whole path, before any of it is solved."""
    if not hasattr(model, "material"):
        raise ParameterError(f"{model} has no laws to march with: give a PlasticFullOrder, or the model of a reduction")
    try:
        pairs = [(float(time), target) for time, target in path]
    except (TypeError, ValueError):
        raise ParameterError("a path is a list of pairs: a time in seconds and the parameters there") from None
    path = [(time, model.parameters.point(target)) for time, target in pairs]
    if not path:
        raise ParameterError("the path is empty: its first time and parameter are where the model is at rest")
    times = np.array([time for time, _ in path])
    if not np.isfinite(times).all():
        raise ParameterError(f"times must be finite, and number {int(np.argmin(np.isfinite(times)))} is not")
    late = np.flatnonzero(np.diff(times) <= 0)
    if late.size:
        before, after = times[late[0] : late[0] + 2]
        raise ParameterError(f"times must increase: {after:g} s comes after {before:g} s")
    return path


def _march(model, path, settings, history) -> None:
    """Solve the steps of a checked path into a history."""
    trail, slopes_seen = (_at_rest(model, *path[0]),), False
    kept, watch = _Kept(), Watch(model.trained, settings.outside)
    for number, (time, target) in enumerate(path[1:], start=1):
        watch.before(number, trail[-1].time, time, trail[-1].parameter, target)
        after, iterations, cut = _advance(model, trail, _Goal(time, target), settings, kept)
        slopes_seen = slopes_seen or _check_slopes(model, trail[-1], after)
        signs = model.signs(after)
        # a step that is refused is not kept
        watch.after(number, time, signs)
        history.points.append(after)
        history.signs.append(signs)
        history.iterations.append(iterations)
        history.cuts += cut
        trail = (*trail[-2:], after)


def _check_slopes(model, before, after) -> bool:
    """Warn of laws with a wrong slope; whether the step flowed enough to tell."""
    if not after.state.cumulated.max(initial=0.0) > 0:
        return False
    strain = model.strain(after.unknown, model.amplitudes(after.parameter))
    complaints = model.material.wrong_slopes(strain, before.state, after.time - before.time)
    for complaint in complaints or ():
        warnings.warn(complaint, LawWarning, stacklevel=4)
    return complaints is not None


class _Goal(NamedTuple):
    """Time and parameter to reach."""

    time: float
    parameter: np.ndarray


def _at_rest(model, time, parameter) -> Point:
    active, material = np.zeros(model.conditions, dtype=bool), model.material
    stress = np.zeros((material.gauss_points, material.components))
    return Point(time, parameter, np.zeros(model.size), np.zeros(active.size), active, stress, material.at_rest())


def _place(model, worst):
    """Where in the full mesh a Gauss point of the model lies, in words."""
    if worst is None:
        return ""
    number = int(model.points[worst])
    return f"; worst at Gauss point {number}, in cell {number // model.operator.per_cell}"


def _advance(model, trail, goal, settings, kept):
    """One step as asked for, then in 2, 4, ... parts, each of which is tried like a step of its own.

    Args:
        model: full or reduced.
        trail: the last points, at most three, the present one at the end.
        goal: where to.
        settings: how.
        kept: what one step leaves to the next.

    Returns:
        The point reached, the iterations of all attempts, and whether the step was cut.
    """
    here, spent = trail[-1], 0
    for parts in (2**halvings for halvings in range(settings.cuts + 1)):
        last = trail
        try:
            for share in np.arange(1, parts + 1) / parts:
                time = here.time + share * (goal.time - here.time)
                part = _Goal(time, (1 - share) * here.parameter + share * goal.parameter)
                after, iterations = _tried(model, last, part, settings, kept)
                spent += iterations
                last = (*last[-2:], after)
            return after, spent, parts > 1
        except _Diverged as error:
            failure = error
            spent += settings.iterations
    raise failure


def _tried(model, trail, goal, settings, kept) -> tuple[Point, int]:
    """A step from the extrapolation of the points before; if that fails, with new tangents from an elastic start."""
    careful = replace(settings, search="tangent") if settings.search == "frozen" else settings
    try:
        return _step(model, trail, goal, settings, kept)
    except (_Diverged, ConvergenceError):
        kept.operator = None
    try:
        after, iterations = _step(model, trail[-1:], goal, careful, kept)
    except ConvergenceError as error:
        kept.operator = None
        raise _Diverged(str(error)) from error
    except _Diverged:
        kept.operator = None
        raise
    return after, settings.iterations + iterations


@dataclass
class _Kept:
    """The operator of the last step, if it served well, and the largest forces and stress (mean square) so far."""

    operator: Operator | None = None
    forces: np.ndarray | float = 0.0
    stress: float = 0.0


def _step(model, trail, goal, settings, kept) -> tuple[Point, int]:
    """One step from the end of ``trail``: from the extrapolation of its points, or an elastic start from one point."""
    here, dt = trail[-1], goal.time - trail[-1].time
    theta = model.amplitudes(goal.parameter)
    x = _extrapolated(trail, goal.time) if len(trail) > 1 else _elastic_start(model, here, theta)
    flows = model.material.flows and settings.search != "elastic"
    mixing = Anderson() if model.material.flows and settings.search != "tangent" else None
    active, operator, noise = here.active, kept.operator if flows else model.elastic, model.round_off(x, theta)
    for iteration in range(1, settings.iterations + 1):
        renew = flows and (operator is None or settings.search == "tangent")
        strain = model.strain(x, theta)
        update = model.material.update(strain, here.state, dt, tangent=renew)
        if not np.isfinite(update.stress).all():
            raise _Diverged("the stress is not finite", int(np.argmin(np.isfinite(update.stress).all(axis=1))))
        residual, scale = model.residual(update.stress, theta)
        flowing = int((update.state.cumulated - here.state.cumulated).argmax())
        try:
            operator = model.linearised(update.tangents) if renew else operator
            correction = operator.correct(residual, x, theta, active)
        except (NotSolvableError, np.linalg.LinAlgError) as error:
            raise _Diverged(f"{error}, a singular tangent", flowing) from None
        if correction.status is not Status.CONVERGED:
            why = f"of the linearised contact problem, {correction.status.value}, or the load is more than is borne"
            raise _Diverged(why, flowing)
        left = model.norms(residual - model.contact_load(correction.forces))
        # each body by its own forces, and where it is unloaded by those it bore before
        if (left <= settings.relative_force * np.maximum(scale, kept.forces) + noise).all():
            # the dearer of the two criteria is asked last
            moved = _moves(operator, model.strain_of(correction.change))
            largest = max(kept.stress, float(np.sqrt(np.mean(update.stress**2))))
            floor = max(settings.floor_stress * largest, ROUND_OFF_STRAIN * operator.moduli.max())
            if (moved - settings.relative_stress * np.abs(update.stress)).max() <= floor:
                _check_small(strain)
                slow = settings.search == "tangent" or iteration > PATIENCE
                kept.operator = None if slow else operator
                kept.forces, kept.stress = np.maximum(scale, kept.forces), largest
                answer = correction.forces, correction.active, update.stress, update.state
                return Point(*goal, x, *answer), iteration
        active = correction.active
        x = x + correction.change if mixing is None else mixing(x, correction.change)
    moved = _moves(operator, model.strain_of(correction.change)).max(axis=1)
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
    stress = here.stress + np.einsum("nij,nj->ni", model.material.elastic, change)
    residual, _ = model.residual(stress, theta)
    try:
        correction = model.elastic.correct(residual, x, theta, here.active)
    except NotSolvableError:
        return x
    return x + correction.change if correction.status is Status.CONVERGED else x


def _check_small(strain):
    """Refuse a runaway: beyond its limit load a body is in balance to round-off, which grows with the displacement."""
    sizes = np.abs(strain).max(axis=1)
    if sizes.max() > MOST_STRAIN:
        why = f"a strain of {sizes.max():.3g} is no small strain: the load is more than is borne"
        raise _Diverged(why, int(sizes.argmax()))


def _moves(operator, strain):
    """By how much the linearisation still moves the stress, |H : ε(δ)|, in the place of R_σ in (6.19)."""
    return np.abs(np.einsum("nij,nj->ni", operator.moduli, strain))


def _extrapolated(points, time):
    """The polynomial through the unknowns of the given points, at a later time."""
    times = np.array([point.time for point in points])
    x = np.zeros_like(points[0].unknown)
    for k, point in enumerate(points):
        others = np.delete(times, k)
        x += np.prod((time - others) / (times[k] - others)) * point.unknown
    return x
