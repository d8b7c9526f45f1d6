"""What attempts of one search share: the full model, its answers, each solved for once, and what has been spent."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from hhr_dolfinx.certify.compare import retraced
from hhr_dolfinx.certify.strains import check_small_strains
from hhr_dolfinx.errors import (
    ConvergenceError,
    HHRError,
    OutsideTrainingWarning,
    ReductionError,
    SceneWarning,
    SmallStrainWarning,
)
from hhr_dolfinx.models.answer import Answer, History
from hhr_dolfinx.sampling import Sobol
from hhr_dolfinx.snapshots.records import Lost, SnapshotSet
from hhr_dolfinx.study.one_call.crew import Crew
from hhr_dolfinx.study.one_call.wish import Budget, Errors, Exact, Wish
from hhr_dolfinx.study.training.train import Progress, Training
from hhr_dolfinx.timing import StageLog, Stopwatch
from hhr_dolfinx.warn import ignored, warn

if TYPE_CHECKING:
    from hhr_dolfinx.path_families import PathFamily

FRESH_SEED = 7000
"""Added to the seed of a search for what models are checked on, which then is no part of any training."""
CORNERS = 6
"""Parameters up to which all corners of the box are trained on."""


class BudgetSpentError(HHRError):
    """Nothing more may be solved for."""


@dataclass
class Bench:
    """What attempts share.

    Attributes:
        full: the full model, on one rank.
        crew: ranks that solve for exact answers; this one alone, mostly.
        wish: how exact a model shall be.
        budget: what may be spent.
        family: paths, where answers depend on these; None where questions are points.
        seed: of what is drawn at random.
        progress: for progress bars.
        errors: of models, in the norms of the wish.
        clock: since the search began.
        solved: number of answers of the full model, those found in the store among them.
        checks: number of checks.
        held_out: answers of checks, beside which models that are built afterwards are compared.
        looked: whether answers of the full model were looked at by themselves.
        forces_off: whether contact forces of the last model that was checked were off by more than is wished; they are
            where nothing is known of them.
    """

    full: Any
    crew: Crew
    wish: Wish
    budget: Budget
    family: PathFamily | None
    seed: int
    progress: Progress
    errors: Errors = field(init=False)
    clock: Stopwatch = field(default_factory=Stopwatch)
    solved: int = 0
    checks: int = 0
    held_out: list[Exact] = field(default_factory=list)
    forces_off: bool = True
    looked: bool = False
    _known: dict[bytes, Answer | History | None] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.errors = Errors(self.wish, self.full)

    def check_budget(self) -> None:
        """Raise BudgetSpentError where nothing more may be solved for."""
        seconds = self.budget.seconds
        if seconds is not None and self.clock.seconds >= seconds:
            raise BudgetSpentError(f"the {seconds:g} s of the budget are over")
        answers = self.budget.full_answers
        if answers is not None and self.solved >= answers:
            raise BudgetSpentError(f"the {answers} full answers of the budget are spent")

    def training(self, count: int) -> Training:
        """About so many training answers, those of smaller trainings among them, and what checks have left."""
        questions: Any
        if self.family is not None:
            questions = self.family.training(count, self.seed)
        else:
            space = self.full.parameters
            questions = Sobol(count, self.seed, corners=len(space.names) <= CORNERS).points(space)
        lost = Lost()
        answers = list(self._answers(questions, "training", lost))
        self._look([Exact(item) for item in answers])
        snapshots = _set_of(answers)
        lost.warn(len(questions), (len(questions) + 1) // 2, "training queries")
        return Training(self.full, snapshots, self.checked, StageLog())

    @property
    def checked(self) -> SnapshotSet | None:
        """Exact answers of checks; None before the first."""
        return _set_of(item.full for item in self.held_out) if self.held_out else None

    def fresh(self, count: int, suspects: np.ndarray | None = None) -> list[Exact]:
        """Exact answers to questions that no model was made from: random ones, and points that are given, (n, P)."""
        self.checks += 1
        seed = self.seed + FRESH_SEED + self.checks
        questions: Any
        if self.family is not None:
            questions = self.family.paths(Sobol(count, seed))
        else:
            questions = self.full.parameters.random(count, seed)
            questions = questions if suspects is None else np.concatenate([questions, suspects])
        lost = Lost()
        found = [Exact(item) for item in self._answers(questions, "fresh answers", lost)]
        lost.warn(len(questions), 1, "fresh queries")
        self._look(found)
        self.errors.know(found)
        return found

    def _look(self, found: Sequence[Exact]) -> None:
        """Tell of what no check of a model finds: strains that are not small, nothing that touches. Once."""
        if self.looked or not found:
            return
        self.looked = True
        try:
            check_small_strains(self.full, _set_of(item.full for item in found))
        except ReductionError as error:
            warn(str(error), SmallStrainWarning, stacklevel=3)
        if not any(answer.forces().any() for item in found for answer in item.answers):
            warn(
                f"nothing touches in any of {len(found)} answers of the full model: look at gaps and at the signs of "
                "loads and displacements, hhr check",
                SceneWarning,
                stacklevel=3,
            )

    def errors_of(self, model: Any, exact: Iterable[Exact]) -> np.ndarray:
        """Errors of a model at known answers, (n, norms of the wish); infinite where it has no answer."""
        rows = []
        with ignored(OutsideTrainingWarning):
            for item in exact:
                try:
                    answers = _found(model, item)
                except HHRError:
                    answers = []
                rows.append(self.errors.of(answers, item))
        return np.array(rows)

    def _answers(self, questions: Any, label: str, lost: Lost) -> Iterator[Answer | History]:
        """Exact answers; what has none is told to ``lost``."""
        for place, question in enumerate(self.progress(label)(questions)):
            key = _key(question)
            if key not in self._known:
                self._solve(questions[place:], lost)
            found = self._known[key]
            if found is not None:
                yield found

    def _solve(self, questions: Any, lost: Lost) -> None:
        """Take in the first of some questions, and as many behind it as there are ranks."""
        self.check_budget()
        answers = self.budget.full_answers
        room = self.crew.size if answers is None else min(self.crew.size, answers - self.solved)
        some: dict[bytes, Any] = {}
        for question in questions:
            if len(some) == room:
                break
            if _key(question) not in self._known:
                some[_key(question)] = question
        self.solved += len(some)
        self._known |= dict.fromkeys(some)
        for (key, question), found in zip(some.items(), self.crew.solved(list(some.values())), strict=True):
            with lost.taken_in(_label(self.full, question)):
                if isinstance(found, HHRError):
                    raise found
                self._known[key] = found


def _set_of(found: Iterable[Answer | History]) -> SnapshotSet:
    """Exact answers side by side."""
    listed: list[Any] = list(found)
    if not listed:
        raise ConvergenceError("no training query has an answer: lower the loads, or narrow the box")
    return SnapshotSet.of_histories(listed) if isinstance(listed[0], History) else SnapshotSet.of_answers(listed)


def _found(model: Any, exact: Exact) -> list[Answer]:
    """Answers of a model to the question of exact ones."""
    if isinstance(exact.full, History):
        return retraced(model, exact.full).answers
    return [model.solve(exact.full.parameter, outside="ignore", raise_on_failure=False)]


def _key(question: Any) -> bytes:
    """What tells a point or a path from others."""
    if isinstance(question, np.ndarray):
        return question.tobytes()
    return b"".join(np.float64(time).tobytes() + np.asarray(point).tobytes() for time, point in question)


def _label(full: Any, question: Any) -> str:
    """A point or a path in words."""
    name = str(getattr(question, "name", ""))
    return name or full.parameters.described(question)
