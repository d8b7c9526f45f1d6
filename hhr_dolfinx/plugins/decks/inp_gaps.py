"""Gap elements of a deck between a flat side of a body and a ground that is held: rigid planes at a
distance.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hhr_dolfinx.plugins.decks.deck import Left, Pair
from hhr_dolfinx.plugins.decks.inp_nodes import DeckNodes
from hhr_dolfinx.plugins.decks.inp_steps import Imposed, KeywordBlock, of_kind
from hhr_dolfinx.plugins.decks.named import NamedParts
from hhr_dolfinx.plugins.decks.with_outside import with_sides

SAME_NODE = 1e-6
"""Distance over the size of the mesh up to which nodes coincide and lie in a plane."""


def gaps_of(
    blocks: Sequence[KeywordBlock],
    parts: NamedParts,
    nodes: DeckNodes,
    state: Sequence[Imposed],
    todo: list[Left],
) -> tuple[list[Pair], set[int]]:
    """Obstacles of gap elements; gaps without counterpart become TODO lines.

    Surfaces may be sides of bodies that the file does not name.

    Args:
        blocks: keyword blocks of the deck, in the order of its lines.
        parts: bodies, surfaces and sets of the mesh.
        nodes: nodes of the deck by number.
        state: rows of supports and loads that act.
        todo: list to which TODO lines are appended.

    Returns:
        The obstacles, and the nodes of their grounds.
    """
    pairs = []
    grounds: set[int] = set()
    held = {
        (number, imposed.component)
        for imposed in state
        if imposed.block.keyword == "BOUNDARY" and not imposed.factor
        for number in nodes.numbers(imposed.row[0])
    }
    for block in of_kind(blocks, "GAP"):
        elements = [
            tuple(int(word) for word in row[1:3])
            for elements_block in of_kind(blocks, "ELEMENT")
            if elements_block.word("TYPE").startswith("GAP")
            and elements_block.word("ELSET") == block.word("ELSET")
            for row in elements_block.rows
        ]
        of_body = [tuple(number in nodes.of_cells for number in element) for element in elements]
        ground = {number for element in elements for number in element} - nodes.of_cells
        fixed = all((number, k) in held for number in ground for k in range(parts.raw.dim))
        ends = set(of_body)
        obstacle = None
        if len(ends) == 1 and sum(next(iter(ends))) == 1 and fixed:
            obstacle = _obstacle(
                block,
                [element[of_body[0].index(True)] for element in elements],
                of_body[0][1],
                parts,
                nodes,
            )
        if obstacle is None:
            todo.append(
                block.left(
                    "no counterpart: a gap between a whole flat side of a body and a ground that "
                    "is held is read. hhr.Obstacle(SURFACE, NORMAL, OFFSET) in contacts is a "
                    "rigid plane at a distance"
                )
            )
            continue
        pairs.append(obstacle)
        grounds |= ground
        if len(block.rows[0]) > 5 and block.rows[0][5]:
            todo.append(block.left("contact is hard here: its stiffness is not read"))
    return pairs, grounds


def _obstacle(
    block: KeywordBlock,
    numbers: Sequence[int],
    towards_body: bool,
    parts: NamedParts,
    nodes: DeckNodes,
) -> Pair | None:
    """Rigid plane in front of some nodes, which are all those of one side.

    None if they are not, or not flat.
    """
    dim = parts.raw.dim
    clearance, *words = (
        [*block.numbers(block.rows[0]), *(0.0,) * 4][:4] if block.rows else (0.0,) * 4
    )
    direction = np.array(words[:dim])
    points = np.array([nodes.point(number)[:dim] for number in numbers])
    size = float(np.ptp(parts.raw.points, axis=0).max())
    if not direction.any():
        return None
    normal = direction / np.linalg.norm(direction) * (-1.0 if towards_body else 1.0) + 0.0
    heights = points @ normal
    if np.ptp(heights) > SAME_NODE * size:
        return None
    named = NamedParts(with_sides(parts.raw))
    for name in named.surfaces:
        of_side = named.raw.points[named.nodes(name)]
        off = np.linalg.norm(of_side[:, None] - points[None], axis=2).min(axis=1)
        if (
            len(of_side) == len(set(numbers))
            and off.max() <= SAME_NODE * size
            and (named.owners(name) >= 0).all()
        ):
            return named.on_plane(name, points[0] + clearance * normal, normal, 0.0, block.source)
    return None
