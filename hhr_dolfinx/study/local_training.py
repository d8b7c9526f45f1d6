"""Local models, thesis chapter 4: the training shared out among a wished number of clusters of like solutions.

:mod:`hhr_dolfinx.study.splitting` finds their number itself.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from hhr_dolfinx.certify.accuracy import FORCE_FLOOR
from hhr_dolfinx.errors import HHRError, ReductionError, StudyError
from hhr_dolfinx.models.choice import Choice
from hhr_dolfinx.models.local import LocalModels
from hhr_dolfinx.models.reduced import ReducedModel
from hhr_dolfinx.parameters import is_number, is_whole
from hhr_dolfinx.reduction.build import build, sizes
from hhr_dolfinx.reduction.recipe import Recipe
from hhr_dolfinx.snapshots.records import SnapshotSet
from hhr_dolfinx.timing import StageLog
from hhr_dolfinx.trained import TrainedRange

if TYPE_CHECKING:
    from hhr_dolfinx.study.training import Training

Progress = Callable[[Iterable], Iterable]
DRAWN = 600
"""Random points of the box at which models of clusters are estimated."""


class Member(NamedTuple):
    """One local model, for a record.

    Attributes:
        snapshots: numbers of its training answers.
        own: how many of them lie in its own part.
        ell_bar, N_lambda_C: modes and contact conditions.
        estimate: 95th percentile of the estimated relative errors at random points of its part; NaN without estimates.
        added: answers of the full model that were added to its training.
    """

    snapshots: np.ndarray
    own: int
    ell_bar: int
    N_lambda_C: int
    estimate: float
    added: int


@dataclass(frozen=True)
class LocalRecord:
    """How local models were made.

    Attributes:
        points: all training points, (S, P), those that were added last; none while they are made.
        members: the models.
        splits: what was split, and why, in words.
        log: times of the stages.
    """

    points: np.ndarray = field(default_factory=lambda: np.empty((0, 0)))
    members: list[Member] = field(default_factory=list)
    splits: list[str] = field(default_factory=list)
    log: StageLog = field(default_factory=StageLog)


@dataclass(frozen=True)
class Clusters:
    """A wished number of clusters of like solutions, thesis sections 4.2.1 and 4.2.2.

    Where training points are a regular grid its cells are clustered by the Grassmann distance between the spaces of the
    solutions at their corners, (4.1)-(4.2), and a query asks the model of its cell: snapshots on the border of two
    clusters belong to both. Other training points are clustered themselves, (4.4), and a random forest trained on their
    labels says which model answers.

    Attributes:
        count: K.
        overlap: part of the width of the box by which training reaches beyond a border, where points are no grid.
        strip: see :class:`~hhr_dolfinx.study.splitting.Splitting`.
        seed: of the clusters, the forest and random points.
        others: more recipes, of which each cluster takes the one whose forces are estimated best at random points.
        modes, conditions: most modes and contact conditions of a model; None for any number.
    """

    count: int = 3
    overlap: float = 0.05
    strip: float = 0.0
    seed: int = 1
    others: tuple[Recipe, ...] = ()
    modes: int | None = None
    conditions: int | None = None

    def __post_init__(self) -> None:
        """Refuse numbers that cannot be."""
        for name, least in (("count", 1), ("seed", 0), ("modes", 1), ("conditions", 1)):
            if getattr(self, name) is None and name in ("modes", "conditions"):
                continue
            if not is_whole(getattr(self, name), least):
                raise StudyError(f"{name} = {getattr(self, name)!r} must be a whole number from {least}")
        for name in ("overlap", "strip"):
            if not (is_number(getattr(self, name)) and 0 <= getattr(self, name) < 1):
                raise StudyError(f"{name} = {getattr(self, name)!r} must be a part of 1, such as 0.05")

    def models(self, training: Training, recipe: Recipe, progress: Progress) -> LocalModels:
        """Local models of a training; see the class."""
        full, snapshots, record = training.full_order, training.snapshots, LocalRecord()
        space, points = full.parameters, training.snapshots.points
        width = np.array(space.upper) - space.lower
        with record.log.stage("clusters"):
            choice, members = self._on_grid(snapshots, full) or self._anywhere(snapshots, full, width)
        drawn = space.random(DRAWN, self.seed)
        labels, places = choice.many(points)[0], choice.many(drawn)[0]
        models = []
        for number in progress(range(self.count)):
            own, held_out = snapshots.take(members[number]), _held_out_of(training, choice, number)
            with record.log.stage("models"):
                model, errors = self._best(full, own, held_out, recipe, drawn[places == number])
            models.append(model)
            count = int((labels == number).sum())
            record.members.append(Member(members[number], count, *sizes_of(model), p95(errors), 0))
        return together(models, choice.reaching(self.strip * width), snapshots, record)

    def _best(
        self, full: Any, snapshots: SnapshotSet, held_out: SnapshotSet | None, recipe: Recipe, points: np.ndarray
    ) -> tuple[ReducedModel, np.ndarray]:
        """The model of a cluster, and estimates of its forces at random points of its region."""
        floor, found, why = force_floor(full, snapshots), [], ""
        for item in (recipe, *(self.others if recipe.trust else (other.as_it_is() for other in self.others))):
            try:
                self._check_sizes(*sizes(full, snapshots, item))
                model = build(full, snapshots, item, None if item.trust is None else held_out)
            except HHRError as error:
                if not self.others:
                    raise
                why = str(error)
                continue
            found.append((model, force_errors(model, points, floor)))
        if not found:
            raise StudyError(f"none of {1 + len(self.others)} recipes makes a model of a cluster; the last: {why}")
        return min(found, key=lambda pair: p95(np.where(np.isnan(pair[1]), np.inf, pair[1])))

    def _check_sizes(self, modes: int, conditions: int) -> None:
        """Raise StudyError for a model that is larger than it may be."""
        for found, most, what in ((modes, self.modes, "modes"), (conditions, self.conditions, "conditions")):
            if most is not None and found > most:
                raise StudyError(f"{found} {what}, and not {most} at most: give a larger tolerance, or more clusters")

    def _on_grid(self, snapshots: SnapshotSet, full: Any) -> tuple[Choice, list[np.ndarray]] | None:
        """The partition of a regular grid, and the snapshots of each cluster; None where points are none."""
        from hhr_dolfinx.reduction.classify import tree_of
        from hhr_dolfinx.reduction.clusters import cell_labels, grid_cells

        try:
            cells = grid_cells(snapshots.points).cells
        except ReductionError:
            return None
        found = cell_labels(snapshots.points, snapshots.displacements, self.count, seed=self.seed)
        choice = tree_of(cells.mean(axis=1), found.labels, full.parameters).snapped(cells[:, 1])
        return choice, [found.snapshots(number) for number in range(self.count)]

    def _anywhere(self, snapshots: SnapshotSet, full: Any, width: np.ndarray) -> tuple[Choice, list[np.ndarray]]:
        """What a forest says, and the snapshots of each cluster with those by its borders."""
        from hhr_dolfinx.reduction.classify import forest_tree
        from hhr_dolfinx.reduction.clusters import snapshot_labels

        labels = snapshot_labels(snapshots.displacements, self.count, seed=self.seed)
        choice = forest_tree(snapshots.points, labels, full.parameters, self.seed)
        members = []
        for number in range(self.count):
            near = _by(choice, number, snapshots.points, self.overlap * width)
            members.append(np.flatnonzero(near | (labels == number)))
        return choice, members


def _by(choice: Choice, number: int, points: np.ndarray, reach: np.ndarray) -> np.ndarray:
    """Whether points, (n, P), lie in a region or within ``reach``, (P,), of one of its boxes, (n,)."""
    outer = np.full(points.shape[1], np.inf)
    near = np.zeros(len(points), dtype=bool)
    for label, lower, upper in choice.boxes(-outer, outer):
        if label == number:
            near |= ((points >= lower - reach) & (points <= upper + reach)).all(axis=1)
    return near


def _held_out_of(training: Training, choice: Choice, number: int) -> SnapshotSet | None:
    """Answers kept out of training that lie in a region; None without any."""
    if training.held_out is None:
        return None
    inside = np.flatnonzero(choice.many(training.held_out.points)[0] == number)
    return training.held_out.take(inside) if inside.size else None


def together(models: list[ReducedModel], choice: Choice, snapshots: SnapshotSet, record: LocalRecord) -> LocalModels:
    """The set of some models, whose door is that of all that was trained: where one ends another one goes on."""
    trained = TrainedRange.of(snapshots.points, models[0].parameters)
    own = [model.changed(trained=trained) for model in models]
    return LocalModels(own, choice, replace(record, points=snapshots.points))


def sizes_of(model: ReducedModel) -> tuple[int, int]:
    """Modes and contact conditions."""
    return model.problem.contact_trial.shape[1], model.problem.contact_trial.shape[0]


def p95(errors: np.ndarray) -> float:
    """95th percentile; NaN if nothing is known."""
    return float(np.percentile(errors, 95, method="higher")) if errors.size else float("nan")


def force_floor(full: Any, snapshots: SnapshotSet) -> float:
    """A thousandth of the largest training forces in the S norm, of the middle of the box."""
    forces = snapshots.forces
    return FORCE_FLOOR * float(np.sqrt(np.einsum("ms,ms->s", forces, full.schur @ forces).max(initial=0.0)))


def force_errors(model: ReducedModel | LocalModels, points: np.ndarray, floor: float) -> np.ndarray:
    """Estimated relative errors of contact forces at some points, (n,), beside a least size of forces; NaN for none.

    Where forces nearly vanish the relative error is that beside ``floor``.
    """
    found = model.solve_many(points, raise_on_failure=False, outside="ignore").estimates()
    if found is None:
        return np.full(len(points), np.nan)
    # e / (|λ| - e) where that is less than e / floor
    return np.fmin(found.dual_relative, found.dual / floor if floor > 0 else np.inf)
