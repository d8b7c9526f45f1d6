"""Local models, thesis chapter 4: training divided into a given number of clusters of similar
solutions.

:mod:`hhr_dolfinx.plugins.local_models.splitting` determines their number.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from hhr_dolfinx.certify.accuracy import least_sizes, summary
from hhr_dolfinx.errors import (
    HHRError,
    LocalModelWarning,
    ReductionError,
    StabilityWarning,
    StudyError,
    TrainingWarning,
)
from hhr_dolfinx.models.reduced import ReducedModel
from hhr_dolfinx.parameters import ParameterSpace, check_counts, is_number
from hhr_dolfinx.plugins.local_models.models import Choice, LocalModels
from hhr_dolfinx.plugins.local_models.subspaces import snapshot_distances
from hhr_dolfinx.reduction.build import HyperReduction, build
from hhr_dolfinx.reduction.enrichment import enrich
from hhr_dolfinx.reduction.projection import reduced_domain
from hhr_dolfinx.reduction.recipe import Recipe, basis_of, chosen_nodes
from hhr_dolfinx.reduction.reductor import Record, Task
from hhr_dolfinx.snapshots.records import Progress, SnapshotSet
from hhr_dolfinx.timing import StageLog
from hhr_dolfinx.trained import TrainedRange
from hhr_dolfinx.warn import collected, warn

if TYPE_CHECKING:
    from hhr_dolfinx.models.full import FullModel
    from hhr_dolfinx.models.reconstruct import Reconstruction
    from hhr_dolfinx.study.training.train import Training

REGION_POINTS = 200
"""Random points of a region at which models of its cluster are estimated."""
EQUAL_ERRORS = 1e-16
"""Errors below count as equal."""
STILL = 1e-12
"""Part of the largest displacement below which a solution counts as zero."""


class Member(NamedTuple):
    """One local model, for a record."""

    snapshots: np.ndarray  #: numbers of its training answers
    own: int  #: number of them in its part
    ell_bar: int  #: modes
    N_lambda_C: int  #: contact conditions
    #: 95th percentile of the estimated relative errors at random points of its part; NaN without
    #: estimates
    estimate: float
    added: int  #: answers of the full model that were added to its training


@dataclass(frozen=True, eq=False)
class LocalFacts:
    """Facts of local models, in their :class:`~hhr_dolfinx.reduction.reductor.Record`."""

    #: all training points, (S, P), including those added later; empty during the construction
    points: np.ndarray = field(default_factory=lambda: np.empty((0, 0)))
    members: list[Member] = field(default_factory=list)
    splits: list[str] = field(default_factory=list)  #: splits with their reasons, in words
    missed: list[str] = field(
        default_factory=list
    )  #: models that miss their targets, with the reasons, in words

    def add(
        self,
        model: ReducedModel,
        snapshots: np.ndarray,
        own: int,
        errors: np.ndarray,
        doubts: list[str],
        added: int,
    ) -> None:
        """Record the next model.

        Args:
            model: the model.
            snapshots: indices of its training answers.
            own: number of these in its cluster.
            errors: estimated errors of its forces at points of its cluster, (n,).
            doubts: warnings of its check.
            added: number of full answers that were added to its training.
        """
        self.missed.extend(f"local model {len(self.members)}: {doubt}" for doubt in doubts)
        p95 = summary(errors)["p95"] if errors.size else float("nan")
        self.members.append(Member(snapshots, own, *sizes_of(model), p95, added))


@dataclass(frozen=True)
class Clusters:
    """A given number of clusters of similar solutions, thesis sections 4.2.1 and 4.2.2.

    If training points are a regular grid, its cells are clustered by the Grassmann distance between
    the spaces of the solutions at their corners, (4.1)-(4.2), and a query uses the model of its
    cell. Snapshots on the border of two clusters belong to both. Other training points are
    clustered themselves, (4.4), and a random forest trained on their labels selects the model.

    Attributes:
        count: K.
        overlap: part of the width of the box by which training extends beyond a border, for points
            that are no grid.
        strip: see :class:`~hhr_dolfinx.plugins.local_models.splitting.Splitting`.
        seed: of the clusters, the forest and random points.
        others: more recipes; each cluster uses the one with the smallest estimated error of forces
            at random points.
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
        check_counts(count=(self.count, 1), seed=(self.seed, 0))
        limits = {"modes": self.modes, "conditions": self.conditions}
        check_counts(**{name: (most, 1) for name, most in limits.items() if most is not None})
        for name in ("overlap", "strip"):
            if not (is_number(getattr(self, name)) and 0 <= getattr(self, name) < 1):
                raise StudyError(
                    f"{name} = {getattr(self, name)!r} must be a part of 1, such as 0.05"
                )
        if not isinstance(self.others, tuple | list) or not all(
            isinstance(recipe, Recipe) for recipe in self.others
        ):
            raise StudyError(f"others = {self.others!r} must be a list of recipes: (Recipe(...),)")

    def models(self, training: Training, recipe: Recipe, progress: Progress) -> LocalModels:
        """Local models of a training, see the class.

        Args:
            training: the full model with its answers.
            recipe: recipe of each model.
            progress: wraps the iteration over the models.

        Raises:
            StudyError: for a cluster of less than two solutions, or one of which no recipe makes a
                model.
        """
        full = training.full_order
        snapshots = training.snapshots
        record = Record(self, 0, LocalFacts(), None, StageLog())
        space = full.parameters
        width = np.array(space.upper) - space.lower
        with record.log.stage("clusters"):
            choice, members = self._on_grid(snapshots) or self._anywhere(snapshots, space, width)
        labels = choice.many(snapshots.points)[0]
        models = []
        for number in progress(range(self.count)):
            cluster_snapshots = snapshots.take(members[number])
            held_out = training.held_out
            if held_out is not None:
                members_held_out = np.flatnonzero(choice.many(held_out.points)[0] == number)
                held_out = held_out.take(members_held_out) if members_held_out.size else None
            if len(cluster_snapshots.points) < 2:
                raise StudyError(
                    f"cluster {number} has {len(cluster_snapshots.points)} solutions, and a model "
                    "needs at least 2: take fewer clusters, or a larger overlap"
                )
            drawn = _drawn_in(choice, number, space, self.seed)
            with record.log.stage("models"):
                model, errors, doubts = self._best(full, cluster_snapshots, held_out, recipe, drawn)
            models.append(model)
            record.facts.add(
                model, members[number], int((labels == number).sum()), errors, doubts, 0
            )
        return together(models, replace(choice, reach=self.strip * width), snapshots, record)

    def _best(
        self,
        full: FullModel,
        snapshots: SnapshotSet,
        held_out: SnapshotSet | None,
        recipe: Recipe,
        points: np.ndarray,
    ) -> tuple[ReducedModel, np.ndarray, list[str]]:
        """Model of a cluster, estimated errors of its forces, and warnings of its check.

        Errors are those at points of its region.
        """
        floor = least_forces(full, snapshots)
        candidates = []
        reason = ""
        for candidate_recipe in (
            recipe,
            *(
                self.others
                if recipe.trust
                else (further_recipe.as_it_is() for further_recipe in self.others)
            ),
        ):
            try:
                if self.modes is not None or self.conditions is not None:
                    limits = self.modes, self.conditions
                    for count, most, kind in above(
                        sizes(full, snapshots, candidate_recipe), limits
                    ):
                        raise StudyError(
                            f"{count} {kind}, and not {most} at most: give a larger tolerance, or "
                            "more clusters"
                        )
                model, doubts = built(full, snapshots, candidate_recipe, held_out)
            except HHRError as error:
                if not self.others:
                    raise
                reason = str(error)
                continue
            errors = force_errors(model, points, floor)
            # answers at all points first, since the scale of their forces is needed for the errors
            finite_errors = np.maximum(errors[np.isfinite(errors)], EQUAL_ERRORS)
            size = np.log(finite_errors).mean() if finite_errors.size else np.inf
            candidates.append(((errors.size - finite_errors.size, size), model, errors, doubts))
        if not candidates:
            raise StudyError(
                f"none of {1 + len(self.others)} recipes makes a model of a cluster; the last: "
                f"{reason}"
            )
        return min(candidates, key=lambda candidate: candidate[0])[1:]

    def _on_grid(self, snapshots: SnapshotSet) -> tuple[Choice, list[np.ndarray]] | None:
        """Partition of a regular grid, and the snapshots of each cluster.

        None if the points are no grid.
        """
        from hhr_dolfinx.plugins.local_models.clusters import cell_labels, grid_cells, tree_of_cells

        try:
            grid = grid_cells(snapshots.points)
        except ReductionError:
            return None
        labels = cell_labels(grid, snapshots.displacements, self.count, self.seed)
        # clusters share the snapshots at their borders
        members = [np.unique(grid.corners[labels == number]) for number in range(self.count)]
        return tree_of_cells(grid.cells, labels), members

    def _anywhere(
        self, snapshots: SnapshotSet, space: ParameterSpace, width: np.ndarray
    ) -> tuple[Choice, list[np.ndarray]]:
        """Partition by a forest, and the snapshots of each cluster with those near its borders."""
        from hhr_dolfinx.plugins.local_models.clusters import forest_tree, medoids

        labels = np.zeros(len(snapshots.points), dtype=np.int64)
        loaded = np.flatnonzero(moving(snapshots.displacements))  # others have no direction
        if not loaded.size:
            raise StudyError(
                "no training solution moves, so that none is like another one: train where bodies "
                "are loaded"
            )
        unit = snapshots.points / width
        nearest = loaded[cKDTree(unit[loaded]).query(unit)[1]]
        labels[loaded] = medoids(
            snapshot_distances(snapshots.displacements[:, loaded]), self.count, self.seed
        )
        labels = labels[nearest]
        choice = forest_tree(snapshots.points, labels, space, self.seed)
        reach = self.overlap * width
        return choice, [
            np.flatnonzero(_by(choice, number, snapshots.points, reach) | (labels == number))
            for number in range(self.count)
        ]


def above(
    found: tuple[int, int], most: tuple[int | None, int | None]
) -> list[tuple[int, int, str]]:
    """Sizes of a model that are above their limits.

    Args:
        found: numbers of modes and conditions.
        most: their limits; None without one.

    Returns:
        Size, limit and name of each.
    """
    rows = zip(found, most, ("modes", "conditions"), strict=True)
    return [(size, limit, kind) for size, limit, kind in rows if limit is not None and size > limit]


def _by(choice: Choice, number: int, points: np.ndarray, reach: np.ndarray) -> np.ndarray:
    """True for points, (n, P), in a region or within ``reach``, (P,), of one of its boxes, (n,)."""
    outer = np.full(points.shape[1], np.inf)
    near = np.zeros(len(points), dtype=bool)
    for label, lower, upper in choice.boxes(-outer, outer):
        if label == number:
            near |= ((points >= lower - reach) & (points <= upper + reach)).all(axis=1)
    return near


def moving(columns: np.ndarray) -> np.ndarray:
    """True for displacements above round-off of the largest, which have a direction, (S,).

    Displacements are (N, S).
    """
    sizes = np.abs(columns).max(axis=0)
    return sizes > STILL * sizes.max(initial=0.0)


def _drawn_in(choice: Choice, number: int, space: ParameterSpace, seed: int) -> np.ndarray:
    """Random points of the boxes of a model, (n, P); empty if it has no box."""
    width = np.array(space.upper) - space.lower
    boxes = [
        (low, high)
        for label, low, high in choice.boxes(space.lower, space.upper)
        if label == number
    ]
    lows, highs = np.array(boxes).reshape(-1, 2, width.size).transpose(1, 0, 2)
    volumes = ((highs - lows) / width).prod(axis=1)
    if not volumes.sum() > 0:
        return np.zeros((0, width.size))
    rng = np.random.default_rng(seed)
    chosen = rng.choice(len(boxes), REGION_POINTS, p=volumes / volumes.sum())
    low = lows[chosen]
    return low + rng.random(low.shape) * (highs[chosen] - low)


def together(
    models: list[ReducedModel], choice: Choice, snapshots: SnapshotSet, record: Record[LocalFacts]
) -> LocalModels:
    """Set of some models.

    Its training range is that of all snapshots: neighbours cover each other's edges.

    Args:
        models: the models.
        choice: tree that chooses the model of a point.
        snapshots: all training answers.
        record: record of the construction.
    """
    trained = TrainedRange.of(snapshots.points, models[0].parameters)
    local_models = [
        model.changed(trained=trained, fields=fields)
        for model, fields in zip(models, _alike(models), strict=True)
    ]
    if record.missed:
        more = (
            ""
            if len(record.missed) == 1
            else f", and {len(record.missed) - 1} more in offline.missed"
        )
        warn(f"{record.missed[0]}{more}", LocalModelWarning)
    return LocalModels(
        local_models, choice, replace(record, facts=replace(record.facts, points=snapshots.points))
    )


def _alike(models: list[ReducedModel]) -> list[Reconstruction]:
    """Fields of the models with a common smallest denominator of relative errors of forces.

    It is that of all training.
    """
    fields = [model.fields for model in models]
    bounds: list[Any] = [fields_of_model.bound for fields_of_model in fields]
    if None in bounds:
        return fields
    least = np.max([bound.least for bound in bounds], axis=0)
    return [
        replace(fields_of_model, bound=replace(bound, least=least))
        for fields_of_model, bound in zip(fields, bounds, strict=True)
    ]


def built(
    full: FullModel, snapshots: SnapshotSet, recipe: Recipe, held_out: SnapshotSet | None
) -> tuple[ReducedModel, list[str]]:
    """Model of some snapshots, and warnings of its check.

    The caller raises warnings only of models that are kept.

    Args:
        full: the full model.
        snapshots: training answers.
        recipe: recipe of the model.
        held_out: validation answers; None without any.
    """
    with collected() as caught:
        model = build(full, snapshots, recipe, None if recipe.trust is None else held_out)
    # a local model is trained on a part of the box on purpose
    stability_warnings = [
        warning for warning in caught if issubclass(warning.category, StabilityWarning)
    ]
    return model, [
        str(warning.message)
        for warning in stability_warnings
        if not issubclass(warning.category, TrainingWarning)
    ]


def sizes_of(model: ReducedModel) -> tuple[int, int]:
    """Modes and contact conditions."""
    return model.problem.contact_trial.shape[1], model.problem.contact_trial.shape[0]


def least_forces(full: FullModel, snapshots: SnapshotSet) -> float:
    """A thousandth of the largest training forces in the S norm, in the middle of the box.

    Args:
        full: the full model.
        snapshots: training answers.
    """
    return float(least_sizes(full.problem, full.schur, snapshots.forces)[0])


def force_errors(model: ReducedModel | LocalModels, points: np.ndarray, floor: float) -> np.ndarray:
    """Estimated relative errors of contact forces at some points, (n,).

    NaN without an estimate, infinite without an answer.

    Args:
        model: one model, or several local ones.
        points: parameters, (n, P).
        floor: denominator if forces nearly vanish.
    """
    if not len(points):
        return np.zeros(0)
    many = model.solve_many(points, raise_on_failure=False, outside="ignore")
    answered = many.converged
    estimates = many.estimates() if answered.any() else None
    if estimates is None:
        return np.where(answered, np.nan, np.inf)
    # e / (|λ| - e) where that is less than e / floor
    errors = np.fmin(estimates.dual_relative, estimates.dual / floor if floor > 0 else np.inf)
    return np.where(answered, errors, np.inf)


def sizes(full: FullModel, snapshots: SnapshotSet, recipe: Recipe) -> tuple[int, int]:
    """Numbers of modes and contact conditions of the model of a recipe, without the model.

    Args:
        full: the full model.
        snapshots: training answers.
        recipe: the recipe.

    Raises:
        ReductionError: for a recipe or answers from which no model can be built.
    """
    problem = full.problem
    HyperReduction(recipe).check(Task(full, snapshots))
    basis = basis_of(recipe.basis, problem, snapshots)
    nodes = chosen_nodes(problem, snapshots, recipe, basis)
    sets = reduced_domain(problem, nodes, recipe.domain.layers)
    kappa_max = np.inf if recipe.enrichment is None else recipe.enrichment.kappa_max
    return enrich(problem, basis, sets, kappa_max).basis.shape[1], sets.A_lambda.size
