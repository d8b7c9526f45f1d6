"""Contact pairs of a deck, their friction, and rigid planes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hhr_dolfinx.plugins.decks.deck import Left, Pair
from hhr_dolfinx.plugins.decks.inp_steps import Block, Imposed
from hhr_dolfinx.plugins.decks.named import NamedParts

STRAIGHT = 1e-9
"""Deviation over their extent up to which the points of a rigid surface lie in a plane."""
Plane = tuple[np.ndarray, np.ndarray, np.ndarray]
"""A point of a rigid plane, its unit normal, and the motion of its reference node, (dim,) each."""


def pairs_of(found: Sequence[Block], parts: NamedParts, state: Sequence[Imposed], left: list[Left]) -> tuple[Pair, ...]:
    """Contact pairs and obstacles; parts without counterpart are left."""
    friction = _frictions(found, left)
    planes = _planes(found, parts, state)
    gaps = {(block.option("SLAVE").upper(), block.option("MASTER").upper()): block.number(block.option("VALUE"))
            for block in found if block.keyword == "CLEARANCE"}  # fmt: skip
    pairs = []
    for block in found:
        for row in block.rows if block.keyword == "CONTACT PAIR" else ():
            names = [word.upper() for word in row if word][:2]
            coefficient = friction.get(block.options.get("INTERACTION", "").upper(), 0.0)
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
            else:
                left.append(block.left(f"'{lost[0]}' is no surface with facets of the mesh, nor a rigid plane"))
    return tuple(pairs)


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
            kind = block.options.get("PRESSURE-OVERCLOSURE", "HARD").upper()
            frictions[name] = None if kind == "TIED" else frictions.get(name, 0.0)
            if kind not in ("HARD", "TIED"):
                left.append(block.left(f"PRESSURE-OVERCLOSURE={kind}: contact is hard here, surfaces do not overlap"))
    return frictions


def _planes(found: Sequence[Block], parts: NamedParts, state: Sequence[Imposed]) -> dict[str, Plane]:
    """Rigid planes by the name of their surface in capitals: straight profiles, and rigid elements in a plane."""
    dim = parts.raw.dim
    out_of_plane = np.array([[0.0, 0.0, 1.0]])
    motions: dict[str, np.ndarray] = {}
    for block in found:
        if block.keyword == "RIGID BODY":
            name = block.options.get("ANALYTICAL SURFACE", block.options.get("ELSET", "")).upper()
            motions[name] = np.zeros(dim)
            for item in state:
                follows = item.row[0].upper() == block.options.get("REF NODE", "").upper()
                if follows and item.block.keyword == "BOUNDARY" and item.component < dim:
                    motions[name][item.component] = item.factor
    planes = {}
    for block in found:
        if block.keyword != "SURFACE" or not block.rows:
            continue
        name = owner = block.option("NAME").upper()
        along = out_of_plane if dim == 2 else np.zeros((0, 3))
        points: list[list[float]] = []
        if block.options.get("TYPE", "").upper() in ("SEGMENTS", "CYLINDER"):
            if [row[0].upper() for row in block.rows] == ["START", *["LINE"] * (len(block.rows) - 1)]:
                points = [[*block.numbers(row, 1), 0.0][:3] for row in block.rows]
                along = out_of_plane
        elif block.rows[0][0].upper() in motions and parts.surface(name) is None:
            owner = block.rows[0][0].upper()
            points = _points_of(found, owner)
        plane = _plane(np.array(points), along)
        if plane is not None:
            planes[name] = plane[0][:dim], plane[1][:dim], motions.get(owner, np.zeros(dim))
    return planes


def _points_of(found: Sequence[Block], elset: str) -> list[list[float]]:
    """Coordinates of the nodes of the elements of blocks with a set."""
    numbers = {word for block in found if block.keyword == "ELEMENT" and block.options.get("ELSET", "").upper() == elset
               for row in block.rows for word in row[1:]}  # fmt: skip
    return [[*block.numbers(row, 1), 0.0, 0.0, 0.0][:3] for block in found if block.keyword == "NODE"
            for row in block.rows if row[0] in numbers]  # fmt: skip


def _plane(points: np.ndarray, along: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """A point and the unit normal of the plane through points, (n, 3), and along directions; None if there is none."""
    if len(points) < 2:
        return None
    spans = np.concatenate([points[1:] - points[0], along * np.ptp(points, axis=0).max(), np.zeros((1, 3))])
    _, sizes, axes = np.linalg.svd(spans)
    sizes = np.append(sizes, 0.0)[:3]
    return (points[0], axes[2]) if sizes[1] > STRAIGHT * sizes[0] >= sizes[2] else None
