"""A scene from a mesh without physics: steel bodies, two surfaces that face each other, a support, a pressure."""

from __future__ import annotations

from itertools import permutations
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from hhr_dolfinx.plugins.decks.deck import Deck, Left, Load, Material, Pair, Section, Support, Tag
from hhr_dolfinx.plugins.decks.named import NamedParts

FACING = -0.5
"""Largest cosine between outer normals of two surfaces that face each other."""


def template(path: Path, parts: NamedParts) -> Deck:
    """Contents of a scene that a mesh suggests; what must be chosen is left."""
    raw = parts.raw
    steel = Material("steel in MPa and mm", path.name, 210e3, 0.3)
    bodies = parts.apart()
    left = [Left(path.name, "materials, support and pressure", "a proposal, with lengths in mm: put in your own")]
    owner = np.full(len(raw.cells), -1)
    for number, tag in enumerate(bodies):
        owner[raw.bodies[tag]] = number
    of = {name: np.unique(owner[cells]) for name in parts.surfaces if ((cells := parts.owners(name)) >= 0).all()}
    outer = {name: int(numbers[0]) for name, numbers in of.items() if numbers.size == 1}
    found = _facing(parts, outer)
    pairs: tuple[Pair, ...] = ()
    supports: list[Support] = []
    loads: tuple[Load, ...] = ()
    if found is None:
        left.append(
            Left(path.name, "contact", "no named surfaces of two bodies face each other: name a pair in contacts")
        )
    else:
        slave, master = found
        pairs = (Pair(f"hhr.Mortar({slave!r}, {master!r}{{}})", 0.0, path.name),)
        base, lid = (_far(parts, outer, name, found) for name in (master, slave))
        if base is not None:
            supports += [Support(base, k, 0.0, path.name) for k in range(raw.dim)]
        if lid is not None:
            along = int(np.abs(parts.normals(lid).mean(axis=0)).argmax())
            supports += [Support(lid, k, 0.0, f"{path.name}: no motion aside") for k in range(raw.dim) if k != along]
            loads = (Load("pressure", f"hhr.Pressure({lid!r}, {{}})", 1.0, path.name),)
        held = {outer[name] for name in (base, lid) if name is not None}
        left += [
            Left(path.name, "support", f"body {tag!r} is not held") for k, tag in enumerate(bodies) if k not in held
        ]
    hypothesis = "solid" if raw.dim == 3 else "plane_strain"
    sections = tuple(Section(tag, steel, path.name) for tag in bodies)
    return Deck(path, hypothesis, sections, tuple(supports), loads, pairs, tuple(left))


def _facing(parts: NamedParts, outer: dict[Tag, int]) -> tuple[Tag, Tag] | None:
    """The two nearest surfaces of different bodies of which the first faces the second, with the finer one first."""
    middles = {name: parts.raw.points[parts.surfaces[name]].mean(axis=1) for name in outer}
    best: tuple[float, Tag, Tag] | None = None
    for first, second in permutations(outer, 2):
        if outer[first] == outer[second]:
            continue
        distance, nearest = cKDTree(middles[second]).query(middles[first])
        cosine = np.einsum("fd,fd->f", parts.normals(first), parts.normals(second)[nearest])
        if (cosine < FACING).mean() > 0.5 and (best is None or np.median(distance) < best[0]):
            best = float(np.median(distance)), first, second
    if best is None:
        return None
    first, second = sorted(best[1:], key=lambda name: -len(middles[name]))
    return first, second


def _far(parts: NamedParts, outer: dict[Tag, int], name: Tag, pair: tuple[Tag, Tag]) -> Tag | None:
    """The surface of the same body that is farthest from a surface of a pair."""
    middle = {one: parts.raw.points[parts.surfaces[one]].mean(axis=(0, 1)) for one in outer}
    others = [one for one in outer if outer[one] == outer[name] and one not in pair
              and not np.isin(parts.nodes(one), parts.nodes(name)).any()]  # fmt: skip
    return max(others, key=lambda one: float(np.linalg.norm(middle[one] - middle[name])), default=None)
