"""Training: a full model with the answers to train and to check reduced models.

They are computed once, and used by many models.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, TypeAlias

import numpy as np
from mpi4py import MPI

from hhr_dolfinx import registry
from hhr_dolfinx.errors import NotOfferedError, ParameterError, StudyError
from hhr_dolfinx.full_order.full import FullOrderModel
from hhr_dolfinx.group import ProcessGroup, group_of, share
from hhr_dolfinx.models.answer import Path as LoadPath
from hhr_dolfinx.models.condensed import CondensedModel
from hhr_dolfinx.models.histories.equilibrium import DEFAULT_MARCH, MarchSettings
from hhr_dolfinx.models.model import KeptModel
from hhr_dolfinx.models.shown import Shown, counted
from hhr_dolfinx.parameters import check_counts, has_names, is_whole
from hhr_dolfinx.reduction.build import build, not_by_rows, usual_recipe
from hhr_dolfinx.reduction.kinds import kind_of
from hhr_dolfinx.reduction.recipe import Recipe
from hhr_dolfinx.reduction.reductor import (
    CondensationSettings,
    RecipeLike,
    Task,
    condensing,
    everywhere,
    made,
)
from hhr_dolfinx.scene import Scene
from hhr_dolfinx.snapshots.records import (
    PROGRESS,
    Lost,
    SnapshotSet,
    held_out_points,
    queries_of,
    spread_snapshots,
    uniform_points,
)
from hhr_dolfinx.snapshots.store import SnapshotStore
from hhr_dolfinx.timing import Announce, StageLog, lines_of, terminal_lines

if TYPE_CHECKING:
    from hhr_dolfinx.parameters import ParameterSpace, PointsLike
    from hhr_dolfinx.sampling import LatinHypercube, Sobol

Progress = Callable[[str], Callable[[Iterable], Iterable]]
"""Maps a label to a wrapper of iterations, for progress bars."""


class ChoosingTraining(Protocol):
    """A training that chooses its queries itself, as ``Greedy`` does."""

    def space(self, scene: Scene) -> ParameterSpace:
        """Box of the points that are chosen; refuses a scene that it is not for."""

    def grown(
        self,
        full: FullOrderModel,
        solve: Callable[[np.ndarray | Sequence[LoadPath]], SnapshotSet],
        comm: MPI.Comm,
        progress: Callable[[Iterable], Iterable],
        store: SnapshotStore | None,
    ) -> tuple[SnapshotSet, object]:
        """Training answers, and the record of their choice.

        Args:
            full: the full model.
            solve: answers to points or paths.
            comm: ranks that share candidates.
            progress: progress bar of the choices.
            store: keeps answers; None keeps nothing.
        """


TrainingLike: TypeAlias = (
    "int | PointsLike | Sobol | LatinHypercube | Sequence[LoadPath] | ChoosingTraining"
)
"""Counts along each parameter of a grid, points, a sampling, load paths, or a training that chooses
its queries.
"""
HeldOut: TypeAlias = "int | Sequence[LoadPath] | None"
"""Number of parameters for the trust check, or paths; None for the default."""


@dataclass(frozen=True, repr=False)
class Training(Shown):
    """A full model with the answers to train and to check reduced models.

    Its methods build models from them.

    Attributes:
        full_order: the full model, on one rank or distributed over all.
        snapshots: training answers.
        held_out: answers for the trust check, or None.
        log: seconds of each stage.
        choice: points chosen by a greedy training, with the errors of its models; None for another
            training.
        read: number of answers that were read from files, whose seconds ``log`` lacks.
    """

    full_order: FullOrderModel
    snapshots: SnapshotSet
    held_out: SnapshotSet | None
    log: StageLog
    choice: Any = None
    read: int = 0

    def facts(self) -> dict[str, str]:
        """See :class:`~hhr_dolfinx.models.shown.Shown`."""
        held_out = 0 if self.held_out is None else len(self.held_out.points)
        return {
            "scene": f"scene '{self.full_order.scene.name}'",
            "answers": counted(len(self.snapshots.points), "full answer"),
            "held out": f"{held_out} held out",
            "sizes": f"{self.full_order.problem.free.size} unknowns",
            "contact": counted(self.full_order.conditions, "contact condition"),
        }

    @cached_property
    def everywhere(self) -> Training:
        """Training with all rows on each rank; itself if the full model is not distributed."""
        if self.full_order.spread.all_here:
            return self
        full, snapshots, held_out = everywhere(self.full_order, self.snapshots, self.held_out)
        return replace(self, full_order=full, snapshots=snapshots, held_out=held_out)

    def build(
        self,
        recipe: RecipeLike = None,
        *,
        checked: bool = True,
        announce: Announce | None = None,
    ) -> Any:
        """Build a reduced model.

        Only unsolvable models are refused without a check too: dependent contact rows, a singular
        K~.

        Args:
            recipe: a recipe, or a user-defined reductor, see
                :class:`~hhr_dolfinx.reduction.reductor.Reductor`. None takes the default recipe of
                the scene, or the one for which a greedy training chose.
            checked: check the model. Without a check it has no warning and no growth of its RID, so
                that it can be measured.
            announce: called with each stage as it begins.

        Raises:
            ReductionError, NotSolvableError, UnstableModelError: see
                :func:`~hhr_dolfinx.reduction.build.build`.
        """
        if recipe is None and self.choice is not None:
            recipe = self.choice.recipe
        if recipe is None and not checked:
            recipe = usual_recipe(self.full_order)
        if not checked and isinstance(recipe, Recipe):
            recipe = recipe.as_it_is()
        return build(
            self.full_order, self.snapshots, recipe, self.held_out if checked else None, announce
        )

    def __getattr__(self, name: str) -> Any:
        """Method that a plug-in adds."""
        import_paths = registry.named("kinds") | registry.named("methods")
        if name.startswith("_") or name not in import_paths:
            reason = registry.remedy("kinds", name) or registry.remedy("methods", name)
            raise AttributeError(
                f"a training has no {name!r}{reason or ', and no installed plug-in adds it'}"
            )
        return partial(registry.load(import_paths[name]), self)

    def condense(
        self, settings: CondensationSettings = None, announce: Announce | None = None
    ) -> CondensedModel | KeptModel:
        """Build a model that keeps all contact conditions, with its check.

        For elastic bodies of constant stiffness it is exact. If the stiffness or the shape depends
        on parameters it is interpolated. Bodies with laws are condensed by the reductor of the
        plug-in that reads these.

        Args:
            settings: ``GridSettings``; None interpolates as finely as the bound of the errors, if
                that is small.
            announce: called with each stage as it begins.

        Raises:
            NotOfferedError: for bodies with rigid motions whose moduli or shapes are parameters,
                and if no installed plug-in interpolates.
        """
        full = self.full_order
        reductor = condensing(full)
        snapshots, held_out, fields = kind_of(full).condensed_from(self.snapshots, self.held_out)
        task = Task(full, snapshots, held_out, announce=announce or terminal_lines())
        return made(reductor.usual(settings, fields=fields), task)


def train(
    scene: Scene,
    training: TrainingLike,
    *,
    held_out: HeldOut = None,
    seed: int = 1,
    folder: str | Path | None = None,
    comm: MPI.Comm = MPI.COMM_WORLD,
    march: MarchSettings = DEFAULT_MARCH,
    progress: Progress = lines_of,
    together: bool | None = None,
) -> Training:
    """Build the full model of a scene on each rank and share the training between the ranks.

    If these models exceed the memory, one full model is distributed, and problems are solved one
    after another.

    Args:
        scene: the scene.
        training: the number of points along each parameter, on a regular grid; a sampling,
            ``Sobol(512)`` or ``LatinHypercube(100)``; ``Greedy(budget=100)``, which chooses points
            where present models are worst; or an array of points, (S, P). If answers depend on
            their path, a list of paths, each of times in seconds and parameters, or drawn from a
            family, ``family.paths(Sobol(12))``, ``Greedy(family=family)``.
        held_out: for the trust check: a number of random parameters (100, a fifth of them with
            grazing contact; 0 for none), or paths.
        seed: of random parameters.
        folder: keeps answers for later runs; None keeps nothing.
        comm: communicator over which the training is distributed.
        march, progress: settings of histories, and progress bars; by default lines on a terminal.
        together: whether one full model is distributed over the ranks, with its factors, answers
            and bases (unless :func:`~hhr_dolfinx.reduction.build.not_by_rows`), which then build
            models together; None: by memory.

    Raises:
        StudyError: for an invalid training, number of answers, seed or folder, before anything is
            computed.

    Example:
        With the scene of :class:`~hhr_dolfinx.Scene`:

        >>> training = hhr.train(scene, hhr.Sobol(64))
        >>> model = training.build()
        >>> answer = model.solve({"push": 50.0})
        >>> round(answer.outputs()["peak"], 1), answer.estimate().kind
        (56.5, 'bound')
    """
    group = group_of(comm)
    with group.together("a training"):  # a full disk or a warning that is an error may end one rank
        return _trained(scene, training, held_out, seed, folder, group, march, progress, together)


def _trained(
    scene: Scene, training: TrainingLike, held_out: HeldOut, seed: int, folder: str | Path | None,
    group: ProcessGroup,
    march: MarchSettings, progress: Progress, together: bool | None,
) -> Training:  # fmt: skip
    """See :func:`train`."""
    log = StageLog()
    with group.each("checking what to train on"):
        queries, apart = checked_training(scene, training, held_out, seed)
        folder = None if folder is None else checked_folder(folder)
    values = [] if chooses_itself(queries) else queries_of(scene.parameters, queries).request()[1:]
    group.agreed(
        "a training", lambda: [f"scene '{scene.name}'", repr((scene, seed, together)), *values]
    )
    with log.stage("full_order"):
        full = _full_model(scene, group, together, queries, log)
    with group.each("opening the folder of answers"):
        store = None if folder is None else SnapshotStore(folder, full)
    with log.stage("snapshots"), full.strains.paused():
        snapshots, choice = _solved(full, queries, group, progress, store, march)
    validation = None
    if apart:
        with log.stage("held_out"), full.strains.paused():
            # a number of points is chosen by forces, whose last digits may differ between machines
            points = (
                apart
                if isinstance(apart, list)
                else held_out_points(full.problem, snapshots, apart, seed)
            )
            points = group.from_first(points)
            validation = _answered(
                full,
                points,
                group,
                _bar(progress, "held out", group),
                store,
                march,
                "queries held out",
            )
    full.strains.check(full, snapshots, validation)
    # ranks of a distributed model have found the same
    counts = group.gathered(0 if store is None else store.found)
    count = max(counts) if full.group.size > 1 else sum(counts)
    if count:
        total = len(snapshots.points) + (0 if validation is None else len(validation.points))
        log.skip(
            "snapshots",
            f"{count} of {total} answers were read from {folder}: the times cover the others",
        )
    return Training(full, snapshots, validation, log, choice, count)


def _full_model(
    scene: Scene, group: ProcessGroup, together: bool | None, queries: TrainingLike, log: StageLog
) -> FullOrderModel:
    """A full model on each rank, or one distributed over all ranks.

    A distributed one keeps its rows if it reduces by rows.
    """
    reason = (
        group.no_room_side_by_side(scene) if together is None else "it was requested" * together
    )
    if not reason or group.size == 1:
        with group.each(f"building the full model of scene '{scene.name}'"):
            return FullOrderModel(scene, MPI.COMM_SELF)
    if scene.shapes:
        raise StudyError(
            f"the shape of scene '{scene.name}' depends on parameters, which ranks do not solve "
            "for together: leave together out, and they work side by side"
        )
    log.skip(
        "problems side by side",
        f"{group.size} ranks solve one problem after another together, since {reason}",
    )
    full = FullOrderModel(scene, group.comm)
    reason = (
        "a greedy training chooses its points"
        if chooses_itself(queries)
        else not_by_rows(kind_of(full))
    )
    if full.spread.all_here or not reason:
        return full
    log.skip("rows of ranks", f"each rank has all rows of all matrices and answers: {reason}")
    return full.gathered()


def _bar(progress: Progress, label: str, group: ProcessGroup) -> Callable[[Iterable], Iterable]:
    """Progress bar of the user; all ranks raise if it fails on one."""
    with group.each(PROGRESS):
        return progress(label)


def _answered(
    full: FullOrderModel,
    queries: np.ndarray | Sequence[LoadPath],
    group: ProcessGroup,
    progress: Callable[[Iterable], Iterable],
    store: SnapshotStore | None,
    march: MarchSettings,
    what: str,
) -> SnapshotSet:
    """Answers to queries; warns of those without one."""
    lost = Lost()
    answers = spread_snapshots(full, queries, group, progress, store, march, lost)
    lost.warn(len(queries), 1, what)
    return answers


def _solved(
    full: FullOrderModel,
    queries: Any,
    group: ProcessGroup,
    progress: Progress,
    store: SnapshotStore | None,
    march: MarchSettings,
) -> tuple[SnapshotSet, Any]:  # fmt: skip
    """Training answers, and the record of a greedy choice; warns of queries without an answer."""
    lost = Lost()
    choice = None
    if chooses_itself(queries):

        def solve(points: np.ndarray | Sequence[LoadPath]) -> SnapshotSet:
            return spread_snapshots(full, points, group, iter, store, march, lost)

        bar = _bar(progress, "greedy", group)
        # ranks share candidates if each has a full model
        snapshots, choice = queries.grown(
            full,
            solve,
            MPI.COMM_SELF if full.group.size > 1 else group.comm,
            lambda items: group.in_step(lambda: bar(items), PROGRESS),
            store,
        )
    else:
        snapshots = spread_snapshots(
            full, queries, group, _bar(progress, "snapshots", group), store, march, lost
        )
    count = len(queries if choice is None else choice.points)
    lost.warn(count, (count + 1) // 2, "training queries")
    return snapshots, choice


class PartSolved(NamedTuple):
    """Counts of one part of a training.

    Training queries, held-out queries, and answers that existed already.
    """

    training: int
    held_out: int
    read: int


def train_part(
    scene: Scene,
    training: TrainingLike,
    number: int,
    parts: int,
    folder: str | Path,
    *,
    held_out: HeldOut = None,
    seed: int = 1,
    comm: MPI.Comm = MPI.COMM_WORLD,
    march: MarchSettings = DEFAULT_MARCH,
    progress: Progress = lines_of,
) -> PartSolved:
    """Solve one of several parts of a training, the work of a job of an array.

    Parts share only the folder of answers.

    After all parts, ``train(scene, training, folder=folder)`` with the same arguments reads them,
    and solves the missing ones: held-out points with grazing contact, which depend on all training
    answers.

    Args:
        scene, training, held_out, seed, comm, march, progress: see :func:`train`.
        number, parts: number of this part, from 1 on, and of all parts.
        folder: keeps the answers.

    Raises:
        StudyError: for a part that does not exist, and for an invalid training.
        NotOfferedError: for a greedy training, whose choices each need all answers before.
    """
    group = group_of(comm)
    with group.each("checking what to train on"):
        if not (is_whole(parts, 1) and is_whole(number, 1) and number <= parts):
            raise StudyError(
                f"part {number!r} of {parts!r}: give numbers from 1 on, such as part 3 of 8"
            )
        queries, apart = checked_training(scene, training, held_out, seed)
        if chooses_itself(queries):
            raise NotOfferedError(
                "a greedy training chooses each point from all answers before it, and has no "
                "parts: give a grid, Sobol(512) or a list of paths, or run it on several ranks"
            )
        target = checked_folder(folder)
    with group.each(f"building the full model of scene '{scene.name}'"):
        full = FullOrderModel(scene, MPI.COMM_SELF)
        store = SnapshotStore(target, full)
    held_out_queries = (
        apart if isinstance(apart, list) else uniform_points(full.parameters, apart, seed)
    )
    counts = []
    for label, all_queries in (("snapshots", queries), ("held out", held_out_queries)):
        mine = [all_queries[k] for k in share(len(all_queries), number - 1, parts)]
        counts.append(len(mine))
        if mine:
            bar = _bar(progress, label, group)
            _answered(full, mine, group, bar, store, march, f"queries of part {number} of {parts}")
    return PartSolved(counts[0], counts[1], group.total(store.found))


def chooses_itself(training: TrainingLike) -> bool:
    """True if a training chooses its queries itself, as ``Greedy`` does.

    Others do not import its module.
    """
    return callable(getattr(training, "grown", None)) and not isinstance(training, type)


def checked_training(scene: Scene, training: Any, held_out: HeldOut, seed: int) -> tuple[Any, Any]:
    """Points or paths to train on; number of points, or paths, that are held out.

    Args:
        scene: the scene.
        training: the training, see :func:`train`.
        held_out: held-out queries, see :func:`train`.
        seed: seed of random points.

    Raises:
        StudyError: for an invalid scene, training, number or seed.
    """
    if not isinstance(scene, Scene):
        raise StudyError(f"{scene!r} is no scene: give a Scene")
    check_counts(seed=(seed, 0))
    if scene.by_paths:
        return registry.tool("queries", f"training of scene '{scene.name}'")(
            scene, training, held_out
        )
    chooses = chooses_itself(training)
    if chooses:
        training.space(scene)
    count = 100 if held_out is None else held_out
    check_counts(held_out=(count, 0))
    return training if chooses else training_points(scene, training), count


def training_points(scene: Scene, training: Any) -> np.ndarray:
    """Training points, (S, P).

    Args:
        scene: the scene.
        training: counts along each parameter of a regular grid, a sampling, or points.

    Raises:
        StudyError: for invalid or fewer than two points.
    """
    original = training
    if isinstance(training, type):
        raise StudyError(
            f"{training.__name__} is a class: give what it makes, {training.__name__}(...)"
        )
    try:
        if hasattr(training, "points"):
            training = np.asarray(training.points(scene.parameters))
        is_table = has_names(training)
        is_table = is_table or (
            isinstance(training, np.ndarray) and (training.ndim > 1 or training.dtype.kind == "f")
        )
        points = scene.parameters.points(training) if is_table else scene.parameters.grid(training)
    except ParameterError as error:
        raise StudyError(f"training of scene '{scene.name}': {error}") from None
    if len(points) < 2:
        raise StudyError(
            f"training of scene '{scene.name}' on {original!r} points: a reduced model needs at "
            "least 2 of them. Give it more, Sobol(64) or a grid such as (16, 16)"
        )
    return points


def checked_folder(folder: str | Path) -> Path:
    """A folder to write to, which need not exist.

    Raises:
        StudyError: for an impossible one.
    """
    if not isinstance(folder, str | os.PathLike):
        raise StudyError(f"the folder {folder!r} must be a path")
    path = Path(folder)
    try:
        if "\0" in str(path):  # some versions of Python would report a missing file
            raise ValueError("embedded null byte")
        existing = next((ancestor for ancestor in (path, *path.parents) if ancestor.exists()), path)
    except (OSError, ValueError) as error:
        raise StudyError(
            f"the folder {str(path)[:80]!r} cannot be made: {error}. Choose another name"
        ) from None
    if existing.exists() and not existing.is_dir():
        raise StudyError(
            f"the folder {path} cannot be made: {existing} is a file. "
            "Choose another folder or move it"
        )
    return path
