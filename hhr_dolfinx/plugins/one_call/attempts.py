"""Models that a search tries, in their order: those with the fewest full answers come first."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from hhr_dolfinx import registry
from hhr_dolfinx.reduction.reductor import Proposal, ways

if TYPE_CHECKING:
    from hhr_dolfinx.plugins.one_call.context import SearchContext

MANY = 1000
"""Number of contact conditions above which a hyper-reduced model is tried after a condensed one of sufficient accuracy;
a heuristic, since the faster one is found by timing."""


def attempts(context: SearchContext) -> Iterator[Proposal]:
    """Models of all reductors of a scene: first those that keep all contact conditions."""
    for way in ways(context.full):
        yield from registry.load(way.place)().proposals(context)
