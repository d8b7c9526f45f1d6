"""Nodes and elements that a deck generates: *NGEN and *NFILL along straight lines, *ELGEN in rows and layers."""

from __future__ import annotations

from itertools import product

import numpy as np

from hhr_dolfinx.geometries.abaqus_blocks import Deck

GENERATED = ("NGEN", "NFILL", "ELGEN", "NCOPY", "ELCOPY", "NMAP")
"""Keywords that generate, copy or move nodes and elements."""
_CURVED = {"NGEN": ("LINE",), "NFILL": ("BIAS", "SINGULAR", "TWO STEP")}
"""Options of lines that are curved, or divided into unequal parts."""


def generate(deck: Deck, keyword: str, options: dict[str, str], rows: list[list[str]]) -> None:
    """Add the nodes or elements of a block to a deck.

    Raises:
        ValueError: for blocks that are not supported, and for nodes or elements that are not there.
    """
    named = [name for name in _CURVED.get(keyword, (keyword,)) if name in options]
    if keyword in ("NCOPY", "ELCOPY", "NMAP") or named:
        what = ", ".join(f"{name}=" for name in named) or "copies and maps"
        raise ValueError(f"{what} are not read: write the deck with all nodes and elements, as a preprocessor does")
    made: list[int] = []
    for row in rows:
        words = [word for word in row if word]
        if keyword == "NGEN":
            first, last, step = (*(int(word) for word in words[:3]), 1)[:3]
            made += _line(deck, first, last, step, (last - first) / (step or np.inf))
        elif keyword == "NFILL":
            ends = [deck.members(name.upper()) for name in words[:2]]
            if len(ends[0]) != len(ends[1]) or not ends[0]:
                raise ValueError(f"sets '{words[0]}' and '{words[1]}' have {len(ends[0])} and {len(ends[1])} nodes")
            count, step = (*(int(word) for word in words[2:4]), 1)[:2]
            for first, last in zip(*ends, strict=True):
                made += _line(deck, first, last, step, count)
        else:
            made += _copies(deck, [int(word) for word in words])
    if name := options.get("ELSET" if keyword == "ELGEN" else "NSET"):
        sets, kind = (deck.element_sets, "elset") if keyword == "ELGEN" else (deck.node_sets, "nset")
        sets.setdefault(deck.named(kind, name), []).extend(made)


def _line(deck: Deck, first: int, last: int, step: int, count: float) -> list[int]:
    """Add nodes between two nodes, which divide the line into ``count`` equal parts; all nodes on it by number."""
    if count < 1 or count != int(count) or not {first, last} <= deck.nodes.keys():
        raise ValueError(f"nodes {first} and {last} are not there, or not {step} apart in steps")
    numbers = [first + k * step for k in range(int(count))]
    places = np.linspace(deck.nodes[first], deck.nodes[last], int(count) + 1)
    deck.nodes |= dict(zip(numbers[1:], places[1:-1].tolist(), strict=True))
    return [*numbers, last]


def _copies(deck: Deck, words: list[int]) -> list[int]:
    """Add copies of an element in rows and layers: count, and increments of nodes and elements, of each direction."""
    master, *given = words
    if master not in deck.elements:
        raise ValueError(f"there is no element {master} before it")
    given += [1, 1, 1, 1, 0, 0, 1, 0, 0][len(given) :]
    kind, corners = deck.elements[master]
    numbers = []
    for index in product(*(range(given[k]) for k in (6, 3, 0))):
        node, number = (sum(i * given[k + of] for i, k in zip(index, (6, 3, 0), strict=True)) for of in (1, 2))
        numbers.append(master + number)
        deck.elements[numbers[-1]] = kind, [one + node for one in corners]
        deck.whole[numbers[-1]] = [one + node for one in deck.whole[master]]
        deck.types[numbers[-1]] = deck.types[master]
    return numbers
