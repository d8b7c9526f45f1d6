"""Snapshots: full-order answers for training, thesis sections 1.4.2 and 6.2.3.

They belong to training parameters, or to steps of training paths.

Queries without an answer, for example beyond a limit load, are left out with a warning. The
held-out points, at which a reduced model is checked, are random, or near parameters with light
contact.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Protocol, TypeVar, cast

import numpy as np

from hhr_dolfinx import registry
from hhr_dolfinx.certify.accuracy import force_floor, round_off_force
from hhr_dolfinx.contact.problem import ContactProblem
from hhr_dolfinx.errors import ConvergenceError, NotSolvableError, ReductionError, TrainingWarning
from hhr_dolfinx.group import ProcessGroup, group_of, share
from hhr_dolfinx.models.answer import Answer, History, ModelFields, Path
from hhr_dolfinx.models.histories.equilibrium import DEFAULT_MARCH, MarchSettings
from hhr_dolfinx.models.shown import Shown, counted
from hhr_dolfinx.models.starts import KnownStatuses
from hhr_dolfinx.parameters import PointsLike, has_names
from hhr_dolfinx.warn import warn

if TYPE_CHECKING:
    from mpi4py.MPI import Comm

    from hhr_dolfinx.linear.rows import Rows
    from hhr_dolfinx.memory import Memory
    from hhr_dolfinx.models.full import FullModel
    from hhr_dolfinx.parameters import ParameterSpace
    from hhr_dolfinx.snapshots.store import SnapshotStore


Query = TypeVar("Query")

NAMED = 5
"""Largest count of queries without an answer that a warning names."""


@dataclass
class Lost:
    """Queries without an answer, for example beyond a limit load.

    Each has a label and a reason.
    """

    failures: list[tuple[str, str]] = field(default_factory=list)

    @contextmanager
    def recorded(self, label: str) -> Iterator[None]:
        """Record the query ``label`` if it has no answer, instead of raising its error."""
        try:
            yield
        except (ConvergenceError, NotSolvableError) as error:
            self.failures.append((label, str(error)))

    def warn(self, count: int, least: int, kind: str) -> None:
        """Warn of the first failures among some queries.

        Args:
            count: number of queries.
            least: number of answers that are needed.
            kind: name of the queries, in the plural.

        Raises:
            ConvergenceError: if fewer than ``least`` are left.
        """
        if not self.failures:
            return
        named = "; ".join(f"{label}: {reason}" for label, reason in self.failures[:NAMED])
        more = f"; and {len(self.failures) - NAMED} more" if len(self.failures) > NAMED else ""
        message = (
            f"{len(self.failures)} of {count} {kind} have no answer and are left out: {named}{more}"
        )
        if count - len(self.failures) < least:
            raise ConvergenceError(
                f"{message}. Fewer than {least} are left: lower the loads, or narrow the box"
            )
        warn(
            (
                f"{message}. Models know nothing of what is near them: lower the loads, or narrow "
                "the box"
            ),
            TrainingWarning,
        )


HELD_OUT_SEED = 2000
"""Offset of the seed for held-out points to that of a training."""
GRAZING_SHARE = 0.2
"""Fraction of held-out points drawn near light contact, and of the training solutions that count as
light contact.

Errors of forces are largest if only a few nodes touch. On the pellet-cladding scene this happens in
a corner of 1 % of the parameter box: for every second seed 100 random points missed it, and models
with errors of 70 % were accepted.
"""


def uniform_points(space: ParameterSpace, number: int, seed: int) -> np.ndarray:
    """Held-out points that depend only on the seed of a training, (k, P).

    Args:
        space: the box of the parameters.
        number: number of held-out points, of which these are four fifths.
        seed: seed of the training.
    """
    return space.random(number - int(GRAZING_SHARE * number), seed + HELD_OUT_SEED)


def held_out_points(
    problem: ContactProblem, training: SnapshotSet, number: int, seed: int
) -> np.ndarray:
    """Held-out points for the trust check, (number, P).

    Uniform in the box, the last fifth near light contact, if any. These lie within one spacing of
    the training points from the solutions with the smallest forces above round-off.

    Args:
        problem: the contact problem.
        training: training answers.
        number: number of points.
        seed: seed of the training.
    """
    space = problem.parameters
    sizes = np.linalg.norm(training.forces, axis=0)
    touching = np.flatnonzero(sizes > force_floor(problem, training))
    aimed = int(GRAZING_SHARE * number) if touching.size else 0
    seed = seed + HELD_OUT_SEED
    if aimed == 0:
        return space.random(number, seed)
    uniform = space.random(number - aimed, seed)
    weakest = touching[np.argsort(sizes[touching], kind="stable")]
    centres = training.points[weakest[: int(np.ceil(GRAZING_SHARE * touching.size))]]
    centres = centres[np.arange(aimed) % len(centres)]
    lower, upper = np.array([space.lower, space.upper])
    # training points along each parameter: of their grid, or of a grid with as many points
    counts = np.array([np.unique(column).size for column in training.points.T])
    if counts.prod() != len(training.points):
        counts = np.full(counts.size, len(training.points) ** (1 / counts.size))
    step = (upper - lower) / np.maximum(counts - 1, 1)
    # a separate generator, so that the uniform points of a seed do not change
    draw = np.random.default_rng([seed, aimed])
    near = draw.uniform(np.maximum(centres - step, lower), np.minimum(centres + step, upper))
    return np.concatenate([uniform, near])


_log = logging.getLogger(__name__)

Progress = Callable[[Iterable], Iterable]
"""Wrapper of an iteration, for a progress bar."""
PROGRESS = "the progress bar of a training"
"""Name of what users wrap iterations in, for messages of ranks."""


@dataclass(frozen=True, eq=False, repr=False)
class SnapshotSet(Shown):
    """Answers of the full model, one column each: at single parameters, or at steps of histories.

    Attributes:
        points: parameters, (S, P).
        displacements: homogeneous parts U0, that is displacements minus their lift, (N, S). For a
            full model on several ranks the local rows, (own, S), except for histories.
        forces: contact forces, (N_lambda, S).
        active: statuses, (N_lambda, S) bool.
        states: memory of laws of bodies, one for each column; empty for elastic bodies.
        histories: histories whose steps are the columns; empty for answers at single parameters.
    """

    points: np.ndarray
    displacements: np.ndarray
    forces: np.ndarray
    active: np.ndarray
    states: tuple[Memory, ...] = ()
    histories: tuple[History, ...] = ()

    def facts(self) -> dict[str, str]:
        """Facts to show, see :class:`~hhr_dolfinx.models.shown.Shown`."""
        steps = f"steps of {len(self.histories)} histories" if self.histories else "answers"
        return {
            "answers": f"{len(self.points)} {steps}",
            "parameters": counted(self.points.shape[1], "parameter"),
            "unknowns": counted(len(self.displacements), "unknown"),
            "contact": counted(len(self.forces), "contact condition"),
        }

    @classmethod
    def of_answers(
        cls, answers: Iterable[Answer], histories: Sequence[History] = (), rows: Rows | None = None
    ) -> SnapshotSet:
        """Make a set of answers of a full model, one column each.

        Args:
            answers: the answers, one or more.
            histories: histories whose steps they are.
            rows: rows of this rank, ``full.spread``, which are kept of each answer; None keeps all.
        """
        answers = [
            answer if rows is None else answer._replace(unknown=rows.of(answer.unknown))
            for answer in answers
        ]
        names = ("unknown", "multipliers", "active")
        unknown, forces, active = (
            np.stack([getattr(answer, name) for answer in answers], axis=1) for name in names
        )
        remembers = registry.memories(of_bodies=True) & answers[0].memory.keys()
        states = tuple(answer.memory for answer in answers) if remembers else ()
        points = np.array([answer.parameter for answer in answers])
        return SnapshotSet(points, unknown, forces, active, states, tuple(histories))

    @classmethod
    def of_histories(cls, histories: Iterable[History]) -> SnapshotSet:
        """Make a set of all steps of some histories.

        Raises:
            ReductionError: if there is no history, or one is invalid or has no step.
        """
        if isinstance(histories, History):
            raise ReductionError("give a list of histories, [history], not a single one")
        histories = list(histories)
        for number, history in enumerate(histories):
            if not isinstance(history, History):
                raise ReductionError(f"history {number} is {history!r}: give what march returns")
            if not history.answers:
                raise ReductionError(f"history {number} has no step: it needs at least one")
        if not histories:
            raise ReductionError(
                "a reduced model needs at least one training history, with at least one step"
            )
        return cls.of_answers(
            [answer for history in histories for answer in history.answers], histories
        )

    def take(self, columns: np.ndarray | slice) -> SnapshotSet:
        """Select columns, with repetitions if any, as answers at single parameters."""
        unknown, forces, active = (array[:, columns] for array in self._columns())
        chosen = np.arange(len(self.points))[columns]
        states = tuple(self.states[k] for k in chosen) if self.states else ()
        return SnapshotSet(self.points[columns], unknown, forces, active, states)

    def gathered(self, problem: ContactProblem) -> SnapshotSet:
        """Gather all rows on every rank, for answers of a problem with distributed rows.

        Collective.
        """
        if self.histories or problem.spread.all_here:
            return self
        return replace(self, displacements=problem.spread.whole(self.displacements))

    def joined(self, others: SnapshotSet) -> SnapshotSet:
        """Append other answers of the same problem.

        Raises:
            ReductionError: for answers at single parameters with histories, or answers on another
                mesh.
        """
        if bool(self.histories) != bool(others.histories) or len(self.displacements) != len(
            others.displacements
        ):
            raise ReductionError(
                f"{len(others.points)} answers cannot be joined to {len(self.points)} others: "
                "histories go with histories, and all are those of one mesh"
            )
        if self.histories:
            return SnapshotSet.of_histories([*self.histories, *others.histories])
        return _concatenated([self, others])

    def known_statuses(self, conditions: np.ndarray | slice = slice(None)) -> KnownStatuses:
        """Statuses of some conditions as initial statuses of further queries."""
        return KnownStatuses(self.points, np.ascontiguousarray(self.active[conditions].T))

    def any_contact(self, problem: ContactProblem) -> bool:
        """True if any answer has contact forces above round-off."""
        if self.histories:
            return bool(np.any(self.forces))
        return bool(np.linalg.norm(self.forces, axis=0).max() > round_off_force(problem, self))

    def _columns(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return self.displacements, self.forces, self.active


def _concatenated(parts: Sequence[SnapshotSet]) -> SnapshotSet:
    unknown, forces, active = (
        np.concatenate(arrays, axis=1)
        for arrays in zip(*(answers._columns() for answers in parts), strict=True)
    )
    return SnapshotSet(
        np.concatenate([answers.points for answers in parts]), unknown, forces, active
    )


def compute_snapshots(
    full: FullModel,
    queries: PointsLike | Sequence[Path],
    progress: Progress = iter,
    store: SnapshotStore | None = None,
    settings: MarchSettings = DEFAULT_MARCH,
    lost: Lost | None = None,
) -> SnapshotSet:
    """Answer queries by the full model: single parameters, or load paths for laws that remember.

    Args:
        full: full model.
        queries: parameters, (S, P) or with names, each solved from the statuses of the one before;
            or paths of times and parameters, each with the state at rest first.
        progress: wrapper of the iteration, for a progress bar.
        store: storage of answers: those found there are not computed again, new ones are saved at
            once, step by step.
        settings: settings of the solution of histories.
        lost: record of queries without an answer, so that the others are kept; None raises at the
            first one.

    Raises:
        ParameterError: if a point or a path is invalid.
        ConvergenceError, NotSolvableError: if a query has no answer; with ``lost``, if no query has
            one.
    """
    checked = queries_of(full.parameters, queries)
    return _some(
        checked.solved(SnapshotSolver(full, progress, store, settings, lost)), lost, len(checked)
    )


def _some(answers: SnapshotSet | None, lost: Lost | None, count: int) -> SnapshotSet:
    if answers is None:
        assert lost is not None
        label, reason = lost.failures[0]
        raise ConvergenceError(
            f"none of {count} queries has an answer; the first, {label}: {reason}"
        )
    return answers


def _are_paths(queries: PointsLike | Sequence[Path]) -> bool:
    """True for paths, lists of times and parameters, which do not form a table."""
    if has_names(queries):
        return False
    try:
        return np.ndim(np.array(queries, dtype=float)) > 2
    except (TypeError, ValueError):
        return True


class Queries(Protocol):
    """Queries of a full model: points, or paths, which a plug-in solves."""

    def __len__(self) -> int:
        """Number of queries."""

    def request(self) -> list[str | np.ndarray]:
        """Words and values, which must be the same on all ranks that share them."""

    def part(self, numbers: Sequence[int]) -> Queries:
        """Select some of them."""

    def solved(self, solver: SnapshotSolver) -> SnapshotSet | None:
        """Answers; None if none has an answer and the lost ones are recorded."""

    def gathered(
        self, own: SnapshotSet | None, full: FullModel, group: ProcessGroup
    ) -> SnapshotSet:
        """Answers of all ranks; some have any.

        Args:
            own: answers of this rank; None without any.
            full: the full model of this rank.
            group: the ranks.
        """


def queries_of(space: ParameterSpace, queries: Any) -> Queries:
    """Queries from points, (S, P) or with names, or from paths of times and parameters.

    Args:
        space: the box of the parameters.
        queries: points, (S, P) or with names, or paths of times and parameters.
    """
    if _are_paths(queries):
        paths: Queries = registry.tool("histories", "a set of snapshots along paths")(queries)
        return paths
    return SingleParameters(space.points(queries))


@dataclass(frozen=True)
class SnapshotSolver:
    """A full model with what is done with its answers, see :func:`compute_snapshots`."""

    full: FullModel
    progress: Progress
    store: SnapshotStore | None
    settings: MarchSettings
    lost: Lost | None

    def in_step(self, items: Iterable[Query]) -> Iterator[Query]:
        """Items with the progress bar of the user, on all ranks together."""
        return self.full.group.in_step(lambda: self.progress(items), PROGRESS)

    def recording(self, label: str) -> AbstractContextManager[None]:
        """A block that records the query ``label`` if it has no answer, or raises."""
        return nullcontext() if self.lost is None else self.lost.recorded(label)


@dataclass(frozen=True)
class SingleParameters:
    """Single parameters, (S, P), each solved from the statuses of the one before."""

    values: np.ndarray

    def __len__(self) -> int:
        return len(self.values)

    def request(self) -> list[str | np.ndarray]:
        """See :class:`Queries`."""
        return [f"{len(self.values)} points", np.array(self.values, dtype=float)]

    def part(self, numbers: Sequence[int]) -> SingleParameters:
        """See :class:`Queries`."""
        return SingleParameters(self.values[list(numbers)])

    def solved(self, solver: SnapshotSolver) -> SnapshotSet | None:
        """See :class:`Queries`."""
        full = solver.full
        full.group.agreed("snapshots", self.request)
        full.problem.require_no_memory("a set of snapshots at single parameters")
        with full.group.together("solving for snapshots"):
            answers = list(self._answers(solver))
            return SnapshotSet.of_answers(answers, rows=full.spread) if answers else None

    def _answers(self, solver: SnapshotSolver) -> Iterator[Answer]:
        full = solver.full
        store = solver.store
        start: str | np.ndarray = "nearest"
        for point in solver.in_step(self.values):
            answer = None if store is None else _stored(full, store, point)
            if answer is None:
                with solver.recording(full.parameters.described(point)):
                    answer = full.solve(point, start=start)
                if answer is None:
                    continue
                if store is not None and full.group.number == 0:
                    store.save(answer)
            start = answer.active
            yield answer
            _log.debug("answer at %s: %d iterations", point, answer.iterations)

    def gathered(
        self, own: SnapshotSet | None, full: FullModel, group: ProcessGroup
    ) -> SnapshotSet:
        """See :class:`Queries`.

        Args:
            own: answers of this rank; None without any.
            full: the full model of this rank.
            group: the ranks.
        """
        return _concatenated([answers for answers in group.gathered(own) if answers is not None])


def _stored(full: FullModel, store: SnapshotStore, point: np.ndarray) -> Answer | None:
    """Stored answer at a point, or None; one rank reads it, and all ranks check its residual."""
    group = full.group
    if group.size == 1:
        return store.load(point)
    answer = None if group.number else store.read(point)
    answer = group.from_first(None if answer is None else answer._replace(fields=NOWHERE))
    return (
        None
        if answer is None
        else store.judged(answer._replace(fields=full), aloud=group.number == 0)
    )


def spread_snapshots(
    full: FullModel,
    queries: PointsLike | Sequence[Path],
    comm: Comm | ProcessGroup,
    progress: Progress = iter,
    store: SnapshotStore | None = None,
    settings: MarchSettings = DEFAULT_MARCH,
    lost: Lost | None = None,
) -> SnapshotSet:
    """Distribute the queries of :func:`compute_snapshots` over the ranks of ``comm``.

    Every rank gets all answers.

    Each rank has a serial full model and the same queries; the ranks share the folder of the store.
    If a query fails on any rank, all ranks raise, unless ``lost`` records it, on all ranks. If the
    full model itself is distributed over the ranks, all of them solve one query after another.

    Args:
        full: full model of this rank, or one that the ranks share.
        queries: the same queries on all ranks, see :func:`compute_snapshots`.
        comm: communicator or group of the ranks.
        progress, store, settings, lost: see :func:`compute_snapshots`.
    """
    group = group_of(comm)
    if full.group.size > 1:
        return compute_snapshots(full, queries, progress, store, settings, lost)
    checked = queries_of(full.parameters, queries)
    group.agreed("a training", checked.request)
    local: SnapshotSet | None = None
    with group.each("solving for snapshots"):
        # consecutive queries on one rank, so that each one starts from a near solution
        mine = share(len(checked), group.number, group.size)
        if mine:
            local = checked.part(mine).solved(SnapshotSolver(full, progress, store, settings, lost))
    if group.size == 1:
        return _some(local, lost, len(checked))
    if lost is not None:
        lost.failures = [
            failure for failures in group.gathered(lost.failures) for failure in failures
        ]
    if not any(group.gathered(local is not None)):
        return _some(None, lost, len(checked))
    return checked.gathered(local, full, group)


NOWHERE = cast("ModelFields", None)
"""Fields of an answer that is sent to another rank."""


def check_of_problem(
    name: str, solutions: SnapshotSet | None, problem: ContactProblem
) -> SnapshotSet:
    """Check solutions.

    Args:
        name: name of the solutions, for the message.
        solutions: the solutions.
        problem: the contact problem.

    Returns:
        The same solutions.

    Raises:
        ReductionError: for invalid solutions, or those of another problem.
    """
    if not isinstance(solutions, SnapshotSet):
        raise ReductionError(
            f"{name} = {solutions!r} must be a SnapshotSet, what compute_snapshots returns"
        )
    points = np.shape(solutions.points)
    if len(points) != 2 or points[0] == 0 or points[1] != len(problem.parameters.names):
        raise ReductionError(
            f"the points of {name} have the shape {points}: one row for each solution, and columns "
            f"{problem.parameters.names}, are needed"
        )
    if not np.isfinite(solutions.points).all():
        raise ReductionError(
            f"the points of {name} are not finite: any query would seem outside what was trained"
        )
    kind = np.asarray(solutions.active).dtype
    if kind.kind != "b":
        raise ReductionError(f"active of {name} holds {kind}: statuses are bool")
    free = problem.free if solutions.histories else problem.spread.of(problem.free)
    rows = {"displacements": free.size, "forces": len(problem.gaps), "active": len(problem.gaps)}
    for attribute, size in rows.items():
        array = getattr(solutions, attribute)
        wrong = (
            np.shape(array) != (size, points[0])
            or np.iscomplexobj(array)
            or not np.isfinite(array).all()
        )
        if problem.spread.sum(float(wrong)):
            raise ReductionError(
                f"{attribute} of {name} have the shape {np.shape(array)}: {size} finite real "
                f"numbers for each of {points[0]} points are needed; are they of another "
                "mesh, or rows of one rank, where snapshots.gathered(problem) has all?"
            )
    return solutions
