"""Local models, thesis chapter 4: several small models, each trained on a part of the box, used
like one.

Solutions with a contact zone that moves far lie on a curved manifold, and a common basis becomes
large. If each model covers a part of the box, models stay small; a query uses the model of its
part. Near a border two models are candidates, and the answer with the smaller error estimate wins.

The parts are regions of a binary tree of cuts through the box. Grids, decision trees and boxes that
were split repeatedly have this form. A query passes about five cuts, in a microsecond or two.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Any, Self

import numpy as np

from hhr_dolfinx.declared import Floats, Integers
from hhr_dolfinx.errors import ReductionError
from hhr_dolfinx.models.answer import Answer, CheckedStart
from hhr_dolfinx.models.model import NEAREST, KeptModel, checked_start
from hhr_dolfinx.models.reconstruct import Reconstruction
from hhr_dolfinx.models.reduced import ADVICE, ReducedModel
from hhr_dolfinx.parameters import ParameterSpace, PointsLike
from hhr_dolfinx.trained import USUAL, TrainedRange

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from hhr_dolfinx.models.many import PartedAnswers
    from hhr_dolfinx.reduction.reductor import Record


SAME_ARRAYS = 1e-5
"""Relative difference of arrays up to which two models are of one scene."""
LEAF = -1
"""Axis of a node without a cut."""


@dataclass(frozen=True, eq=False)
class Choice:
    """A binary tree of cuts across the axes (n nodes, first the whole box; P parameters).

    ReductionError if invalid.
    """

    axis: Annotated[Integers, "nodes"]  #: index of the parameter that is cut; -1 for a region
    cut: Annotated[Floats, "nodes"]  #: value of the cut; a point at the cut or below goes low
    low: Annotated[Integers, "nodes"]
    high: Annotated[
        Integers, "nodes"
    ]  #: the nodes below and above the cut, each with a higher number than its parent
    label: Annotated[Integers, "nodes"]  #: number of the model of a region
    #: half the width, along each parameter, of the strip along a cut in which both sides are
    #: candidates, (P,)
    reach: Annotated[Floats, "P"]

    def __post_init__(self) -> None:
        """A query of an invalid tree would not end, or end nowhere."""
        count = len(self.axis)
        sizes = {len(column) for column in (self.axis, self.cut, self.low, self.high, self.label)}
        inner = np.flatnonzero(self.axis != LEAF)
        if (
            sizes != {count}
            or count == 0
            or not (np.isfinite(self.cut).all() and np.isfinite(self.reach).all())
        ):
            raise ReductionError(
                "a choice between models needs as many finite cuts as nodes, at least one"
            )
        children = np.concatenate([self.low[inner], self.high[inner]])
        if (
            (self.axis < LEAF).any()
            or (self.axis >= len(self.reach)).any()
            or (self.reach < 0).any()
        ):
            raise ReductionError(
                f"a choice between models cuts axes {np.unique(self.axis)} of {len(self.reach)}"
            )
        if (
            not np.array_equal(np.sort(children), np.arange(1, count))
            or (children <= np.tile(inner, 2)).any()
        ):
            raise ReductionError("the cuts of a choice between models are no tree")
        if (self.label[self.axis == LEAF] < 0).any():
            raise ReductionError("a region of a choice between models has no model")

    @cached_property
    def _nodes(self) -> list[tuple[int, float, int, int, int]]:
        """Axis, cut, low, high and label of each node as plain numbers.

        Python follows these ten times as fast.
        """
        columns = (self.axis, self.cut, self.low, self.high, self.label)
        return list(zip(*(column.tolist() for column in columns), strict=True))

    @cached_property
    def _reach(self) -> list[float]:
        return self.reach.tolist()

    def candidates(self, point: Sequence[float]) -> tuple[int, int]:
        """Model of a point, P numbers, and near a border the model on the other side, else -1.

        Of several borders the nearest one counts, in parts of their reach. Points on both sides of
        it have the same two candidates, so that the answer does not jump there.
        """
        nodes = self._nodes
        reach = self._reach
        near = []
        axis, cut, low, high, label = nodes[0]
        while axis >= 0:
            off = point[axis] - cut
            width = reach[axis]
            if -width <= off <= width:
                near.append((abs(off) / width if width else 0.0, high if off <= 0 else low))
            axis, cut, low, high, label = nodes[low if off <= 0 else high]
        for _, branch in sorted(near):
            axis, cut, low, high, neighbour = nodes[branch]
            while axis >= 0:
                axis, cut, low, high, neighbour = nodes[low if point[axis] <= cut else high]
            # both sides of a cut may belong to one model
            if neighbour != label:
                return label, neighbour
        return label, LEAF

    def many(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Models and second candidates of many points, (n, P): (n,) each."""
        rows = points.tolist()
        candidates = np.array([self.candidates(row) for row in rows], dtype=np.int64).reshape(
            len(rows), 2
        )
        return candidates[:, 0], candidates[:, 1]

    def boxes(self, lower: ArrayLike, upper: ArrayLike) -> list[tuple[int, np.ndarray, np.ndarray]]:
        """Regions inside a box, in the order of the nodes.

        Args:
            lower: lower corner of the box, (P,).
            upper: upper corner of the box, (P,).

        Returns:
            Number of the model, and corners, (P,) each, of each region.
        """
        corners = {0: (np.array(lower, dtype=float), np.array(upper, dtype=float))}
        regions = []
        for node, (axis, cut, low, high, label) in enumerate(self._nodes):
            least, most = corners.pop(node)
            if axis == LEAF:
                regions.append((label, least, most))
                continue
            # a cut may lie outside of the box
            corners[low], corners[high] = halves_of(
                least, most, axis, min(max(cut, least[axis]), most[axis])
            )
        return regions


def halves_of(
    lower: np.ndarray, upper: np.ndarray, axis: int, cut: float
) -> tuple[tuple[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]:
    """Corners, (P,), of the boxes below and above a cut.

    Args:
        lower: lower corner of the box, (P,).
        upper: upper corner of the box, (P,).
        axis: index of the parameter that is cut.
        cut: value of the cut.
    """
    below = upper.copy()
    above = lower.copy()
    below[axis] = above[axis] = cut
    return (lower, below), (above, upper)


class LocalModels(KeptModel):
    """Reduced models of one elastic scene, each for a part of the box; used like one model.

    Args:
        models: the models, of the same scene.
        choice: selects the model that answers.
        offline: record of their construction; None from a file.

    Raises:
        ReductionError: for models of several scenes, or a choice of models that do not exist.
    """

    kept = ("models", "choice")
    advice = ADVICE

    def __init__(
        self, models: Sequence[ReducedModel], choice: Choice, offline: Record | None = None
    ):
        self.models = tuple(models)
        self.choice = choice
        self.offline = offline
        _check_alike(self.models, choice)
        self.parameters: ParameterSpace = self.models[0].parameters

    def __len__(self) -> int:
        return len(self.models)

    @property
    def members(self) -> tuple[KeptModel, ...]:
        """The models."""
        return self.models

    @property
    def fields(self) -> Reconstruction:
        """Fields of the first model: gaps, S and outputs are common.

        Answers are completed by their own models.
        """
        return self.models[0].fields

    @property
    def own_conditions(self) -> int:
        """Number of conditions of the first model; others may have more, or fewer."""
        return self.models[0].own_conditions

    @property
    def sizes(self) -> tuple[int, int]:
        """Sizes of answers of the first model."""
        return self.models[0].sizes

    def for_file(self) -> Self:
        """The models without their indicators, which are code."""
        return self.changed(models=tuple(model.for_file() for model in self.models))

    def faults(self, sizes: Mapping[str, int]) -> Iterator[str]:
        """No faults beyond those of its models.

        The constructor refuses models that do not fit together.
        """
        return iter(())

    def model_of(self, answer: Answer) -> int:
        """Number of the model that returned an answer.

        Args:
            answer: an answer of this set of models.

        Raises:
            ReductionError: if none of the models returned it.
        """
        for number, model in enumerate(self.models):
            if model.fields is answer.fields:
                return number
        raise ReductionError("this answer is not of these local models")

    def columns(self, many: Iterable[Answer]) -> dict[str, np.ndarray]:
        """See :meth:`AnsweringModel.columns`: number of the model that answered."""
        return {"model": np.array([self.model_of(answer) for answer in many], dtype=float)}

    def _answered(
        self, point: np.ndarray, start: CheckedStart, outside: str, gradient: bool
    ) -> Answer:
        """Answer by the model of the part, or by the better one of two near a border."""
        number, neighbour = self.choice.candidates(point.tolist())
        if neighbour != LEAF:
            number = int(self._nearer(np.array([number]), np.array([neighbour]), point[None])[0])
        model = self.models[number]
        # statuses of another model, as along a path
        if isinstance(start, np.ndarray) and start.size != model.own_conditions:
            start = NEAREST
        model.check_range(point, outside)
        return model._answered(point, start, outside, gradient)

    def _checked_start(self, start: Any) -> CheckedStart:
        """Statuses of any of the models, checked."""
        sizes = [model.own_conditions for model in self.models]
        count = np.shape(start)[0] if np.ndim(start) == 1 else 0
        return checked_start(start, count if count in sizes else sizes[0])

    def _criteria(self, numbers: np.ndarray, points: np.ndarray) -> np.ndarray:
        """Criteria against answers of models to points, the most important first: (3, n).

        The models are given by their numbers, (n,), the points are (n, P).

        No solution: infinite. Outside the training range of the model: 1. The larger of the
        relative estimates of displacement and forces, and, if these are infinite, in units; 0
        without an estimate.
        """
        criteria = np.zeros((3, len(points)))
        for number in np.unique(numbers):
            rows = np.flatnonzero(numbers == number)
            model = self.models[number]
            many = model.solve_many(points[rows], raise_on_failure=False, outside="ignore")
            if isinstance(model.trained, TrainedRange):
                within = (model.trained.lower <= points[rows]) & (
                    points[rows] <= model.trained.upper
                )
                criteria[0, rows] = ~within.all(axis=1)
            if (estimates := many.estimates()) is not None:
                criteria[1, rows] = np.maximum(estimates.primal_relative, estimates.dual_relative)
                criteria[2, rows] = np.maximum(estimates.primal, estimates.dual)
            criteria[:, rows[~many.converged]] = np.inf
        return criteria

    def _nearer(self, one: np.ndarray, two: np.ndarray, points: np.ndarray) -> np.ndarray:
        """The better of two models at each point, (n,), of numbers (n,) each.

        The first if they are equal.
        """
        less = np.zeros(len(points), dtype=bool)
        # from the least important criterion to the first, each of which decides if those before it
        # are equal
        for first, second in zip(
            self._criteria(one, points)[::-1], self._criteria(two, points)[::-1], strict=True
        ):
            less = (second < first) | ((second == first) & less)
        return np.where(less, two, one)

    def solve_many(
        self, points: PointsLike, *, raise_on_failure: bool = True, outside: str = USUAL
    ) -> PartedAnswers:
        """Answer many parameters, one batch per model, see :meth:`CondensedModel.solve_many`.

        Args:
            points: parameters, (n, P).
            raise_on_failure: raise an error for a point without a solution.
            outside: policy for points outside the training range, see :meth:`Model.solve`.
        """
        from hhr_dolfinx.models.many import PartedAnswers

        checked = self.parameters.points(points)
        number, neighbour = self.choice.many(checked)
        near = np.flatnonzero(neighbour != LEAF)
        number[near] = self._nearer(number[near], neighbour[near], checked[near])
        batches = []
        for chosen in np.unique(number):
            rows = np.flatnonzero(number == chosen)
            many = self.models[chosen].solve_many(
                checked[rows], raise_on_failure=raise_on_failure, outside=outside
            )
            batches.append((rows, many))
        return PartedAnswers.of(batches, number)


def _check_alike(models: Sequence[ReducedModel], choice: Choice) -> None:
    """ReductionError for models of several scenes, or a choice of models that do not exist."""
    if not models or not all(isinstance(model, ReducedModel) for model in models):
        raise ReductionError("local models are a list of reduced models, at least one")
    if any(model.flow is not None for model in models):
        raise ReductionError(
            "local models are of elastic bodies: where bodies flow take one model, build() or "
            "condense()"
        )
    first = models[0]
    point = first.parameters.random(1, seed=1)[0]
    for number, model in enumerate(models):
        if not (
            _scene_of(model) == _scene_of(first) and _same_arrays(model.fields, first.fields, point)
        ):
            raise ReductionError(
                f"local model {number} is of another scene or mesh than the first one"
            )
    if not isinstance(choice, Choice):
        raise ReductionError(f"{choice!r} is no Choice, which says what local model answers where")
    if len(choice.reach) != len(first.parameters.names):
        raise ReductionError(
            f"a choice of {len(choice.reach)} parameters does not suit {first.parameters.names}"
        )
    if choice.label[choice.axis == LEAF].max() >= len(models):
        raise ReductionError(
            f"a region belongs to a model that is not among {len(models)} local ones"
        )


def _scene_of(model: ReducedModel) -> list[ParameterSpace | int | tuple[int, ...] | str]:
    """Box, mesh, and names of outputs of a model."""
    functionals = model.fields.functionals
    outputs = () if functionals is None else functionals.items
    sizes = len(model.fields.basis), model.fields.gaps.shape
    return [model.parameters, *sizes, *(functional.name for functional in outputs)]


def _same_arrays(one: Reconstruction, two: Reconstruction, point: np.ndarray) -> bool:
    """True if the arrays of two models belong to one scene.

    These are gaps, θ at a point, and, if both have them, S, lifts and loads.
    """
    theta_of_one = one.amplitudes(point)
    theta_of_two = two.amplitudes(point)
    alike = [(one.gaps, two.gaps), (theta_of_one.values, theta_of_two.values)]
    if not all(np.array_equal(mine, reference) for mine, reference in alike):
        return False
    if one is two or one.bound is None or two.bound is None:
        # models with and without an estimate cannot be compared near a border
        return one.bound is two.bound
    pairs = [
        (one.bound.schur, two.bound.schur),
        (one.lifts, two.lifts),
        (one.bound.free_slack, two.bound.free_slack),
    ]
    return all(
        abs(mine - reference).max() <= SAME_ARRAYS * abs(reference).max()
        for mine, reference in pairs
        if reference.size
    )
