"""Kind of answers that depend on their path: what training, reduction and comparison do with
histories.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING

from hhr_dolfinx.certify.compare import Comparison
from hhr_dolfinx.certify.trust import TrustLimits, warn_of_few_held_out, warn_of_no_contact
from hhr_dolfinx.errors import HHRError, ReductionError
from hhr_dolfinx.models.answer import Answer, Model
from hhr_dolfinx.models.reconstruct import Reconstruction
from hhr_dolfinx.plugins.paths.compared import compared_histories, retraced
from hhr_dolfinx.reduction.kinds import Answered, OfPoints
from hhr_dolfinx.snapshots.records import SnapshotSet
from hhr_dolfinx.trained import Trained

if TYPE_CHECKING:
    from hhr_dolfinx.models.full import Checked


class OfHistories(OfPoints):
    """Answers at the steps of paths, each of which starts from the one before."""

    def trains_on(self, family: object) -> bool:
        """Points have no answers to train on."""
        return family is not None

    def check(self, name: str, solutions: SnapshotSet | None) -> SnapshotSet:
        """Refuse answers at single parameters, too.

        Args:
            name: name of the answers, for the message.
            solutions: the answers.

        Raises:
            ReductionError: for answers that are no histories.
        """
        histories = super().check(name, solutions)
        if not histories.histories:
            raise ReductionError(
                f"{name} of a scene with {self.full.law.name} must be histories: "
                "SnapshotSet.of_histories"
            )
        return histories

    def warn_of_training(self, snapshots: SnapshotSet, held_out: SnapshotSet | None) -> None:
        """A path counts as many points, and need not fill the box.

        Args:
            snapshots: training histories.
            held_out: validation histories; None without any.
        """
        warn_of_no_contact(self.full.problem, snapshots)
        warn_of_few_held_out(held_out, 0, "a history")

    def warn_of_estimates(self, fields: Reconstruction) -> None:
        """Errors are indicated."""

    def with_corners(self, model: Checked) -> Checked:
        """See :class:`OfPoints`: a point takes dozens of increments, and the full model warns."""
        return model

    def compared(
        self,
        model: Model,
        snapshots: SnapshotSet,
        held_out: SnapshotSet | None,
        limits: TrustLimits | None,
        remedy: str | Mapping[str, str],
    ) -> tuple[Comparison | None, Trained | None]:
        """Errors against known histories, and the training range.

        Args:
            model: the model.
            snapshots: training histories.
            held_out: validation histories; None without any.
            limits: limits of the errors; None for no comparison.
            remedy: advice for a model that is refused.
        """
        trained: Trained | None = getattr(model, "trained", None)
        return compared_histories(self.full, model, snapshots, held_out, limits, remedy)[0], trained

    def pairs(self, model: Model, known: SnapshotSet) -> Answered:
        """Steps of one known history, with those of a model along the same path.

        Args:
            model: the model.
            known: exact histories.
        """
        if not known.histories:
            yield from super().pairs(model, known)
        for history in known.histories[:1]:
            answers: Sequence[Answer | None] = [None] * len(history.answers)
            with suppress(HHRError):
                answers = retraced(model, history).answers
            for answer, exact in zip(answers, history.answers, strict=True):
                yield exact, answer, f"t = {exact.time:g} s of history 0"
