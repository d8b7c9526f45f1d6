"""Stages of hyper-reduction that a plug-in adds for bodies with laws: its facet ``stages``."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol

from hhr_dolfinx.models.histories.equilibrium import facet_of

if TYPE_CHECKING:
    import numpy as np

    from hhr_dolfinx.certify.compare import Comparison
    from hhr_dolfinx.certify.trust import TrustLimits
    from hhr_dolfinx.contact.problem import IndexSets
    from hhr_dolfinx.models.full import FullModel
    from hhr_dolfinx.models.reduced import ReducedLaws, ReducedModel
    from hhr_dolfinx.reduction.completion import FittedLaws
    from hhr_dolfinx.reduction.recipe import Recipe, Tangents
    from hhr_dolfinx.snapshots.records import SnapshotSet
    from hhr_dolfinx.trained import Trained


class Stages(Protocol):
    """Stages of the reduction of bodies with laws."""

    def recipe(self) -> Recipe:
        """The usual recipe."""

    def check_given(self, full: FullModel, name: str, solutions: SnapshotSet) -> None:
        """Raise ReductionError for solutions, called ``name``, of other laws or of another mesh."""

    def tangents(self, full: FullModel, snapshots: SnapshotSet, step: Tangents) -> list[Any]:
        """Tangents at training states, which :meth:`margin` takes."""

    def fitted(self, snapshots: SnapshotSet) -> FittedLaws:
        """Fields of training, decomposed once for all attempts."""

    def projected(self, full: FullModel, basis: np.ndarray, sets: IndexSets) -> ReducedLaws:
        """Laws on the RID, for a basis, (N, ell)."""

    def margin(self, model: ReducedModel, tangents: list[Any], least: float, layers: int) -> float:
        """Smallest margin of the projected tangents.

        Raises:
            UnstableModelError: if it is below ``least``.
        """

    def checked(
        self,
        full: FullModel,
        model: ReducedModel,
        snapshots: SnapshotSet,
        held_out: SnapshotSet | None,
        limits: TrustLimits | None,
    ) -> tuple[Comparison | None, Trained | None]:
        """Errors against known histories, and the training range."""


def stages_of(full: FullModel) -> Stages:
    """Stages for the laws of a full model that has an equilibrium.

    Raises:
        NotOfferedError: if hyper-reduction is not built in for them.
    """
    assert full.equilibrium is not None
    found: Stages = facet_of(full.equilibrium, "stages", "hyper-reduction")
    return found
