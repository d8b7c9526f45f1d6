"""Curved rigid surfaces of a deck: profiles of lines and arcs in the plane, and rigid elements."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hhr_dolfinx.plugins.decks.inp_nodes import DeckNodes
from hhr_dolfinx.plugins.decks.inp_steps import Block

ARC = np.deg2rad(1.0)
"""Angle of the chords of an arc, which are within 4e-5 of its radius of it."""
MOST = 2000
"""Facets of a rigid surface that a scene file lists."""


def tool_of(block: Block, owner: str, nodes: DeckNodes, dim: int) -> str:
    """Obstacle of a rigid *SURFACE as text of Python, with ``{surface}``, ``{place}`` and ``{}`` for its friction.

    ``owner`` is the set of rigid elements of the surface, empty for an analytical one. The text is empty for a surface
    without counterpart.
    """
    if block.word("TYPE") == "SEGMENTS" and dim == 2:
        points = _profile(block)
        return _drawn(points) if len(points) > 1 else ""
    elements = [
        nodes.deck.whole[one]
        for one in nodes.deck.element_sets.get(owner, ())
        if nodes.deck.types[one].startswith("R") and one in nodes.deck.whole
    ]
    sizes = {len(one) for one in elements}
    if dim == 2 and sizes == {2}:
        line = _chain(elements)
        return _drawn(np.array([nodes.point(number)[:2] for number in line])) if line else ""
    if dim != 3 or not sizes or not sizes <= {3, 4} or len(elements) > MOST:
        return ""
    used = sorted({number for one in elements for number in one})
    index = {number: k for k, number in enumerate(used)}
    places = [tuple(nodes.point(number).tolist()) for number in used]
    facets = [[[index[number] for number in one] for one in elements if len(one) == size] for size in sorted(sizes)]
    lists = ", ".join(map(repr, (places, *facets)))
    return f"hhr.RigidMesh({{surface}}, ({lists}), place={{place}}{{}})"


def _drawn(points: np.ndarray) -> str:
    return f"hhr.Profile({{surface}}, {points.round(12).tolist()!r}, smooth=False, place={{place}}{{}})"


def _profile(block: Block) -> np.ndarray:
    """Points of a profile, (n, 2): START, then LINE with an end, or CIRCL with an end and a centre."""
    points: list[np.ndarray] = []
    for row in block.rows:
        word = row[0].upper()
        numbers = np.array([*block.numbers(row, 1), *(0.0,) * 4][:4])
        if word in ("START", "LINE"):
            points.append(numbers[:2])
        elif word == "CIRCL" and points:
            points += _arc(points[-1], numbers[:2], numbers[2:])
        else:
            return np.zeros((0, 2))
    return np.array(points)


def _arc(start: np.ndarray, end: np.ndarray, centre: np.ndarray) -> list[np.ndarray]:
    """Points of the shorter arc between two points, without the first."""
    angles = [np.arctan2(*(one - centre)[::-1]) for one in (start, end)]
    turn = (angles[1] - angles[0] + np.pi) % (2 * np.pi) - np.pi
    radius = np.linalg.norm(start - centre)
    steps = np.linspace(angles[0], angles[0] + turn, max(2, int(np.ceil(abs(turn) / ARC)) + 1))[1:]
    return [*(centre + radius * np.array([np.cos(angle), np.sin(angle)]) for angle in steps[:-1]), end]


def _chain(elements: Sequence[Sequence[int]]) -> list[int]:
    """Nodes of lines one after another, closed if the first is the last; empty if they are no single chain."""
    after: dict[int, list[int]] = {}
    for first, last in elements:
        after.setdefault(first, []).append(last)
        after.setdefault(last, []).append(first)
    ends = [number for number, others in after.items() if len(others) == 1]
    if any(len(others) > 2 for others in after.values()) or len(ends) > 2:
        return []
    chain = [ends[0] if ends else next(iter(after))]
    while True:
        onward = [one for one in after[chain[-1]] if len(chain) < 2 or one != chain[-2]]
        if not onward:
            break
        chain.append(onward[0])
        if chain[-1] == chain[0]:
            break
    return chain if len(set(chain)) == len(after) else []
