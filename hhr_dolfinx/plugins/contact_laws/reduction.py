"""Laws of contacts in hyper-reduced models: by ranges, or by their own increments."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from hhr_dolfinx import registry
from hhr_dolfinx.contact.law import ContactLaw
from hhr_dolfinx.errors import NotOfferedError
from hhr_dolfinx.models.answer import InterfaceCompletion
from hhr_dolfinx.models.histories.steps import steps_of
from hhr_dolfinx.plugins.contact_laws.interface import Interface, ranged

if TYPE_CHECKING:
    from hhr_dolfinx.models.full import FullModel


def completed(full: FullModel) -> tuple[ContactLaw, Callable[..., InterfaceCompletion]]:
    """The law of a full model as hyper-reduced ones solve it, by ranges or its own increments, and its completion.

    Raises:
        NotOfferedError: for a law without the facet ``range``, inelastic bodies with laws on ranges, or without a
            plug-in that completes forces.
    """
    law = full.law
    what = f"hyper-reduction of contacts with {law.name}"
    complete = registry.tool("forces_outside", what)
    if not isinstance(law, Interface) and steps_of(law).completes:
        return law, complete
    if full.equilibrium is not None:
        raise NotOfferedError(
            f"{what}, and of inelastic bodies, is not built in: a step starts from the memory of the RID, and an "
            "answer has that of the whole contact surface alone"
        )
    found = ranged(law, full.conditions)
    for part in found.ranges:
        part.solver()
    return found, complete
