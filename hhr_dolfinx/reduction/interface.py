"""Laws in the hyper-reduction: those of contacts, and the facet ``reduction`` of laws of bodies."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Protocol

from hhr_dolfinx import registry
from hhr_dolfinx.contact.law import ContactLaw
from hhr_dolfinx.models.answer import InterfaceCompletion
from hhr_dolfinx.models.histories.equilibrium import facet_of
from hhr_dolfinx.reduction.recipe import Recipe

if TYPE_CHECKING:
    from hhr_dolfinx.certify.compare import Comparison
    from hhr_dolfinx.certify.trust import TrustLimits
    from hhr_dolfinx.models.full import FullModel
    from hhr_dolfinx.reduction.completion import FittedLaws
    from hhr_dolfinx.snapshots.records import SnapshotSet
    from hhr_dolfinx.trained import Trained


def completed(full: FullModel) -> tuple[ContactLaw, Callable[..., InterfaceCompletion]]:
    """The law of a full model as hyper-reduced ones solve it, by ranges or its own increments, and its completion.

    Raises:
        NotOfferedError: if no plug-in reduces the law.
    """
    found: tuple[ContactLaw, Callable[..., InterfaceCompletion]] = registry.tool(
        "reduced_law", f"hyper-reduction of contacts with {full.law.name}"
    )(full)
    return found


class ReducedBodies(Protocol):
    """Reduction of bodies with laws."""

    def recipes(self) -> tuple[Recipe, ...]:
        """The usual recipes."""

    def check_given(self, full: FullModel, name: str, solutions: SnapshotSet) -> None:
        """Raise ReductionError for solutions, called ``name``, of other laws or of another mesh."""

    def fitted(self, snapshots: SnapshotSet) -> FittedLaws:
        """Fields of training, decomposed once for all attempts."""

    def checked(
        self,
        full: FullModel,
        model: object,
        snapshots: SnapshotSet,
        held_out: SnapshotSet | None,
        limits: TrustLimits | None,
        remedy: str | Mapping[str, str],
    ) -> tuple[Comparison | None, Trained | None]:
        """Errors against known histories, and the training range."""


def bodies_of(full: FullModel) -> ReducedBodies:
    """Reduction of the laws of a full model that has an equilibrium; NotOfferedError if none is built in for them."""
    assert full.equilibrium is not None
    found: ReducedBodies = facet_of(full.equilibrium, "reduction", "a reduced model")
    return found
