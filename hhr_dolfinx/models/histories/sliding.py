"""Histories of elastic bodies with friction: what has slipped is their memory.

An increment goes from one point of a path to the next and slips in a straight line, backward Euler for the rate of
slip. A step that does not settle is halved. With a tolerance each step is solved at once and in two halves, whose
forces differ by about what those of the halves are off, and is cut until that is small enough.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any, NamedTuple

import numpy as np
from threadpoolctl import threadpool_limits

from hhr_dolfinx.contact.active_set import Status
from hhr_dolfinx.contact.friction import Friction, SlipState
from hhr_dolfinx.contact.sliding_set import Increment, Sliding, SlidingContact
from hhr_dolfinx.errors import ConvergenceError, NotSolvableError
from hhr_dolfinx.models.answer import Answer, History, Path, outcome, unanswered
from hhr_dolfinx.models.eliminations.elimination import CondensedContact
from hhr_dolfinx.models.histories.equilibrium import MarchSettings
from hhr_dolfinx.models.histories.path import check_settings

PROPORTIONAL = 4
"""Increments from rest to a single parameter before any is cut: one and two of a single step may agree by chance."""
TOLERANCE = 1e-3
"""Error of forces that increments to a single parameter may make, relative to the largest force."""
CUTS = 12
"""How often a step may be halved for the sake of a tolerance."""


class _Reached(NamedTuple):
    """Where a history has come to."""

    point: np.ndarray
    time: float
    forces: np.ndarray
    slip: SlipState


class Slider:
    """Solves increments of one model.

    Args:
        model: full or condensed, with a ``friction``, and a ``contact_at`` for the contact problem of a point.
    """

    def __init__(self, model: Any):
        self.model = model
        self.friction: Friction = model.friction
        self._sliding: SlidingContact | None = None

    def at_rest(self, time: float, point: np.ndarray) -> _Reached:
        """Undeformed bodies, of which nothing has slipped."""
        return _Reached(point, time, np.zeros(self.model.own_conditions), SlipState.at_rest(self.friction))

    def increment(self, before: _Reached, time: float, point: np.ndarray) -> tuple[Sliding, _Reached, CondensedContact]:
        """One increment, settled or not."""
        contact: CondensedContact = self.model.contact_at(point)
        taken = None if contact.floating is None else contact.floating.equalities.taken
        if self._sliding is None or self._sliding.schur is not contact.schur:
            self._sliding = SlidingContact(contact.schur, self.friction, taken)
        slack = contact.free_slack.copy()
        slack[self.friction.tangential] -= before.slip.position
        driving = np.zeros(0) if contact.floating is None else contact.floating.driving
        given = Increment(slack, *self.friction.bounds(point), driving)
        found = self._sliding.increment(given, before.forces)
        slip = before.slip.after(self.friction, found.forces, found.slack, found.active)
        return found, _Reached(point, time, found.forces, slip), contact

    def answer(self, found: Sliding, reached: _Reached, contact: CondensedContact) -> Answer:
        """What is handed out of an increment."""
        unknown = contact.unknown(found.forces)
        if contact.floating is not None:
            unknown = unknown + contact.floating.modes @ found.motions
        return Answer(
            reached.point, unknown, found.forces, found.active, found.iterations, found.status, found.sweeps > 0,
            self.model.fields, time=reached.time, slip=reached.slip,
        )  # fmt: skip


class _Step:
    """One step of a path, cut as far as it must be."""

    def __init__(self, slider: Slider, cuts: int, tolerance: float | None, largest: float):
        self.slider = slider
        self.cuts = cuts
        self.tolerance = tolerance
        self.largest = largest
        self.iterations = 0
        self.error = 0.0
        self.cycled = False
        self.ends: list[float] = []

    def taken(self, before: _Reached, time: float, point: np.ndarray, depth: int = 0) -> tuple[Sliding, Any, Any]:
        """The last increment of the step."""
        whole = self._solved(before, time, point)
        settled = whole[0].status is Status.CONVERGED
        if whole[0].status is Status.NOT_FINITE or (settled and self.tolerance is None):
            return whole
        if depth >= (self.cuts if not settled else CUTS):
            return whole
        middle = 0.5 * (before.time + time), 0.5 * (before.point + point)
        half = self._solved(before, *middle)
        if settled and half[0].status is Status.CONVERGED:
            second = self._solved(half[1], time, point)
            if second[0].status is Status.CONVERGED:
                self.largest = max(self.largest, float(np.linalg.norm(second[0].forces)))
                error = np.linalg.norm(second[0].forces - whole[0].forces) / (self.largest or 1.0)
                if error <= (self.tolerance or 0.0):
                    self.error += float(error)
                    self.ends.append(middle[0])
                    return second
        first = self.taken(before, *middle, depth + 1)
        if first[0].status is not Status.CONVERGED:
            return first
        self.ends.append(middle[0])
        return self.taken(first[1], time, point, depth + 1)

    def _solved(self, before: _Reached, time: float, point: np.ndarray) -> tuple[Sliding, _Reached, CondensedContact]:
        found = self.slider.increment(before, time, point)
        self.iterations += found[0].iterations
        self.cycled |= found[0].sweeps > 0
        return found


@threadpool_limits.wrap(limits=1, user_api="blas")
def slide_along(
    model: Any,
    path: Path,
    settings: MarchSettings,
    *,
    known: Sequence[Answer] = (),
    keep: Callable[[Answer], None] = lambda answer: None,
) -> History:
    """A history of elastic bodies with friction, from rest, undeformed, at the first time of the path.

    Args:
        model: see :class:`Slider`.
        path: as :func:`~hhr_dolfinx.models.histories.path.checked_path` returns it.
        settings: of which ``cuts``, ``time_tolerance`` and ``outside`` count.
        known, keep: see :meth:`FullOrderModel.march`.
    """
    check_settings(settings)
    history = History(*path[0], time_tolerance=settings.time_tolerance)
    slider = Slider(model)
    reached = slider.at_rest(*path[0])
    largest = 0.0
    error = 0.0
    try:
        for number, (time, point) in enumerate(path[1:]):
            if number < len(known):
                answer = known[number]
            else:
                model.check_range(point, settings.outside)
                answer = _stepped(slider, reached, time, point, settings, largest)
                answer = answer._replace(time_error=error + answer.time_error)
                keep(answer)
            assert answer.slip is not None
            reached = _Reached(point, time, answer.multipliers, answer.slip)
            largest = max(largest, float(np.linalg.norm(answer.multipliers)))
            error = answer.time_error
            history.cuts += answer.parts > 1
            history.answers.append(answer)
    except BaseException as stop:
        with suppress(AttributeError):
            stop.history = history  # type: ignore[attr-defined]
        raise
    return history


def _stepped(
    slider: Slider, reached: _Reached, time: float, point: np.ndarray, settings: MarchSettings, largest: float
) -> Answer:
    """The answer at the end of a step; an error where there is none."""
    step = _Step(slider, settings.cuts, settings.time_tolerance, largest)
    found, there, contact = step.taken(reached, time, point)
    answer = slider.answer(found, there, contact)._replace(
        iterations=step.iterations, cycled=step.cycled, ends=tuple(step.ends),
        time_error=np.nan if settings.time_tolerance is None else step.error,
    )  # fmt: skip
    advice = dict(slider.model.advice)
    if found.unsettled.size:
        advice[found.status] = f"conditions {found.unsettled[:8].tolist()} keep changing"
    return outcome(answer, True, advice)


def proportional(model: Any, point: np.ndarray, raise_on_failure: bool, outside: str) -> Answer:
    """The answer to a checked point, (P,), loaded in proportion from rest where the box is nearest to zero.

    Moduli, shapes and friction are those of the point all along. Increments are cut until forces have settled to
    :data:`TOLERANCE`; ``time_error`` says what is left.
    """
    space = model.parameters
    start = np.clip(0.0, space.lower, space.upper)
    fixed = model.friction.fixed
    start[fixed] = point[fixed]
    shares = np.linspace(0.0, 1.0, PROPORTIONAL + 1)
    path = [(float(share), start + share * (point - start)) for share in shares]
    path[-1] = (1.0, point)
    settings = MarchSettings(time_tolerance=TOLERANCE, outside="ignore")
    model.check_range(point, outside)
    try:
        history = slide_along(model, path, settings)
    except (ConvergenceError, NotSolvableError):
        if raise_on_failure:
            raise
        return unanswered(point, model.sizes, model.fields, Status.UNSETTLED)
    answer = history.answers[-1]
    return answer._replace(
        iterations=sum(history.iterations), cycled=any(one.cycled for one in history.answers), time=np.nan, ends=()
    )
