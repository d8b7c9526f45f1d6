"""A scene from a mesh without physics: steel bodies, two surfaces that face each other, a support, a pressure."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from itertools import permutations
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from hhr_dolfinx.full_order.free_bodies import components_of_nodes
from hhr_dolfinx.plugins.decks.deck import Deck, Left, Load, Material, Section, Support, Tag
from hhr_dolfinx.plugins.decks.named import NamedParts

FACING = -0.5
"""Largest cosine between outer normals of two surfaces that face each other."""


def template(path: Path, parts: NamedParts) -> Deck:
    """Contents of a scene that a mesh suggests; what must be chosen is left."""
    dim = parts.raw.dim
    source = path.name
    steel = Material("steel in MPa and mm", source, 210e3, 0.3)
    sections = tuple(Section(tag, steel, source) for tag in parts.apart())
    left = [Left(source, "materials, support and pressure", "a proposal, with lengths in mm: put in your own")]
    hypothesis = "solid" if dim == 3 else "plane_strain"
    piece = _pieces(parts)
    found = _facing(parts, piece)
    if found is None:
        left.append(Left(source, "contact", "no named surfaces of two bodies face each other: name a pair in contacts"))
        return Deck(path, hypothesis, sections, left=tuple(left))
    slave, master = found
    supports: list[Support] = []
    loads: tuple[Load, ...] = ()
    for number in sorted(set(piece.values())):
        far = _far(parts, [name for name in piece if piece[name] == number and name not in found], slave)
        if far is None:
            left.append(Left(source, "support", f"no named surface to hold the body of {slave!r} or {master!r}"))
            continue
        along = int(np.abs(parts.normals(far).mean(axis=0)).argmax()) if number == piece[slave] else -1
        supports += [Support(far, k, 0.0, source) for k in range(dim) if k != along]
        if number == piece[slave]:
            loads = (Load("pressure", f"hhr.Pressure({far!r}, {{}})", 1.0, source),)
    pairs = (parts.pair(slave, master, 0.0, source),)
    return Deck(path, hypothesis, sections, tuple(supports), loads, pairs, tuple(left))


def _pieces(parts: NamedParts) -> dict[Tag, int]:
    """Number of the connected piece of the mesh of each outer surface of one piece; names come before numbers."""
    labels = components_of_nodes(len(parts.raw.points), parts.raw.cells)
    names: list[Tag] = [name for name in parts.surfaces if isinstance(name, str)]
    of = {
        name: set(labels[parts.nodes(name)].tolist())
        for name in names or parts.surfaces
        if (parts.owners(name) >= 0).all()
    }
    return {name: numbers.pop() for name, numbers in of.items() if len(numbers) == 1}


def _facing(parts: NamedParts, piece: Mapping[Tag, int]) -> tuple[Tag, Tag] | None:
    """The two nearest surfaces of different pieces that face each other, with the finer one first."""
    middles = {name: parts.raw.points[parts.surfaces[name]].mean(axis=1) for name in piece}
    best: tuple[float, Tag, Tag] | None = None
    for first, second in permutations(piece, 2):
        if piece[first] == piece[second]:
            continue
        distance, nearest = cKDTree(middles[second]).query(middles[first])
        cosine = np.einsum("fd,fd->f", parts.normals(first), parts.normals(second)[nearest])
        if (cosine < FACING).mean() > 0.5 and (best is None or np.median(distance) < best[0]):
            best = float(np.median(distance)), first, second
    if best is None:
        return None
    first, second = sorted(best[1:], key=lambda name: -len(middles[name]))
    return first, second


def _far(parts: NamedParts, names: Iterable[Tag], name: Tag) -> Tag | None:
    """The surface that is farthest from another one, among those without common nodes."""
    points = parts.raw.points
    middle = points[parts.nodes(name)].mean(axis=0)
    others = [one for one in names if not np.isin(parts.nodes(one), parts.nodes(name)).any()]
    return max(others, key=lambda one: np.linalg.norm(points[parts.nodes(one)].mean(axis=0) - middle), default=None)
