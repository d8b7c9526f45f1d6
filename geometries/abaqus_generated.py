"""Nodes and elements that a deck generates: *NGEN on lines and arcs, *NFILL on lines, *ELGEN in
rows and layers.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import product

import numpy as np

from hhr_dolfinx.geometries.abaqus_blocks import DeckContents, number_of

Arc = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]
"""Places, (n, 3), between two ends at some shares of the way, (n, 1)."""

GENERATED = ("NGEN", "NFILL", "ELGEN", "NCOPY", "ELCOPY", "NMAP")
"""Keywords that generate, copy or move nodes and elements."""
_CURVED = {"NGEN": ("SYSTEM",), "NFILL": ("BIAS", "SINGULAR", "TWO STEP")}
"""Options of lines that are divided into unequal parts, or whose centres are in another system."""


def generate(
    deck: DeckContents, keyword: str, options: dict[str, str], rows: list[list[str]]
) -> None:
    """Add the nodes or elements of a block to a deck.

    Args:
        deck: the deck that is filled.
        keyword: keyword of the block, one of :data:`GENERATED`.
        options: options of the block, by name in capitals.
        rows: words of the data lines of the block.

    Raises:
        ValueError: for blocks that are not supported, and for nodes or elements that are not there.
    """
    named = [name for name in _CURVED.get(keyword, ()) if options.get(name, "RC").upper() != "RC"]
    line = options.get("LINE", "").upper()
    named += ["LINE"] if line not in ("", "C") else []
    if keyword in ("NCOPY", "ELCOPY", "NMAP") or named:
        listed = ", ".join(f"{name}=" for name in named) or "copies and maps"
        raise ValueError(
            f"{listed} are not read: write the deck with all nodes and elements, as a preprocessor "
            "does"
        )
    numbers: list[int] = []
    for row in rows:
        words = [word for word in row if word]
        if keyword == "NGEN":
            first, last, step = (int(word or 1) for word in (*row, "", "")[:3])
            arc = _arc(deck, [*row, *("",) * 10][3:10]) if line else None
            numbers += _line(deck, first, last, step, (last - first) / (step or np.inf), arc)
        elif keyword == "NFILL":
            ends = [deck.members(name.upper()) for name in words[:2]]
            if len(ends[0]) != len(ends[1]) or not ends[0]:
                raise ValueError(
                    f"sets '{words[0]}' and '{words[1]}' have {len(ends[0])} and {len(ends[1])} "
                    "nodes"
                )
            count, step = (*(int(word) for word in words[2:4]), 1)[:2]
            for first, last in zip(*ends, strict=True):
                numbers += _line(deck, first, last, step, count)
        else:
            numbers += _copies(deck, [int(word) for word in words])
    if name := options.get("ELSET" if keyword == "ELGEN" else "NSET"):
        sets, kind = (
            (deck.element_sets, "elset") if keyword == "ELGEN" else (deck.node_sets, "nset")
        )
        sets.setdefault(deck.named(kind, name), []).extend(numbers)


def _line(
    deck: DeckContents, first: int, last: int, step: int, count: float, on_arc: Arc | None = None
) -> list[int]:
    """Add nodes between two nodes, which divide the line into ``count`` equal parts.

    All nodes on it by number.
    """
    if count < 1 or count != int(count) or not {first, last} <= deck.nodes.keys():
        raise ValueError(f"nodes {first} and {last} are not there, or not {step} apart in steps")
    numbers = [first + k * step for k in range(int(count))]
    shares = np.linspace(0.0, 1.0, int(count) + 1)[1:-1, None]
    ends = [np.array(deck.nodes[number]) for number in (first, last)]
    coordinates = (
        on_arc(ends[0], ends[1], shares) if on_arc else (1 - shares) * ends[0] + shares * ends[1]
    )
    deck.nodes |= dict(zip(numbers[1:], coordinates.tolist(), strict=True))
    return [*numbers, last]


def _arc(deck: DeckContents, given: list[str]) -> Arc:
    """Arc about a centre, which is a node or three coordinates.

    ValueError for one that needs its normal.
    """
    if any(given[4:]):
        raise ValueError(
            "arcs of 180 degrees and more, with a normal, are not read: divide them in two"
        )
    if given[0] and int(given[0]) not in deck.nodes:
        raise ValueError(f"there is no node {given[0]} before it")
    centre = np.array(
        deck.nodes[int(given[0])] if given[0] else [number_of(word) for word in given[1:4]]
    )

    def places(start: np.ndarray, end: np.ndarray, shares: np.ndarray) -> np.ndarray:
        """Points at ``shares`` of the way, (n, 1), from ``start`` to ``end``; raises ValueError
        without a plane.
        """
        radii = [float(np.linalg.norm(point - centre)) for point in (start, end)]
        angle = np.arccos((start - centre) @ (end - centre) / (radii[0] * radii[1] or np.nan))
        if not 1e-6 < angle < np.pi - 1e-6:
            raise ValueError(
                f"an arc from {start.tolist()} to {end.tolist()} has no plane about "
                f"{centre.tolist()}"
            )
        point = np.sin((1 - shares) * angle) / np.sin(angle) * (start - centre) / radii[0]
        second = np.sin(shares * angle) / np.sin(angle) * (end - centre) / radii[1]
        return centre + ((1 - shares) * radii[0] + shares * radii[1]) * (point + second)

    return places


def _copies(deck: DeckContents, words: list[int]) -> list[int]:
    """Add copies of an element in rows and layers: count, and increments of nodes and elements, of
    each direction.
    """
    master, *counts = words
    if master not in deck.elements:
        raise ValueError(f"there is no element {master} before it")
    counts += [1, 1, 1, 1, 0, 0, 1, 0, 0][len(counts) :]
    kind, corners = deck.elements[master]
    numbers = []
    for index in product(*(range(counts[k]) for k in (6, 3, 0))):
        node, number = (
            sum(i * counts[k + of] for i, k in zip(index, (6, 3, 0), strict=True)) for of in (1, 2)
        )
        numbers.append(master + number)
        deck.elements[numbers[-1]] = kind, [corner + node for corner in corners]
        deck.whole[numbers[-1]] = [corner + node for corner in deck.whole[master]]
        deck.types[numbers[-1]] = deck.types[master]
    return numbers
