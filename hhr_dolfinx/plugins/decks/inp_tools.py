"""Curved rigid surfaces of a deck: profiles of lines and arcs, also swept and revolved in space,
and rigid elements.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hhr_dolfinx.plugins.decks.deck import Tag
from hhr_dolfinx.plugins.decks.inp_nodes import DeckNodes
from hhr_dolfinx.plugins.decks.inp_steps import KeywordBlock

ARC = np.deg2rad(1.0)
"""Angle of the chords of an arc, which are within 4e-5 of its radius of it."""
REVOLVED_FACETS = 120
"""Facets around a surface of revolution, which are within 4e-4 of its radius of it.

So are long arcs of its profile.
"""
MOST_FACETS = 8000
"""Facets of a rigid surface that a scene file lists."""


@dataclass(frozen=True)
class Tool:
    """A rigid surface as text of Python, with ``{surface}``, ``{place}`` and ``{}`` for its
    friction.

    That of a sphere has ``{inside}`` before its friction.
    """

    text: str
    origin: tuple[float, ...] = ()  #: its place where it does not move, empty for zeros
    sphere: bool = False

    def written(self, surface: Tag, points: np.ndarray, normals: np.ndarray) -> str:
        """Text for a surface of a body.

        Args:
            surface: name of the surface.
            points: midpoints of its facets, (f, dim).
            normals: their outer normals, (f, dim).
        """
        text = self.text.replace("{surface}", repr(surface))
        # a body in a hole looks away from the centre
        hole = self.sphere and ((points - self.origin) * normals).sum() > 0
        return text.replace("{inside}", ", inside=True" if hole else "")


def tool_of(block: KeywordBlock, owner: str, nodes: DeckNodes, dim: int) -> Tool | None:
    """Obstacle of a rigid *SURFACE; None for one without counterpart.

    Args:
        block: the *SURFACE.
        owner: set of rigid elements of the surface, empty for an analytical one.
        nodes: nodes of the deck by number.
        dim: dimension of the mesh, 2 or 3.
    """
    if block.word("TYPE") == "SEGMENTS" and dim == 2:
        points = _profile(block, block.rows)
        return _drawn(points) if len(points) > 1 else None
    if block.word("TYPE") in ("CYLINDER", "REVOLUTION") and dim == 3:
        return _in_space(block, nodes)
    elements = [
        nodes.deck.whole[number]
        for number in nodes.deck.element_sets.get(owner, ())
        if nodes.deck.types[number].startswith("R") and number in nodes.deck.whole
    ]
    sizes = {len(element) for element in elements}
    if dim == 2 and sizes == {2}:
        line = _chain(elements)
        return _drawn(np.array([nodes.point(number)[:2] for number in line])) if line else None
    if dim != 3 or not sizes or not sizes <= {3, 4} or len(elements) > MOST_FACETS:
        return None
    used = sorted({number for element in elements for number in element})
    index = {number: k for k, number in enumerate(used)}
    coordinates = [tuple(nodes.point(number).tolist()) for number in used]
    facets = [
        [[index[number] for number in element] for element in elements if len(element) == size]
        for size in sorted(sizes)
    ]
    return Tool(_mesh(coordinates, *facets))


def _mesh(places: Sequence[Sequence[float]], *facets: Sequence[Sequence[int]]) -> str:
    return (
        f"hhr.RigidMesh({{surface}}, ({', '.join(map(repr, (places, *facets)))}), "
        "place={place}{})"
    )


def _drawn(points: np.ndarray) -> Tool:
    return Tool(
        f"hhr.Profile({{surface}}, {points.round(12).tolist()!r}, smooth=False, "
        "place={place}{})"
    )


def _swept(rows: np.ndarray, closed: bool) -> Tool | None:
    """Facets between neighbouring rows of points, (rows, n, 3), of the last and the first too if it
    is closed.
    """
    count, n = rows.shape[:2]
    number = np.arange(count * n).reshape(count, n)
    if closed:
        number = np.vstack([number, number[:1]])
    quads = np.stack(
        [number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]], axis=-1
    ).reshape(-1, 4)
    return (
        Tool(_mesh(rows.reshape(-1, 3).round(12).tolist(), quads.tolist()))
        if len(quads) <= MOST_FACETS
        else None
    )


def _in_space(block: KeywordBlock, nodes: DeckNodes) -> Tool | None:
    """Profile that is swept along a generator, or revolved about an axis: a sphere, or facets.

    Points a, b and c before START give the axes, else they are those of the deck, and y is the axis
    of revolution.
    """
    first = next((k for k, row in enumerate(block.rows) if row[0].upper() == "START"), 0)
    axis_points = np.concatenate([np.zeros(0), *(block.numbers(row) for row in block.rows[:first])])
    revolved = block.word("TYPE") == "REVOLUTION"
    profile = _profile(block, block.rows[first:])
    if revolved and len(profile) > MOST_FACETS / REVOLVED_FACETS:
        profile = _profile(block, block.rows[first:], 2 * np.pi / REVOLVED_FACETS)
    if len(profile) < 2 or axis_points.size not in (0, 6, 9):
        return None
    origin = axis_points[:3] if axis_points.size else np.zeros(3)
    x = axis_points[3:6] - origin if axis_points.size else np.array([1.0, 0.0, 0.0])
    all_points = np.array(list(nodes.deck.nodes.values()))
    if not revolved:
        along = axis_points[6:9] - origin if axis_points.size == 9 else np.array([0.0, 0.0, -1.0])
        x /= np.linalg.norm(x)
        along /= np.linalg.norm(along)
        line = origin + profile @ [x, np.cross(x, along)]
        heights = (all_points - origin) @ along
        size = np.ptp(all_points, axis=0).max()
        ends = (heights.min() - size, heights.max() + size)
        rows = np.array([line + end * along for end in ends])
        return _swept(rows, closed=False)
    axis = x / np.linalg.norm(x) if axis_points.size else np.array([0.0, 1.0, 0.0])
    arcs = np.array(
        [block.numbers(row, 1)[2:4] for row in block.rows[first + 1 :] if row[0].upper() == "CIRCL"]
    )
    if len(arcs) == len(block.rows) - first - 1 and np.allclose(arcs, [0.0, arcs[0][1]], atol=1e-9):
        centre = origin + arcs[0][1] * axis
        radius = float(np.linalg.norm(profile[0] - arcs[0]))
        return Tool(
            f"hhr.Sphere({{surface}}, {{place}}, {radius!r}{{inside}}{{}})",
            tuple(centre.tolist()),
            True,
        )
    across = np.linalg.svd(axis[None])[2][1:]
    turns = np.linspace(0.0, 2 * np.pi, REVOLVED_FACETS, endpoint=False)
    ways = np.cos(turns)[:, None] * across[0] + np.sin(turns)[:, None] * across[1]
    rows = origin + profile[None, :, :1] * ways[:, None, :] + profile[None, :, 1:] * axis
    return _swept(rows, closed=True)


def _profile(block: KeywordBlock, rows: Sequence[Sequence[str]], chord: float = ARC) -> np.ndarray:
    """Points of a profile, (n, 2): START, then LINE with an end, or CIRCL with an end and a centre.

    ``chord`` is the angle of the chords of arcs.
    """
    points: list[np.ndarray] = []
    for row in rows:
        word = row[0].upper()
        numbers = np.array([*block.numbers(row, 1), *(0.0,) * 4][:4])
        if word in ("START", "LINE"):
            points.append(numbers[:2])
        elif word == "CIRCL" and points:
            points += _arc(points[-1], numbers[:2], numbers[2:], chord)
        else:
            return np.zeros((0, 2))
    return np.array(points)


def _arc(start: np.ndarray, end: np.ndarray, centre: np.ndarray, chord: float) -> list[np.ndarray]:
    """Points of the shorter arc between two points, without the first."""
    angles = [np.arctan2(*(point - centre)[::-1]) for point in (start, end)]
    turn = (angles[1] - angles[0] + np.pi) % (2 * np.pi) - np.pi
    radius = np.linalg.norm(start - centre)
    steps = np.linspace(
        angles[0], angles[0] + turn, max(2, int(np.ceil(abs(turn) / chord - 1e-9)) + 1)
    )[1:]
    return [
        *(centre + radius * np.array([np.cos(angle), np.sin(angle)]) for angle in steps[:-1]),
        end,
    ]


def _chain(elements: Sequence[Sequence[int]]) -> list[int]:
    """Nodes of lines one after another, closed if the first is the last.

    Empty if they are no single chain.
    """
    after: dict[int, list[int]] = {}
    for first, last in elements:
        after.setdefault(first, []).append(last)
        after.setdefault(last, []).append(first)
    ends = [number for number, neighbours in after.items() if len(neighbours) == 1]
    if any(len(neighbours) > 2 for neighbours in after.values()) or len(ends) > 2:
        return []
    chain = [ends[0] if ends else next(iter(after))]
    while True:
        onward = [
            neighbour for neighbour in after[chain[-1]] if len(chain) < 2 or neighbour != chain[-2]
        ]
        if not onward:
            break
        chain.append(onward[0])
        if chain[-1] == chain[0]:
            break
    return chain if len(set(chain)) == len(after) else []
