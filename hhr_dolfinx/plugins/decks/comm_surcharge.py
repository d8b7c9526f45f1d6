"""The rule of surcharge of code_aster: of what one keyword gives a group several times, the last
counts (U1.03.00).

Loads of different commands add up.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from hhr_dolfinx.plugins.decks.comm_commands import Command
from hhr_dolfinx.plugins.decks.deck import DeckLoad, Left, Support, Tag
from hhr_dolfinx.plugins.decks.named import NamedParts


@dataclass(frozen=True, eq=False)
class Applied:
    """Supports or loads of a factor at one group.

    Attributes:
        command: command of the factor.
        kind: keyword of the factor.
        factor: the factor.
        components: names of the numbers that the factor gives.
        covered: nodes, or facets as sorted nodes, at which they act.
        items: a support of one component, or loads, none for forces of 0.
    """

    command: Command
    kind: str
    factor: Command
    components: frozenset[str]
    covered: frozenset[int | tuple[int, ...]]
    items: tuple[Support | DeckLoad, ...]


def what_counts(applied: Sequence[Applied]) -> Iterator[Support | DeckLoad | Left]:
    """Supports and loads without those that later ones replace.

    TODO lines of those that later ones replace in part.
    """
    for position, entry in enumerate(applied):
        replaced = False
        todo: list[Left] = []
        for later in (
            successor for successor in applied[position + 1 :] if entry.covered & successor.covered
        ):
            same = later.kind == entry.kind and later.command is entry.command
            if same and later.components == entry.components and entry.covered <= later.covered:
                replaced = True
            elif clash := _clash(entry, later, same):
                todo.append(entry.factor.left(f"{entry.kind}: {clash}"))
        if not replaced:
            yield from entry.items
            yield from todo


def _clash(one: Applied, later: Applied, same: bool) -> str:
    """Sentence on a common part of two groups at which the scene has both.

    Empty if both act in code_aster too.
    """
    supports = [entry for entry in (*one.items, *later.items) if isinstance(entry, Support)]
    if len(supports) == 2:
        if (
            len({entry.component for entry in supports}) == 2
            or len({entry.value for entry in supports}) == 1
        ):
            return ""
        return (
            f"nodes of it have another displacement by {later.factor.source}: name a group "
            "without these"
        )
    if same:
        return (
            f"{later.factor.source} replaces a part of it, and here both act: name groups that "
            "have nothing in common"
        )
    return ""


def covered_by(parts: NamedParts, place: Tag, of_facets: bool) -> frozenset[int | tuple[int, ...]]:
    """Nodes of a set, or facets of a surface as sorted nodes.

    Args:
        parts: bodies, surfaces and sets of the mesh.
        place: name of the set or surface in the mesh.
        of_facets: True for facets, if the place is a surface.
    """
    if of_facets and place in parts.surfaces:
        return frozenset(tuple(row) for row in np.sort(parts.surfaces[place], axis=1).tolist())
    return frozenset(parts.nodes(place).tolist())
