"""Histories of elastic bodies with a law of interfaces that remembers: increments, which are cut
until they are small.

A step that does not converge is halved. With a tolerance each step is solved as a whole and in two
halves, and is cut until their difference, which the law measures, is small; the difference is about
the error of the halves.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple, Protocol, TypeVar

import numpy as np

from hhr_dolfinx.contact.active_set import Status
from hhr_dolfinx.errors import ConvergenceError, NotOfferedError, NotSolvableError, TimeStepWarning
from hhr_dolfinx.models.answer import Answer, History, Path, outcome
from hhr_dolfinx.models.eliminations.elimination import CondensedContact
from hhr_dolfinx.models.histories.equilibrium import MarchSettings
from hhr_dolfinx.models.histories.path import check_settings, walked
from hhr_dolfinx.one_thread import one_thread
from hhr_dolfinx.warn import warn

if TYPE_CHECKING:
    from hhr_dolfinx.models.model import AnsweringModel

PROPORTIONAL = 4
"""Increments from rest to a single parameter before any is cut: one and two may agree by chance."""
INCREMENT_TOLERANCE = 1e-3
"""Error of forces allowed in increments to a single parameter, relative to the largest force."""
GRADIENT_TOLERANCE = 1e-2
"""Change of derivatives over the box allowed by twice as many increments, relative to the largest,
if they converge.
"""
MOST_INCREMENTS = 2048
"""Largest number of increments to a single parameter."""
CUTS = 12
"""Largest number of times that a step is halved to meet a tolerance."""
PATH_GRADIENT_NOTE = (
    "derivative of the path in its increments, at their statuses: check that more increments do "
    "not change it"
)
"""Note of derivatives of a path in its increments."""


class HistoryState(Protocol):
    """State of a history at the end of an increment; a law adds what it remembers."""

    time: float  #: in seconds
    point: np.ndarray  #: parameter, (P,)
    weights: np.ndarray  #: derivative of each parameter here along that of the whole history, (P,)


class IncrementEnd(NamedTuple):
    """End of an increment: time, point and weights as of :class:`HistoryState`."""

    time: float
    point: np.ndarray
    weights: np.ndarray

    def halfway(self, before: HistoryState) -> IncrementEnd:
        """Midpoint between the present state of a history and this end."""
        return IncrementEnd(
            0.5 * (before.time + self.time),
            0.5 * (before.point + self.point),
            0.5 * (before.weights + self.weights),
        )


Reached = TypeVar("Reached", covariant=True)


class SolvedIncrement(Protocol[Reached]):
    """A solved increment."""

    status: Status  #: why its search stopped
    iterations: int  #: equality problems solved
    cycled: bool  #: see :class:`Answer`

    @property
    def reached(self) -> Reached:
        """Place at its end."""


P = TypeVar("P", bound=HistoryState)
S = TypeVar("S", bound=SolvedIncrement)


class Increments(Protocol[P, S]):
    """Solves the increments of one history of a model by its law.

    A facet of the law's plug-in makes it.
    """

    def at_rest(self, time: float, point: np.ndarray, weights: np.ndarray) -> P:
        """Place of undeformed bodies.

        Args:
            time: time in seconds.
            point: parameter, (P,).
            weights: derivative of each parameter along that of the whole history, (P,).
        """

    def going_on(self, answer: Answer, weights: np.ndarray) -> P:
        """Place after a step that the full model solved before.

        Args:
            answer: answer at the end of the last step.
            weights: derivative of each parameter along that of the whole history, (P,).
        """

    def increment(self, before: P, target: IncrementEnd) -> S:
        """Solve one increment; it may not converge.

        Args:
            before: state at the start of the increment.
            target: end of the increment.
        """

    def compare(self, solved: S) -> None:
        """Take in the size of an increment, by which differences are measured."""

    def difference(self, before: P, half: S, second: S, whole: S) -> float:
        """Relative difference of a step in two halves to the whole one.

        Args:
            before: state at the start of the step.
            half: first half of the step.
            second: second half of the step.
            whole: the step as one increment.
        """

    def check(self, place: P) -> None:
        """Check the place at the end of a step, and warn."""

    def answer(self, solved: S) -> Answer:
        """Answer of an increment."""

    def advice(self, solved: S) -> Mapping[Status, str]:
        """Remedy for its status, for messages."""


class SolvedForces(Protocol):
    """Solution of the contact problem of an increment (M rows, r rigid motions)."""

    @property
    def forces(self) -> np.ndarray:
        """Forces of all rows, (M,)."""

    @property
    def motions(self) -> np.ndarray:
        """Amplitudes of rigid motions, (r,)."""


def unknown_of(contact: CondensedContact, solution: SolvedForces) -> np.ndarray:
    """Primal unknown under the forces of an increment, (n,).

    Args:
        contact: condensed contact problem of the increment.
        solution: its forces, and the motions of bodies that contact alone holds.
    """
    unknown = contact.unknown(solution.forces)
    if contact.kernel is None:
        return unknown
    return unknown + contact.kernel.modes @ solution.motions


class _CutStep:
    """One step of a path, cut as often as necessary."""

    def __init__(
        self,
        increments: Increments,
        cuts: int,
        tolerance: float | None,
        watch: Callable[[Answer], None] | None = None,
    ):
        self.increments = increments
        self.cuts = cuts
        self.tolerance = tolerance
        self.iterations = 0
        self.error = 0.0
        self.cycled = False
        self.ends: list[float] = []
        self._watch = watch

    def advance(
        self,
        before: HistoryState,
        target: IncrementEnd,
        depth: int = 0,
        whole: SolvedIncrement | None = None,
    ) -> SolvedIncrement:
        """Solve the step and return its last increment.

        Args:
            before: state at the start of the step.
            target: end of the step.
            depth: number of halvings so far.
            whole: the step as one increment; None if it is not solved yet.
        """
        if whole is None:
            whole = self._solved(before, target)
        settled = whole.status is Status.CONVERGED
        if whole.status is Status.NOT_FINITE or (settled and self.tolerance is None):
            return whole
        if depth >= (CUTS if settled else self.cuts):
            return whole
        middle = target.halfway(before)
        half = self._solved(before, middle)
        if settled and half.status is Status.CONVERGED:
            second = self._solved(half.reached, target)
            error = self.increments.difference(before, half, second, whole)
            if second.status is Status.CONVERGED and (
                error <= (self.tolerance or 0.0) or depth + 1 >= CUTS
            ):
                self.error += error
                self._ended(middle.time, half)
                return second
        first = self.advance(before, middle, depth + 1, half)
        if first.status is not Status.CONVERGED:
            return first
        self._ended(middle.time, first)
        return self.advance(first.reached, target, depth + 1)

    def _ended(self, time: float, part: SolvedIncrement) -> None:
        """Report an increment within the step, at a time."""
        self.ends.append(time)
        if self._watch is not None:
            self._watch(self.increments.answer(part))

    def _solved(self, before: HistoryState, target: IncrementEnd) -> SolvedIncrement:
        solved: SolvedIncrement = self.increments.increment(before, target)
        if self.tolerance is not None and solved.status is Status.CONVERGED:
            self.increments.compare(solved)
        self.iterations += solved.iterations
        self.cycled |= solved.cycled
        return solved


@one_thread
def follow(
    model: AnsweringModel,
    path: Path,
    settings: MarchSettings,
    *,
    weights: np.ndarray | None = None,
    known: Sequence[Answer] = (),
    keep: Callable[[Answer], None] = lambda answer: None,
    watch: Callable[[Answer], None] | None = None,
) -> History:
    """History of elastic bodies whose law remembers, from rest, undeformed, at the first time of a
    checked path.

    Args:
        model: with a ``law``, and ``increments`` that solve by it.
        path, known, keep: see :meth:`FullOrderModel.march`; known steps have no derivatives.
        settings: ``cuts``, ``time_tolerance``, ``outside`` and ``gradient`` count.
        weights: derivatives of the parameters at each time of the path along those of the whole
            history, (times, P). 1 by default: each parameter is shifted by the same at all times.
        watch: called with the answer of each increment, also of the parts of a step.

    Raises:
        NotOfferedError: for time errors without a tolerance.
    """
    check_settings(settings)
    if settings.time_error and settings.time_tolerance is None:
        raise NotOfferedError(
            f"the time error of elastic bodies with {model.law.name} is estimated with a "
            "tolerance alone: MarchSettings(time_tolerance=0.001)"
        )
    model.law.check_path(model.parameters, np.array([point for _, point in path]))
    history = History(*path[0], time_tolerance=settings.time_tolerance)
    weights = np.ones((len(path), path[0][1].size)) if weights is None else weights
    # known steps have no derivatives, on which those of later ones depend
    known = () if settings.gradient else known
    return walked(
        _ByIncrements(model, settings, path[0], weights, watch), path, history, known, keep
    )


class _ByIncrements:
    """Steps of one history, each cut into increments.

    ``weights`` and ``watch`` as in :func:`follow`.
    """

    def __init__(
        self,
        model: AnsweringModel,
        settings: MarchSettings,
        rest: tuple[float, np.ndarray],
        weights: np.ndarray,
        watch: Callable[[Answer], None] | None,
    ):
        self.model = model
        self.settings = settings
        self.weights = weights
        self.watch = watch
        self.increments: Increments = model.increments(settings)
        self.reached = self.increments.at_rest(*rest, weights[0])
        self.error = 0.0
        self.warned = False

    def known(self, number: int, answer: Answer) -> Answer:
        """Continue from the end of a step that the full model solved before.

        Args:
            number: number of the step in the path, from 1 on.
            answer: answer at the end of the last step.
        """
        self.reached = self.increments.going_on(answer, self.weights[number])
        self.increments.check(self.reached)
        self.error = answer.time_error
        return answer

    def solved(self, number: int, time: float, point: np.ndarray) -> Answer:
        """Answer at the end of a step, of which ``watch`` has seen the parts.

        Args:
            number: number of the step in the path, from 1 on.
            time: time in seconds.
            point: parameter, (P,).
        """
        self.model.check_range(point, self.settings.outside)
        step = _CutStep(
            self.increments, self.settings.cuts, self.settings.time_tolerance, self.watch
        )
        solved = step.advance(self.reached, IncrementEnd(time, point, self.weights[number]))
        self.reached = solved.reached
        self.increments.check(self.reached)
        self.error += np.nan if self.settings.time_tolerance is None else step.error
        answer = _checked_answer(self.model, step, solved)._replace(time_error=self.error)
        if answer.undetermined is not None and not self.warned:  # once for a path
            self.warned = True
            self.model.warn_undetermined(answer)
        if self.watch is not None:
            self.watch(answer)
        return answer


def _checked_answer(model: AnsweringModel, step: _CutStep, solved: SolvedIncrement) -> Answer:
    """Answer at the end of a step; raises an error without one."""
    answer = step.increments.answer(solved)
    answer = answer._replace(iterations=step.iterations, cycled=step.cycled, ends=tuple(step.ends))
    try:
        return outcome(answer, True, {**model.advice, **step.increments.advice(solved)})
    except (ConvergenceError, NotSolvableError) as error:
        vars(error)["status"] = answer.status
        raise


def proportional(
    model: AnsweringModel,
    point: np.ndarray,
    raise_on_failure: bool,
    outside: str,
    gradient: bool,
    *,
    converged: bool = False,
) -> Answer:
    """Answer to a checked point, loaded in proportion from rest, where the box is nearest to zero.

    The parameters that the law fixes are those of the point throughout. Increments are cut until
    forces have converged to :data:`INCREMENT_TOLERANCE`; ``time_error`` has the remaining error.
    The notes of answer and gradient have what was reached.

    Args:
        model: model of elastic bodies with a law of contacts.
        point: parameter, (P,).
        raise_on_failure: raise instead of returning NaN and a status.
        outside: policy outside the training range.
        gradient: compute the derivatives along the parameters.
        converged: double the increments until forces and the derivatives of their limit change
            little.

    Warns:
        TimeStepWarning: if the most increments are too few for ``converged``.
    """
    model.check_range(point, outside)
    try:
        load = _Proportional(model, point)
        answer = load.converged(gradient) if converged else load.cut(gradient)
    except (ConvergenceError, NotSolvableError) as error:
        if raise_on_failure:
            raise
        return model.unanswered(point, vars(error).get("status", Status.UNSETTLED))
    return answer._replace(time=np.nan, ends=())


class _Proportional:
    """Load in proportion from rest to a point, (P,)."""

    def __init__(self, model: AnsweringModel, point: np.ndarray):
        space = model.parameters
        self._model = model
        self._point = point
        self._start = np.clip(0.0, space.lower, space.upper)
        self._start[model.law.fixed] = point[model.law.fixed]
        self._sides = np.subtract(space.upper, space.lower)

    def _path(self, shares: np.ndarray) -> tuple[Path, np.ndarray]:
        """Path at some shares of the load, and derivatives of its parameters along those of the
        point.
        """
        path = [
            (float(share), self._start + share * (self._point - self._start)) for share in shares
        ]
        path[-1] = (1.0, self._point)
        weights = np.tile(shares[:, None], self._point.size)
        weights[:, self._model.law.fixed] = 1.0
        return path, weights

    def cut(self, gradient: bool) -> Answer:
        """The answer in increments that are cut until forces have converged."""
        path, _ = self._path(np.linspace(0.0, 1.0, PROPORTIONAL + 1))
        history = self._model.follow(
            path, MarchSettings(time_tolerance=INCREMENT_TOLERANCE, outside="ignore")
        )
        error = history.answers[-1].time_error
        solved = history.solved_path
        if gradient:  # on the parts that the tolerance required
            path, weights = self._path(np.array([time for time, _ in solved]))
            settings = MarchSettings(outside="ignore", gradient=True)
            history = self._model.answering(history).follow(path, settings, weights=weights)
        kind = (
            "these increments, and not of their limit, which solve(mu, gradient=True, "
            "converged=True) has"
        )
        return self._noted(history, len(solved) - 1, error, kind)

    def converged(self, gradient: bool) -> Answer:
        """The answer in increments that are doubled until forces and derivatives changed little
        twice.
        """
        count = PROPORTIONAL
        last: Answer | None = None
        settled = 0
        change = slope = np.inf
        while settled < 2 and count <= MOST_INCREMENTS:
            path, weights = self._path(np.linspace(0.0, 1.0, count + 1))
            settings = MarchSettings(outside="ignore", gradient=gradient, limit=gradient)
            history = self._model.follow(path, settings, weights=weights)
            answer = history.answers[-1]
            if last is not None:
                change = _changed(answer.multipliers, last.multipliers)
                slopes = [
                    refined.gradient.multipliers * self._sides
                    for refined in (answer, last)
                    if refined.gradient
                ]
                slope = _changed(*slopes) if slopes else 0.0
                settled = (
                    settled + 1
                    if change <= INCREMENT_TOLERANCE and slope <= GRADIENT_TOLERANCE
                    else 0
                )
            last = answer
            count *= 2
        if settled < 2:
            warn(
                f"{count // 2} increments of one proportional load are too few: half of them "
                f"change forces by {100 * change:.2g} %, and their derivatives by "
                f"{100 * slope:.2g} %: march along your own path",
                TimeStepWarning,
            )
        kind = f"the limit of small increments, which has converged to {100 * slope:.2g} %"
        return self._noted(history, count // 2, change, kind)

    def _noted(self, history: History, count: int, error: float, kind: str) -> Answer:
        """The last answer with notes on its path and on the ``kind`` of its derivatives."""
        start = self._model.parameters.described(self._start)
        note = (
            f"one proportional load from {start} in {count} increments, forces converged to "
            f"{100 * error:.2g} %"
        )
        answer = history.answers[-1]
        gradient = answer.gradient
        if gradient is not None:
            gradient = gradient._replace(note=f"{note}; derivatives are those of {kind}")
        cycled = any(step.cycled for step in history.answers)
        return answer._replace(
            iterations=sum(history.iterations),
            cycled=cycled,
            time_error=error,
            note=note,
            gradient=gradient,
        )


def _changed(values: np.ndarray, last: np.ndarray) -> float:
    """Change of values relative to their norm."""
    size = float(np.linalg.norm(values))
    return float(np.linalg.norm(values - last)) / size if size else 0.0


@one_thread
def single(
    model: AnsweringModel, point: np.ndarray, raise_on_failure: bool, outside: str, gradient: bool
) -> Answer:
    """Answer to a checked point of laws without memory: one increment.

    Args:
        model: model of elastic bodies with a law of contacts.
        point: parameter, (P,).
        raise_on_failure: raise instead of returning NaN and a status.
        outside: policy outside the training range.
        gradient: compute the derivatives along the parameters.
    """
    model.check_range(point, outside)
    increments: Increments = model.increments(MarchSettings(outside="ignore", gradient=gradient))
    weights = np.ones(point.size)
    try:
        solved = increments.increment(
            increments.at_rest(0.0, point, weights), IncrementEnd(1.0, point, weights)
        )
    except NotSolvableError:
        if raise_on_failure:
            raise
        return model.unanswered(point)
    answer = increments.answer(solved)._replace(time=np.nan)
    answer = outcome(answer, raise_on_failure, {**model.advice, **increments.advice(solved)})
    if answer.converged and answer.undetermined is not None:
        model.warn_undetermined(answer)
    return answer
