"""Kinds of answers: what training, reduction and comparison need of the laws of a scene.

Answers of elastic bodies in unilateral contact belong to points, each by itself: :class:`OfPoints`.
Kinds of other laws derive from it, and plug-ins have them: the facet ``reduction`` for laws of
bodies, the tool ``reduction`` for laws of contacts, both functions of the full model.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from typing import TYPE_CHECKING

import numpy as np

from hhr_dolfinx import registry
from hhr_dolfinx.certify.accuracy import Residuals, contact_residuals, force_floor
from hhr_dolfinx.certify.compare import Comparison, compare_points
from hhr_dolfinx.certify.trust import (
    TrustLimits,
    check_comparison,
    warn_of_few_held_out,
    warn_of_gaps_in_training,
    warn_of_moduli_unseen,
    warn_of_no_contact,
)
from hhr_dolfinx.contact.active_set import Status
from hhr_dolfinx.errors import HHRError, ReductionError
from hhr_dolfinx.models.answer import Answer, Model
from hhr_dolfinx.models.estimates import warn_unbounded
from hhr_dolfinx.models.histories.equilibrium import facet_of
from hhr_dolfinx.models.reconstruct import Reconstruction
from hhr_dolfinx.models.starts import KnownStatuses
from hhr_dolfinx.reduction.recipe import Recipe
from hhr_dolfinx.snapshots.records import SnapshotSet, check_of_problem
from hhr_dolfinx.trained import Trained, TrainedRange

if TYPE_CHECKING:
    from hhr_dolfinx.models.full import Checked, FullModel

MOST_TRAINING_COMPARED = 50
"""Approximate number of training solutions that are compared if none were held out."""
MOST_SURE = 4
"""Answers by which a claim is compared at most: a model that claims too much is off nearly
everywhere.
"""
EXACT_MODEL = 1e-6
"""Relative error up to which a model may call itself exact; those of the package are off by
1e-12.
"""
Answered = Iterator[tuple[Answer, Answer | None, str]]
"""Answers of the full model, those of a model or None if it has none, and where."""


class OfPoints:
    """Answers that belong to points, of elastic bodies in unilateral contact.

    Base of all other kinds.
    """

    cone: bool = True  #: forces outside the RID may be combinations of those of training, (1.70)

    def __init__(self, full: FullModel):
        self.full = full

    def recipes(self) -> tuple[Recipe, ...]:
        """Default recipes; each is tried if the one before leaves contact rows dependent."""
        return (Recipe(),)

    def not_by_rows(self) -> str:
        """Reason why a distributed problem is not reduced by rows; empty if it is."""
        return ""

    @property
    def unbounded(self) -> str:
        """Reason why no error has a bound; empty if one may be proved."""
        return ""

    def trains_on(self, family: object) -> bool:
        """True if a search can train its models on points, or on paths of a family.

        Points have the family None.
        """
        return True

    def require_linear(self, what: str) -> None:
        """Raise ReductionError for ``what``, which needs linear bodies, where bodies have laws."""

    def require_completion(self) -> None:
        """Refuse a law of contacts that hyper-reduced models cannot complete outside the RID.

        Raises:
            NotOfferedError: for such a law.
        """

    def check(self, name: str, solutions: SnapshotSet | None) -> SnapshotSet:
        """Check solutions.

        Args:
            name: name of the solutions, for the message.
            solutions: the solutions.

        Returns:
            The same solutions.

        Raises:
            ReductionError: for solutions of another problem, or of other laws.
        """
        checked = check_of_problem(name, solutions, self.full.problem)
        if checked.states:
            raise ReductionError(
                f"bodies of {name} have laws, and none of the model do: they are of another scene"
            )
        return checked

    def warn_of_training(self, snapshots: SnapshotSet, held_out: SnapshotSet | None) -> None:
        """Warn of deficits in training and validation that no check of a model can find.

        Args:
            snapshots: training answers.
            held_out: validation answers; None if there are none.
        """
        warn_of_gaps_in_training(snapshots.points)
        warn_of_moduli_unseen(self.full.problem, snapshots.points)
        warn_of_no_contact(self.full.problem, snapshots)
        warn_of_few_held_out(held_out)

    def skipped(self, recipe: Recipe) -> Iterator[tuple[str, str]]:
        """Optional stages that a recipe leaves out, with the reasons."""
        if recipe.indicator is None:
            yield "indicator", "no estimate of the error of each answer was requested"

    def condensed_from(
        self, snapshots: SnapshotSet, held_out: SnapshotSet | None
    ) -> tuple[SnapshotSet | None, SnapshotSet | None, bool | None]:
        """Answers for a model of all contact conditions.

        Args:
            snapshots: training answers.
            held_out: validation answers; None if there are none.

        Returns:
            Answers for the model and for its check, and whether it needs fields; None if it does
            not.
        """
        return snapshots, held_out, None

    def with_corners(self, model: Checked) -> Checked:
        """A model whose strains in corners of the box are checked.

        It has a limit where they are too large.
        """
        return self.full.strains.corners(self.full, model)

    def statuses(
        self, snapshots: SnapshotSet | None, found: Callable[[], KnownStatuses]
    ) -> KnownStatuses:
        """Statuses from which an exact model starts.

        Args:
            snapshots: training answers; None if there are none.
            found: returns statuses if there is no training.
        """
        return found() if snapshots is None else snapshots.known_statuses()

    def starts(self, snapshots: SnapshotSet, conditions: np.ndarray) -> KnownStatuses | None:
        """Statuses of the conditions of a RID from which a reduced model starts.

        Args:
            snapshots: training answers.
            conditions: conditions of the RID, (m,).
        """
        return snapshots.known_statuses(conditions)

    def range_of(self, snapshots: SnapshotSet) -> Trained | None:
        """The training range of a reduced model, as far as it is known before its check."""
        return TrainedRange.of(snapshots.points, self.full.parameters)

    def compared(
        self,
        model: Model,
        snapshots: SnapshotSet,
        held_out: SnapshotSet | None,
        limits: TrustLimits | None,
        remedy: str | Mapping[str, str],
    ) -> tuple[Comparison | None, Trained | None]:
        """Errors against validation answers, or else training ones, and the training range.

        Args:
            model: model that was built.
            snapshots: training answers.
            held_out: validation answers; None if there are none.
            limits: limits of the errors; None to compare nothing.
            remedy: advice for a model that is refused.

        Raises:
            UnstableModelError: if an error is beyond its limit.
        """
        trained: Trained | None = getattr(model, "trained", None)
        if limits is None:
            return None, trained
        if held_out is None:
            stride = max(1, len(snapshots.points) // MOST_TRAINING_COMPARED)
            held_out = snapshots.take(np.arange(0, len(snapshots.points), stride))
        comparison = compare_points(
            self.full, model, held_out, force_floor(self.full.problem, snapshots)
        )
        check_comparison(comparison, limits, remedy)
        return comparison, trained

    def warn_of_estimates(self, fields: Reconstruction) -> None:
        """Warn of a reduced model without an estimate of its errors."""
        warn_unbounded(fields)

    def round_off(self, known: SnapshotSet) -> float:
        """Relative error by which a model that calls itself exact may be off of known answers."""
        return EXACT_MODEL

    def pairs(self, model: Model, known: SnapshotSet) -> Answered:
        """Some known answers with those of a model, by which its claims are compared.

        Args:
            model: model that was built.
            known: answers of the full model.
        """
        full = self.full
        problem = full.problem
        count = len(known.points)
        for column in np.unique(np.linspace(0, count - 1, min(count, MOST_SURE)).astype(int)):
            point = known.points[column]
            unknown = problem.spread.whole(known.displacements[:, column])
            attributes = (
                known.forces[:, column],
                known.active[:, column],
                0,
                Status.CONVERGED,
                False,
                full,
            )
            answer = None
            with suppress(HHRError):
                answer = model.solve(point, outside="ignore")
            yield Answer(point, unknown, *attributes), answer, problem.parameters.described(point)

    def residuals(self, answer: Answer) -> Residuals:
        """Residuals of an answer of any model: equilibrium, gaps, signs."""
        problem = self.full.problem
        theta = problem.amplitudes(answer.parameter)
        opened = problem.law.opened(answer.memory)
        return contact_residuals(
            problem.at(answer.parameter), answer.displacement(), answer.forces(), theta, opened
        )


def kind_of(full: FullModel) -> OfPoints:
    """The kind of the answers of a full model.

    Raises:
        NotOfferedError: for laws of bodies without the facet ``reduction``, and for laws of
            contacts without a plug-in that has the tool ``reduction``.
    """
    kind: Callable[[FullModel], OfPoints] = OfPoints
    if full.equilibrium is not None:
        kind = facet_of(full.equilibrium, "reduction", "a reduced model of bodies that have laws")
    elif full.law.plugin:
        kind = registry.tool("reduction", f"a reduced model of contacts with {full.law.name}")
    return kind(full)
