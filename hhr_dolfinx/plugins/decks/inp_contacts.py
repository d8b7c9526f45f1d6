"""Contact pairs of a deck, their friction, and rigid planes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hhr_dolfinx.plugins.decks.deck import Left, Pair, Tag
from hhr_dolfinx.plugins.decks.inp_steps import Imposed
from hhr_dolfinx.plugins.decks.inp_words import Block
from hhr_dolfinx.plugins.decks.named import NamedParts

STRAIGHT = 1e-9
"""Deviation over their extent up to which the points of a rigid profile lie on a line."""


@dataclass(frozen=True)
class _Interaction:
    """Friction and gap of a *SURFACE INTERACTION."""

    friction: float = 0.0
    tied: bool = False


@dataclass(frozen=True)
class _Rigid:
    """A rigid line or plane: a point and the normal, (dim,), and how far its reference node moves, (dim,)."""

    point: np.ndarray
    normal: np.ndarray
    motion: np.ndarray


def pairs_of(found: Sequence[Block], parts: NamedParts, state: Sequence[Imposed]) -> tuple[list[Pair], list[Left]]:
    """Contact pairs and obstacles, and parts without counterpart."""
    interactions, left = _interactions(found)
    planes = _planes(found, parts, state)
    clearances = {tuple(_pair_names(block)): block for block in found if block.keyword == "CLEARANCE"}
    pairs = []
    for block in found:
        for row in block.rows if block.keyword == "CONTACT PAIR" else ():
            law = interactions.get(block.options.get("INTERACTION", "").upper(), _Interaction())
            names = [word for word in row if word]
            pair = "a pair needs two surfaces" if len(names) < 2 else "it is tied"
            if len(names) > 1 and not law.tied and "TIED" not in block.options:
                pair = _pair(block, names, law.friction, parts, planes, clearances)
            if isinstance(pair, str):
                left.append(block.left(pair))
            else:
                pairs.append(pair)
    return pairs, left


def _pair_names(block: Block) -> list[str]:
    return [block.options.get(name, "").upper() for name in ("SLAVE", "MASTER")]


def _interactions(found: Sequence[Block]) -> tuple[dict[str, _Interaction], list[Left]]:
    """Friction by the name of the interaction in capitals, and laws of pressure that are not hard contact."""
    interactions: dict[str, _Interaction] = {}
    left = []
    name = ""
    for block in found:
        if block.keyword == "SURFACE INTERACTION":
            name = block.option("NAME").upper()
            interactions[name] = _Interaction()
        elif block.keyword == "FRICTION" and name and block.rows:
            interactions[name] = _Interaction(block.number(block.rows[0][0]), interactions[name].tied)
        elif block.keyword == "SURFACE BEHAVIOR" and name:
            kind = block.options.get("PRESSURE-OVERCLOSURE", "HARD").upper()
            if kind == "TIED":
                interactions[name] = _Interaction(0.0, True)
            elif kind != "HARD":
                left.append(block.left(f"PRESSURE-OVERCLOSURE={kind}: contact is hard here, surfaces do not overlap"))
    return interactions, left


def _pair(
    block: Block,
    names: Sequence[str],
    friction: float,
    parts: NamedParts,
    planes: Mapping[str, _Rigid],
    clearances: Mapping[tuple[str, ...], Block],
) -> Pair | str:
    """A pair of surfaces, or the reason why there is none."""
    rigid = [name for name in names if name.upper() in planes]
    slave, master = (parts.surface(name) for name in names[:2])
    if rigid and (slave if slave is not None else master) is not None:
        return _obstacle(block, slave if slave is not None else master, planes[rigid[0].upper()], friction, parts)
    lost = [name for name, tag in zip(names, (slave, master), strict=False) if tag is None]
    if lost:
        return f"'{lost[0]}' is no surface with facets of the mesh, nor a rigid plane"
    assert slave is not None and master is not None
    clearance = clearances.get(tuple(name.upper() for name in names[:2]))
    gap = clearance.number(clearance.option("VALUE")) if clearance is not None else 0.0
    normal = parts.flat_normal(slave)
    if normal is not None and parts.coincide(slave, master):
        text = f"hhr.NodeToNode({slave!r}, {master!r}, {normal!r}{{}})"
        return Pair(text, friction, block.source, gap, "nodes coincide")
    return Pair(f"hhr.Mortar({slave!r}, {master!r}{{}})", friction, block.source, gap)


def _obstacle(block: Block, surface: Tag | None, plane: _Rigid, friction: float, parts: NamedParts) -> Pair:
    """A rigid plane, whose motion against the body closes the gap."""
    assert surface is not None
    outward = parts.normals(surface).mean(axis=0)
    normal = plane.normal if plane.normal @ outward > 0 else -plane.normal
    text = f"hhr.Obstacle({surface!r}, {tuple((normal + 0.0).tolist())!r}, {float(plane.point @ normal)!r}{{}})"
    return Pair(text, friction, block.source, float(plane.motion @ normal))


def _planes(found: Sequence[Block], parts: NamedParts, state: Sequence[Imposed]) -> dict[str, _Rigid]:
    """Rigid planes by the name of their surface in capitals: straight profiles, and rigid elements in a plane."""
    dim = parts.raw.dim
    nodes = {int(row[0]): np.array((*block.numbers(row, 1), 0.0, 0.0, 0.0)[:3])
             for block in found if block.keyword == "NODE" for row in block.rows}  # fmt: skip
    motions = {}
    for block in found:
        if block.keyword == "RIGID BODY":
            own = [item for item in state if item.block.keyword == "BOUNDARY" and item.component < dim
                   and item.row[0].upper() == block.options.get("REF NODE", "").upper()]  # fmt: skip
            motion = np.zeros(dim)
            for item in own:
                motion[item.component] = item.factor
            name = block.options.get("ANALYTICAL SURFACE", block.options.get("ELSET", ""))
            motions[name.upper()] = motion
    planes = {}
    for block in found:
        kind = block.options.get("TYPE", "ELEMENT").upper()
        if block.keyword != "SURFACE" or parts.surface(block.option("NAME")) is not None:
            continue
        name = block.option("NAME").upper()
        if kind in ("SEGMENTS", "CYLINDER") and block.rows and block.rows[0][0].upper() == "START":
            profile = [block.numbers(row, 1)[:2] for row in block.rows if row[0].upper() in ("START", "LINE")]
            points = np.array(profile) if len(profile) == len(block.rows) else np.zeros((0, 2))
            points = np.column_stack([points, np.zeros(len(points))])
            sweep = np.array([[0.0, 0.0, 1.0]])
            owner = name
        elif kind == "ELEMENT" and block.rows and block.rows[0][0].upper() in motions:
            owner = block.rows[0][0].upper()
            points = np.array([nodes[n] for n in _nodes_of(found, owner) if n in nodes])
            sweep = np.array([[0.0, 0.0, 1.0]]) if dim == 2 else np.zeros((0, 3))
        else:
            continue
        plane = _plane(points, sweep)
        if plane is not None:
            planes[name] = _Rigid(plane[0][:dim], plane[1][:dim], motions.get(owner, np.zeros(dim)))
    return planes


def _nodes_of(found: Sequence[Block], elset: str) -> list[int]:
    """Nodes of the elements of blocks with a set."""
    return [int(word) for block in found if block.keyword == "ELEMENT"
            and block.options.get("ELSET", "").upper() == elset for row in block.rows for word in row[1:]]  # fmt: skip


def _plane(points: np.ndarray, sweep: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """A point and the unit normal of the plane through points and along a direction; None if there is none."""
    if len(points) < 2:
        return None
    along = np.concatenate([points[1:] - points[0], sweep * np.ptp(points, axis=0).max()])
    _, sizes, axes = np.linalg.svd(along)
    sizes = np.pad(sizes, (0, 3 - sizes.size)) if sizes.size < 3 else sizes
    return (points[0], axes[2]) if sizes[1] > STRAIGHT * sizes[0] >= sizes[2] else None
