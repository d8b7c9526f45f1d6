"""The rule of surcharge of code_aster: of what one keyword gives a group several times, the last counts (U1.03.00).

Loads of different commands add up.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.plugins.decks.comm_commands import Command
from hhr_dolfinx.plugins.decks.deck import Left, Load, Support, Tag
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
    items: tuple[Support | Load, ...]


def what_counts(applied: Sequence[Applied]) -> Iterator[Support | Load | Left]:
    """Supports and loads without those that later ones replace; TODO lines of those that later ones replace in part."""
    for position, one in enumerate(applied):
        replaced = False
        left: list[Left] = []
        for later in (two for two in applied[position + 1 :] if one.covered & two.covered):
            same = later.kind == one.kind and later.command is one.command
            if same and later.components == one.components and one.covered <= later.covered:
                replaced = True
            elif clash := _clash(one, later, same):
                left.append(one.factor.left(f"{one.kind}: {clash}"))
        if not replaced:
            yield from one.items
            yield from left


def _clash(one: Applied, later: Applied, same: bool) -> str:
    """Sentence on a common part of two groups at which the scene has both; empty if both act in code_aster too."""
    supports = [item for item in (*one.items, *later.items) if isinstance(item, Support)]
    if len(supports) == 2:
        if len({item.component for item in supports}) == 2 or len({item.value for item in supports}) == 1:
            return ""
        return f"nodes of it have another displacement by {later.factor.source}: name a group without these"
    if same:
        return (
            f"{later.factor.source} replaces a part of it, and here both act: name groups that have nothing in common"
        )
    return ""


def covered_by(parts: NamedParts, place: Tag, of_facets: bool) -> frozenset[int | tuple[int, ...]]:
    """Nodes of a set, or facets of a surface as sorted nodes."""
    if of_facets and place in parts.surfaces:
        return frozenset(tuple(row) for row in np.sort(parts.surfaces[place], axis=1).tolist())
    return frozenset(parts.nodes(place).tolist())


def bodies_of(parts: NamedParts, groups: Mapping[Command, Sequence[Tag]]) -> Iterator[tuple[Tag, Command]]:
    """Bodies without common cells, each with the last factor that has its cells.

    Args:
        parts: names of the mesh.
        groups: bodies of each factor in the order of the file; none for a factor that has all cells.

    Raises:
        SceneError: for cells of a factor that belong to no body of its own.
    """
    bodies = parts.raw.bodies
    owner = np.full(len(parts.raw.cells), -1)
    for number, tags in enumerate(groups.values()):
        for rows in [bodies[tag] for tag in tags] or [np.arange(len(owner))]:
            owner[rows] = number
    by_size = sorted(bodies, key=lambda tag: (isinstance(tag, int), -len(bodies[tag])))
    for number, (factor, tags) in enumerate(groups.items()):
        chosen = _partition(bodies, [*tags, *parts.apart()], owner == number)
        chosen = chosen if chosen is not None else _partition(bodies, [*tags, *by_size], owner == number)
        if chosen is None:
            raise SceneError(
                f"{factor.source} AFFE_MATERIAU: a later group replaces the material of a part of its cells, and no "
                "group holds the others: name one in the mesh"
            )
        yield from ((tag, factor) for tag in chosen)


def _partition(bodies: Mapping[Tag, np.ndarray], tags: Sequence[Tag], free: np.ndarray) -> list[Tag] | None:
    """The first bodies of a list that have only free cells and none in common; None if free cells remain."""
    free = free.copy()
    chosen = []
    for tag in tags:
        if len(bodies[tag]) and free[bodies[tag]].all():
            free[bodies[tag]] = False
            chosen.append(tag)
    return None if free.any() else chosen
