"""Context that all attempts of a search share: the full model, its answers, each solved once, and
the cost so far.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import islice
from typing import TYPE_CHECKING, Any

import numpy as np

from hhr_dolfinx.errors import (
    ConvergenceError,
    HHRError,
    OutsideTrainingWarning,
    ReductionError,
    SceneWarning,
    SmallStrainWarning,
)
from hhr_dolfinx.full_order.full import FullOrderModel
from hhr_dolfinx.models.answer import Answer, History
from hhr_dolfinx.models.answer import Path as AnswerPath
from hhr_dolfinx.models.model import AnsweringModel, KeptModel
from hhr_dolfinx.plugins.one_call.array_store import ArrayStore
from hhr_dolfinx.plugins.one_call.progress import Stopwatch
from hhr_dolfinx.plugins.one_call.target import Budget, Exact, Target, TargetErrors, steps_of
from hhr_dolfinx.plugins.one_call.workers import Workers
from hhr_dolfinx.plugins.paths.compared import retraced
from hhr_dolfinx.plugins.paths.path_families import PathFamily
from hhr_dolfinx.reduction.build import build
from hhr_dolfinx.reduction.claims import check_claim
from hhr_dolfinx.reduction.kinds import kind_of
from hhr_dolfinx.reduction.reductor import Reductor
from hhr_dolfinx.sampling import Sobol
from hhr_dolfinx.snapshots.records import Lost, SnapshotSet
from hhr_dolfinx.study.training.train import Training
from hhr_dolfinx.timing import Announce, StageLog
from hhr_dolfinx.warn import ignored, warn

if TYPE_CHECKING:
    from hhr_dolfinx.plugins.paths.path_families import NamedPath

FRESH_SEED = 7000
"""Offset of the seed for points of checks, which then differ from those of any training."""
TRAINED_CORNERS = 6
"""Parameters up to which all corners of the box are trained on."""
BOUND_CHECKS = 4
"""Full answers that a model is compared with if its bound meets the target already."""
FRESH = 40
"""Full answers that others are compared with.

Half of them where the model expects its largest errors.
"""
HOPELESS = 16
"""Queries after which a search ends if none has an answer: more of them would not help a training,
which needs half.
"""
DOUBTED = 1.5
"""Factor by which the expected time of a stage must exceed the budget to stop it: its first step
takes longer.
"""


class BudgetSpentError(HHRError):
    """The next stage exceeds the budget, or ``stage`` was stopped; empty if none had begun."""

    def __init__(self, text: str, stage: str = ""):
        super().__init__(text)
        self.stage = stage


class FewAnswersError(ConvergenceError):
    """Too few queries of the box have an answer.

    No model can be built or checked, however many more are solved for.
    """


@dataclass
class SearchContext:
    """Context of the attempts."""

    full: FullOrderModel  #: on one rank
    workers: Workers  #: the ranks that solve for exact answers
    target: Target  #: accuracy of the model
    budget: Budget  #: limits of the cost
    family: PathFamily | None  #: paths, if answers depend on them; None if queries are points
    seed: int  #: of random draws
    progress: Announce  #: receives each stage, and the share of it that is done
    store: ArrayStore | None = (
        None  # keeps solutions of connected components; None keeps them in memory alone
    )
    #: whether the model keeps arrays that only displacements need, or ``surface``
    fields: bool | str = True
    errors: TargetErrors = field(init=False)  #: of models, in the norms of the target
    clock: Stopwatch = field(default_factory=Stopwatch)  #: since the search began
    solved: int = 0  #: number of answers of the full model, those found in the store among them
    checks: int = 0  #: number of them
    held_out: list[Exact] = field(
        default_factory=list
    )  #: answers of checks, with which later models are compared
    #: whether contact forces of the last checked model were less accurate than the target; True if
    #: nothing is known of them
    forces_off: bool = True
    #: whether answers of the full model were checked for large strains and missing contact
    looked: bool = False
    #: whether a model is being checked: before that, time is reserved for the answers of a check
    checking: bool = False
    #: reason why the last check has fewer answers than planned; empty if it has all
    short: str = ""
    batches: list[float] = field(
        default_factory=list
    )  #: seconds of full answers, as many at once as there are ranks
    _first_failure: str = ""  #: the first query without an answer, and the reason
    _began: dict[str, float] = field(default_factory=dict)
    _last: dict[str, float] = field(default_factory=dict)
    _known: dict[bytes, Answer | History | None] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.errors = TargetErrors(self.target, self.full)

    def check_budget(self) -> None:
        """Refuse a further full answer if the budget is spent.

        Raises:
            BudgetSpentError: if no more full answers are allowed, or no time is left.
        """
        self._check_seconds()
        answers = self.budget.full_answers
        if answers is not None and self.solved >= answers:
            raise BudgetSpentError(f"the {answers} full answers of the budget are spent")

    def _check_seconds(self) -> None:
        seconds = self.budget.seconds
        if seconds is not None and self.clock.seconds >= seconds:
            raise BudgetSpentError(f"the {seconds:g} s of the budget are over")

    def announce(self, stage: str, share: float) -> None:
        """Report a stage.

        Args:
            stage: its name.
            share: share of it that is done.

        Raises:
            BudgetSpentError: if no time is left, or not enough by the time of the share that is
                done.
        """
        self.progress(stage, share)
        self._check_seconds()
        now = self.clock.seconds
        if now >= self.deadline:
            raise BudgetSpentError(f"stage '{stage}' was stopped: {self._left()}", stage)
        if not share:
            self._began[stage] = self._last[stage] = now
            return
        step = now - self._last.get(stage, now)
        self._last[stage] = now
        # stored results took no time: the next step may take as long as this one
        remaining = max(
            (now - self._began.get(stage, now)) * (1 / share - 1), step if share < 1 else 0.0
        )
        if now + remaining / DOUBTED > self.deadline:
            raise BudgetSpentError(
                f"stage '{stage}' would take about {_about(remaining)} s more, and {self._left()}",
                stage,
            )

    @property
    def deadline(self) -> float:
        """Seconds on the clock by which the present work must end.

        A check may use the time reserved for it.
        """
        seconds = self.budget.seconds
        if seconds is None:
            return math.inf
        return seconds if self.checking else seconds - min(self._duration(FRESH), seconds / 2)

    def measure(self) -> None:
        """Time one full answer, the first of the first check, to plan a budget of seconds."""
        if self.budget.seconds is not None and self.family is None:
            points = self.full.parameters.random(1, self.seed + FRESH_SEED + 1)
            list(self._answers(points, "full answer to plan by", Lost()))

    def _duration(self, count: int) -> float:
        """Expected seconds of so many full answers, from those solved so far.

        Zero before the first.
        """
        return (
            float(np.median(self.batches)) * math.ceil(count / self.workers.size)
            if self.batches
            else 0.0
        )

    def _left(self) -> str:
        seconds = self.budget.seconds
        assert seconds is not None
        seconds_left = max(0.0, self.deadline - self.clock.seconds)
        reserved = (
            ""
            if self.checking
            else f", beside {_about(seconds - self.deadline)} s that are kept back for a check"
        )
        return f"{_about(seconds_left)} of the {seconds:g} s of the budget are left{reserved}"

    def check_affordable(
        self, questions: np.ndarray | Sequence[AnswerPath], what: str, besides: int = 0
    ) -> None:
        """Refuse queries whose answers exceed the budget.

        Args:
            questions: points, (n, P), or paths; answers that are solved already count nothing.
            what: name of these answers, for the message.
            besides: number of further answers that are needed.

        Raises:
            BudgetSpentError: if these answers exceed the budget.
        """
        count = self._unsolved(questions)
        answers = self.budget.full_answers
        if answers is not None and count and self.solved + count + besides > answers:
            raise BudgetSpentError(
                f"{what} takes {count} full answers and its check {besides} at least, and "
                f"{answers - self.solved} of the {answers} full answers of the budget are left"
            )
        if self.clock.seconds + self._duration(count) > self.deadline:
            raise BudgetSpentError(
                f"{what} would take about {_about(self._duration(count))} s, and {self._left()}"
            )

    def _unsolved(self, questions: np.ndarray | Sequence[AnswerPath]) -> int:
        """Number of queries that are not solved yet."""
        return len({_key(question) for question in questions} - self._known.keys())

    def training(self, count: int) -> Training:
        """About so many training answers, including those of smaller trainings and of checks.

        Args:
            count: number of points, or paths.

        Raises:
            BudgetSpentError: before anything is solved for, if the budget does not allow it.
            FewAnswersError: if less than half of the queries have an answer.
        """
        questions: np.ndarray | list[NamedPath]
        if self.family is not None:
            questions = self.family.training(count, self.seed)
        else:
            space = self.full.parameters
            questions = Sobol(count, self.seed, corners=len(space.names) <= TRAINED_CORNERS).points(
                space
            )
        self.check_affordable(questions, f"a training of {len(questions)}", BOUND_CHECKS)
        lost = Lost()
        least = (len(questions) + 1) // 2
        answers = list(self._answers(questions, "training answers", lost, least))
        if len(answers) < least:
            queried = sum(_key(question) in self._known for question in questions)
            raise self._few(
                f"{len(answers)} of the first {queried} of {len(questions)} training queries have "
                "an answer, and a model needs half of them"
            )
        self._look(answers)
        snapshots = _set_of(answers)
        lost.warn(len(questions), least, "training queries")
        return Training(self.full, snapshots, self.checked, StageLog())

    def reduced(self, reductor: Reductor, count: int) -> KeptModel:
        """Model that a reductor makes of about so many training answers.

        Args:
            reductor: the reductor.
            count: number of points, or paths.
        """
        training = self.training(count)
        return build(self.full, training.snapshots, reductor, training.held_out, self.announce)

    @property
    def reads_displacements(self) -> bool:
        """True if the target, or an output of the scene, needs displacements."""
        functionals = self.full.functionals
        outputs = functionals is not None and any(
            functional.count for functional in functionals.items
        )
        return self.target.needs_fields or outputs

    def check_claim(self, method: str, model: AnsweringModel, exact: Iterable[Exact]) -> None:
        """Check a model that calls itself exact at exact answers, whatever the target is.

        Args:
            method: name of its kind.
            model: the model.
            exact: exact answers.

        Raises:
            ClaimError: if it is off.
        """
        answers = list(exact)
        histories = self.family is not None
        for batch in ([query] for query in answers) if histories else (answers,):
            check_claim(method, kind_of(self.full), model, _set_of(batch))

    @property
    def checked(self) -> SnapshotSet | None:
        """Exact answers of checks; None before the first."""
        return _set_of(self.held_out) if self.held_out else None

    def fresh(self, count: int, suspects: np.ndarray | None = None) -> list[Exact]:
        """Exact answers to queries that no model was built from: random ones, and given points.

        If the budget ends there are fewer, and ``short`` has the reason.

        Args:
            count: number of random queries.
            suspects: given points, (n, P); None without any.

        Raises:
            BudgetSpentError: if the budget allows none.
            FewAnswersError: if no query of the box has an answer.
        """
        self.checks += 1
        seed = self.seed + FRESH_SEED + self.checks
        questions: np.ndarray | list[NamedPath]
        if self.family is not None:
            questions = self.family.paths(Sobol(count, seed))
        else:
            questions = self.full.parameters.random(count, seed)
            questions = questions if suspects is None else np.concatenate([questions, suspects])
        lost = Lost()
        answers: list[Exact] = []
        self.short = ""
        try:
            for answer in self._answers(questions, "fresh answers", lost):
                answers.append(answer)
        except BudgetSpentError as error:
            if not answers:
                raise
            self.short = (
                f"{len(answers)} of {len(questions)} fresh answers were affordable: {error}"
            )
        if not answers and self.family is None:  # a part of the box may have answers
            questions = self.full.parameters.random(HOPELESS, seed)[count:]
            answers += islice(self._answers(questions, "fresh answers", lost), BOUND_CHECKS)
        if not answers and self._first_failure:
            raise self._few(f"none of {len(self._known)} queries of the box has an answer")
        lost.warn(len(answers) + len(lost.failures), 1, "fresh queries")
        self._look(answers)
        self.errors.know(answers)
        return answers

    def _few(self, what: str) -> FewAnswersError:
        """Error of too few answers, with the first reason."""
        return FewAnswersError(
            f"{what}; the first, {self._first_failure}. Lower the loads, or narrow the box"
        )

    def _look(self, found: Sequence[Exact]) -> None:
        """Warn once of faults that no check of a model detects.

        These are strains that are not small, and bodies that never touch.
        """
        if self.looked or not found:
            return
        self.looked = True
        try:
            self.full.strains.check(self.full, _set_of(found))
        except ReductionError as error:
            warn(str(error), SmallStrainWarning)
        if not any(answer.forces().any() for query in found for answer in steps_of(query)):
            warn(
                f"nothing touches in any of {len(found)} answers of the full model: look at gaps "
                "and at the signs of loads and displacements, hhr check",
                SceneWarning,
            )

    def errors_of(self, model: AnsweringModel, exact: Iterable[Exact]) -> np.ndarray:
        """Errors of a model at exact answers, (n, norms of the target).

        Infinite if it has no answer.

        Args:
            model: the model.
            exact: exact answers, or histories.
        """
        rows = []
        with ignored(OutsideTrainingWarning):
            for query in exact:
                answers: list[Answer] = []
                with suppress(HHRError):
                    if isinstance(query, History):
                        answers = retraced(model, query).answers
                    else:
                        answers = [
                            model.solve(query.parameter, outside="ignore", raise_on_failure=False)
                        ]
                rows.append(self.errors.of(answers, query))
        return np.array(rows)

    def _answers(
        self, questions: np.ndarray | Sequence[AnswerPath], label: str, lost: Lost, least: int = 0
    ) -> Iterator[Answer | History]:
        """Exact answers; queries without one are reported to ``lost``.

        End when fewer than ``least`` can be left.
        """
        missing = 0
        count = self._unsolved(questions)
        seconds = self._duration(count)
        self.announce(
            f"{count} {label}" + (f", about {_about(seconds)} s" if seconds > 1 else ""), 0.0
        )
        for index, question in enumerate(questions):
            key = _key(question)
            if key not in self._known:
                self._solve(questions[index:], lost)
                self.progress(label, (index + 1) / len(questions))
            answer = self._known[key]
            if answer is not None:
                yield answer
                continue
            missing += 1
            if len(questions) - missing < least or (least and missing == index + 1 == HOPELESS):
                return

    def _solve(self, questions: np.ndarray | Sequence[AnswerPath], lost: Lost) -> None:
        """Solve the first of some queries, and as many after it as there are ranks."""
        self.check_budget()
        if self.clock.seconds + self._duration(1) > self.deadline:
            raise BudgetSpentError(
                f"a full answer takes {_about(self._duration(1))} s, and {self._left()}"
            )
        answers = self.budget.full_answers
        room = (
            self.workers.size if answers is None else min(self.workers.size, answers - self.solved)
        )
        batch: dict[bytes, np.ndarray | AnswerPath] = {}
        for question in questions:
            if len(batch) == room:
                break
            if _key(question) not in self._known:
                batch[_key(question)] = question
        self.solved += len(batch)
        self._known |= dict.fromkeys(batch)
        clock = Stopwatch()
        solved = self.workers.solved(list(batch.values()))
        self.batches.append(clock.seconds)
        for (key, question), answer in zip(batch.items(), solved, strict=True):
            with lost.recorded(self._called(question)):
                if isinstance(answer, HHRError):
                    self._first_failure = (
                        self._first_failure or f"{self._called(question)}: {answer}"
                    )
                    raise answer
                self._known[key] = answer

    def _called(self, question: Any) -> str:
        """Name of a path, or a point in words."""
        return str(getattr(question, "name", "")) or self.full.parameters.described(question)


def _about(seconds: float) -> str:
    """Seconds with two digits, or all digits before the point."""
    return f"{seconds:.0f}" if seconds >= 10 else f"{seconds:.2g}"


def _set_of(found: Iterable[Answer | History]) -> SnapshotSet:
    listed: list[Any] = list(found)
    if not listed:
        raise ConvergenceError(
            "no training query has an answer: lower the loads, or narrow the box"
        )
    return (
        SnapshotSet.of_histories(listed)
        if isinstance(listed[0], History)
        else SnapshotSet.of_answers(listed)
    )


def _key(question: np.ndarray | AnswerPath) -> bytes:
    """Key that identifies a point or a path."""
    if isinstance(question, np.ndarray):
        return question.tobytes()
    return b"".join(
        np.float64(time).tobytes() + np.asarray(point).tobytes() for time, point in question
    )
