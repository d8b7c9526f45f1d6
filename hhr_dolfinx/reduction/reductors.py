"""Reductors by place, in the order in which a search tries them: those of the core, then those of plug-ins."""

from __future__ import annotations

from hhr_dolfinx import registry
from hhr_dolfinx.errors import NotOfferedError
from hhr_dolfinx.models.full import FullModel
from hhr_dolfinx.reduction.reductor import Reductor
from hhr_dolfinx.registry import Way

OWN = (
    Way("hhr_dolfinx.reduction.exact:ExactCondensation",
        lambda full: full.equilibrium is None and not full.problem.varies, condenses=True),
    Way("hhr_dolfinx.reduction.build:HyperReduction", lambda full: full.problem.reshaped is None),
)  # fmt: skip
"""Reductors of the core."""


def ways(full: FullModel) -> list[Way]:
    """Reductors for a full model, which are not loaded yet: first those that keep all contact conditions."""
    every = (*OWN, *(way for plugin in registry.installed().values() for way in plugin.reductors.values()))
    return sorted((way for way in every if way.wanted(full)), key=lambda way: not way.condenses)


def condensing(full: FullModel) -> type[Reductor]:
    """The first reductor for a full model that keeps all contact conditions.

    Raises:
        NotOfferedError: if there is none.
    """
    for way in ways(full):
        if way.condenses:
            return registry.load(way.place)
    of_what = "whose stiffness or shape depends on parameters" if full.problem.varies else "as it is"
    raise NotOfferedError(
        f"no installed reductor condenses scene '{full.scene.name}', {of_what}: it takes a plug-in that registers one"
    )
