"""Greedy training, thesis Alg. 1.3: answers are added where a reduced model of those before is worst.

An error indicator picks the worst candidate; it needs no full-order answer. The box in which points are chosen is that
of the scene or, where bodies flow, that of a family of paths.

An indicator of your own is an object with ``prepared(full)``, which returns what maps a reduced model, the answers it
was built from and some of its own answers (histories, where bodies flow) to one number for each of them, or to one
vector whose norm counts: then it is known too which of them are wrong in the same way.
"""

from __future__ import annotations

import logging
import warnings
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np
from mpi4py import MPI

from hhr_dolfinx import ranks
from hhr_dolfinx.certify.accuracy import force_floor
from hhr_dolfinx.contact.active_set import Pairs, SchurEqualities, active_set
from hhr_dolfinx.contact.problem import ContactProblem, IndexSets
from hhr_dolfinx.contact.restriction import Restriction, restricted
from hhr_dolfinx.errors import (
    BudgetWarning,
    ConvergenceError,
    FileContentError,
    NotSolvableError,
    ReductionError,
    StudyError,
)
from hhr_dolfinx.files import check_layout, read_arrays, write_arrays
from hhr_dolfinx.linear.sparse import FreeCholesky
from hhr_dolfinx.models.answer import Answer, History
from hhr_dolfinx.parameters import ParameterSpace, is_number, is_whole
from hhr_dolfinx.path_families import PathFamily
from hhr_dolfinx.reduction.build import build, usual_recipe
from hhr_dolfinx.reduction.recipe import Pod, Recipe
from hhr_dolfinx.sampling import Lattice, Sobol
from hhr_dolfinx.snapshots.records import SnapshotSet
from hhr_dolfinx.snapshots.store import digest_of_values

if TYPE_CHECKING:
    from mpi4py.MPI import Comm

    from hhr_dolfinx.snapshots.store import SnapshotStore


Score = Callable[[Any, SnapshotSet, Sequence[Any]], np.ndarray]
"""Maps a reduced model, what it was built from, and some of its answers or histories to indicators, (n,) or (n, k)."""

NO_ANSWER = np.inf
"""Indicator of what has no answer."""


class GreedyIndicator(Protocol):
    """What says how wrong answers are."""

    def prepared(self, full: Any) -> Score:
        """With all that does not depend on a reduced model computed once.

        Raises:
            StudyError: for a full model it cannot judge.
        """


def _refuse_flow(full: Any, name: str) -> None:
    if full.equilibrium is not None:
        raise StudyError(
            f"bodies of scene '{full.scene.name}' flow, and {name} judges single answers of elastic ones: take "
            "LargestEstimate()"
        )


@dataclass(frozen=True)
class LargestEstimate:
    """What answers say of themselves: the larger of both relative errors of ``estimate()``, in a history the largest.

    That of an elastic answer is a bound or nearly one, where its model has one. That of a step of bodies that flow is
    the part of its stress that no mode of training explains; it follows the error of the stress, see docs/bounds.md.
    """

    def prepared(self, full: Any) -> Score:
        """See :class:`GreedyIndicator`."""

        def score(model: Any, known: SnapshotSet, answers: Sequence[Answer | History | None]) -> np.ndarray:
            return np.array([NO_ANSWER if item is None else self._of(item, full) for item in answers])

        return score

    def _of(self, item: Answer | History, full: Any) -> float:
        answers = item.answers if isinstance(item, History) else [item]
        return max(self._of_answer(answer, full) for answer in answers)

    def _of_answer(self, answer: Answer, full: Any) -> float:
        if not answer.converged:
            return NO_ANSWER
        estimate = answer.estimate()
        if estimate is None:
            raise StudyError(
                f"answers of scene '{full.scene.name}' have no estimate: take another indicator, ForceError()"
            )
        return max(estimate.primal_relative, estimate.dual_relative)


@dataclass(frozen=True)
class ForceError:
    """Error of the contact forces everywhere, a vector, beside a condensed model that keeps all contact conditions.

    Where the stiffness is constant condensation is exact, and the indicator is the error; elsewhere condensation is
    interpolated between few parameters, and right to a small part of the tolerance. Forces below a thousandth of the
    largest of training count as that large.

    Attributes:
        settings: of the interpolation, a ``GridSettings``; None for the usual ones.
    """

    settings: Any = None

    def prepared(self, full: Any) -> Score:
        """See :class:`GreedyIndicator`."""
        _refuse_flow(full, "ForceError()")
        if full.problem.varies and full.problem.pins is not None:
            raise StudyError(
                f"contact alone holds bodies of scene '{full.scene.name}', and their elasticity depends on parameters: "
                "nothing tells a greedy training how wrong its forces are there. Train on points of the whole box "
                "instead: Sobol(128), or --sobol 128 in a command"
            )
        condensed: list[Any] = []
        exact: dict[bytes, np.ndarray] = {}

        def score(model: Any, known: SnapshotSet, answers: Sequence[Answer]) -> np.ndarray:
            if not condensed:
                condensed.append(self._condensed(full, known))
            floor = force_floor(full.problem, known)

            def error(answer: Answer) -> np.ndarray:
                key = answer.parameter.tobytes()
                if key not in exact:
                    exact[key] = condensed[0].solve(answer.parameter, outside="ignore").forces()
                if not answer.converged:
                    return np.full(exact[key].shape, NO_ANSWER)
                size = max(float(np.linalg.norm(exact[key])), floor)
                return (answer.forces() - exact[key]) / (size or 1.0)

            return np.array([error(answer) for answer in answers])

        return score

    def _condensed(self, full: Any, known: SnapshotSet) -> Any:
        if not full.problem.varies:
            from hhr_dolfinx.baselines.condensation import exact_condensation

            return exact_condensation(full, known.known_statuses(), field=False)
        from hhr_dolfinx.reduction.condense import condense
        from hhr_dolfinx.reduction.interpolate import GridSettings

        try:
            return condense(full, known, self.settings or GridSettings(), coarse=self.settings is not None)
        except ReductionError as error:
            raise StudyError(
                f"scene '{full.scene.name}' cannot be condensed, {error}: choose by another indicator, such as Eta2()"
            ) from error


@dataclass(frozen=True)
class Eta:
    """The indicator (1.73) of Fauque et al. (2018): beside the full equations of the RID, eta_u + eta_λ.

    What lies on the interface of the RID is interpolated between training answers, (1.72). The thesis interpolates on a
    regular grid; points that are chosen one by one make none, and radial functions r, which are exact at training
    points and linear in one parameter, take its place.
    """

    def prepared(self, full: Any) -> Score:
        """See :class:`GreedyIndicator`."""
        _refuse_flow(full, "Eta()")

        def score(model: Any, known: SnapshotSet, answers: Sequence[Answer]) -> np.ndarray:
            floor = force_floor(full.problem, known)
            domain = _Domain(full.problem, model.offline.sets)
            interface = _interpolated(full.problem, known, answers, domain.interface)

            def indicator(answer: Answer, there: np.ndarray) -> float:
                if not answer.converged:
                    return NO_ANSWER
                field, forces = domain.at(answer.parameter).solved(there, answer.parameter)
                own = model.offline.basis[domain.inner] @ answer.unknown - field
                return _ratio(own, field) + _ratio(answer.multipliers - forces, forces, floor)

            return np.array([indicator(*pair) for pair in zip(answers, interface, strict=True)])

        return score


@dataclass(frozen=True)
class Eta2:
    """The indicator (2.124) of the thesis: residual on the RID, and the jump on its interface to what is interpolated.

    In the energy norm of the RID, in which the form a has α = M_a = 1: |R|_{K^-1} + 2 |jump|_K, over the energy norm of
    the answer on the RID. Interpolated as for :class:`Eta`.
    """

    def prepared(self, full: Any) -> Score:
        """See :class:`GreedyIndicator`."""
        _refuse_flow(full, "Eta2()")

        def score(model: Any, known: SnapshotSet, answers: Sequence[Answer]) -> np.ndarray:
            domain = _Domain(full.problem, model.offline.sets)
            interface = _interpolated(full.problem, known, answers, domain.interface)

            def indicator(answer: Answer, there: np.ndarray) -> float:
                if not answer.converged:
                    return NO_ANSWER
                inside = domain.at(answer.parameter)
                field = model.offline.basis[inside.part.dofs] @ answer.unknown
                residual = inside.residual(field, answer.multipliers, answer.parameter)
                jump = np.zeros_like(field)
                jump[domain.places] = there - field[domain.places]
                size = inside.energy(field)
                return (inside.dual(residual) + 2 * inside.energy(jump)) / (size or 1.0)

            return np.array([indicator(*pair) for pair in zip(answers, interface, strict=True)])

        return score


def _ratio(error: np.ndarray, exact: np.ndarray, floor: float = 0.0) -> float:
    """Size of an error over that of what is exact, or a floor."""
    return float(np.linalg.norm(error)) / (max(float(np.linalg.norm(exact)), floor) or 1.0)


def _interpolated(
    problem: ContactProblem, known: SnapshotSet, answers: Sequence[Answer], dofs: np.ndarray
) -> np.ndarray:
    """U0 on some dofs between training answers, at the points of some answers, (n, dofs), see (1.72)."""
    from scipy.interpolate import RBFInterpolator

    lower, upper = np.array([problem.parameters.lower, problem.parameters.upper])
    asked = np.array([answer.parameter for answer in answers]).reshape(len(answers), -1)
    between = RBFInterpolator(
        (known.points - lower) / (upper - lower), known.displacements[dofs].T, kernel="linear", degree=0
    )
    return between((asked - lower) / (upper - lower))


class _Domain:
    """The full equations of a RID at any point, factored once where the stiffness is constant.

    Args:
        problem: the whole problem.
        sets: of the RID.

    Attributes:
        inner: dofs of A, in the whole problem.
        interface: dofs of the RID that are no dofs of A, likewise.
        places: of these among the dofs of the RID.
    """

    def __init__(self, problem: ContactProblem, sets: IndexSets):
        self._problem = problem
        self._sets = sets
        part = restricted(problem, sets)
        self.places = np.flatnonzero(~part.problem.free)
        self.inner = part.dofs[part.problem.free]
        self.interface = part.dofs[self.places]
        self._constant = None if problem.varies else _Inside(part)

    def at(self, point: np.ndarray) -> _Inside:
        """The equations of a point, (P,)."""
        return self._constant or _Inside(restricted(self._problem.at(point), self._sets))


class _Inside:
    """The full equations of a RID at one stiffness.

    Args:
        part: cut out of the whole problem.
    """

    def __init__(self, part: Restriction):
        self.part = part
        problem = part.problem
        whole = slice(0, problem.free.size)
        self._factors = FreeCholesky(problem.stiffness, problem.free, whole, "rid", "qmd", MPI.COMM_SELF)

    @cached_property
    def _contact(self) -> tuple[np.ndarray, SchurEqualities, Pairs | None]:
        """K^-1 B^T, what solves for forces, and their pairs."""
        problem = self.part.problem
        per_force = self._factors.solve_columns(problem.contact.T)
        return per_force, SchurEqualities.of(problem.contact @ per_force), Pairs.of(problem.contact_pairs)

    def solved(self, interface: np.ndarray, point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """U0 on A, and the forces of the RID, for what lies on its interface, see (1.73)."""
        problem = self.part.problem
        per_force, equalities, pairs = self._contact
        theta = problem.amplitudes(point)
        imposed = np.zeros(problem.free.size)
        imposed[~problem.free] = interface
        unloaded = self._factors.solve(problem.loads @ theta + self.part.load_of @ imposed)
        slack = problem.gaps @ theta + self.part.gap_of @ imposed - problem.contact @ unloaded
        found = active_set(equalities, slack, slack < 0, pairs=pairs)
        return (unloaded - per_force @ found.forces)[problem.free], found.forces

    def residual(self, field: np.ndarray, forces: np.ndarray, point: np.ndarray) -> np.ndarray:
        """R of (2.91) on A, 0 elsewhere, of U0 on the RID and its forces."""
        problem = self.part.problem
        left = problem.loads @ problem.amplitudes(point) - problem.stiffness @ field - problem.contact.T @ forces
        return left * problem.free

    def dual(self, residual: np.ndarray) -> float:
        """|R|_{K^-1}."""
        return float(np.sqrt(max(residual @ self._factors.solve(residual), 0.0)))

    def energy(self, field: np.ndarray) -> float:
        """|U0|_K on the dofs of the RID."""
        return float(np.sqrt(max(field @ (self.part.problem.stiffness @ field), 0.0)))


_log = logging.getLogger(__name__)

FORMAT = "hhr_dolfinx greedy choice"
VERSION = 1
_LAYOUT = {"points": ("float", "S", "P"), "counts": ("int", "R"), "worst": ("float", "R"), "middle": ("float", "R")}
FINE = 1e-13
"""Tolerance of the POD of a greedy training of points."""
UNKNOWN = 1e6
"""Indicator of a candidate without an answer: more than any error, and finite, so that distances still count."""
NOTHING = 1e-12
"""Part of an error that is round-off once the directions of others are taken out of it."""


class Round(NamedTuple):
    """What one model of a greedy training was worth.

    Attributes:
        answers: points, or paths, that it was trained on.
        worst: largest indicator among the candidates.
        middle: their median.
    """

    answers: int
    worst: float
    middle: float


class Choice(NamedTuple):
    """What a greedy training chose.

    Attributes:
        points: of the box, in the order in which they were chosen, (S, P).
        rounds: of each model on the way.
        recipe: of these models, for which the points were chosen.
    """

    points: np.ndarray
    rounds: tuple[Round, ...]
    recipe: Recipe


@dataclass(frozen=True)
class Greedy:
    """Where to train: a few points first, then those where an indicator is largest.

    Attributes:
        indicator: what says how wrong an answer is; None takes :class:`ForceError` of points, and of histories the
            largest estimate of their steps, :class:`LargestEstimate`.
        tolerance: indicator at which it stops, the largest among the candidates.
        budget: points, or paths, at which it stops otherwise.
        start: a sampling of the first ones. None takes a ``Lattice(20)``, or half of the budget of Sobol points where
            the stiffness varies.
        candidates: a sampling of those to choose from. None takes a ``Lattice(1000)``, or ``Sobol(2048)`` where the
            stiffness varies. Where it is constant points that share coordinates share fields of loads, and it takes
            fewer answers of them: on the pellet 150 that are chosen among Sobol points have errors more than ten times
            larger. Where it varies they share none, and what is chosen on few values of a modulus is wrong between.
        together: how many are added between two models.
        recipe: of the models on the way, which are not checked, and of those that the training builds by default. None
            takes the usual one where bodies flow, and elsewhere the usual one with more modes: each answer that was
            chosen brings what others do not, and a POD that leaves part of it out makes errors five times larger.
            Where the stiffness varies modes are of one body each: an answer brings as many as there are bodies.
        family: of the paths, where bodies flow; samplings are then drawn in the box of its own parameters.
    """

    indicator: GreedyIndicator | None = None
    tolerance: float = 0.01
    budget: int = 150
    start: Any = None
    candidates: Any = None
    together: int = 16
    recipe: Recipe | None = None
    family: PathFamily | None = None

    def __post_init__(self) -> None:
        """Refuse what never ends or never begins, with StudyError."""
        if not (is_number(self.tolerance) and self.tolerance > 0):
            raise StudyError(f"tolerance = {self.tolerance!r} of Greedy must be a positive number")
        for name in ("budget", "together"):
            if not is_whole(getattr(self, name), 1):
                raise StudyError(f"{name} = {getattr(self, name)!r} of Greedy must be a whole number from 1")
        for name in ("start", "candidates"):
            given = getattr(self, name)
            if given is not None and not callable(getattr(given, "points", None)):
                raise StudyError(f"{name} = {given!r} of Greedy must be a sampling, such as Sobol(16)")
        if self.indicator is not None and not callable(getattr(self.indicator, "prepared", None)):
            raise StudyError(f"indicator = {self.indicator!r} of Greedy must have prepared(full), as Eta2() has")
        for name, kind in (("recipe", Recipe), ("family", PathFamily)):
            if not isinstance(getattr(self, name), kind | None):
                raise StudyError(f"{name} = {getattr(self, name)!r} of Greedy must be a {kind.__name__}")

    def space(self, scene: Any) -> ParameterSpace:
        """The box of the points.

        Raises:
            StudyError: for a family where nothing flows, none where bodies flow, or one of another scene.
        """
        flows = any(body.law is not None for body in scene.bodies)
        if flows and self.family is None:
            raise StudyError(
                f"bodies of scene '{scene.name}' flow: a greedy training chooses among the paths of a family, "
                "Greedy(family=...)"
            )
        if self.family is None:
            return scene.parameters
        if not flows:
            raise StudyError(f"nothing of scene '{scene.name}' flows: a greedy training chooses points, not paths")
        if self.family.space.names != scene.parameters.names:
            raise StudyError(
                f"the family '{self.family.name}' has parameters {self.family.space.names}, the scene "
                f"'{scene.name}' {scene.parameters.names}"
            )
        return self.family.own

    def grown(
        self,
        full: Any,
        solve: Callable[[Any], SnapshotSet],
        comm: Comm,
        progress: Callable[[Any], Any] = iter,
        store: SnapshotStore | None = None,
    ) -> tuple[SnapshotSet, Choice]:
        """Training answers, and what was chosen.

        Args:
            full: the full model, one on each rank.
            solve: answers of the full model to points, (n, P), or paths; on all ranks together.
            comm: ranks, each of which has all answers; they share the candidates out.
            progress: wraps the iteration over the models.
            store: in whose folder the choice is kept too: what an earlier run chose is not looked for again.
        """
        space = self.space(full.scene)
        score = self._score(full)
        start, choices = self._samplings(full)
        candidates = space.points(choices.points(space))
        points = space.points(start.points(space))[: self.budget]
        rounds = []
        kept = None
        if store is not None and comm.rank == 0:
            kept = KeptChoice(store.folder, store.problem_digest, self, self._recipe(full), full.parameters)
        earlier = comm.bcast(None if kept is None else kept.load(space))
        if earlier is not None:
            points, rounds = earlier
        known = solve(self._queries(points))
        most = 1 + -(-max(self.budget - len(points), 0) // self.together)
        for _ in progress(range(most)):
            if rounds and rounds[-1].answers == len(points):
                break  # an earlier run was done
            errors = self._errors(full, known, candidates, score, comm)
            values = np.linalg.norm(errors, axis=1)
            rounds.append(Round(len(points), float(values.max()), float(np.median(values))))
            _log.info("greedy training: %d answers, indicator %.3g", *rounds[-1][:2])
            chosen = np.zeros(0, dtype=np.int64)
            if rounds[-1].worst > self.tolerance:
                room = min(self.together, self.budget - len(points))
                chosen = comm.bcast(_chosen(errors, candidates, points, space, room))
            if chosen.size:
                more = candidates[chosen]
                points = np.vstack([points, more])
                with suppress(ConvergenceError):  # none of them has an answer, and none is asked for again
                    known = known.joined(solve(self._queries(more)))
            if kept is not None:
                kept.save(points, rounds)
            if not chosen.size:
                break
        if rounds[-1].worst > self.tolerance and comm.rank == 0:
            warnings.warn(
                f"the greedy training ended after {len(points)} answers, its budget is {self.budget}: its indicator is "
                f"{rounds[-1].worst:.2g} where {self.tolerance:g} was wished. Raise the budget, or accept that error",
                BudgetWarning,
                stacklevel=3,
            )
        return known, Choice(points, tuple(rounds), self._recipe(full))

    def _samplings(self, full: Any) -> tuple[Any, Any]:
        """Of the first points, and of the candidates."""
        start: Any = Lattice(20)
        candidates: Any = Lattice(1000)
        if self.family is None and full.problem.varies:
            start = Sobol(-(-self.budget // 2))
            candidates = Sobol(2048, seed=5)
        return start if self.start is None else self.start, candidates if self.candidates is None else self.candidates

    def _recipe(self, full: Any) -> Recipe:
        """Of the models on the way."""
        if self.recipe is not None:
            return self.recipe
        if self.family is not None:
            return usual_recipe(full)
        return Recipe(basis=Pod(FINE, relative=True, by_body=full.problem.varies))

    def _queries(self, points: np.ndarray) -> Any:
        """What is asked of the full model."""
        return points if self.family is None else self.family.paths(points)

    def _score(self, full: Any) -> Score:
        """The indicator, with what of it needs no model."""
        usual = ForceError() if self.family is None else LargestEstimate()
        return (usual if self.indicator is None else self.indicator).prepared(full)

    def _errors(self, full: Any, known: SnapshotSet, candidates: np.ndarray, score: Score, comm: Comm) -> np.ndarray:
        """Indicators of a model of what is known, (n, k)."""
        recipe = self._recipe(full).as_it_is()
        mine = np.array_split(candidates, comm.size)[comm.rank]
        found = np.zeros((0, 1))
        with ranks.each_for_itself(comm, "choosing where to train"):
            try:
                model = build(full, known, recipe)
            except NotSolvableError as error:  # too few answers for a model: all of the box is unknown
                _log.info("greedy training: no model of %d answers: %s", len(known.points), error)
                found = np.full((len(mine), 1), UNKNOWN)
            else:
                found = score(model, known, self._answers(model, mine))
                found = found.reshape(len(mine), -1) if len(mine) else np.zeros((0, 1))
                found[~np.isfinite(found).all(axis=1)] = UNKNOWN / np.sqrt(found.shape[1])
        return np.concatenate([part for part in comm.allgather(found) if len(part)])

    def _answers(self, model: Any, points: np.ndarray) -> list[Any]:
        """Answers or histories of a reduced model; None for a history that it cannot finish."""
        if self.family is None:
            return list(model.solve_many(points, outside="ignore", raise_on_failure=False)) if len(points) else []
        return [_marched(model, path) for path in self.family.paths(points)] if len(points) else []


def _marched(model: Any, path: Any) -> Any:
    from hhr_dolfinx.models.histories.equilibrium import MarchSettings, told_once

    try:
        with told_once():
            return model.march(path, MarchSettings(outside="ignore"))
    except (ConvergenceError, NotSolvableError):
        return None


def _chosen(
    errors: np.ndarray, candidates: np.ndarray, known: np.ndarray, space: ParameterSpace, count: int
) -> np.ndarray:
    """Numbers of the candidates to add, (k,): by their errors as vectors where all have one, else by distances."""
    if errors.shape[1] == 1 or (np.linalg.norm(errors, axis=1) >= UNKNOWN / 2).any():
        return apart(candidates, np.linalg.norm(errors, axis=1), known, space, count)
    there = (candidates[:, None] == known).all(axis=2).any(axis=1)
    return independent(np.where(there[:, None], 0.0, errors), count)


def independent(errors: np.ndarray, count: int) -> np.ndarray:
    """Numbers of the errors that are largest once the directions of those chosen before are taken out, (k,).

    What is wrong in the same way at several candidates one answer mends. On the pellet 150 answers chosen so, 16 at a
    time, have half the error of as many that were chosen by size and distance.

    Args:
        errors: of each candidate, (n, k).
        count: how many at most.
    """
    left = errors.copy()
    chosen = list[int]()
    least = NOTHING * np.linalg.norm(errors, axis=1).max(initial=0.0)
    while len(chosen) < count:
        sizes = np.linalg.norm(left, axis=1)
        worst = int(sizes.argmax())
        if not sizes[worst] > least:
            break
        chosen.append(worst)
        direction = left[worst] / sizes[worst]
        left -= np.outer(left @ direction, direction)
        left[worst] = 0.0
    return np.array(chosen, dtype=np.int64)


def apart(
    candidates: np.ndarray, values: np.ndarray, known: np.ndarray, space: ParameterSpace, count: int
) -> np.ndarray:
    """Numbers of candidates with large values that are far from what is known and from each other, (k,).

    The worst alone would be neighbours, of which one answer helps all: each value is weighed by the distance to the
    nearest point that is there or chosen, over what these have on average. Candidates that are there already are
    never chosen.

    Args:
        candidates: (n, P).
        values: their indicators, not negative, (n,).
        known: points that are there, (S, P).
        space: the box.
        count: how many at most.
    """
    lower, upper = np.array([space.lower, space.upper])
    scaled, there = ((points - lower) / (upper - lower) for points in (candidates, known))
    distances = np.full(len(scaled), np.inf)
    for point in there:
        distances = np.minimum(distances, np.linalg.norm(scaled - point, axis=1))
    chosen: list[int] = []
    while len(chosen) < count:
        worth = values * distances
        best = int(worth.argmax())
        if not worth[best] > 0:
            break
        chosen.append(best)
        distances = np.minimum(distances, np.linalg.norm(scaled - scaled[best], axis=1))
    return np.array(chosen, dtype=np.int64)


class KeptChoice:
    """What a greedy training chose, beside the answers in its folder, so that a killed one goes on where it stopped.

    Args:
        folder: of the answers.
        problem: digest of the problem that they solve, hexadecimal.
        greedy: how to choose.
        recipe: of its models.
        space: the box, which is not part of a problem.
    """

    def __init__(self, folder: Path, problem: str, greedy: Greedy, recipe: Recipe, space: ParameterSpace):
        box = [space.names, *(tuple(float(end) for end in ends) for ends in (space.lower, space.upper))]
        asked = FORMAT, VERSION, problem, greedy, recipe, box
        self._digest = digest_of_values(asked, "a greedy training that is kept in a folder")[:40]
        self._path = folder / f"greedy_{self._digest[:16]}.npz"

    def load(self, space: ParameterSpace) -> tuple[np.ndarray, list[Round]] | None:
        """Points and rounds, see :class:`Choice`, or None where there are none that fit."""
        try:
            header, arrays = read_arrays(self._path, FORMAT, VERSION)
            check_layout(arrays, _LAYOUT, {"P": len(space.names)})
        except (FileNotFoundError, FileContentError):
            return None
        if header.get("asked") != self._digest:
            return None
        rounds = zip(arrays["counts"].tolist(), arrays["worst"].tolist(), arrays["middle"].tolist(), strict=True)
        return arrays["points"], [Round(*row) for row in rounds]

    def save(self, points: np.ndarray, rounds: list[Round]) -> None:
        """Keep what was chosen up to here.

        Raises:
            FileError: if the file cannot be written.
        """
        counts, worst, middle = (np.array(part) for part in zip(*rounds, strict=True))
        arrays = {"points": points, "counts": counts.astype(np.int64), "worst": worst, "middle": middle}
        write_arrays(self._path, {"format": FORMAT, "version": VERSION, "asked": self._digest}, arrays)
