"""Models that a search may try. A reductor with a method ``proposals(search)`` says them itself."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

from hhr_dolfinx.reduction.kinds import kind_of
from hhr_dolfinx.reduction.reductor import Reductor, Task, made

if TYPE_CHECKING:
    from hhr_dolfinx.models.condensed import CondensedModel
    from hhr_dolfinx.models.model import KeptModel
    from hhr_dolfinx.plugins.one_call.context import SearchContext

POINT_COUNTS = (32, 64, 128, 256, 512)
PATHS = (8, 16, 32)
"""Training points and paths of the models that a search tries.

Each training has twice as many as the one before.
"""


@dataclass(frozen=True)
class Proposal:
    """A model that a search may try, and its row in the table."""

    method: str
    setting: str
    make: Callable[[], KeptModel]
    spared: Callable[[], KeptModel] | None = (
        None  # makes one without bound, if the budget ends at fields or bound
    )


def proposals_of(reductor: Reductor, search: SearchContext) -> Iterator[Proposal]:
    """Models of a reductor that a search may try.

    Args:
        reductor: the reductor.
        search: the search.
    """
    from hhr_dolfinx.reduction.exact import ExactCondensation

    user_proposals: Callable[[SearchContext], Iterator[Proposal]] | None = getattr(
        reductor, "proposals", None
    )
    if user_proposals is not None:
        yield from user_proposals(search)
    elif isinstance(reductor, ExactCondensation):
        yield Proposal(reductor.method, "exact", partial(_exact, search))
    elif kind_of(search.full).trains_on(search.family):
        yield from of_more_answers(reductor, search)


def of_more_answers(reductor: Reductor, search: SearchContext) -> Iterator[Proposal]:
    """Models trained on more and more points, or paths.

    Args:
        reductor: the reductor.
        search: the search.
    """
    kind, counts = ("points", POINT_COUNTS) if search.family is None else ("paths", PATHS)
    for count in counts:
        yield Proposal(
            reductor.method, f"{count} training {kind}", partial(search.reduced, reductor, count)
        )


def _exact(search: SearchContext) -> CondensedModel:
    """One model, which needs no training."""
    from hhr_dolfinx.reduction.exact import ExactCondensation

    search.announce("exact condensation", 0.0)
    return made(ExactCondensation(search.target.needs_fields), Task(search.full, sure=0))
