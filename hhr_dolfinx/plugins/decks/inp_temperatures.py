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
    found: Sequence[KeywordBlock],
    state: Sequence[Imposed],
    nodes: DeckNodes,
    bodies: Mapping[Tag, DeckMaterial],
    left: list[Left],
) -> list[DeckLoad]:
    """Thermal expansion of bodies above the temperatures of *INITIAL CONDITIONS.

    A body with different temperatures has the field of the deck, of which the load is a multiple.
    """
    given = [item.block for item in state if item.block.keyword == "TEMPERATURE"]
    if not given:
        return []
    left += _unknown(found, state, nodes)
    rise = rise_of(found, state, nodes)
    most = max(rise.values(), key=abs, default=0.0)
    final = rise_of(found, imposed_of(found), nodes)
    loads = []
    for tag, material in bodies.items():
        own = _at_corners(nodes, tag, rise)
        if not material.expansion or not own.any():
            continue
        text = f"hhr.ThermalExpansion({tag!r}, {material.expansion!r}, {{}}"
        if np.ptp(own) <= EQUAL_TEMPERATURES * np.abs(own).max():
            loads.append(DeckLoad("temperature", f"{text})", float(own[0, 0]), given[0].source))
        elif not np.allclose(own / most, _fractions(final, nodes, tag), atol=EQUAL_TEMPERATURES):
            left.append(
                given[0].left(
                    f"the distribution of the temperature of body '{tag}' changes with the steps"
                )
            )
        else:
            text += f", field=hhr.DeckTemperatures(MESH, {tag!r}))"
            loads.append(DeckLoad("temperature", text, most, given[0].source))
    return loads


def distribution(path: Path, tag: Tag) -> tuple[np.ndarray, np.ndarray]:
    """Corners of the cells of a body of a deck, (c, k, 3), and their rises over the largest of the
    deck, (c, k).
    """
    nodes = DeckNodes(flat_deck(path))
    found = blocks_of(path)[0]
    points = np.array(
        [
            [nodes.point(number) for number in one[: CORNERS[kind]]]
            for kind, one in _cells(nodes, tag)
        ]
    )
    return points, _fractions(rise_of(found, imposed_of(found), nodes), nodes, tag)


def _fractions(rise: Mapping[int, float], nodes: DeckNodes, tag: Tag) -> np.ndarray:
    """Rises at corners of cells of a body, over the largest of the deck, (c, k)."""
    most = max(rise.values(), key=abs, default=0.0)
    return _at_corners(nodes, tag, rise) / (most or 1.0)


def _at_corners(nodes: DeckNodes, tag: Tag, rise: Mapping[int, float]) -> np.ndarray:
    """Temperatures at the corners of the cells of a body, (c, k).

    In cells of second order they are those of the linear function that is nearest to the quadratic
    one, of equal mean: linear strains feel no difference, and CalculiX does so in C3D20.
    """
    cells = _cells(nodes, tag)
    if not cells:
        return np.zeros((0, 0))
    kind = cells[0][0]
    given = np.array([[rise.get(number, 0.0) for number in one] for _, one in cells])
    count = CORNERS[kind]
    ends = np.array(EDGES[kind])
    own = given[:, :count]
    middles = given[:, count : count + len(ends)]
    if middles.shape[1] < len(ends):
        return own
    near, beyond = PROJECTED[kind]
    shares = np.full((len(ends), count), beyond)
    shares[np.arange(len(ends))[:, None], ends] = near
    found: np.ndarray = own + (middles - own[:, ends].mean(axis=2)) @ shares
    return found


def _cells(nodes: DeckNodes, tag: Tag) -> list[tuple[str, list[int]]]:
    """Kinds of the cells of a body, and numbers of their nodes."""
    deck = nodes.deck
    elements = deck.element_sets.get(str(tag).upper(), deck.elements if tag == "all" else ())
    most = max((DIMENSION.get(kind, 0) for kind, _ in deck.elements.values()), default=0)
    kinds = {number: deck.elements[number][0] for number in elements if number in deck.elements}
    # a set may hold membranes on the sides of its solids too
    kinds = {number: kind for number, kind in kinds.items() if DIMENSION.get(kind) == most}
    return [(kind, deck.whole[one]) for one, kind in kinds.items()]


def rise_of(
    found: Sequence[KeywordBlock], state: Sequence[Imposed], nodes: DeckNodes
) -> dict[int, float]:
    """Temperatures above the initial ones by the number of the node.

    Of several sets with a node the last one counts.

    An amplitude multiplies the temperature itself. Without one the factor of a row multiplies the
    rise: it is the part of the step that is over. Rows of one set add up: within a step they are
    that of the step before, which fades, and the new one.
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


def _starts(found: Sequence[KeywordBlock]) -> list[KeywordBlock]:
    return [
        one for one in of_kind(found, "INITIAL CONDITIONS") if one.word("TYPE") == "TEMPERATURE"
    ]


def _unknown(
    found: Sequence[KeywordBlock], state: Sequence[Imposed], nodes: DeckNodes
) -> Iterator[Left]:
    given = [(item.block, item.row) for item in state if item.block.keyword == "TEMPERATURE"]
    for block, row in [*((one, row) for one in _starts(found) for row in one.rows), *given]:
        if not nodes.numbers(row[0]):
            yield block.left(f"'{row[0]}' is no set of nodes of the mesh")
