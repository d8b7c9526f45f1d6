"""Driver of all reductions: attempt, compare, trust, refine, record.

A reductor prepares the data that its attempts share, and makes one model for each level, coarse
levels first. The driver compares each model with answers of the full one. It goes on while a check
refuses the model or its errors exceed the target, and returns the best one.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, Generic, Protocol, TypeAlias, TypeVar

from hhr_dolfinx import registry
from hhr_dolfinx.certify.compare import Comparison
from hhr_dolfinx.certify.trust import OF_A_RID, TrustLimits
from hhr_dolfinx.errors import (
    ConvergenceError,
    HHRError,
    NotOfferedError,
    NotSolvableError,
    ReductionError,
    SceneWarning,
    SmallStrainWarning,
    UnseenLoadError,
    UnstableModelError,
)
from hhr_dolfinx.models.full import FullModel
from hhr_dolfinx.models.model import AnsweringModel, KeptModel
from hhr_dolfinx.reduction.claims import check_claim
from hhr_dolfinx.reduction.kinds import OfPoints, kind_of
from hhr_dolfinx.registry import Way
from hhr_dolfinx.snapshots.records import Lost, SnapshotSet, compute_snapshots
from hhr_dolfinx.timing import Announce, StageLog, terminal_lines
from hhr_dolfinx.trained import Trained, TrainedRange
from hhr_dolfinx.warn import Warned, collected, repeat

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

    from hhr_dolfinx.reduction.recipe import Recipe

EXACTNESS_SAMPLES = 2
"""Full answers that are solved for to compare a model that calls itself exact, if none were held
out.
"""
MOST_FRESH = 16
"""Points at which a full answer is solved for at most: a box may have points without an
equilibrium.
"""
OF_SCENE = SceneWarning, SmallStrainWarning
"""Warnings of the scene, which survive an attempt that is refused: the returned model belongs to
the same scene.
"""

Prepared = TypeVar("Prepared")
Facts = TypeVar("Facts")
Candidate = TypeVar("Candidate")


@dataclass(frozen=True, eq=False)
class Task:
    """Input of a reduction."""

    full: FullModel
    snapshots: SnapshotSet | None = None  #: for training
    held_out: SnapshotSet | None = None  #: for validation
    log: StageLog = field(default_factory=StageLog)
    #: called with each stage and the share that is done; may raise to stop the build
    announce: Announce = field(default_factory=terminal_lines)
    #: full answers solved for to compare a model that calls itself exact; 0 if the caller compares
    #: it
    sure: int = EXACTNESS_SAMPLES

    @cached_property
    def kind(self) -> OfPoints:
        """Kind of the answers."""
        return kind_of(self.full)

    def check_answers(self) -> None:
        """Raise ReductionError for answers of another problem, or of other laws."""
        self.kind.check("snapshots", self.snapshots)
        if self.held_out is not None:
            self.kind.check("held_out", self.held_out)


@dataclass(frozen=True, eq=False)
class Record(Generic[Facts]):
    """Record of the construction of a model.

    The facts of its kind are attributes too: ``record.basis``.
    """

    reductor: Any  #: what made the model
    level: Any  #: of the attempt that was chosen
    facts: (
        Facts  # results of the reductor, such as :class:`~hhr_dolfinx.reduction.build.HyperFacts`
    )
    comparison: Comparison | None  #: errors against known answers; None if nothing was compared
    log: StageLog  #: seconds of the stages, skipped stages, refused attempts

    def __getattr__(self, name: str) -> Any:
        """A fact, by its name."""
        if name.startswith("_") or name == "facts":
            raise AttributeError(name)
        return getattr(self.facts, name)


class Reducing(Protocol):
    """An object that makes a model in one attempt, and checks it by itself."""

    def reduced(
        self, full: FullModel, snapshots: SnapshotSet | None, held_out: SnapshotSet | None
    ) -> AnsweringModel:
        """The model of a full one.

        Args:
            full: the full model.
            snapshots: training answers.
            held_out: answers for the check of the model; None without any.
        """


class Reductor(ABC, Generic[Prepared]):
    """A way to make a model from the full one and its answers; only :meth:`attempt` is required."""

    method: ClassVar[str]  #: its name in tables
    level: ClassVar[str] = "level"  #: name of what levels count, for the log
    remedy: ClassVar[str | Mapping[str, str]] = OF_A_RID  #: advice for a model that is refused
    #: errors of an attempt after which the next level is tried
    refusals: ClassVar[tuple[type[HHRError], ...]] = (
        NotSolvableError,
        UnstableModelError,
        UnseenLoadError,
    )
    #: whether its models know where they hold: in the whole box, or in a range that it sets.
    #: Otherwise the driver limits them to the box around the training points, and warns of a
    #: training without validation
    own_range: ClassVar[bool] = False

    @classmethod
    def usual(cls, settings: Any, *, fields: bool | None) -> Reductor:
        """The reductor of ``condense(settings)``.

        Args:
            settings: settings of the condensation; None for the defaults.
            fields: compute displacements; None if the reductor may choose.

        Raises:
            NotOfferedError: if its models do not keep all contact conditions.
        """
        raise NotOfferedError(f"{cls.__name__} does not condense")

    @property
    def limits(self) -> TrustLimits | None:
        """Limits of the comparison, above which a model is refused or a warning is given.

        None skips it.
        """
        return TrustLimits()

    def check(self, task: Task) -> None:
        """Refuse what it is not for, before anything is computed."""

    def not_by_rows(self, task: Task) -> str:
        """Reason why it needs all rows of a distributed problem on each rank; else empty."""
        return "its reductor does not say that it reduces by rows"

    def prepare(self, task: Task, before: Prepared | None = None) -> Prepared:
        """Data that all attempts share.

        Args:
            task: input of the reduction.
            before: data that were prepared for another task of the same full model; None without
                any.
        """
        return task  # type: ignore[return-value]

    def levels(self, task: Task) -> Iterable[object]:
        """Levels of the attempts, coarse ones first."""
        return (0,)

    @abstractmethod
    def attempt(self, prepared: Prepared, level: Any) -> tuple[AnsweringModel, object]:
        """A model, and the facts of its record.

        Args:
            prepared: data that all attempts share.
            level: level of the attempt.
        """

    def compare(self, task: Task, model: Any) -> tuple[Comparison | None, Trained | None]:
        """Errors against known answers, checked, and the training range.

        Args:
            task: input of the reduction.
            model: model that was built.
        """
        return compared(task, model, self.limits, self.remedy)

    def off(self, comparison: Comparison | None) -> float:
        """Largest error over its target; above 1 the next level is tried.

        The best model is returned. 0 by default: the first level that is not refused ends the
        attempts.
        """
        return 0.0


RecipeLike: TypeAlias = "Recipe | Reductor | Reducing | None"
"""A way to make a model; None for the default recipe of the scene."""
CondensationSettings: TypeAlias = "DataclassInstance | Reductor | None"
"""Settings of a condensation, or its reductor; None for the defaults."""


@dataclass(eq=False)
class Outcome(Generic[Candidate]):
    """Result of one candidate: a model or an error, and its warnings."""

    candidate: Candidate
    made: Any = None
    error: HHRError | None = None
    warnings: Sequence[Warned] = ()


def outcomes(
    candidates: Iterable[Candidate],
    make: Callable[[Candidate], object],
    refusals: tuple[type[HHRError], ...],
) -> Iterator[Outcome[Candidate]]:
    """The loop over attempts: the result of each, or the error that refused it.

    The caller stops or takes the next.

    Args:
        candidates: levels, or recipes.
        make: makes the model of one candidate.
        refusals: errors that refuse a candidate; others are raised.
    """
    for candidate in candidates:
        outcome = Outcome(candidate)
        try:
            with collected() as outcome.warnings:
                outcome.made = make(candidate)
        except refusals as error:
            outcome.error = error
        except BaseException:
            repeat(_of_scene(outcome))
            raise
        yield outcome


def _of_scene(outcome: Outcome) -> list[Warned]:
    """Warnings of the scene."""
    return [warning for warning in outcome.warnings if issubclass(warning.category, OF_SCENE)]


def made(reductor: Reductor[Prepared], task: Task, before: Prepared | None = None) -> Any:
    """The model of a reductor.

    Args:
        reductor: the reductor.
        task: input of the reduction.
        before: see :meth:`Reductor.prepare`.

    Raises:
        ReductionError: for a task from which it can build no model.
        ClaimError: for a model that calls itself exact and is not.
        NotSolvableError, UnstableModelError: if all attempts are refused; the error of the last
            one.

    Warns:
        StabilityWarning, UncheckedWarning: of the returned model.
    """
    reductor.check(task)
    if not reductor.own_range and reductor.limits is not None and task.snapshots is not None:
        task.kind.warn_of_training(task.snapshots, task.held_out)
    if not task.full.spread.all_here and (reason := reductor.not_by_rows(task)):
        task.log.skip(
            "rows of ranks", f"each rank has all rows of all matrices and answers: {reason}"
        )
        full, snapshots, held_out = everywhere(task.full, task.snapshots, task.held_out)
        task = replace(task, full=full, snapshots=snapshots, held_out=held_out)
    with task.full.problem.group.together(f"reducing scene '{task.full.scene.name}'"):
        return _driven(reductor, task, reductor.prepare(task, before))


def _driven(reductor: Reductor[Prepared], task: Task, prepared: Prepared) -> AnsweringModel:
    """The best of the attempts."""
    log = task.log
    before = len(log.skipped)
    best: tuple[float, Outcome, list[dict[str, str]]] | None = None
    refused: list[Outcome] = []

    def make(level: object) -> tuple[AnsweringModel, object, Comparison | None]:
        del log.skipped[before:]
        model, facts = reductor.attempt(prepared, level)
        _check_scene(task.full, reductor, model)
        _check_claim(reductor, task, model)
        comparison, trained = reductor.compare(task, model)
        training = task.snapshots
        if trained is None and not (reductor.own_range or training is None or training.histories):
            trained = TrainedRange.of(training.points, task.full.parameters)
        if (
            isinstance(model, KeptModel)
            and "trained" in model.kept
            and trained is not model.trained
        ):
            model = model.changed(trained=trained)
        return model, facts, comparison

    for outcome in outcomes(reductor.levels(task), make, reductor.refusals):
        if outcome.error is not None:
            log.refuse(str(outcome.error), **{reductor.level: outcome.candidate})
            refused.append(outcome)
            continue
        off = reductor.off(outcome.made[2])
        if best is None or off < best[0] or math.isnan(best[0]):
            best = off, outcome, log.skipped[before:]
        if off <= 1:
            break
        log.refuse(
            f"errors are {off:.2g} times what is small enough",
            **{reductor.level: outcome.candidate},
        )
    repeat(warning for outcome in refused for warning in _of_scene(outcome))
    if best is None:
        error = refused[-1].error if refused else None
        raise error or ReductionError(f"{type(reductor).__name__} has no levels")
    repeat(best[1].warnings)
    log.skipped[before:] = best[2]
    model, facts, comparison = best[1].made
    log.say(model.known_error)
    if isinstance(model, KeptModel) and model.offline is None:
        model.offline = Record(reductor, best[1].candidate, facts, comparison, log)
    return model


def everywhere(full: FullModel, *sets: SnapshotSet | None) -> tuple[Any, ...]:
    """Gather a distributed full model and its answers, all rows on each rank. Collective.

    Args:
        full: the full model.
        *sets: answers of it, or None each.
    """
    return full.gathered(), *(
        None if answers is None else answers.gathered(full.problem) for answers in sets
    )


def compared(
    task: Task,
    model: KeptModel,
    limits: TrustLimits | None,
    remedy: str | Mapping[str, str] = OF_A_RID,
) -> tuple[Comparison | None, Trained | None]:
    """Errors against validation answers, or else against training, checked, and the training range.

    The training range of a model of load paths is known only after it has solved the known paths.

    Args:
        task: input of the reduction.
        model: model that was built.
        limits: limits of the errors; None to compare nothing.
        remedy: advice for a model that is refused.

    Raises:
        UnstableModelError: if an error is beyond its limit.
    """
    if task.snapshots is None:
        return None, model.trained
    with task.log.stage("validation", task.announce):
        return task.kind.compared(model, task.snapshots, task.held_out, limits, remedy)


def _name_of(reductor: Reductor) -> str:
    return type(getattr(reductor, "given", reductor)).__name__


def _check_scene(full: FullModel, reductor: Reductor, model: AnsweringModel) -> None:
    """Raise ReductionError for a result that is no model of the scene of the full one."""
    name = f"{_name_of(reductor)} made"
    if not isinstance(model, AnsweringModel):
        raise ReductionError(f"{name} {model!r}: it must return a model")
    returned = model.parameters.names, model.conditions
    conditions = len(full.problem.gaps)
    if returned != (full.parameters.names, conditions):
        raise ReductionError(
            f"{name} a model of the parameters {returned[0]} and {returned[1]} contact "
            f"conditions, and the full model has {full.parameters.names} and {conditions}: "
            "it must return one of the same scene"
        )
    law = model.law if model.fields.interface is None else model.fields.interface.whole
    if law.plugins != full.law.plugins or (model.equilibrium is None) != (full.equilibrium is None):
        raise ReductionError(
            f"{name} a model that leaves out laws of scene '{full.scene.name}', of its contacts "
            f"({full.law.name}) or of its bodies: it must know them, or refuse the scene"
        )


def _check_claim(reductor: Reductor, task: Task, model: AnsweringModel) -> None:
    """Compare what a model claims with validation answers, or else with training.

    Exactness with fresh answers.
    """
    if isinstance(model, FullModel):
        return
    full = task.full
    references = task.held_out
    if references is None and (not model.fields.exact or full.by_paths):
        references = task.snapshots
    elif references is None and task.sure:
        references = _fresh(full, task.sure)
    if references is not None:
        check_claim(_name_of(reductor), task.kind, model, references)


def _fresh(full: FullModel, count: int) -> SnapshotSet:
    """Full answers at random points.

    At more of them if none of the first has an answer, as beyond a limit load.

    Raises:
        ConvergenceError: if none has one.
    """
    points = full.parameters.random(max(count, MOST_FRESH), seed=count)
    with suppress(ConvergenceError):
        return compute_snapshots(full, points[:count], lost=Lost())
    return compute_snapshots(full, points[count:], lost=Lost())


@dataclass(frozen=True)
class SingleAttempt(Reductor[Task]):
    """An object with ``reduced(full, snapshots, held_out)`` alone.

    One attempt, which checks its model by itself.
    """

    given: Any
    method: ClassVar[str] = "own"
    refusals: ClassVar[tuple[type[HHRError], ...]] = ()
    own_range: ClassVar[bool] = True

    def attempt(self, prepared: Task, level: int) -> tuple[AnsweringModel, None]:
        """The model that it returns.

        Args:
            prepared: input of the reduction.
            level: not used.
        """
        return self.given.reduced(prepared.full, prepared.snapshots, prepared.held_out), None

    def compare(self, task: Task, model: AnsweringModel) -> tuple[None, Trained | None]:
        """Nothing is compared.

        Args:
            task: input of the reduction.
            model: model that was built.
        """
        return None, getattr(model, "trained", None)


def as_reductor(given: RecipeLike) -> Reductor | None:
    """A reductor, or an object with ``reduced``; None for anything else."""
    if isinstance(given, Reductor):
        return given
    return (
        SingleAttempt(given)
        if callable(getattr(given, "reduced", None)) and not isinstance(given, type)
        else None
    )


OWN = (
    Way("hhr_dolfinx.reduction.exact:ExactCondensation",
        lambda full: full.equilibrium is None and not full.problem.varies, condenses=True),
    Way("hhr_dolfinx.reduction.build:HyperReduction", lambda full: True),
)  # fmt: skip
"""Reductors of the core, by place."""


def ways(full: FullModel) -> list[Way]:
    """Reductors for a full model, not loaded yet.

    Those that keep all contact conditions come first.
    """
    candidates = (
        *OWN,
        *(way for plugin in registry.installed().values() for way in plugin.reductors.values()),
    )
    return sorted(
        (way for way in candidates if registry.wants(way, full)), key=lambda way: not way.condenses
    )


def condensing(full: FullModel) -> type[Reductor]:
    """The first reductor for a full model that keeps all contact conditions.

    Raises:
        NotOfferedError: if there is none.
    """
    for way in ways(full):
        if way.condenses:
            return registry.load(way.place)
    of_what = (
        "whose stiffness or shape depends on parameters" if full.problem.varies else "as it is"
    )
    raise NotOfferedError(
        f"no installed reductor condenses scene '{full.scene.name}', {of_what}: it takes a "
        "plug-in that registers one"
    )
