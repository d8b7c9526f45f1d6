"""Temperatures of a deck: thermal expansion of its bodies."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from hhr_dolfinx.geometries.abaqus_deck import flat_deck
from hhr_dolfinx.geometries.cells import CORNERS, DIMENSION, EDGES
from hhr_dolfinx.plugins.decks.deck import DeckLoad, DeckMaterial, Left, Tag
from hhr_dolfinx.plugins.decks.inp_nodes import DeckNodes
from hhr_dolfinx.plugins.decks.inp_steps import Imposed, KeywordBlock, imposed_of, of_kind
from hhr_dolfinx.plugins.decks.keywords import blocks_of

EQUAL_TEMPERATURES = 1e-9
"""Difference of temperatures over the largest one up to which they are one."""

PROJECTED = {
    "triangle": (3 / 5, -1 / 5),
    "quadrilateral": (2 / 3, 0.0),
    "tetrahedron": (8 / 15, -2 / 15),
    "hexahedron": (2 / 3, 0.0),
}
"""Values at the ends of an edge, and at other corners, of the best linear function for one that is
1 in its middle.
"""


def heated_of(
    blocks: Sequence[KeywordBlock],
    state: Sequence[Imposed],
    nodes: DeckNodes,
    bodies: Mapping[Tag, DeckMaterial],
    todo: list[Left],
) -> list[DeckLoad]:
    """Thermal expansion of bodies above the temperatures of *INITIAL CONDITIONS.

    A body with different temperatures has the field of the deck, of which the load is a multiple.

    Args:
        blocks: keyword blocks of the deck, in the order of its lines.
        state: rows of supports and loads that act.
        nodes: nodes of the deck by number.
        bodies: material of each body.
        todo: list to which TODO lines are appended.
    """
    heated = [imposed.block for imposed in state if imposed.block.keyword == "TEMPERATURE"]
    if not heated:
        return []
    todo += _unknown(blocks, state, nodes)
    rise = rise_of(blocks, state, nodes)
    most = max(rise.values(), key=abs, default=0.0)
    final = rise_of(blocks, imposed_of(blocks), nodes)
    loads = []
    for tag, material in bodies.items():
        rises = _at_corners(nodes, tag, rise)
        if not material.expansion or not rises.any():
            continue
        text = f"hhr.ThermalExpansion({tag!r}, {material.expansion!r}, {{}}"
        if np.ptp(rises) <= EQUAL_TEMPERATURES * np.abs(rises).max():
            loads.append(DeckLoad("temperature", f"{text})", float(rises[0, 0]), heated[0].source))
        elif not np.allclose(rises / most, _fractions(final, nodes, tag), atol=EQUAL_TEMPERATURES):
            todo.append(
                heated[0].left(
                    f"the distribution of the temperature of body '{tag}' changes with the steps"
                )
            )
        else:
            text += f", field=hhr.DeckTemperatures(MESH, {tag!r}))"
            loads.append(DeckLoad("temperature", text, most, heated[0].source))
    return loads


def distribution(path: Path, tag: Tag) -> tuple[np.ndarray, np.ndarray]:
    """Distribution of the temperature rise of a body of a deck.

    Args:
        path: the deck.
        tag: name of the body.

    Returns:
        Corners of its cells, (c, k, 3), and their rises over the largest of the deck, (c, k).
    """
    nodes = DeckNodes(flat_deck(path))
    blocks = blocks_of(path)[0]
    points = np.array(
        [
            [nodes.point(number) for number in numbers[: CORNERS[kind]]]
            for kind, numbers in cells_of(nodes, tag)
        ]
    )
    return points, _fractions(rise_of(blocks, imposed_of(blocks), nodes), nodes, tag)


def _fractions(rise: Mapping[int, float], nodes: DeckNodes, tag: Tag) -> np.ndarray:
    """Rises at corners of cells of a body, over the largest of the deck, (c, k)."""
    most = max(rise.values(), key=abs, default=0.0)
    return _at_corners(nodes, tag, rise) / (most or 1.0)


def _at_corners(nodes: DeckNodes, tag: Tag, rise: Mapping[int, float]) -> np.ndarray:
    """Temperatures at the corners of the cells of a body, (c, k).

    In cells of second order they are those of the linear function that is nearest to the quadratic
    one, of equal mean: linear strains feel no difference, and CalculiX does so in C3D20.
    """
    cells = cells_of(nodes, tag)
    if not cells:
        return np.zeros((0, 0))
    kind = cells[0][0]
    values = np.array([[rise.get(number, 0.0) for number in numbers] for _, numbers in cells])
    count = CORNERS[kind]
    ends = np.array(EDGES[kind])
    at_corners = values[:, :count]
    middles = values[:, count : count + len(ends)]
    if middles.shape[1] < len(ends):
        return at_corners
    near, beyond = PROJECTED[kind]
    shares = np.full((len(ends), count), beyond)
    shares[np.arange(len(ends))[:, None], ends] = near
    linear: np.ndarray = at_corners + (middles - at_corners[:, ends].mean(axis=2)) @ shares
    return linear


def cells_of(nodes: DeckNodes, tag: Tag) -> list[tuple[str, list[int]]]:
    """Kinds of the cells of a body, and numbers of their nodes.

    Args:
        nodes: nodes of the deck by number.
        tag: name of the body.
    """
    deck = nodes.deck
    elements = deck.element_sets.get(str(tag).upper(), deck.elements if tag == "all" else ())
    most = max((DIMENSION.get(kind, 0) for kind, _ in deck.elements.values()), default=0)
    kinds = {number: deck.elements[number][0] for number in elements if number in deck.elements}
    # a set may hold membranes on the sides of its solids too
    kinds = {number: kind for number, kind in kinds.items() if DIMENSION.get(kind) == most}
    return [(kind, deck.whole[index]) for index, kind in kinds.items()]


def rise_of(
    blocks: Sequence[KeywordBlock], state: Sequence[Imposed], nodes: DeckNodes
) -> dict[int, float]:
    """Temperatures above the initial ones by the number of the node.

    Of several sets with a node the last one counts.

    An amplitude multiplies the temperature itself. Without one the factor of a row multiplies the
    rise: it is the part of the step that is over. Rows of one set add up: within a step they are
    that of the step before, which fades, and the new one.

    Args:
        blocks: keyword blocks of the deck, in the order of its lines.
        state: rows of supports and loads that act.
        nodes: nodes of the deck by number.
    """
    initial = initial_of(blocks, nodes)
    rise: dict[int, float] = {}
    set_of: dict[int, str] = {}  # set of the last row of each node
    # a row with the factor 0 does not act yet
    for imposed in (
        imposed for imposed in state if imposed.block.keyword == "TEMPERATURE" and imposed.factor
    ):
        with_amplitude = "AMPLITUDE" in imposed.block.options
        for number in nodes.numbers(imposed.row[0]):
            before = rise[number] if set_of.get(number) == imposed.row[0] else 0.0
            start = initial.get(number, 0.0) * (1.0 if with_amplitude else imposed.factor)
            rise[number] = before + imposed.factor * imposed.unit - start
            set_of[number] = imposed.row[0]
    return rise


def initial_of(blocks: Sequence[KeywordBlock], nodes: DeckNodes) -> dict[int, float]:
    """Temperatures of *INITIAL CONDITIONS by the number of the node.

    Args:
        blocks: keyword blocks of the deck, in the order of its lines.
        nodes: nodes of the deck by number.
    """
    return {
        number: block.number(row[1])
        for block in _starts(blocks)
        for row in block.rows
        if len(row) > 1
        for number in nodes.numbers(row[0])
    }


def _starts(blocks: Sequence[KeywordBlock]) -> list[KeywordBlock]:
    return [
        block
        for block in of_kind(blocks, "INITIAL CONDITIONS")
        if block.word("TYPE") == "TEMPERATURE"
    ]


def _unknown(
    blocks: Sequence[KeywordBlock], state: Sequence[Imposed], nodes: DeckNodes
) -> Iterator[Left]:
    imposed_rows = [
        (imposed.block, imposed.row) for imposed in state if imposed.block.keyword == "TEMPERATURE"
    ]
    for block, row in [
        *((start_block, row) for start_block in _starts(blocks) for row in start_block.rows),
        *imposed_rows,
    ]:
        if not nodes.numbers(row[0]):
            yield block.left(f"'{row[0]}' is no set of nodes of the mesh")
