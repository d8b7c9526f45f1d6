"""Bodies without common cells of files that may give a cell several materials, of which the last
counts.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.plugins.decks.deck import Tag
from hhr_dolfinx.plugins.decks.named import NamedParts


def bodies_of(
    parts: NamedParts, groups: Sequence[Sequence[Tag] | None], titles: Sequence[str]
) -> list[list[Tag]]:
    """Bodies of each group without the cells of later groups; no two of them have common cells.

    Args:
        parts: names of the mesh.
        groups: bodies of each group in the order of the file; None for all cells.
        titles: line and keyword of each group, for messages.

    Raises:
        SceneError: for cells that a group keeps and that belong to no body without cells of others,
            with its title.
    """
    bodies = parts.raw.bodies
    owner = np.full(len(parts.raw.cells), -1)
    for number, group in enumerate(groups):
        for rows in [np.arange(len(owner))] if group is None else [bodies[tag] for tag in group]:
            owner[rows] = number
    by_size = sorted(bodies, key=lambda tag: (isinstance(tag, int), -len(bodies[tag])))
    chosen_of = []
    for number, (group, title) in enumerate(zip(groups, titles, strict=True)):
        chosen = _partition(bodies, [*(group or ()), *parts.apart()], owner == number)
        chosen = (
            chosen
            if chosen is not None
            else _partition(bodies, [*(group or ()), *by_size], owner == number)
        )
        if chosen is None:
            raise SceneError(
                f"{title}: a later group replaces the material of a part of its cells, and no "
                "group of the mesh holds the others: name one"
            )
        chosen_of.append(chosen)
    return chosen_of


def _partition(
    bodies: Mapping[Tag, np.ndarray], tags: Sequence[Tag], free: np.ndarray
) -> list[Tag] | None:
    """The first bodies of a list that have only free cells and none in common.

    None if free cells remain.
    """
    free = free.copy()
    chosen = []
    for tag in tags:
        if len(bodies[tag]) and free[bodies[tag]].all():
            free[bodies[tag]] = False
            chosen.append(tag)
    return None if free.any() else chosen
