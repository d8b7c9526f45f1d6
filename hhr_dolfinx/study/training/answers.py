"""Results of a training: a full model, its answers, and their times."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from hhr_dolfinx.full_order.full import FullOrderModel
from hhr_dolfinx.models.shown import Shown, counted
from hhr_dolfinx.snapshots.records import SnapshotSet
from hhr_dolfinx.timing import StageLog


@dataclass(frozen=True, repr=False)
class TrainingAnswers(Shown):
    """A full model with the answers to train and to check reduced models.

    Attributes:
        full_order: the full model, on one rank or distributed over all.
        snapshots: training answers.
        held_out: answers for the trust check, or None.
        log: seconds of each stage.
        choice: points chosen by a greedy training, with the errors of its models; None for another training.
        read: number of answers that were read from files, whose seconds ``log`` lacks.
    """

    full_order: FullOrderModel
    snapshots: SnapshotSet
    held_out: SnapshotSet | None
    log: StageLog
    choice: Any = None
    read: int = 0

    def facts(self) -> dict[str, str]:
        """See :class:`~hhr_dolfinx.models.shown.Shown`."""
        held_out = 0 if self.held_out is None else len(self.held_out.points)
        return {
            "scene": f"scene '{self.full_order.scene.name}'",
            "answers": counted(len(self.snapshots.points), "full answer"),
            "held out": f"{held_out} held out",
            "sizes": f"{self.full_order.problem.free.size} unknowns",
            "contact": counted(self.full_order.conditions, "contact condition"),
        }
