"""Temperatures of a deck: thermal expansion of its bodies."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from hhr_dolfinx.geometries.abaqus_blocks import blocks
from hhr_dolfinx.geometries.abaqus_deck import flat_deck
from hhr_dolfinx.geometries.cells import CORNERS
from hhr_dolfinx.plugins.decks.deck import Left, Load, Material, Tag
from hhr_dolfinx.plugins.decks.inp_nodes import DeckNodes
from hhr_dolfinx.plugins.decks.inp_steps import Block, Imposed, imposed_of, of_kind

ALIKE = 1e-9
"""Difference of temperatures over the largest one up to which they are one."""


def heated_of(
    found: Sequence[Block],
    state: Sequence[Imposed],
    nodes: DeckNodes,
    bodies: Mapping[Tag, Material],
    left: list[Left],
) -> list[Load]:
    """Thermal expansion of bodies above the temperatures of *INITIAL CONDITIONS.

    A body with different temperatures has the field of the deck, of which the load is a multiple.
    """
    given = [item.block for item in state if item.block.keyword == "TEMPERATURE"]
    if not given:
        return []
    left += _unknown(found, state, nodes)
    rise = rise_of(found, state, nodes)
    most = max(rise.values(), key=abs, default=0.0)
    loads = []
    for tag, material in bodies.items():
        corners = cells_of(nodes, tag)
        own = np.array([[rise.get(number, 0.0) for number in one] for one in corners])
        if not material.expansion or not own.any():
            continue
        text = f"hhr.ThermalExpansion({tag!r}, {material.expansion!r}, {{}}"
        if np.ptp(own) <= ALIKE * np.abs(own).max():
            loads.append(Load("temperature", f"{text})", float(own[0, 0]), given[0].source))
        elif not np.allclose(own / most, _fractions(found, nodes, corners), atol=ALIKE):
            left.append(given[0].left(f"the distribution of the temperature of body '{tag}' changes with the steps"))
        else:
            text += f", field=hhr.DeckTemperatures(MESH, {tag!r}))"
            loads.append(Load("temperature", text, most, given[0].source))
    return loads


def distribution(path: Path, tag: Tag) -> tuple[np.ndarray, np.ndarray]:
    """Corners of the cells of a body of a deck, (c, k, 3), and their rises over the largest of the deck, (c, k)."""
    nodes = DeckNodes(flat_deck(path))
    found = [Block(path.name, *block) for block in blocks(path)]
    corners = cells_of(nodes, tag)
    points = np.array([[nodes.point(number) for number in one] for one in corners])
    return points, _fractions(found, nodes, corners)


def _fractions(found: Sequence[Block], nodes: DeckNodes, corners: list[list[int]]) -> np.ndarray:
    """Rises at corners of cells at the end of the last step, over the largest of the deck."""
    rise = rise_of(found, imposed_of(found), nodes)
    most = max(rise.values(), key=abs, default=0.0)
    return np.array([[rise.get(number, 0.0) for number in one] for one in corners]) / (most or 1.0)


def cells_of(nodes: DeckNodes, tag: Tag) -> list[list[int]]:
    """Numbers of the corners of the cells of a body."""
    deck = nodes.deck
    elements = deck.element_sets.get(str(tag).upper(), deck.elements if tag == "all" else ())
    kinds = {number: deck.elements[number][0] for number in elements if number in deck.elements}
    return [deck.whole[one][: CORNERS[kind]] for one, kind in kinds.items() if kind in CORNERS]


def rise_of(found: Sequence[Block], state: Sequence[Imposed], nodes: DeckNodes) -> dict[int, float]:
    """Temperatures above the initial ones by the number of the node; of several sets with a node the last one counts.

    An amplitude multiplies the temperature itself. Without one the factor of a row multiplies the rise: it is the part
    of the step that is over. Rows of one set add up: within a step they are that of the step before, which fades, and
    the new one.
    """
    initial = {
        number: block.number(row[1])
        for block in _starts(found)
        for row in block.rows
        if len(row) > 1
        for number in nodes.numbers(row[0])
    }
    rise: dict[int, float] = {}
    set_of: dict[int, str] = {}  # set of the last row of each node
    # a row with the factor 0 does not act yet
    for item in (item for item in state if item.block.keyword == "TEMPERATURE" and item.factor):
        with_amplitude = "AMPLITUDE" in item.block.options
        for number in nodes.numbers(item.row[0]):
            before = rise[number] if set_of.get(number) == item.row[0] else 0.0
            start = initial.get(number, 0.0) * (1.0 if with_amplitude else item.factor)
            rise[number] = before + item.factor * item.unit - start
            set_of[number] = item.row[0]
    return rise


def _starts(found: Sequence[Block]) -> list[Block]:
    return [one for one in of_kind(found, "INITIAL CONDITIONS") if one.word("TYPE") == "TEMPERATURE"]


def _unknown(found: Sequence[Block], state: Sequence[Imposed], nodes: DeckNodes) -> Iterator[Left]:
    given = [(item.block, item.row) for item in state if item.block.keyword == "TEMPERATURE"]
    for block, row in [*((one, row) for one in _starts(found) for row in one.rows), *given]:
        if not nodes.numbers(row[0]):
            yield block.left(f"'{row[0]}' is no set of nodes of the mesh")
