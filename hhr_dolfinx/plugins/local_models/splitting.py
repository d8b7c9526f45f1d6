"""Local models without a given number: the box is split until each model is small, and training
grows as needed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hhr_dolfinx.errors import StudyError, UnstableModelError
from hhr_dolfinx.models.reduced import ReducedModel
from hhr_dolfinx.parameters import check_counts, is_number
from hhr_dolfinx.plugins.local_models.clustered import (
    LocalFacts,
    above,
    built,
    force_errors,
    least_forces,
    moving,
    sizes,
    sizes_of,
    together,
)
from hhr_dolfinx.plugins.local_models.models import LEAF, Choice, LocalModels, halves_of
from hhr_dolfinx.plugins.local_models.subspaces import snapshot_distances
from hhr_dolfinx.reduction.recipe import Recipe
from hhr_dolfinx.reduction.reductor import Record
from hhr_dolfinx.snapshots.records import Progress, SnapshotSet, compute_snapshots
from hhr_dolfinx.timing import StageLog

if TYPE_CHECKING:
    from hhr_dolfinx.study.training.train import Training

FEWEST_SNAPSHOTS = 8
"""Snapshots in a part below which the full model computes more."""
HELD_OUT = 20
"""Answers of the full model by which each model is checked."""
BALANCE = 0.25
"""Least part of the snapshots on each side of a split."""
FEW = 60
"""Least number of snapshots whose modes are counted."""
CLUSTERED = 300
"""Most snapshots of a part that decide its split; more change nothing."""
STUCK = 3
USELESS_CUT = 0.9
"""Cuts in a row after which a part is left whole, if each leaves more than this part of the
modes.
"""
LEARNED = 30
"""Points of full answers in one round: those of the largest errors."""


@dataclass(frozen=True)
class Splitting:
    """Splits the box, part by part, until models are small.

    Training grows until their forces are accurate.

    A part is split across the axis that best separates two clusters of its solutions (k-medoids by
    the angle between them, (4.4)). Its model is trained on the solutions in it and near its
    borders. Errors are estimated at random points of the part. If forces may exceed the target
    error, full answers are added to the training, also of neighbours that follow.

    Attributes:
        modes: most modes of a model.
        conditions: most contact conditions of a model; None for any number.
        forces: target relative error of the contact forces in the S norm; the denominator is at
            least a thousandth of the largest training forces.
        overlap: part of the width of a part by which its training extends beyond its borders.
        strip: part of the width of the box, on each side of a border, in which both models are
            candidates.
        checks: random points of each part at which errors are estimated.
        rounds: most additions of training answers to one part.
        most: most models.
        seed: of random points.
    """

    modes: int = 90
    conditions: int | None = None
    forces: float = 1e-3
    overlap: float = 0.2
    strip: float = 0.001
    checks: int = 500
    rounds: int = 3
    most: int = 100
    seed: int = 1

    def __post_init__(self) -> None:
        limits = {"modes": 2, "checks": 1, "rounds": 0, "most": 1, "seed": 0}
        limits |= {} if self.conditions is None else {"conditions": 1}
        check_counts(**{name: (getattr(self, name), least) for name, least in limits.items()})
        for name in ("forces", "overlap", "strip"):
            value = getattr(self, name)
            if not (is_number(value) and 0 <= value < 1) or (name == "forces" and value == 0):
                raise StudyError(
                    f"{name} = {value!r} must be a part of 1, such as {getattr(type(self), name)}"
                )

    def models(self, training: Training, recipe: Recipe, progress: Progress) -> LocalModels:
        """Local models of a training, see the class.

        Args:
            training: the full model with its answers.
            recipe: recipe of each model.
            progress: wraps the iteration over the parts.
        """
        return _Run(self, training, recipe).grown(progress)


class _Part(NamedTuple):
    """A box for one model."""

    node: int  #: its index in the tree
    lower: np.ndarray
    upper: np.ndarray
    modes: float = np.inf  #: of the model of its parent
    stuck: int = 0  #: cuts in a row that hardly reduced models, or gave unreliable ones


class _Run:
    """One run of :class:`Splitting`."""

    def __init__(self, settings: Splitting, training: Training, recipe: Recipe):
        self.settings = settings
        self.recipe = recipe
        self.full = training.full_order
        self.snapshots = training.snapshots
        self.space = self.full.parameters
        self.lower = np.array(self.space.lower)
        self.upper = np.array(self.space.upper)
        self.rng = np.random.default_rng(settings.seed)
        self.record = Record(settings, 0, LocalFacts(), None, StageLog())
        self.models: list[ReducedModel] = []
        self.kept: tuple[int, SnapshotSet] | None = None
        # axis, cut, low, high and label of each node, see Choice
        self.nodes: list[list[float]] = [[LEAF, 0.0, 0, 0, LEAF]]

    def grown(self, progress: Progress) -> LocalModels:
        """Split and build until every part has a model."""
        waiting = [_Part(0, self.lower, self.upper)]
        for _ in progress(iter(waiting.__len__, 0)):
            # the largest first: if the models run out, all parts are about equally fine
            sizes_left = [self._inside(box, 0.0).size for box in waiting]
            box = waiting.pop(int(np.argmax(sizes_left)))
            waiting += self._settled(box, len(waiting))
        axis, cut, low, high, label = map(np.array, zip(*self.nodes, strict=True))
        choice = Choice(
            axis, cut, low, high, label, self.settings.strip * (self.upper - self.lower)
        )
        return together(self.models, choice, self.snapshots, self.record)

    def _settled(self, part: _Part, waiting: int) -> list[_Part]:
        """The halves of a part that is too large for one model; empty if its model was built."""
        room = len(self.models) + waiting + 2 <= self.settings.most
        settings = self.settings
        missing = FEWEST_SNAPSHOTS - self._inside(part, 0.0).size
        if missing > 0:  # to separate its halves
            self._learn(self._drawn(part, missing))
        added = 0
        for rounds_left in range(settings.rounds, -1, -1):
            rows = self._inside(part, settings.overlap)
            members = self._inside(part, 0.0)
            try:
                model, doubts = self._built(rows, part, refuse=room)
            except _TooLargeError as error:
                halves = self._split(part._replace(stuck=error.stuck(part)), members, error)
                if halves:
                    return halves
                # a part that cannot be split stays whole, in later rounds too
                room = False
                model, doubts = self._built(rows, part, refuse=room)
            points = self._drawn(part, settings.checks)
            errors = force_errors(model, points, least_forces(self.full, self.snapshots))
            poor = points[_worst(errors, settings.forces)]
            if rounds_left == 0 or not len(poor):
                break
            added += len(poor)
            self._learn(poor)
        self.nodes[part.node][4] = len(self.models)
        self.models.append(model)
        self.record.facts.add(
            model, rows, members.size, errors, self._missed(model, errors) + doubts, added
        )
        return []

    def _missed(self, model: ReducedModel, errors: np.ndarray) -> list[str]:
        """Targets that a model misses."""
        settings = self.settings
        misses = [
            f"{size} {kind} instead of {most} at most: allow more models (most), or more of them"
            for size, most, kind in above(sizes_of(model), (settings.modes, settings.conditions))
        ]
        worst = float(np.fmax.reduce(errors))
        if np.isnan(worst):
            misses.append(
                "nothing is known of its errors: its forces were not held against the wish"
            )
        elif not worst <= settings.forces:
            misses.append(
                f"forces may be off by {worst:.2g} instead of {settings.forces:g}: allow more "
                "rounds, or train on more"
            )
        return misses

    def _built(
        self, rows: np.ndarray, part: _Part, *, refuse: bool
    ) -> tuple[ReducedModel, list[str]]:
        """Model of some snapshots, checked in its part, and warnings of its check.

        An unreliable one is refused: by _TooLargeError if ``refuse`` is set, as one above the
        limits is.
        """
        if refuse:
            self._check_sizes(rows)
        held_out = None if self.recipe.trust is None else self._held_out(part)
        try:
            with self.record.log.stage("models"):
                return built(self.full, self.snapshots.take(rows), self.recipe, held_out)
        except UnstableModelError as error:
            if refuse:
                raise _TooLargeError(str(error)) from None
            raise UnstableModelError(
                f"of the part {part.lower.tolist()} to {part.upper.tolist()} no model is to be "
                f"trusted: {error}. Allow more models (most), or another recipe"
            ) from None

    def _held_out(self, part: _Part) -> SnapshotSet:
        """Answers of the full model in a part, for all models that are tried there."""
        if self.kept is None or self.kept[0] != part.node:
            with self.record.log.stage("held_out"):
                self.kept = part.node, compute_snapshots(self.full, self._drawn(part, HELD_OUT))
        return self.kept[1]

    def _check_sizes(self, rows: np.ndarray) -> None:
        """_TooLargeError if the model of some snapshots has too many modes, or conditions."""
        settings = self.settings
        recipe = self.recipe
        with self.record.log.stage("sizes"):
            if rows.size > (few := max(2 * settings.modes, FEW)):
                # if a subset has too many modes already, which is fast to compute
                subset = np.sort(self.rng.choice(rows, few, replace=False))
                count = recipe.basis.modes(self.full.problem, self.snapshots.take(subset)).shape[1]
                if count > settings.modes:
                    raise _TooLargeError(f"at least {count} modes", np.nan)
            modes, conditions = sizes(self.full, self.snapshots.take(rows), recipe)
        if modes > settings.modes:
            raise _TooLargeError(f"{modes} modes", modes)
        if settings.conditions is not None and conditions > settings.conditions:
            raise _TooLargeError(f"{conditions} contact conditions", modes)

    def _split(self, part: _Part, own: np.ndarray, error: _TooLargeError) -> list[_Part]:
        """Halves of a part, cut between two clusters of its solutions.

        None after several cuts that did not help.
        """
        from hhr_dolfinx.plugins.local_models.clusters import medoids, separating_cut

        # zero displacements have no direction
        own = own[moving(self.snapshots.displacements[:, own])]
        if part.stuck >= STUCK or own.size < 2:
            return []
        width = part.upper - part.lower
        own = (
            own
            if own.size <= CLUSTERED
            else np.sort(self.rng.choice(own, CLUSTERED, replace=False))
        )
        unit = (self.snapshots.points[own] - part.lower) / np.where(width > 0, width, 1.0)
        with self.record.log.stage("clusters"):
            distances = snapshot_distances(self.snapshots.displacements[:, own])
            cut_through = separating_cut(unit, medoids(distances, 2, self.settings.seed), BALANCE)
        if cut_through is None:
            return []
        axis = cut_through[0]
        cut = float(part.lower[axis] + cut_through[1] * width[axis])
        first = len(self.nodes)
        self.nodes[part.node][:4] = [axis, cut, first, first + 1]
        self.nodes += [[LEAF, 0.0, 0, 0, LEAF] for _ in range(2)]
        self.record.splits.append(f"{self.space.names[axis]} = {cut:.4g}, for {error}")
        modes = part.modes if np.isnan(error.modes) else error.modes
        boxes = halves_of(part.lower, part.upper, axis, cut)
        return [_Part(first + k, *box, modes, part.stuck) for k, box in enumerate(boxes)]

    def _inside(self, part: _Part, overlap: float) -> np.ndarray:
        """Numbers of the snapshots in a part and up to ``overlap`` beyond its borders."""
        more = overlap * (part.upper - part.lower) + 1e-12 * (self.upper - self.lower)
        points = self.snapshots.points
        return np.flatnonzero(
            ((points >= part.lower - more) & (points <= part.upper + more)).all(axis=1)
        )

    def _drawn(self, part: _Part, count: int) -> np.ndarray:
        """Random points of a part, (count, P)."""
        return part.lower + self.rng.random((count, len(part.lower))) * (part.upper - part.lower)

    def _learn(self, points: np.ndarray) -> None:
        """Solve the full model for this part and for its neighbours."""
        with self.record.log.stage("full order"):
            self.snapshots = self.snapshots.joined(compute_snapshots(self.full, points))


def _worst(errors: np.ndarray, wished: float) -> np.ndarray:
    """Indices of errors above the target, or without an answer; empty without any estimate."""
    if np.isnan(errors).all():
        return np.zeros(0, dtype=np.int64)
    bounded = np.where(np.isnan(errors), np.inf, errors)
    order = np.argsort(-bounded, kind="stable")[:LEARNED]
    return order[bounded[order] > wished]


class _TooLargeError(Exception):
    """A model that a part must not have, and its modes.

    NaN if only some modes were counted, infinite if the model is unreliable.
    """

    def __init__(self, why: str, modes: float = np.inf):
        super().__init__(why)
        self.modes = modes

    def stuck(self, part: _Part) -> int:
        """Number of useless cuts in a row, including the one that created a part."""
        if np.isnan(self.modes):
            return part.stuck
        return (
            part.stuck + 1 if np.isinf(self.modes) or self.modes > USELESS_CUT * part.modes else 0
        )
