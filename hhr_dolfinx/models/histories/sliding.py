"""Histories of elastic bodies with friction, whose state is their slip.

An increment goes from one point of a path to the next and slips in a straight line, backward Euler for the rate of
slip. A step that does not converge is halved. With a tolerance each step is solved as a whole and in two halves. The
difference of their forces and dissipated work is about the error of the halves; the step is cut until it is small. A
contact that closes within an increment sticks relative to the start of the increment, as a whole and in halves alike:
its sticking force counts as an error too.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from hhr_dolfinx.contact.active_set import Status
from hhr_dolfinx.contact.friction import Friction, SlipState
from hhr_dolfinx.contact.sliding_set import Increment, Sliding, SlidingContact
from hhr_dolfinx.errors import ConvergenceError, NotSolvableError, ParameterError
from hhr_dolfinx.memory import Memory
from hhr_dolfinx.models.answer import Answer, History, Path, outcome
from hhr_dolfinx.models.eliminations.elimination import CondensedContact
from hhr_dolfinx.models.gradient import Gradient
from hhr_dolfinx.models.histories.equilibrium import MarchSettings
from hhr_dolfinx.models.histories.far_sliding import FarSliding
from hhr_dolfinx.models.histories.path import check_settings
from hhr_dolfinx.models.histories.surfaces import surface_of
from hhr_dolfinx.one_thread import one_thread

PROPORTIONAL = 4
"""Increments from rest to a single parameter before any is cut: one and two may agree by chance."""
TOLERANCE = 1e-3
"""Error of forces allowed in increments to a single parameter, relative to the largest force."""
WORK = 1e-3
"""Part of the elastic energy of contact below which dissipated work counts as zero."""
APART = 1e-9
"""Part of the largest gap above which a contact is open."""
CUTS = 12
"""Largest number of times that a step is halved to meet a tolerance."""


class Reached(NamedTuple):
    """State of a history at the end of an increment."""

    point: np.ndarray
    time: float
    forces: np.ndarray
    active: np.ndarray | None
    gap: np.ndarray
    """Gaps of contacts with friction, (C,)."""
    slip: SlipState
    weights: np.ndarray
    """Derivative of each parameter here along that of the whole history, (P,)."""
    changes: np.ndarray
    """Derivatives of the position of tangential rows, (T, P)."""
    displacement: np.ndarray | None = None
    surface_forces: np.ndarray | None = None
    """Displacement of, and forces on, all dofs of surfaces, (n,), for surfaces that are paired again."""


class Target(NamedTuple):
    """End of an increment: time, point and weights as of :class:`Reached`."""

    time: float
    point: np.ndarray
    weights: np.ndarray

    def halfway(self, before: Reached) -> Target:
        """Midpoint between the present state of a history and this end."""
        return Target(
            0.5 * (before.time + self.time), 0.5 * (before.point + self.point), 0.5 * (before.weights + self.weights)
        )


class Solved(NamedTuple):
    """An increment: its solution, the state at its end, the contact problem there, and derivatives if requested."""

    found: Sliding
    reached: Reached
    contact: CondensedContact
    gradient: Gradient | None

    @property
    def settled(self) -> bool:
        """True if the increment converged."""
        return self.found.status is Status.CONVERGED


class Slider:
    """Solves increments of one model.

    Args:
        model: full or condensed, with a ``friction``, and ``contacts`` for the contact problem of each point.
        gradient: compute derivatives too.

    Attributes:
        friction: on the conditions of the model.
        surface: the whole contact surface, whose slip is stored.
        largest, energy: largest norm of forces, and elastic energy of contact, so far: the units of errors.
    """

    def __init__(self, model: Any, gradient: bool = False):
        self.model = model
        self.gradient = gradient
        self.friction: Friction = model.friction
        self.surface = surface_of(model)
        self._contact_at: Callable[[np.ndarray], CondensedContact] = model.contacts()
        self._sliding: SlidingContact | None = None
        self.largest = 0.0
        self.energy = 0.0

    def at_rest(self, time: float, point: np.ndarray, weights: np.ndarray) -> Reached:
        """Undeformed bodies without slip."""
        forces = np.zeros(self.model.own_conditions)
        changes = np.zeros((self.friction.tangential.size, point.size))
        gap = self._contact_at(point).free_slack[self.friction.normal]
        return Reached(point, time, forces, None, gap, SlipState.at_rest(self.surface.whole), weights, changes)

    def going_on(self, answer: Answer, weights: np.ndarray) -> Reached:
        """State after a step that the full model solved before."""
        schur = self._contact_at(answer.parameter).schur
        forces = answer.multipliers
        self.largest = max(self.largest, float(np.linalg.norm(forces)))
        self.energy = max(self.energy, 0.5 * float(forces @ (schur @ forces)))
        problem = self.model.problem.at(answer.parameter)
        slack = problem.gaps @ problem.amplitudes(answer.parameter) - problem.contact @ answer.unknown
        gap = slack[self.friction.normal]
        changes = np.zeros((self.friction.tangential.size, answer.parameter.size))
        return Reached(answer.parameter, answer.time, forces, answer.active, gap, answer.slip, weights, changes)

    def increment(self, before: Reached, target: Target) -> Solved:
        """Solve one increment; it may not converge."""
        time, point, weights = target
        contact = self._contact_at(point)
        of_motions = None if contact.floating is None else contact.floating.equalities.contact_of_motions
        if self._sliding is None or self._sliding.given is not contact.schur:
            self._sliding = SlidingContact(contact.schur, self.friction, of_motions)
        slack = contact.free_slack.copy()
        slack[self.friction.tangential] -= self.surface.position(before.slip)
        driving = np.zeros(0) if contact.floating is None else contact.floating.driving
        given = Increment(slack, *self.friction.bounds(point), driving)
        found = self._sliding.increment(given, before.forces, before.active)
        slip = self.surface.after(before.slip, given, found, partial(unknown_of, contact, found), point)
        gradient = None
        changes = before.changes
        if self.gradient and found.status is Status.CONVERGED:
            gradient = self._gradient(before, target, given, found, contact)
            changes = changes + np.where(
                found.active[self.friction.tangential, None], 0.0, gradient.slack[self.friction.tangential]
            )
        gap = found.slack[self.friction.normal]
        if found.status is Status.CONVERGED:
            self.largest = max(self.largest, float(np.linalg.norm(found.forces)))
        return Solved(
            found, Reached(point, time, found.forces, found.active, gap, slip, weights, changes), contact, gradient
        )

    def _gradient(
        self, before: Reached, target: Target, given: Increment, found: Sliding, contact: CondensedContact
    ) -> Gradient:
        """Derivatives of an increment at fixed statuses, also of the increments before."""
        assert self._sliding is not None
        floating = contact.floating
        unknown = unknown_of(contact, found)
        slack, of_unknown = (part * target.weights for part in contact.at_fixed_forces(found.forces, unknown))
        slack = slack.copy()
        slack[self.friction.tangential] -= before.changes
        bounds = [part * target.weights for part in self.friction.bound_slopes(target.point)]
        driving = np.zeros((0, slack.shape[1]))
        if floating is not None:
            driving = floating.drift(found.forces, unknown) * target.weights
        forces, motions = self._sliding.changes(given, found, slack, (bounds[0], bounds[1]), driving)
        slack = slack + self._sliding.schur @ forces - self._sliding.contact_of_motions @ motions
        slack[found.active] = 0.0
        of_unknown = of_unknown - contact.pushed(forces)
        if floating is not None:
            of_unknown = of_unknown + floating.modes @ motions
        return Gradient(of_unknown, forces, self._sliding.grazing(given, found), slack)

    def held(self, before: Reached, after: Reached) -> float:
        """Sticking force of contacts that closed in this increment; its reference is the start of the increment."""
        assert after.active is not None
        friction = self.friction
        # a contact that was closed at the start has no motion before its closing
        closed = after.active[friction.normal] & (before.gap > APART * np.abs(before.gap).max(initial=0.0))
        return float(np.linalg.norm(after.forces[friction.tangential][closed[friction.owner]]))

    def forces(self, solved: Solved) -> np.ndarray:
        """Forces by which two increments are compared, (M,)."""
        return solved.found.forces

    def elastic_energy(self, solved: Solved) -> float:
        """Elastic energy of contact forces."""
        forces = solved.found.forces
        return 0.5 * float(forces @ (solved.contact.schur @ forces))

    def answer(self, solved: Solved) -> Answer:
        """Answer of an increment."""
        found, reached, contact, gradient = solved
        return Answer(
            reached.point, unknown_of(contact, found), found.forces, found.active, found.iterations, found.status,
            found.sweeps > 0, self.model.fields, time=reached.time, gradient=gradient, memory=Memory(slip=reached.slip),
            undetermined=self._undetermined(contact, found),
        )  # fmt: skip

    def _undetermined(self, contact: CondensedContact, found: Sliding) -> np.ndarray | None:
        """Motions that neither closed nor sticking contacts hold, see :class:`Answer`; None if there are none."""
        floating = contact.floating
        if floating is None or found.status is not Status.CONVERGED:
            return None
        rows = self.friction.tangential
        pressures = found.forces.copy()
        pressures[rows] = 0.0
        holding = floating.equalities.bearing(pressures, contact.free_slack)
        holding[rows] = holding[self.friction.normal[self.friction.owner]] & found.active[rows]
        ways = floating.equalities.left_open(holding)
        return floating.modes @ ways if ways.shape[1] else None


def unknown_of(contact: CondensedContact, found: Sliding) -> np.ndarray:
    """The primal unknown under the forces of an increment, (n,)."""
    unknown = contact.unknown(found.forces)
    return unknown if contact.floating is None else unknown + contact.floating.modes @ found.motions


class _Step:
    """One step of a path, cut as often as necessary."""

    def __init__(
        self, slider: Slider, cuts: int, tolerance: float | None, watch: Callable[[Answer], None] | None = None
    ):
        self.slider = slider
        self.cuts = cuts
        self.tolerance = tolerance
        self.iterations = 0
        self.error = 0.0
        self.cycled = False
        self.ends: list[float] = []
        self._watch = watch

    def advance(self, before: Reached, target: Target, depth: int = 0, whole: Solved | None = None) -> Solved:
        """Solve the step and return its last increment; ``whole`` is the step as one increment if it is known."""
        if whole is None:
            whole = self._solved(before, target)
        if whole.found.status is Status.NOT_FINITE or (whole.settled and self.tolerance is None):
            return whole
        if depth >= (CUTS if whole.settled else self.cuts):
            return whole
        middle = target.halfway(before)
        half = self._solved(before, middle)
        if whole.settled and half.settled:
            second = self._solved(half.reached, target)
            error = self._difference(before, half, second, whole)
            if second.settled and (error <= (self.tolerance or 0.0) or depth + 1 >= CUTS):
                self.error += error
                self._ended(middle.time, half)
                return second
        first = self.advance(before, middle, depth + 1, half)
        if not first.settled:
            return first
        self._ended(middle.time, first)
        return self.advance(first.reached, target, depth + 1)

    def _difference(self, before: Reached, half: Solved, second: Solved, whole: Solved) -> float:
        """Error of a step in two halves: of forces over the largest so far, of work over the dissipated work."""
        slider = self.slider
        closing = np.linalg.norm([slider.held(before, half.reached), slider.held(half.reached, second.reached)])
        off = np.linalg.norm(slider.forces(second) - slider.forces(whole)) + closing
        work = float(second.reached.slip.work.sum())
        change = abs(work - float(whole.reached.slip.work.sum()))
        return max(float(off) / (slider.largest or 1.0), change / (work + WORK * slider.energy or 1.0))

    def _ended(self, time: float, part: Solved) -> None:
        """Report an increment within the step, at a time."""
        self.ends.append(time)
        if self._watch is not None:
            self._watch(self.slider.answer(part))

    def _solved(self, before: Reached, target: Target) -> Solved:
        solved = self.slider.increment(before, target)
        if self.tolerance is not None and solved.settled:
            self.slider.energy = max(self.slider.energy, self.slider.elastic_energy(solved))
        self.iterations += solved.found.iterations
        self.cycled |= solved.found.sweeps > 0
        return solved


@one_thread
def slide_along(
    model: Any,
    path: Path,
    settings: MarchSettings,
    *,
    weights: np.ndarray | None = None,
    known: Sequence[Answer] = (),
    keep: Callable[[Answer], None] = lambda answer: None,
    watch: Callable[[Answer], None] | None = None,
) -> History:
    """History of elastic bodies with friction from rest, undeformed, at the first time of the path.

    Args:
        model: see :class:`Slider`.
        path: as :func:`~hhr_dolfinx.models.histories.path.checked_path` returns it.
        settings: ``cuts``, ``time_tolerance``, ``outside`` and ``gradient`` count.
        weights: derivatives of the parameters at each time of the path along those of the whole history, (times, P). 1
            by default: each parameter is shifted by the same at all times.
        known, keep: see :meth:`FullOrderModel.march`; known steps have no derivatives.
        watch: called with the answer of each increment, also of the parts of a step.
    """
    check_settings(settings)
    _check_shape(model, path)
    history = History(*path[0], time_tolerance=settings.time_tolerance)
    slider = model.slider(settings)
    weights = np.ones((len(path), path[0][1].size)) if weights is None else weights
    reached = slider.at_rest(*path[0], weights[0])
    error = 0.0
    warned = False
    far = FarSliding()
    try:
        for number, ((time, point), weight) in enumerate(zip(path[1:], weights[1:], strict=True)):
            if number < len(known) and not settings.gradient:
                answer = known[number]
                reached = slider.going_on(answer, weight)
                far.check(slider.surface.whole, reached.slip, model.parameters.described(point))
                error = answer.time_error
                history.cuts += answer.parts > 1
                history.answers.append(answer)
                continue
            model.check_range(point, settings.outside)
            step = _Step(slider, settings.cuts, settings.time_tolerance, watch)
            solved = step.advance(reached, Target(time, point, weight))
            reached = solved.reached
            far.check(slider.surface.whole, reached.slip, model.parameters.described(point))
            error += np.nan if settings.time_tolerance is None else step.error
            answer = _checked_answer(slider, step, solved)._replace(time_error=error)
            if answer.undetermined is not None and not warned:  # once for a path
                warned = True
                model.warn_undetermined(answer)
            if watch is not None:
                watch(answer)
            history.cuts += answer.parts > 1
            history.answers.append(answer)
            keep(answer)
    except BaseException as stop:
        with suppress(AttributeError):
            stop.history = history  # type: ignore[attr-defined]
        raise
    return history


def _check_shape(model: Any, path: Path) -> None:
    """Refuse a checked path along which bodies change their shape: slip is measured on one.

    Raises:
        ParameterError: with the parameter that changes.
    """
    points = np.array([point for _, point in path])
    for place in model.friction.shaped.tolist():
        if np.ptp(points[:, place]) > 0:
            raise ParameterError(
                f"{model.parameters.names[place]} changes along the path, and the shape of bodies depends on it: what "
                "slips is measured on one shape. Keep it as it is along the path"
            )


def _checked_answer(slider: Slider, step: _Step, solved: Solved) -> Answer:
    """Answer at the end of a step; raises an error without one."""
    answer = slider.answer(solved)._replace(iterations=step.iterations, cycled=step.cycled, ends=tuple(step.ends))
    found = solved.found
    advice = dict(slider.model.advice)
    if found.status is Status.ADRIFT:
        advice[found.status] = "friction does not bear its loads, or nothing presses on it"
    elif found.unsettled.size:
        advice[found.status] = f"conditions {found.unsettled[:8].tolist()} keep changing"
    try:
        return outcome(answer, True, advice)
    except (ConvergenceError, NotSolvableError) as error:
        vars(error)["status"] = answer.status
        raise


def proportional(model: Any, point: np.ndarray, raise_on_failure: bool, outside: str, gradient: bool) -> Answer:
    """Answer to a checked point, (P,), loaded in proportion from rest, where the box is nearest to zero.

    Moduli, shapes and friction are those of the point throughout. Increments are cut until forces have converged to
    :data:`TOLERANCE`; ``time_error`` has the remaining error.
    """
    space = model.parameters
    start = np.clip(0.0, space.lower, space.upper)
    fixed = model.friction.fixed
    start[fixed] = point[fixed]
    shares = np.linspace(0.0, 1.0, PROPORTIONAL + 1)
    path = [(float(share), start + share * (point - start)) for share in shares]
    path[-1] = (1.0, point)
    weights = np.tile(shares[:, None], point.size)
    weights[:, fixed] = 1.0
    settings = MarchSettings(time_tolerance=TOLERANCE, outside="ignore")
    model.check_range(point, outside)
    try:
        history = model.slide(path, settings)
        error = history.answers[-1].time_error
        if gradient:  # on the parts that the tolerance required
            path, weights = _parted(history, path, weights)
            settings = MarchSettings(outside="ignore", gradient=True)
            history = model.answering(history).slide(path, settings, weights=weights)
    except (ConvergenceError, NotSolvableError) as error:
        if raise_on_failure:
            raise
        return model.unanswered(point, vars(error).get("status", Status.UNSETTLED))
    answer = history.answers[-1]
    return answer._replace(
        iterations=sum(history.iterations), cycled=any(one.cycled for one in history.answers), time=np.nan, ends=(),
        time_error=error,
    )  # fmt: skip


def _parted(history: History, path: Path, weights: np.ndarray) -> tuple[Path, np.ndarray]:
    """A path of load shares with all parts of its steps, and the weights there."""
    parts = history.solved_path
    shares = np.array([time for time, _ in parts])
    known = np.array([time for time, _ in path])
    return parts, np.column_stack([np.interp(shares, known, column) for column in weights.T])
