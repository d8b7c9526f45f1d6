"""Local models of histories from labels of training steps, see :mod:`hhr_dolfinx.models.local_histories`.

Usually all of them are built on one reduced integration domain, around the nodes that the whole training chooses: they
evaluate their laws at the same points and hand their state on as it is. Bases, and modes of stress and plastic strain,
are local.

Worth it where the parts of a path are trained as they will be asked, as loading and unloading: with fewer modes a
smaller domain is stable. In a family of paths a model of some steps seldom knows a state better than one of all of
them, since it has not seen what is left of flow that was not trained.

Where nothing flows and surfaces rub, each model has nodes of its own: what friction remembers is of the whole surface,
whichever model goes on. Steps whose forces are alike belong to one model.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from hhr_dolfinx.certify.compare import Comparison
from hhr_dolfinx.certify.trust import (
    check_stability,
    checked_histories,
    compared_histories,
    first_trusted,
    warn_of_training,
)
from hhr_dolfinx.contact.problem import ContactProblem
from hhr_dolfinx.errors import NotOfferedError, ReductionError
from hhr_dolfinx.full_order.full import FullOrderModel
from hhr_dolfinx.models.answer import History
from hhr_dolfinx.models.local_histories import LocalHistories
from hhr_dolfinx.models.local_sliding import LocalSliding
from hhr_dolfinx.models.reduced import ReducedModel
from hhr_dolfinx.parameters import is_whole
from hhr_dolfinx.reduction.build import build, usual_recipe
from hhr_dolfinx.reduction.calibration import calibrated
from hhr_dolfinx.reduction.recipe import Recipe, Rid, chosen_nodes
from hhr_dolfinx.snapshots.records import SnapshotSet
from hhr_dolfinx.timing import StageLog
from hhr_dolfinx.trained import TrainedPaths, TrainedRange

if TYPE_CHECKING:
    from hhr_dolfinx.study.training.answers import TrainingAnswers


@dataclass(frozen=True)
class LocalHistoryRecord:
    """How local models of histories were made.

    Attributes:
        recipe: how each was reduced.
        labels: number of the model to which each step of each training history belongs.
        overlap: steps before and behind those of a label that its model was trained on besides.
        layers: layers of cells of the RID.
        comparison: what users get beside histories that are known; None if the check was left out.
        log: times of the stages, what was left out, attempts that were refused.
    """

    recipe: Recipe
    labels: tuple[np.ndarray, ...]
    overlap: int
    layers: int
    comparison: Comparison | None
    log: StageLog


def local_histories(
    training: TrainingAnswers,
    labels: Sequence[Any],
    recipe: Recipe | None = None,
    *,
    overlap: int = 2,
    common: bool | None = None,
    checked: bool = True,
) -> LocalHistories | LocalSliding:
    """Local models that take turns along a path, from the training steps of each.

    Args:
        training: histories of a scene whose bodies flow, or of elastic bodies with friction.
        labels: for each training history the number of the model of each step, whole numbers from 0, all of them used.
        recipe: how to reduce; None takes the usual one of the scene. ``trust`` is asked of all models together.
        overlap: steps of a history before and behind those of a label that its model is trained on too, so that
            neighbours know the states at which they take turns.
        common: whether all models share the nodes of the whole training, and hand their state on as it is; else each
            has a reduced integration domain of its own, and completes the state that it hands on. None is true where
            bodies flow.
        checked: whether what ``recipe.trust`` and ``recipe.tangents`` refuse is refused.

    Raises:
        ReductionError: for a training without histories, or labels that are not those of its steps.
        UnstableModelError: if the check refuses the models at the most layers of cells.
    """
    full = training.full_order
    snapshots = training.snapshots
    recipe = usual_recipe(full) if recipe is None else recipe
    if not isinstance(recipe, Recipe):
        raise ReductionError(f"{recipe!r} is no recipe: give a Recipe")
    recipe = recipe if checked else recipe.as_it_is()
    if not snapshots.histories or (full.equilibrium is None and full.friction is None):
        raise ReductionError(
            "nothing flows in this training, and nothing rubs: local models of histories need a training on paths"
        )
    if full.equilibrium is not None and full.friction is not None:
        raise NotOfferedError(
            "local models of bodies that flow with friction are not built in: take one model, build() or condense()"
        )
    common = full.equilibrium is not None if common is None else common
    known = _checked_labels(labels, snapshots.histories, overlap)
    if recipe.trust is not None:
        warn_of_training(full, snapshots, training.held_out)
    log = StageLog()
    own = recipe
    if common:
        with log.stage("nodes"):
            basis = recipe.basis.modes(full.problem, snapshots)
            nodes = chosen_nodes(full.problem, snapshots, recipe, basis)
        own = replace(recipe, nodes=(_GivenNodes(nodes),))
    parts = [snapshots.part(columns) for columns in _columns_of(known, overlap)]
    kept = training.held_out if checked else None
    shared = _Shared(full, snapshots, kept, recipe, own, known, overlap, parts, log)
    return first_trusted(shared.attempt, recipe.domain.layers, recipe.domain.most_layers, log)


def labels_by_forces(histories: Sequence[History], count: int, seed: int = 1) -> list[np.ndarray]:
    """A label of each step of some histories, (steps,) int: those whose forces point alike belong together.

    Steps without forces go with the first behind them that has any.

    Raises:
        ReductionError: for more labels than steps with forces, or no history with any.
    """
    from hhr_dolfinx.reduction.clusters import direction_labels

    forces = [np.array([answer.multipliers for answer in history.answers]) for history in histories]
    rubs = [np.linalg.norm(item, axis=1) > 0 for item in forces]
    columns = np.concatenate([item[own] for item, own in zip(forces, rubs, strict=True)])
    if len(columns) < count:
        raise ReductionError(f"{count} local models of {len(columns)} steps with forces: take fewer models")
    found = direction_labels(columns, count, seed)
    if np.bincount(found, minlength=count).min() < 2:
        raise ReductionError(f"{count} local models of {len(columns)} steps: some would have one only, take fewer")
    ends = np.cumsum([0, *(own.sum() for own in rubs)])
    return [_filled(own, found[first:last]) for own, (first, last) in zip(rubs, pairwise(ends), strict=True)]


def _filled(known: np.ndarray, labels: np.ndarray) -> np.ndarray:
    """Labels of all steps from those of the known ones, (steps,) bool: of the next one, or the last."""
    if not labels.size:
        return np.zeros(known.size, dtype=np.int64)
    behind = np.minimum(np.cumsum(known) - known, labels.size - 1)
    return labels[behind].astype(np.int64)


@dataclass(frozen=True)
class _GivenNodes:
    """Nodes that were chosen before."""

    chosen: np.ndarray

    def nodes(self, problem: ContactProblem, snapshots: SnapshotSet, basis: np.ndarray) -> np.ndarray:
        """Those."""
        return self.chosen


@dataclass(frozen=True)
class _Shared:
    """What all attempts share."""

    full: FullOrderModel
    snapshots: SnapshotSet
    held_out: SnapshotSet | None
    recipe: Recipe
    own: Recipe
    labels: tuple[np.ndarray, ...]
    overlap: int
    parts: list[SnapshotSet]
    log: StageLog

    def attempt(self, layers: int) -> LocalHistories | LocalSliding:
        """All models with a fixed number of layers."""
        recipe = self.recipe
        own = replace(self.own, domain=Rid(layers, layers), trust=None)
        models = []
        for part in self.parts:
            with self.log.stage("models"):
                models.append(build(self.full, part, own))
            if recipe.trust is not None:
                check_stability(models[-1].offline.stability, recipe.trust)
        local, comparison, trained = self._flowing(models) if self.full.friction is None else self._rubbing(models)
        record = LocalHistoryRecord(recipe, self.labels, self.overlap, layers, comparison, self.log)
        return local.changed(trained=trained, offline=record)

    def _flowing(self, models: list[ReducedModel]) -> tuple[LocalHistories, Comparison | None, TrainedPaths | None]:
        """Models that flow, beside known histories, and what they were trained on."""
        local = LocalHistories(models)
        with self.log.stage("validation"):
            known = self.snapshots, self.held_out, self.recipe.trust
            return local, *checked_histories(self.full, local, *known)

    def _rubbing(self, models: list[ReducedModel]) -> tuple[LocalSliding, Comparison | None, TrainedRange]:
        """Elastic models with friction likewise."""
        local = LocalSliding(models)
        trained = TrainedRange.of(self.snapshots.points, self.full.parameters)
        limits = self.recipe.trust
        if limits is None:
            return local, None, trained
        with self.log.stage("indicator"):
            known = [item.histories for item in (self.held_out, self.snapshots) if item is not None]
            local = LocalSliding(calibrated(local, known, self.log))
        with self.log.stage("validation"):
            return local, compared_histories(self.full, local, self.snapshots, self.held_out, limits)[0], trained


def _checked_labels(labels: Sequence[Any], histories: Sequence[History], overlap: object) -> tuple[np.ndarray, ...]:
    """Labels as arrays, one for each history, or ReductionError."""
    if not is_whole(overlap, 0):
        raise ReductionError(f"overlap = {overlap} must be a whole number of steps from 0")
    try:
        found = tuple(np.asarray(item) for item in labels)
    except (TypeError, ValueError):
        found = ()
    lengths = [len(history.answers) for history in histories]
    if [item.shape for item in found] != [(length,) for length in lengths]:
        raise ReductionError(
            f"labels of the shapes {[item.shape for item in found]} must be one array for each training history, with "
            f"as many numbers as it has steps: {lengths}"
        )
    whole = all(item.dtype.kind in "iu" for item in found)
    if not whole or min(item.min() for item in found) < 0:
        raise ReductionError("labels of steps must be whole numbers from 0: those of the models")
    every = np.concatenate([item.astype(np.int64) for item in found])
    if not 0 <= every.max() < every.size:
        raise ReductionError(f"label {every.max()} of {every.size} steps: labels are those of the models, from 0 on")
    counts = np.bincount(every)
    if counts.min() < 2:
        raise ReductionError(
            f"label {int(counts.argmin())} has {int(counts.min())} steps of the training: a local model needs at least "
            "2, and labels from 0 on without a gap"
        )
    return found


def _columns_of(labels: tuple[np.ndarray, ...], overlap: int) -> list[np.ndarray]:
    """For each label its steps and their neighbours in time, by their numbers among all steps."""
    count = max(int(item.max()) for item in labels) + 1
    columns = []
    for number in range(count):
        near = []
        for item in labels:
            steps = np.flatnonzero(item == number)[:, None] + np.arange(-overlap, overlap + 1)
            mask = np.zeros(len(item), dtype=bool)
            mask[np.clip(steps, 0, len(item) - 1)] = True
            near.append(mask)
        columns.append(np.flatnonzero(np.concatenate(near)))
    return columns
