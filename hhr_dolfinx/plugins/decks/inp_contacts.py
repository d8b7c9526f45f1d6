"""Contact pairs of a deck, their friction, and rigid surfaces."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hhr_dolfinx.plugins.decks.deck import Left, Pair
from hhr_dolfinx.plugins.decks.inp_nodes import DeckNodes
from hhr_dolfinx.plugins.decks.inp_steps import Block, Imposed, of_kind
from hhr_dolfinx.plugins.decks.inp_tools import Tool, tool_of
from hhr_dolfinx.plugins.decks.named import NamedParts

STRAIGHT = 1e-9
"""Deviation over their extent up to which the points of a rigid surface lie in a plane."""
Plane = tuple[np.ndarray, np.ndarray, np.ndarray]
"""A point of a rigid plane, its unit normal, and the motion of its reference node, (dim,) each."""


def pairs_of(
    found: Sequence[Block], parts: NamedParts, nodes: DeckNodes, state: Sequence[Imposed], left: list[Left]
) -> tuple[Pair, ...]:
    """Contact pairs and obstacles; parts without counterpart are left."""
    friction = _frictions(found, left)
    planes, tools = _rigid(found, parts, nodes, state)
    cleared = of_kind(found, "CLEARANCE")
    gaps = {_sides(block): block.number(block.option("VALUE")) for block in cleared}
    given = {tuple(word.upper() for word in row if word)[:2] for b in of_kind(found, "CONTACT PAIR") for row in b.rows}
    left += [one.left("no pair has this slave and master") for one in cleared if _sides(one) not in given]
    pairs = []
    for block in of_kind(found, "CONTACT PAIR"):
        for row in block.rows:
            names = [word.upper() for word in row if word][:2]
            coefficient = friction.get(word := block.word("INTERACTION"), 0.0)
            if word and word not in friction:
                left.append(block.left(f"there is no *SURFACE INTERACTION '{word}', so that its friction is 0"))
            if len(names) < 2 or coefficient is None or "TIED" in block.options:
                left.append(block.left("a pair needs two surfaces" if len(names) < 2 else "no counterpart: it is tied"))
                continue
            surfaces = [parts.surface(name) for name in names]
            slave, master = surfaces
            lost = [name for name, tag in zip(names, surfaces, strict=True) if tag is None]
            deformable = slave if slave is not None else master
            if slave is not None and master is not None:
                pairs.append(parts.pair(slave, master, coefficient, block.source, gaps.get((names[0], names[1]), 0.0)))
            elif lost[0] in planes and deformable is not None:
                point, normal, motion = planes[lost[0]]
                normal = normal * np.sign(normal @ parts.normals(deformable).mean(axis=0)) + 0.0
                text = f"hhr.Obstacle({deformable!r}, {tuple(normal.tolist())}, {float(point @ normal)!r}{{}})"
                pairs.append(Pair(text, coefficient, block.source, float(motion @ normal)))
                left += _dragging(block, coefficient, motion - (motion @ normal) * normal)
            elif lost[0] in tools and deformable is not None:
                tool, motion = tools[lost[0]]
                middles = parts.raw.points[parts.surfaces[deformable]].mean(axis=1)
                text = tool.written(deformable, middles, parts.normals(deformable))
                moved = tuple(motion.tolist())
                pairs.append(Pair(text, coefficient, block.source, motion=moved, origin=tool.origin))
                left += _dragging(block, coefficient, motion)
            else:
                left.append(
                    block.left(f"'{lost[0]}' is no surface with facets of the mesh, nor a rigid surface that is read")
                )
    return tuple(pairs)


def _dragging(block: Block, friction: float, motion: np.ndarray) -> list[Left]:
    """The motion of a rigid surface with friction along itself, which is lost."""
    why = "a rigid surface that moves along the body does not drag it by friction: move the body instead"
    return [block.left(why)] if friction and motion.any() else []


def _sides(block: Block) -> tuple[str, str]:
    """Slave and master of a *CLEARANCE, in capitals."""
    return block.word("SLAVE"), block.word("MASTER")


def _frictions(found: Sequence[Block], left: list[Left]) -> dict[str, float | None]:
    """Coefficient of friction by the name of the interaction in capitals, None if it is tied."""
    frictions: dict[str, float | None] = {}
    name = ""
    for block in found:
        if block.keyword == "SURFACE INTERACTION":
            name = block.option("NAME").upper()
            frictions[name] = 0.0
        elif block.keyword == "FRICTION" and block.rows:
            frictions[name] = block.number(block.rows[0][0])
        elif block.keyword == "SURFACE BEHAVIOR":
            kind = block.word("PRESSURE-OVERCLOSURE") or "HARD"
            frictions[name] = None if kind == "TIED" else frictions.get(name, 0.0)
            if kind not in ("HARD", "TIED"):
                left.append(block.left(f"PRESSURE-OVERCLOSURE={kind}: contact is hard here, surfaces do not overlap"))
    return frictions


def is_tool(block: Block, parts: NamedParts) -> bool:
    """True for a *RIGID BODY without cells of the mesh."""
    return "NSET" not in block.options and parts.body(block.word("ELSET")) is None


def _rigid(
    found: Sequence[Block], parts: NamedParts, nodes: DeckNodes, state: Sequence[Imposed]
) -> tuple[dict[str, Plane], dict[str, tuple[Tool, np.ndarray]]]:
    """Rigid surfaces by their names in capitals: planes, and curved ones with their motions."""
    dim = parts.raw.dim
    motions: dict[str, np.ndarray] = {}
    for block in of_kind(found, "RIGID BODY"):
        if not is_tool(block, parts):
            continue
        motion = motions.setdefault(block.word("ANALYTICAL SURFACE") or block.word("ELSET"), np.zeros(dim))
        for item in state:
            if item.row[0].upper() == block.word("REF NODE") and item.moves(dim) and item.component < dim:
                motion[item.component] = item.factor
    planes = {}
    tools: dict[str, tuple[Tool, np.ndarray]] = {}
    for block in (one for one in of_kind(found, "SURFACE") if not _in_moved_part(found, one)):
        name = owner = block.option("NAME").upper()
        firsts = [row[0].upper() for row in block.rows]
        points: list[list[float]] = []
        profile = block.word("TYPE") in ("SEGMENTS", "CYLINDER", "REVOLUTION")
        if block.word("TYPE") != "REVOLUTION" and profile and firsts[:1] == ["START"] and set(firsts[1:]) == {"LINE"}:
            points = [[*[*block.numbers(row, 1), 0.0, 0.0][:2], 0.0] for row in block.rows]
        elif not profile and firsts and firsts[0] in motions and parts.surface(name) is None:
            owner = firsts[0]
            points = _points_of(found, owner)
        plane = _plane(np.array(points), sweep=profile or dim == 2)
        motion = motions.get(owner, np.zeros(dim))
        if plane is not None:
            planes[name] = plane[0][:dim], plane[1][:dim], motion
        elif (profile or owner in motions) and (tool := tool_of(block, "" if profile else owner, nodes, dim)):
            tools[name] = tool, motion
    return planes, tools


def _in_moved_part(found: Sequence[Block], surface: Block) -> bool:
    """True for an analytical surface of a part, or in an instance, that the assembly moves."""
    if not surface.word("TYPE"):
        return False
    around = [one for one in of_kind(found, "PART", "END PART", "INSTANCE", "END INSTANCE") if one.line < surface.line]
    inner = around[-1] if around else surface
    part = inner.word("NAME") if inner.keyword == "PART" else None
    instances = [one for one in of_kind(found, "INSTANCE") if one is inner or (part and one.word("PART") == part)]
    return any(any(one.numbers(row)) for one in instances for row in one.rows)


def _points_of(found: Sequence[Block], elset: str) -> list[list[float]]:
    """Coordinates of the nodes of the elements of blocks with a set."""
    elements = [row for block in of_kind(found, "ELEMENT") if block.word("ELSET") == elset for row in block.rows]
    numbers = {word for row in elements for word in row[1:]}
    nodes = [(block, row) for block in of_kind(found, "NODE") for row in block.rows if row[0] in numbers]
    return [[*block.numbers(row, 1), 0.0, 0.0, 0.0][:3] for block, row in nodes]


def _plane(points: np.ndarray, sweep: bool) -> tuple[np.ndarray, np.ndarray] | None:
    """A point and the unit normal of the plane through points, (n, 3), and along z if they are swept; else nothing."""
    if len(points) < 2:
        return None
    along = [0.0, 0.0, np.ptp(points, axis=0).max() * sweep]
    spans = np.concatenate([points[1:] - points[0], [along, along]])
    _, sizes, axes = np.linalg.svd(spans)
    return (points[0], axes[2]) if sizes[1] > STRAIGHT * sizes[0] >= sizes[2] else None
