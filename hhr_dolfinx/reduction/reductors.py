"""Reductors by place, in the order in which a search tries them: those of the core, then those of plug-ins."""

from __future__ import annotations

from collections.abc import Iterator

from hhr_dolfinx import registry
from hhr_dolfinx.errors import NotOfferedError
from hhr_dolfinx.models.full import FullModel
from hhr_dolfinx.reduction.reductor import Reductor
from hhr_dolfinx.registry import Way

OWN = (
    Way("hhr_dolfinx.reduction.exact:ExactCondensation",
        lambda full: full.equilibrium is None and not full.problem.varies, condenses=True),
    Way("hhr_dolfinx.reduction.condense:Condensation",
        lambda full: full.equilibrium is None and full.problem.varies, condenses=True),
    Way("hhr_dolfinx.reduction.condense_flow:CorrectionSettings",
        lambda full: full.equilibrium is not None, condenses=True),
    Way("hhr_dolfinx.reduction.build:HyperReduction", lambda full: full.problem.reshaped is None),
)  # fmt: skip
"""Reductors of the core."""


def reductors_of(full: FullModel) -> Iterator[type[Reductor]]:
    """Reductors for a full model, each loaded when it is asked for: first those that keep all contact conditions."""
    every = [*OWN, *(way for plugin in registry.installed().values() for way in plugin.reductors.values())]
    for way in sorted(every, key=lambda way: not way.condenses):
        if way.wanted(full):
            yield registry.load(way.place)


def condensing(full: FullModel) -> type[Reductor]:
    """The first reductor for a full model that keeps all contact conditions.

    Raises:
        NotOfferedError: if there is none.
    """
    for way in (*OWN, *(way for plugin in registry.installed().values() for way in plugin.reductors.values())):
        if way.condenses and way.wanted(full):
            return registry.load(way.place)
    raise NotOfferedError(f"no installed reductor condenses scene '{full.scene.name}'")
