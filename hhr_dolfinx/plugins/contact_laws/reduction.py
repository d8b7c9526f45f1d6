"""Reduction of contacts with laws: kinds of answers, of points if no law remembers, and laws
outside the RID.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, TypedDict, Unpack

import numpy as np

from hhr_dolfinx import registry
from hhr_dolfinx.certify.trust import TrustLimits
from hhr_dolfinx.contact.law import ContactLaw
from hhr_dolfinx.errors import NotOfferedError
from hhr_dolfinx.models.answer import InterfaceCompletion
from hhr_dolfinx.models.histories.steps import steps_of
from hhr_dolfinx.models.starts import KnownStatuses
from hhr_dolfinx.plugins.contact_laws.interface import Interface, ranged
from hhr_dolfinx.plugins.paths.kinds import OfHistories
from hhr_dolfinx.reduction.build import Draft
from hhr_dolfinx.reduction.kinds import OfPoints
from hhr_dolfinx.reduction.recipe import Deim, Enrich, ForceDeim, LoadNodes, Pod, Recipe, Rid
from hhr_dolfinx.snapshots.records import SnapshotSet

if TYPE_CHECKING:
    from hhr_dolfinx.models.full import FullModel
    from hhr_dolfinx.reduction.recipe import Basis, Indicator, NodeChoice

OF_STEPS = 1e-3
"""Relative error up to which single answers of laws that remember may be off of exact ones:
round-off may change the increments that lead to them.
"""


class RecipeSteps(TypedDict, total=False):
    """Steps of a recipe by name, see :class:`Recipe`."""

    basis: Basis
    nodes: tuple[NodeChoice, ...]
    domain: Rid
    enrichment: Enrich | None
    trust: TrustLimits | None
    indicator: Indicator | None
    bound: bool
    cone: bool


def of_paths(**changes: Unpack[RecipeSteps]) -> Recipe:
    """Recipe for elastic bodies with laws of contacts: slip needs more modes, and a RID with most
    contacts.
    """
    nodes = Deim(), ForceDeim(1e-4), LoadNodes()
    usual: RecipeSteps = {"basis": Pod(1e-10), "nodes": nodes, "domain": Rid(2, 4)}
    return Recipe(
        **(usual | {"enrichment": Enrich(10.0), "trust": TrustLimits.of_histories()} | changes)
    )


def completed(full: FullModel) -> tuple[ContactLaw, Callable[..., InterfaceCompletion]]:
    """The law of a full model as hyper-reduced ones solve it, by ranges or its own increments, and
    its completion.

    Raises:
        NotOfferedError: for a law without the facet ``range``, inelastic bodies with laws on
            ranges, or without a plug-in that completes forces.
    """
    law = full.law
    capability = f"hyper-reduction of contacts with {law.name}"
    complete = registry.tool("forces_outside", capability)
    if not isinstance(law, Interface) and steps_of(law).completes:
        return law, complete
    if full.equilibrium is not None:
        raise NotOfferedError(
            f"{capability}, and of inelastic bodies, is not built in: a step starts from the "
            "memory of the RID, and an answer has that of the whole contact surface alone"
        )
    interface = ranged(law, full.conditions)
    for law_range in interface.ranges:
        law_range.solver()
    return interface, complete


def complete_contacts(draft: Draft) -> None:
    """Stage of the hyper-reduction: forces and memories of laws of contacts outside the RID."""
    shared = draft.shared
    law, complete = completed(shared.full)
    fitted = complete(shared.full.problem, law, draft.sets.A_lambda, shared.snapshots.forces)
    draft.fields = replace(draft.fields, interface=fitted)


class OfContactLaws(OfPoints):
    """Answers of contacts whose laws remember nothing: they belong to points, and forces may have
    any sign.
    """

    cone = False

    def recipes(self) -> tuple[Recipe, ...]:
        """With more functions of contact nodes where contact alone holds a body, whose modes lack
        its motions.
        """
        return of_paths(), of_paths(enrichment=Enrich(2.0))

    def not_by_rows(self) -> str:
        """Fits of forces take all rows."""
        return f"contact with {self.full.law.name}"

    def require_completion(self) -> None:
        """Refuse a law without ranges, and laws on ranges of inelastic bodies."""
        completed(self.full)

    def check(self, name: str, solutions: SnapshotSet | None) -> SnapshotSet:
        """Refuse laws that hyper-reduced models cannot complete, too.

        Args:
            name: name of the answers, for messages.
            solutions: answers as a user gives them.
        """
        self.require_completion()
        return super().check(name, solutions)


class OfPaths(OfHistories, OfContactLaws):
    """Answers of elastic bodies with laws of contacts that remember."""

    @property
    def unbounded(self) -> str:
        """Errors add up along a path."""
        return f"contact with {self.full.law.name}: the error of reduced increments has no bound"

    def skipped(self, recipe: Recipe) -> Iterator[tuple[str, str]]:
        """None: forces are indicated in any case."""
        yield from ()

    def condensed_from(
        self, snapshots: SnapshotSet, held_out: SnapshotSet | None
    ) -> tuple[None, None, bool]:
        """Answers for a condensed model: none, as an increment starts from the one before.

        Outputs of displacements take fields.

        Args:
            snapshots: training answers.
            held_out: validation answers, if any.
        """
        outputs = self.full.functionals
        return (
            None,
            None,
            outputs is not None and any(functional.count for functional in outputs.items),
        )

    def statuses(
        self, snapshots: SnapshotSet | None, found: Callable[[], KnownStatuses]
    ) -> KnownStatuses:
        """Statuses of training: none.

        Args:
            snapshots: training answers.
            found: function of the training statuses, which is not called.
        """
        problem = self.full.problem
        return KnownStatuses(problem.middle[None], np.zeros((1, len(problem.gaps)), dtype=bool))

    def round_off(self, known: SnapshotSet) -> float:
        """More for single answers."""
        return super().round_off(known) if known.histories else OF_STEPS


def kind_of_contacts(full: FullModel) -> OfPoints:
    """Tool ``reduction``: the kind of the answers of elastic bodies with laws of contacts."""
    return OfPaths(full) if full.law.remembers else OfContactLaws(full)
