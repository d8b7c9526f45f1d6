"""Greedy training, thesis Alg. 1.3: each round adds answers at the largest error indicators of the
reduced model.

An error indicator selects the worst candidate (:mod:`hhr_dolfinx.plugins.greedy.indicators`); it
needs no full answer. Points are chosen in the box of the scene or, for inelastic bodies, of a
family of paths.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.spatial.distance import cdist

from hhr_dolfinx.declared import check_layout
from hhr_dolfinx.errors import (
    BudgetWarning,
    ConvergenceError,
    FileContentError,
    NotSolvableError,
    StudyError,
)
from hhr_dolfinx.files import read_arrays, write_arrays
from hhr_dolfinx.group import group_of
from hhr_dolfinx.parameters import ParameterSpace, is_number, is_whole
from hhr_dolfinx.plugins.greedy.digest import digest_of_values
from hhr_dolfinx.plugins.greedy.indicators import (
    ForceError,
    GreedyIndicator,
    LargestEstimate,
    Score,
)
from hhr_dolfinx.plugins.greedy.lattice import Lattice
from hhr_dolfinx.reduction.build import build, usual_recipe
from hhr_dolfinx.reduction.recipe import Pod, Recipe
from hhr_dolfinx.sampling import Sobol
from hhr_dolfinx.snapshots.records import Progress, SnapshotSet
from hhr_dolfinx.snapshots.store import SnapshotStore
from hhr_dolfinx.warn import warn

if TYPE_CHECKING:
    from mpi4py.MPI import Comm

    from hhr_dolfinx.full_order.full import FullOrderModel
    from hhr_dolfinx.models.answer import Answer, History
    from hhr_dolfinx.models.answer import Path as LoadPath
    from hhr_dolfinx.models.model import AnsweringModel
    from hhr_dolfinx.plugins.paths.path_families import NamedPath, PathFamily, Sampling
    from hhr_dolfinx.scene import Scene


_log = logging.getLogger(__name__)

CHOICE_FORMAT = "hhr_dolfinx greedy choice"
"""Content of a file, in its header."""
CHOICE_VERSION = 1
"""Version of this format, in the header too."""
_LAYOUT = {
    "points": ("float", "S", "P"),
    "counts": ("int", "R"),
    "worst": ("float", "R"),
    "middle": ("float", "R"),
}
FINE = 1e-13
"""Tolerance of the POD of a greedy training of points."""
UNSOLVED_CANDIDATE = 1e6
"""Indicator of a candidate without an answer: more than any error, and finite, so that distances
still count.
"""
DIRECTION_ROUND_OFF = 1e-12
"""Part of an error that counts as round-off after the directions of others are removed."""


class Round(NamedTuple):
    """Quality of one model of a greedy training."""

    answers: int  #: points, or paths, that it was trained on
    worst: float  #: largest indicator among the candidates
    middle: float  #: their median


class GreedyChoice(NamedTuple):
    """Chosen points of the box, the models on the way, and their recipe.

    Points are in the order in which they were chosen, (S, P).
    """

    points: np.ndarray
    rounds: tuple[Round, ...]
    recipe: Recipe


@dataclass(frozen=True)
class Greedy:
    """Greedy choice of training points: a few points first, then those with the largest indicator.

    Attributes:
        indicator: estimates the error of an answer. None takes :class:`ForceError` for points, and
            for histories the largest estimate of their steps, :class:`LargestEstimate`.
        tolerance: indicator at which the training stops, the largest among the candidates.
        budget: points, or paths, at which it stops otherwise.
        start: a sampling of the first ones. None takes a ``Lattice(20)``, or half of the budget of
            Sobol points if the stiffness varies.
        candidates: a sampling of those to choose from. None takes a ``Lattice(1000)``, or
            ``Sobol(2048)`` if the stiffness varies. For constant stiffness, points that share
            coordinates share fields of loads, and fewer answers suffice: on the pellet 150 chosen
            among Sobol points have errors more than ten times larger. For variable stiffness they
            share none, and a choice on few values of a modulus is inaccurate between them.
        together: number of points that are added between two models.
        recipe: of the models on the way, which are not checked, and of those that the training
            builds by default. None takes the default for inelastic bodies, and for elastic ones the
            default with more modes: each chosen answer differs from the others, and a POD that
            leaves part of it out makes errors five times larger. If the stiffness varies, each mode
            belongs to one body: an answer adds as many modes as there are bodies.
        family: of the paths, for inelastic bodies; samplings are then drawn in the box of its
            parameters.
    """

    indicator: GreedyIndicator | None = None
    tolerance: float = 0.01
    budget: int = 150
    start: Sampling | None = None
    candidates: Sampling | None = None
    together: int = 16
    recipe: Recipe | None = None
    family: PathFamily | None = None

    def __post_init__(self) -> None:
        """Refuse settings that never end or never begin, with StudyError."""
        if not (is_number(self.tolerance) and self.tolerance > 0):
            raise StudyError(f"tolerance = {self.tolerance!r} of Greedy must be a positive number")
        for name in ("budget", "together"):
            if not is_whole(getattr(self, name), 1):
                raise StudyError(
                    f"{name} = {getattr(self, name)!r} of Greedy must be a whole number from 1"
                )
        for name in ("start", "candidates"):
            sampling = getattr(self, name)
            if sampling is not None and not callable(getattr(sampling, "points", None)):
                raise StudyError(
                    f"{name} = {sampling!r} of Greedy must be a sampling, such as Sobol(16)"
                )
        if self.indicator is not None and not callable(getattr(self.indicator, "prepared", None)):
            raise StudyError(
                f"indicator = {self.indicator!r} of Greedy must have prepared(full), as Eta2() has"
            )
        if not isinstance(self.recipe, Recipe | None):
            raise StudyError(f"recipe = {self.recipe!r} of Greedy must be a Recipe")
        if self.family is not None:  # the type is imported only by trainings that have one
            from hhr_dolfinx.plugins.paths.path_families import PathFamily

            if not isinstance(self.family, PathFamily):
                raise StudyError(f"family = {self.family!r} of Greedy must be a PathFamily")

    def space(self, scene: Scene) -> ParameterSpace:
        """Box of the points that are chosen.

        Args:
            scene: the scene.

        Raises:
            StudyError: for a family that does not fit the scene, or inelastic bodies without a
                family.
        """
        flows = any(body.law is not None for body in scene.bodies)
        if flows and self.family is None:
            raise StudyError(
                f"bodies of scene '{scene.name}' flow: a greedy training chooses among the paths "
                "of a family, Greedy(family=...)"
            )
        if self.family is None:
            return scene.parameters
        if not flows:
            raise StudyError(
                f"nothing of scene '{scene.name}' flows: a greedy training chooses points, not "
                "paths"
            )
        if self.family.space.names != scene.parameters.names:
            raise StudyError(
                f"the family '{self.family.name}' has parameters {self.family.space.names}, the "
                f"scene '{scene.name}' {scene.parameters.names}"
            )
        return self.family.own

    def grown(
        self,
        full: FullOrderModel,
        solve: Callable[[np.ndarray | list[NamedPath]], SnapshotSet],
        comm: Comm,
        progress: Progress = iter,
        store: SnapshotStore | None = None,
    ) -> tuple[SnapshotSet, GreedyChoice]:
        """Compute training answers, and the record of their choice.

        Each rank has a full model and all answers; the ranks share the candidates.

        Args:
            full: the full model.
            solve: returns answers to points, (n, P), or paths; collective.
            comm: ranks of the training.
            progress: wraps the iteration over the models.
            store: its folder keeps the choice too, which later runs continue; None without one.
        """
        space = self.space(full.scene)
        usual = ForceError() if self.family is None else LargestEstimate()
        score = (usual if self.indicator is None else self.indicator).prepared(full)
        start, choices = self._samplings(full)
        candidates = space.points(choices.points(space))
        points = space.points(start.points(space))[: self.budget]
        rounds = []
        kept_choice = None
        if store is not None and comm.rank == 0:
            kept_choice = KeptChoice(
                store.folder, store.problem_digest, self, self._recipe(full), full.parameters
            )
        earlier = comm.bcast(None if kept_choice is None else kept_choice.load(space))
        if earlier is not None:
            points, rounds = earlier
        snapshots = solve(self._queries(points))
        most = 1 + -(-max(self.budget - len(points), 0) // self.together)
        for _ in progress(range(most)):
            if rounds and rounds[-1].answers == len(points):
                break  # an earlier run was complete
            errors = self._errors(full, snapshots, candidates, score, comm)
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
                with suppress(
                    ConvergenceError
                ):  # none of them has an answer; they are not tried again
                    snapshots = snapshots.joined(solve(self._queries(more)))
            if kept_choice is not None:
                kept_choice.save(points, rounds)
            if not chosen.size:
                break
        if rounds[-1].worst > self.tolerance and comm.rank == 0:
            warn(
                f"the greedy training ended after {len(points)} answers, its budget is "
                f"{self.budget}: its indicator is {rounds[-1].worst:.2g} where {self.tolerance:g} "
                "was wished. Raise the budget, or accept that error",
                BudgetWarning,
            )
        return snapshots, GreedyChoice(points, tuple(rounds), self._recipe(full))

    def _samplings(self, full: FullOrderModel) -> tuple[Sampling, Sampling]:
        varies = self.family is None and full.problem.varies
        start = Sobol(-(-self.budget // 2)) if varies else Lattice(20)
        candidates = Sobol(2048, seed=5) if varies else Lattice(1000)
        return (
            start if self.start is None else self.start,
            candidates if self.candidates is None else self.candidates,
        )

    def _recipe(self, full: FullOrderModel) -> Recipe:
        if self.recipe is not None:
            return self.recipe
        if self.family is not None:
            return usual_recipe(full)
        return Recipe(basis=Pod(FINE, relative=True, by_body=full.problem.varies))

    def _queries(self, points: np.ndarray) -> np.ndarray | list[NamedPath]:
        return points if self.family is None else self.family.paths(points)

    def _errors(
        self,
        full: FullOrderModel,
        known: SnapshotSet,
        candidates: np.ndarray,
        score: Score,
        comm: Comm,
    ) -> np.ndarray:
        """Indicators of a model of the present answers, (n, k)."""
        recipe = self._recipe(full).as_it_is()
        mine = np.array_split(candidates, comm.size)[comm.rank]
        errors = np.zeros((0, 1))
        with group_of(comm).each("choosing where to train"):
            try:
                model = build(full, known, recipe)
            except (
                NotSolvableError
            ) as error:  # too few answers for a model: errors are unknown in the whole box
                _log.info("greedy training: no model of %d answers: %s", len(known.points), error)
                errors = np.full((len(mine), 1), UNSOLVED_CANDIDATE)
            else:
                if len(mine):
                    errors = score(model, known, self._answers(model, mine)).reshape(len(mine), -1)
                errors[~np.isfinite(errors).all(axis=1)] = UNSOLVED_CANDIDATE / np.sqrt(
                    errors.shape[1]
                )
        return np.concatenate(
            [errors_of_rank for errors_of_rank in comm.allgather(errors) if len(errors_of_rank)]
        )

    def _answers(self, model: AnsweringModel, points: np.ndarray) -> list[Answer | History | None]:
        """Answers or histories of a reduced model; None for a history that it cannot complete."""
        if self.family is None:
            return list(model.solve_many(points, outside="ignore", raise_on_failure=False))
        return [_marched(model, path) for path in self.family.paths(points)]


def _marched(model: AnsweringModel, path: LoadPath) -> History | None:
    from hhr_dolfinx.models.histories.equilibrium import MarchSettings, told_once

    try:
        with told_once():
            return model.march(path, MarchSettings(outside="ignore"))
    except (ConvergenceError, NotSolvableError):
        return None


def _chosen(
    errors: np.ndarray, candidates: np.ndarray, known: np.ndarray, space: ParameterSpace, count: int
) -> np.ndarray:
    """Indices of the candidates to add, (k,).

    They are chosen by their error vectors if all have one, else by distances.
    """
    if errors.shape[1] == 1 or (np.linalg.norm(errors, axis=1) >= UNSOLVED_CANDIDATE / 2).any():
        return apart(candidates, np.linalg.norm(errors, axis=1), known, space, count)
    present = (candidates[:, None] == known).all(axis=2).any(axis=1)
    return independent(np.where(present[:, None], 0.0, errors), count)


def independent(errors: np.ndarray, count: int) -> np.ndarray:
    """Indices of the candidates with the largest independent errors, (k,).

    Each error counts without the directions of those chosen before. One answer reduces all errors
    of the same direction. On the pellet 150 answers chosen so, 16 at a time, have half the error of
    as many chosen by size and distance.

    Args:
        errors: error vectors of the candidates, (n, k).
        count: largest number of candidates.
    """
    remaining = errors.copy()
    chosen = list[int]()
    least = DIRECTION_ROUND_OFF * np.linalg.norm(errors, axis=1).max(initial=0.0)
    while len(chosen) < count:
        sizes = np.linalg.norm(remaining, axis=1)
        worst = int(sizes.argmax())
        if not sizes[worst] > least:
            break
        chosen.append(worst)
        direction = remaining[worst] / sizes[worst]
        remaining -= np.outer(remaining @ direction, direction)
        remaining[worst] = 0.0
    return np.array(chosen, dtype=np.int64)


def apart(
    candidates: np.ndarray, values: np.ndarray, known: np.ndarray, space: ParameterSpace, count: int
) -> np.ndarray:
    """Indices of candidates with large values, far from present points and each other, (k,).

    The worst alone would be neighbours, which one answer improves all. So each value is weighted by
    the distance to the nearest present or chosen point, over the average distance. Candidates that
    are present already are never chosen.

    Args:
        candidates: points of the box, (n, P).
        values: error of each candidate, (n,).
        known: points of training, (S, P).
        space: the box, which scales distances.
        count: largest number of candidates.
    """
    lower, upper = np.array([space.lower, space.upper])
    scaled, scaled_known = ((points - lower) / (upper - lower) for points in (candidates, known))
    distances = cdist(scaled, scaled_known).min(axis=1, initial=np.inf)
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
    """Choice of a greedy training, stored next to its answers.

    An interrupted training continues from it.
    """

    def __init__(
        self, folder: Path, problem: str, greedy: Greedy, recipe: Recipe, space: ParameterSpace
    ):
        box = [
            space.names,
            *(tuple(float(end) for end in ends) for ends in (space.lower, space.upper)),
        ]
        key = CHOICE_FORMAT, CHOICE_VERSION, problem, greedy, recipe, box
        self._digest = digest_of_values(key, "a greedy training that is kept in a folder")[:40]
        self._path = folder / f"greedy_{self._digest[:16]}.npz"

    def load(self, space: ParameterSpace) -> tuple[np.ndarray, list[Round]] | None:
        """Points and rounds, see :class:`GreedyChoice`, or None without a file of this training."""
        try:
            header, arrays = read_arrays(self._path, CHOICE_FORMAT, CHOICE_VERSION)
            check_layout(arrays, _LAYOUT, {"P": len(space.names)})
        except (FileNotFoundError, FileContentError):
            return None
        if header.get("asked") != self._digest:
            return None
        rounds = zip(
            arrays["counts"].tolist(),
            arrays["worst"].tolist(),
            arrays["middle"].tolist(),
            strict=True,
        )
        return arrays["points"], [Round(*row) for row in rounds]

    def save(self, points: np.ndarray, rounds: list[Round]) -> None:
        """Store the choice so far.

        Args:
            points: chosen points, (n, P).
            rounds: record of the rounds.

        Raises:
            FileError: if the file cannot be written.
        """
        counts, worst, middle = (np.array(column) for column in zip(*rounds, strict=True))
        arrays = {
            "points": points,
            "counts": counts.astype(np.int64),
            "worst": worst,
            "middle": middle,
        }
        write_arrays(
            self._path,
            {"format": CHOICE_FORMAT, "version": CHOICE_VERSION, "asked": self._digest},
            arrays,
        )
