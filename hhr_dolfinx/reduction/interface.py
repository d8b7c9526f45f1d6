"""Facet ``reduction`` of a law of interfaces: its part in the hyper-reduction."""

from __future__ import annotations

from hhr_dolfinx import registry
from hhr_dolfinx.contact.law import ContactLaw
from hhr_dolfinx.reduction.recipe import Recipe


class Reduction:
    """Base of the facet, that of unilateral contact. A law completes its forces by stages of its manifest."""

    def recipes(self) -> tuple[Recipe, ...]:
        """Default recipes for elastic bodies; each is tried if the one before leaves contact rows dependent."""
        return (Recipe(),)


_UNILATERAL = Reduction()


def reduction_of(law: ContactLaw) -> Reduction:
    """The facet of a law.

    Raises:
        NotOfferedError: if its plug-in has none: the model would leave the law out.
    """
    if not law.plugin:
        return _UNILATERAL
    found: Reduction = registry.facet(law.plugin, "reduction", f"hyper-reduction of contacts with {law.name}")
    return found
