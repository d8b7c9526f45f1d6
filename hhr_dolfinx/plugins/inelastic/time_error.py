"""Error of the time steps of a history, from a second solution in steps of another length.

Steps controlled by it.

Implicit Euler's rule and the return mappings of laws without rates are of first order in the length
of the steps. So if y_h is the solution in steps of some lengths and y_h/2 that in their halves,
both along the whole path, the errors are about 2 (y_h - y_h/2) and y_h - y_h/2: Richardson's
extrapolation, applied to whole histories (E. Hairer, S. P. Norsett, G. Wanner, Solving Ordinary
Differential Equations I, section II.4). Errors of earlier steps are carried to later ones by both
solutions themselves, so that this needs no property of a law. The estimate has a norm for each of
stress, displacement and contact forces, over the largest norm of that field so far.

Without a tolerance the answers are y_h, and the halves are solved beside them: twice the work of
the history is added. With a tolerance the answers are y_h/2. Each part is solved as a whole from
the same state too, and the difference of both, the error that the part adds, controls its length;
that is twice the work of the answers, and attempts that are discarded. docs/flow.md has a table of
estimates over true errors, which ``make time-errors`` measures.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from hhr_dolfinx.errors import ConvergenceError, NotSolvableError, SceneError, SmallStrainWarning
from hhr_dolfinx.models.answer import Answer
from hhr_dolfinx.models.histories.equilibrium import MarchSettings
from hhr_dolfinx.plugins.inelastic.equilibrium import Diverged, Goal, MaterialEquilibrium, Stepper
from hhr_dolfinx.plugins.inelastic.state import state as gauss_of
from hhr_dolfinx.warn import ignored

RICHARDSON_FACTOR = 1.25
"""Factor over Richardson's estimate, which is too small where steps are too long to be of first
order: without it the estimates in the table of docs/flow.md are down to 0.85 of the true errors.
"""
SAFETY = 0.8
"""Part of the allowed error at which the next part of a step aims."""
LEAST_GROWTH = 0.1
"""Least factor from one part of a step to the next."""
MOST_GROWTH = 4.0
"""Largest factor from one part of a step to the next."""
EARLY = 2
"""Steps in which the estimate may grow to half of the tolerance; in n steps to n / (n + 2) of
it.
"""
LATE = 20
"""Steps in which an estimate that has used up the tolerance may grow by as much again."""
NEGLIGIBLE_TIME_ERROR = 3e-3
"""Part of the tolerance that any part of a step may add, however short: steps are solved more
accurately than that.
"""
STEP_TOLERANCES = {"floor_stress": 1e-4, "relative_stress": 1e-4, "relative_force": 1e-4}
"""Largest tolerances of the solution of a step, over the time tolerance: with the default ones two
solutions differed by 2e-5 however short a step was.
"""
CONTROLLED = 2
"""Fields that a tolerance controls, the first ones: forces are large beside the largest so far
where contact begins.
"""
MOST_PARTS = 10_000
"""Parts of one step of a path above which a tolerance is out of reach."""

SHORTEST = 1e-9
"""Part of a step that counts as no part of it."""

Trail = tuple[Answer, ...]


class TimeErrors(NamedTuple):
    """Estimated errors of the time steps, each relative to the largest norm of its field so far."""

    stress: float  #: where the model evaluates its laws
    displacement: float  #: on the whole mesh
    forces: float  #: on the contact conditions of the model


def tightened(settings: MarchSettings) -> MarchSettings:
    """Settings of a solution in time that are small enough for its time tolerance, if it has
    one.
    """
    tolerance = settings.time_tolerance
    if tolerance is None:
        return settings
    values: Any = {
        name: min(getattr(settings, name), factor * tolerance)
        for name, factor in STEP_TOLERANCES.items()
    }
    return replace(settings, **values)


class SecondSolution:
    """Second solution of one history: in halves of its steps, or in whole steps if a tolerance
    makes it take halves.
    """

    def __init__(self, model: MaterialEquilibrium, settings: MarchSettings, rest: Answer):
        self._model = model.alongside()
        self._stepper = self._model.stepper(tightened(settings))
        self._in_halves = settings.time_tolerance is None
        self._trail: Trail = (rest,)
        self._behind = list[tuple[Answer, Answer, bool]]()
        self._lost = False
        self._errors = np.zeros(
            len(TimeErrors._fields)
        )  # norms of the difference of both solutions
        self.largest = np.zeros(len(TimeErrors._fields))  # norms of the fields so far

    def follow(self, before: Answer, after: Answer, turned: bool) -> None:
        """Note a step of the history; it is solved when needed.

        Args:
            before: answer at its start.
            after: answer at its end.
            turned: True if the path turns at its start, which is elastic then.
        """
        self._behind.append((before, after, turned))

    def errors(self) -> TimeErrors:
        """Estimated errors of the history so far.

        NaN after a step that the second solution did not solve.
        """
        for before, after, turned in self._behind:
            self._trail = self._trail[-1:] if turned else self._trail
            try:
                ends = [] if self._lost else self.advanced(self._trail, self._goals(before, after))
            except (Diverged, ConvergenceError, NotSolvableError, SceneError):
                ends = []
            self._lost = not ends
            if ends:
                self._trail = (*self._trail, *ends)[-3:]
                self._errors = self.norms(after, ends[-1])
                self.largest = np.maximum(self.largest, self.norms(after))
        self._behind.clear()
        times = math.nan if self._lost else RICHARDSON_FACTOR * (2.0 if self._in_halves else 1.0)
        return TimeErrors(*(times * relative(self._errors, self.largest)).tolist())

    def advanced(self, trail: Trail, goals: Sequence[Goal]) -> list[Answer]:
        """Answers from the end of a trail up to some goals; Diverged without them."""
        answers = list[Answer]()
        with ignored(SmallStrainWarning):  # the history itself warns
            for goal in goals:
                answers += self._stepper.advance((*trail, *answers)[-3:], goal)
        return answers

    def attempt(
        self, stepper: Stepper, trail: Trail, goal: Goal
    ) -> tuple[list[Answer], list[Answer]]:
        """Solve a part of a step of the history as a whole, and in halves by its stepper.

        Args:
            stepper: solves the halves.
            trail: last answers, at most three, the present one last.
            goal: end of the part.

        Returns:
            The answers of both.
        """
        undivided = self.advanced(trail, [goal])
        halves = list[Answer]()
        for end in halved(trail[-1], [Goal(answer.time, answer.parameter) for answer in undivided]):
            halves += stepper.advance((*trail, *halves)[-3:], end)
        return undivided, halves

    def _goals(self, before: Answer, after: Answer) -> list[Goal]:
        """Ends of the steps of this solution within a step of the history."""
        duration = after.time - before.time
        shares = [(end - before.time) / duration for end in after.ends]
        points = [(1 - share) * before.parameter + share * after.parameter for share in shares]
        ends = [*map(Goal, after.ends, points), Goal(after.time, after.parameter)]
        return halved(before, ends) if self._in_halves else [*ends[1:-1:2], ends[-1]]

    def norms(self, answer: Answer, other: Answer | None = None) -> np.ndarray:
        """Norms of stress, displacement and contact forces of an answer, or of its difference to
        another one, (3,).

        Args:
            answer: an answer.
            other: another answer; None for the norms of ``answer``.
        """
        stress, displacement, forces = (
            first if other is None else first - second
            for first, second in zip(
                _fields(answer), _fields(answer if other is None else other), strict=True
            )
        )
        squares = self._model.together.total(float(np.vdot(stress, stress)))
        return np.array([math.sqrt(squares), np.linalg.norm(displacement), np.linalg.norm(forces)])


def relative(errors: np.ndarray, largest: np.ndarray) -> np.ndarray:
    """Errors over the largest norms; 0 of fields that are 0.

    Args:
        errors: errors of some fields.
        largest: largest norm of each field.
    """
    return np.divide(errors, largest, out=np.zeros_like(errors), where=largest > 0)


def _fields(answer: Answer) -> tuple[np.ndarray, ...]:
    return gauss_of(answer).stress, answer.displacement(), answer.multipliers


def halved(before: Answer, ends: Sequence[Goal]) -> list[Goal]:
    """Ends of the halves of some steps.

    Args:
        before: answer at their start.
        ends: ends of the steps.
    """
    starts = [Goal(before.time, before.parameter), *ends]
    middles = [
        Goal((first.time + second.time) / 2, (first.parameter + second.parameter) / 2)
        for first, second in pairwise(starts)
    ]
    return [goal for pair in zip(middles, ends, strict=True) for goal in pair]


def in_parts(
    stepper: Stepper, trail: Trail, goal: Goal, second: SecondSolution, number: int, turned: bool
) -> tuple[list[Answer], int]:
    """Solve a step of a path in parts, each as two halves, whose difference to the whole part is
    the error they add.

    The parts may add the tolerance less the estimate, each in proportion to its length; where
    little is left of that, a small part of the tolerance. Where the error before a part decayed in
    it, as in a hold, the next part may add as much as that. An added error is about proportional to
    the square of the length of its part, so the length of the next part, or of the same one once
    more, changes by the ratio of the allowed error to it. The first attempt is the whole step. All
    this depends on the path up to here alone, so that a history that continues after stored answers
    finds the same parts.

    Args:
        trail: last answers, at most three, the present one last.
        goal: end of the step.
        turned: True if the path turns at the start of the step.
        stepper: of the history, whose last answers are ``trail``; its settings have the tolerance.
        second: solution of the history in whole parts, which follows.
        number: of the step in the path, from 1 on; it starts elastically if the path ``turned``.

    Returns:
        The answers at the ends of the halves, and the iterations of all attempts, discarded ones
        included.

    Raises:
        Diverged: if a part does not converge, or the parts are too many or too short.
    """
    start = trail[-1]
    tolerance = stepper.settings.time_tolerance or 0.0
    limit = tolerance * number / (number + EARLY)
    error = np.nan_to_num(second.errors())
    decay = np.zeros(
        len(error)
    )  # part of the error before the last part of the step that it does not keep
    done = 0.0
    length = 1.0
    spent = 0
    largest = np.zeros(
        len(error)
    )  # of all attempts: near rest an error is small beside the fields of the step
    solved = list[Answer]()
    for _ in range(MOST_PARTS):
        end = _end_of_part(done, length)
        time = goal.time if end == 1 else start.time + end * (goal.time - start.time)
        undivided, halves = second.attempt(
            stepper, trail, Goal(time, (1 - end) * start.parameter + end * goal.parameter)
        )
        spent += sum(answer.iterations for answer in (*undivided, *halves))
        largest = np.maximum(largest, second.norms(halves[-1]))
        added = relative(
            RICHARDSON_FACTOR * second.norms(halves[-1], undivided[-1]),
            np.maximum(largest, second.largest),
        )
        duration = end - done
        share = np.maximum(duration / (1 - done), decay)
        allowed = np.maximum(
            (limit - error) * share, tolerance * max(duration / LATE, NEGLIGIBLE_TIME_ERROR)
        )
        miss = float((added / allowed)[:CONTROLLED].max())
        length = duration * (
            float(np.clip(SAFETY / miss, LEAST_GROWTH, MOST_GROWTH)) if miss > 0 else MOST_GROWTH
        )
        if miss <= 1:
            second.follow(
                trail[-1],
                halves[-1]._replace(ends=tuple(answer.time for answer in halves[:-1])),
                turned,
            )
            following = np.nan_to_num(second.errors())
            decay = np.clip(1 - relative(following - added, error), 0.0, 1.0) * (error > 0)
            error = following
            solved += halves
            trail = (*trail, *halves)[-3:]
            turned = False
            done = end
        if done == 1:
            return solved, spent
        if length < SHORTEST:
            break
    raise Diverged(
        f"a time tolerance of {tolerance:g} takes too many parts of a step: allow a larger one"
    )


def _end_of_part(done: float, length: float) -> float:
    """End of the next part of a step, as a share of it: two equal parts instead of one and a short
    rest.
    """
    end = done + length
    if end >= 1 - SHORTEST:
        return 1.0
    return (1 + done) / 2 if end + 0.5 * length > 1 else end
