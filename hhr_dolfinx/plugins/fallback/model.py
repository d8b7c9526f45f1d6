"""A reduced model with the full model as a fallback, for queries whose error bound is too large."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from hhr_dolfinx.contact.active_set import Status
from hhr_dolfinx.errors import (
    BoundError,
    HHRError,
    OutsideTrainingError,
    ParameterError,
    ReductionError,
)
from hhr_dolfinx.models.answer import (
    Answer,
    CheckedStart,
    History,
    ListedAnswers,
    ModelFields,
    Path,
    SeveralAnswers,
    Start,
)
from hhr_dolfinx.models.estimates import (
    FORCES_INDICATOR,
    check_asked,
    check_of_forces,
    check_word,
    known_error,
    relative_error,
    relative_errors,
)
from hhr_dolfinx.models.full import FullModel
from hhr_dolfinx.models.histories.equilibrium import MarchSettings
from hhr_dolfinx.models.histories.path import check_settings
from hhr_dolfinx.models.model import AnsweringModel, KeptModel
from hhr_dolfinx.parameters import ParameterSpace, PointsLike, is_number
from hhr_dolfinx.trained import USUAL
from hhr_dolfinx.warn import collected, repeat

if TYPE_CHECKING:
    from hhr_dolfinx.full_order.full import FullOrderModel
    from hhr_dolfinx.models.bound import Bound
    from hhr_dolfinx.models.eliminations.elimination import CondensedContact
    from hhr_dolfinx.reduction.recipe import Recipe
    from hhr_dolfinx.study.training.train import Training

_log = logging.getLogger(__name__)

FULL_SOLVE_MESSAGE = "the full model answers: %s"
"""Message of the log, with the estimated error."""
SAME_PROBLEM = 1e-5
"""Relative difference of gaps and S up to which two models are of one scene: S may be
interpolated.
"""


class _NotGoodEnough(Exception):
    """Raised at an increment of a reduced model whose error may exceed the tolerance."""


class FallbackModel(AnsweringModel):
    """Model that calls the full one if the error of a reduced one may exceed a tolerance.

    The relative error of each answer is at most ``tolerance``, in the quantity ``of``: ``forces``,
    nodal contact forces in the Euclidean norm; ``pressure``, the largest error of a nodal pressure
    over the peak pressure; ``displacement``, in the energy norm; or an output, by its name. None
    means displacement in the energy norm and forces in the S norm: errors of nodal forces and
    pressures may then be ten or more times larger. See :mod:`hhr_dolfinx.models.estimates`. For
    answers without a bound the error is that of their ``estimate``. Not thread-safe, since it
    counts its queries.

    Args:
        reduced: a model whose answers have a bound, or with friction an indicator of forces.
        full: the full model of the same scene.
        tolerance: largest relative error.
        of: quantity of the error.

    Attributes:
        asked: number of queries.
        fallen: number of queries that the full model answered.

    Raises:
        BoundError: for a reduced model whose answers have no bound.
        ParameterError: for a tolerance that is not a positive number, an unknown quantity, or an
            output without a bound.
        ReductionError: if ``full`` is not a full model, or of another scene.
    """

    usual_outside = "ignore"
    """The training range is ignored: the bound decides when the full model answers."""
    instead = "its full model needs the mesh. Keep the reduced one, save_model(path, safe.reduced)"

    def __init__(
        self,
        reduced: AnsweringModel,
        full: FullOrderModel,
        tolerance: float = 0.01,
        *,
        of: str | None = None,
    ):
        check_allowance(tolerance)
        _check_alike(reduced, full)
        check_asked(reduced.fields, of)
        self.of = of
        self.advice = full.advice
        self.law = full.law
        self.reduced = reduced
        self.full = full
        self.tolerance = float(tolerance)
        self.parameters: ParameterSpace = reduced.parameters
        self.asked = 0
        self.fallen = 0

    @property
    def fields(self) -> ModelFields:
        """Fields of the reduced model; each answer has the fields of the model that computed it."""
        return self.reduced.fields

    @property
    def share(self) -> float:
        """Part of the queries that the full model answered."""
        return self.fallen / max(self.asked, 1)

    @property
    def known_error(self) -> str:
        """See :attr:`AnsweringModel.known_error`."""
        quantity = "displacement or forces, in energy," if self.of is None else self.of
        error_of_reduced = known_error(self.reduced.fields)
        return (
            f"{error_of_reduced}. Where {quantity} may be off by more than {self.tolerance:g} "
            "the full model answers"
        )

    @property
    def estimating(self) -> AnsweringModel:
        """The reduced model; answers of the full one are exact."""
        return self.reduced

    def columns(self, many: Iterable[Answer]) -> dict[str, np.ndarray]:
        """See :meth:`AnsweringModel.columns`.

        The first column is 1 for answers of the full model; the others are those of the reduced
        one.
        """
        answers = list(many)
        fell = np.array([self.fell_back(answer) for answer in answers], dtype=bool)
        table = {"fell_back": fell.astype(float)}
        for head, values in self.reduced.columns(
            answer for answer in answers if not self.fell_back(answer)
        ).items():
            table[head] = np.full(len(fell), np.nan)
            table[head][~fell] = values
        return table

    def summed_up(self, sums: Mapping[str, float]) -> str:
        """See :meth:`AnsweringModel.summed_up`."""
        return f" ({sums['fell_back']:.0f} by the full model)"

    def fell_back(self, answer: Answer) -> bool:
        """True if the full model computed an answer."""
        return answer.fields is self.full

    def _answered(
        self, point: np.ndarray, start: CheckedStart, outside: str, gradient: bool
    ) -> Answer:
        """Answer of the reduced model if its error is small, else of the full one."""
        answer = self._reduced_answer(point, start, outside, gradient)
        self.asked += 1
        if answer is not None and self._is_good(answer):
            return answer
        self.fallen += 1
        return self.full._answered(point, None, outside, gradient)

    def follow(self, path: Path, settings: MarchSettings, **how: Any) -> History:
        """See :class:`AnsweringModel`; one model answers the whole history of a law that remembers.

        Args:
            path: the load path.
            settings: settings of its increments.
            how: further arguments of :meth:`AnsweringModel.follow`.
        """
        if not self.by_paths:
            return super().follow(path, settings, **how)
        check_settings(settings)
        self.asked += 1
        history = self._reduced_history(path, settings, how)
        if history is None:
            self.fallen += 1
            history = self.full.follow(path, settings, **how)
        return history

    def _reduced_history(
        self, path: Path, settings: MarchSettings, how: dict[str, Any]
    ) -> History | None:
        """History of the reduced model.

        None if it has none, or if the error of an increment may be too large.

        Warnings of a discarded history are discarded too.
        """
        try:
            with collected() as caught:
                history = self.reduced.follow(path, settings, **how, watch=self._require_good)
        except ParameterError:
            raise
        except (HHRError, _NotGoodEnough) as error:
            _log.info(FULL_SOLVE_MESSAGE, error)
            return None
        repeat(caught)
        return history

    def _require_good(self, answer: Answer) -> None:
        """Stop a history at an increment whose error may exceed the tolerance."""
        if not self._is_good(answer):
            raise _NotGoodEnough(f"the error may be above {self.tolerance:g}")

    def answering(self, history: History) -> AnsweringModel:
        """Model that computed a history."""
        return self.full if self.fell_back(history.answers[-1]) else self.reduced

    def unanswered(self, point: np.ndarray, status: Status = Status.UNDEFINED) -> Answer:
        """Answer of NaN, of the full model, which was queried last.

        Args:
            point: parameters, (P,).
            status: reason for the missing answer.
        """
        return self.full.unanswered(point, status)

    def contacts(self) -> Callable[[np.ndarray], CondensedContact]:
        """See :class:`AnsweringModel`; those of the full model."""
        return self.full.contacts()

    def _checked_start(self, start: Start) -> CheckedStart:
        sizes = np.shape(start) if isinstance(start, np.ndarray) else None
        # statuses of an answer of the full model may be too many
        too_many = sizes == (self.full.conditions,) != (self.reduced.own_conditions,)
        return self.reduced._checked_start("nearest" if too_many else start)

    @property
    def sizes(self) -> tuple[int, int]:
        """Sizes of answers of the full model."""
        return self.full.sizes

    def solve_many(
        self, points: PointsLike, *, raise_on_failure: bool = True, outside: str = USUAL
    ) -> SeveralAnswers:
        """Answer many parameters by the reduced model, those with a large error by the full one.

        Args:
            points: parameters, (n, P).
            raise_on_failure: raise an error for a point without a solution.
            outside: policy for points outside the training range, see :meth:`Model.solve`.
        """
        from hhr_dolfinx.models.many import PartedAnswers

        if self.by_paths:
            return super().solve_many(points, raise_on_failure=raise_on_failure, outside=outside)
        outside = self._checked_outside(outside)
        checked = self.parameters.points(points)
        try:
            many = self.reduced.solve_many(checked, raise_on_failure=False, outside=outside)
            errors = relative_errors(many, self.of)
        except HHRError:  # a single point may be refused, or have no estimate
            errors = None
        if errors is None:
            one_by_one = (
                self.solve(point, raise_on_failure=raise_on_failure, outside=outside)
                for point in checked
            )
            return ListedAnswers(tuple(one_by_one))
        good = errors <= self.tolerance
        self.asked += len(checked)
        exact = []
        for point in checked[~good]:
            self.fallen += 1
            exact.append(self.full.solve(point, raise_on_failure=raise_on_failure))
        batches = [(np.flatnonzero(good), many.take(good))] if good.any() else []
        batches += [(np.flatnonzero(~good), ListedAnswers(tuple(exact)))] if exact else []
        return PartedAnswers.of(batches, np.where(good, 0, 1))

    def _reduced_answer(
        self, point: np.ndarray, start: CheckedStart, outside: str, gradient: bool
    ) -> Answer | None:
        """Answer of the reduced model; None if it has none, for any reason."""
        try:
            return self.reduced.solve(
                point, start=start, raise_on_failure=False, outside=outside, gradient=gradient
            )
        except OutsideTrainingError:
            return None
        except ParameterError:  # an invalid start or ``outside``
            raise
        except HHRError as error:
            _log.info(FULL_SOLVE_MESSAGE, error)
            return None

    def _is_good(self, answer: Answer) -> bool:
        try:
            estimate = answer.estimate()
            # False for NaN
            return (
                estimate is not None and relative_error(answer, estimate, self.of) <= self.tolerance
            )
        except HHRError as error:
            _log.info(FULL_SOLVE_MESSAGE, error)
            return False


def check_allowance(tolerance: float) -> None:
    """Refuse an invalid tolerance.

    Raises:
        ParameterError: if it is not a positive number.
    """
    if not (is_number(tolerance) and tolerance > 0):
        raise ParameterError(f"tolerance = {tolerance!r} must be a positive number, such as 0.01")


def _remedy(full: FullOrderModel) -> str:
    """Sentence with the scene of the full model and the model that is needed."""
    name = full.scene.name
    return (
        f". It is of scene '{name}': give the FullOrderModel of the scene that was trained, or "
        "train this one"
    )


def _check_alike(reduced: AnsweringModel, full: FullOrderModel) -> None:
    """Check that a reduced model has a bound, and that the full one is of the same scene.

    Box, S and an answer are compared.
    """
    fields = reduced.fields if isinstance(reduced, AnsweringModel) else ModelFields()
    bound = fields.bound
    if bound is None and fields.estimated != FORCES_INDICATOR:
        reason = known_error(fields).removeprefix("none: ")
        raise BoundError(
            "answers of this reduced model have no bound, so that nothing says when to ask the "
            f"full one: {reason}"
        )
    if not isinstance(full, FullModel):
        raise ReductionError(
            f"{full!r} is no full model, whose answers are exact: give FullOrderModel(scene)"
        )
    if reduced.parameters != full.parameters:
        raise ReductionError(
            f"the reduced model has the parameters {reduced.parameters}, and the full one "
            f"{full.parameters}"
        )
    if bound is None:
        _check_same_law(reduced, full)
    else:
        _check_same_scene(reduced, bound, full)


def _check_same_law(reduced: AnsweringModel, full: FullOrderModel) -> None:
    """Raise ReductionError unless a reduced model with a law was built from this full model."""
    interface = reduced.fields.interface
    if full.law.plugins != interface.whole.plugins or full.equilibrium is not None:
        unlike = "inelastic bodies" if full.equilibrium is not None else full.law.name
        raise ReductionError(f"the full model has {unlike}, unlike the reduced one{_remedy(full)}")
    if differences := interface.differences(full.problem):
        raise ReductionError(
            f"the full model is that of another scene or mesh: {differences} differ{_remedy(full)}"
        )


def _check_same_scene(reduced: AnsweringModel, bound: Bound, full: FullOrderModel) -> None:
    """ReductionError unless S and an answer of the full model agree with the reduced one."""
    if (
        bound.schur.shape != full.schur.shape
        or np.abs(bound.schur - full.schur).max() > SAME_PROBLEM * full.schur.max()
    ):
        raise ReductionError(
            f"the full model is that of another scene or mesh: its stiffness differs{_remedy(full)}"
        )
    point = reduced.parameters.random(1, seed=1)[0]
    answer = full.solve(point, raise_on_failure=False)
    problem = full.problem.at(point)
    if answer.converged:
        gaps = problem.gaps @ problem.theta(point)
        slack_of_bound = bound.at(point[None], reduced.fields.amplitudes(point)).slack(
            answer.forces()[None]
        )[0]
        slack = gaps - problem.contact @ answer.unknown
        kernel = full.problem.kernel
        if kernel is not None:  # S does not include rigid motions
            contact_of_motions = kernel.contact_of_motions
            slack = (
                slack
                + contact_of_motions
                @ np.linalg.lstsq(contact_of_motions, slack_of_bound - slack, rcond=None)[0]
            )
        # relative to displacements: if all conditions are active, slack and gaps may be round-off
        if np.abs(slack_of_bound - slack).max() > SAME_PROBLEM * max(
            np.abs(gaps).max(), np.abs(answer.unknown).max()
        ):
            raise ReductionError(
                "the full model is that of another scene: its gaps, its loads or its materials "
                f"differ{_remedy(full)}"
            )


def safe_model(
    training: Training,
    tolerance: float = 0.01,
    *,
    of: str | None = None,
    recipe: Recipe | None = None,
    checked: bool = True,
) -> FallbackModel | KeptModel:
    """Build a model whose answers all have errors within a tolerance.

    For elastic bodies of constant stiffness without friction it is the condensed model, which is
    exact. Else it is a reduced model that calls the full one if its error may exceed the tolerance.

    Args:
        training: the full model with its answers.
        tolerance: largest relative error of any answer.
        of: quantity of the error, see :class:`FallbackModel`.
        recipe, checked: of the reduced model, see
            :meth:`hhr_dolfinx.study.training.train.Training.build`.

    Raises:
        BoundError: if answers of the reduced model have no bound.
        ParameterError: for an invalid tolerance, an unknown quantity, or an output without a bound.
    """
    gathered = training.everywhere
    full = gathered.full_order
    # before a model is built, which takes long
    check_allowance(tolerance)
    check_word(
        []
        if full.functionals is None
        else [functional.name for functional in full.functionals.items],
        of,
    )
    if full.law.remembers:
        check_of_forces(of)
    elif full.equilibrium is None and not full.problem.varies:
        # an estimate solves the exact problem on S: the condensed model answers with it, and is
        # faster
        return training.condense()
    return FallbackModel(gathered.build(recipe, checked=checked), full, tolerance, of=of)
