"""A scene from a mesh without physics: steel bodies, surfaces that face each other, supports, a
pressure, preloads.
"""

from __future__ import annotations

import re
from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import permutations
from pathlib import Path

import numpy as np

from hhr_dolfinx.errors import FileContentError
from hhr_dolfinx.full_order.free_bodies import components_of_nodes
from hhr_dolfinx.geometries.cells import outer_faces
from hhr_dolfinx.plugins.decks.deck import (
    Deck,
    DeckLoad,
    DeckMaterial,
    Left,
    Pair,
    Section,
    Support,
    Tag,
)
from hhr_dolfinx.plugins.decks.named import FLAT_SURFACE, NamedParts
from hhr_dolfinx.plugins.decks.stated import stated_in
from hhr_dolfinx.plugins.decks.with_outside import with_sides
from hhr_dolfinx.plugins.scene_checks.candidates import OuterFacets

FACING_SHARE = 0.25
"""Share of the facets of a surface that lie in front of another one from which on the two face each
other.
"""
FURTHER_PAIR = 0.1
"""Largest distance of a further pair of surfaces, over the extent of the smaller one."""
STRAIN = 1e-3
"""Shortening of a bolt over its length: half of the yield strain of a common bolt, part of which
the joint takes.
"""
BEDDING_STIFFNESS = 1e-7
"""Stiffness of a bedding that holds a loose body, over E over its extent: a slender body that bends
bears far less.
"""
PROPOSED = "a proposal for lengths in mm: replace it by your own"
STATED = (
    "a proposal for lengths in mm, which is not that of the file: replace it by what the file "
    "states in these lines"
)
NO_PAIR = "no surfaces of two bodies face each other: name a pair in contacts"
NO_SUPPORT = "no surface to hold a body at: name one in the file of the mesh"
NO_LOAD = "no surface to press, and the answer is zero: name one in the file"
HELD_NAMES = ("fixed", "clamp")
"""Beginnings of names of surfaces that are held; capitals do not matter."""
SYMMETRY_NAMES = ("symmetry",)
"""Beginnings of names of surfaces on planes of symmetry."""
PRESSED_NAMES = ("pressure",)
"""Beginnings of names of surfaces under pressure."""


def template(path: Path, mesh: NamedParts, plane: str = "plane_strain") -> Deck:
    """Contents of a scene that a mesh suggests by its names, otherwise by its positions.

    Choices that remain are TODO lines.

    Args:
        path: the mesh file. Statements beside its mesh become TODO lines.
        mesh: its contents.
        plane: hypothesis of a mesh in the plane.

    Raises:
        FileContentError: for a mesh of shells.
    """
    parts = mesh
    dim = parts.raw.dim
    if parts.raw.points.shape[1] > dim:
        raise FileContentError(
            f"{path} has cells of dimension {dim} in a space of dimension 3: shells are not "
            "supported. Mesh the volume of the bodies, and save it, in gmsh by a physical group "
            "of volumes; a plane mesh must lie across z"
        )
    source = path.name
    steel = DeckMaterial("steel in MPa and mm", source, 210e3, 0.3)
    sections = tuple(Section(tag, steel, source) for tag in parts.apart())
    stated = stated_in(path)
    todo = [
        Left(source, "materials, support and pressure", STATED if stated else PROPOSED),
        *stated,
    ]
    bolts = dict(_bolts(parts, source))
    deck = Deck(
        path,
        "solid" if dim == 3 else plane,
        sections,
        constraints=(*bolts.values(),),
        cuts=(*bolts,),
    )
    supports, loads, planes = _by_names(parts, source, todo)
    parts, pairs = _touching(mesh, supports, wider=not bolts)
    piece = _pieces(parts)
    if not pairs:
        todo.append(Left(source, "contact", NO_PAIR))
    held = {support.component for support in supports}
    if pairs and len(held) < dim and not planes:
        proposed, pressures = _by_places(parts, piece, pairs[0], source, todo, mesh.surfaces)
        along = {(piece.get(support.place), support.component) for support in supports}
        supports += [
            support
            for support in proposed
            if (piece[support.place], support.component) not in along
        ]
        loads = loads or pressures
        if not loads:
            todo.append(Left(source, "loads", NO_LOAD))
    elif not pairs and not loads:
        places = [support.place for support in supports]
        end_supports, loads = _by_ends(parts, piece, places, source)
        supports = supports or end_supports
        if not supports:
            todo.append(Left(source, "support", NO_SUPPORT))
        elif not loads:
            todo.append(Left(source, "loads", NO_LOAD))
    return replace(
        deck,
        supports=tuple(supports),
        loads=tuple(loads),
        constraints=(*deck.constraints, *planes),
        pairs=tuple(_pair(parts, *pair, source) for pair in pairs) or parts.out_of_reach(supports),
        left=tuple(todo),
        proposal=True,
        sides=parts is not mesh,
    )


def _touching(
    parts: NamedParts, supports: Sequence[Support], wider: bool
) -> tuple[NamedParts, list[tuple[Tag, Tag]]]:
    """Pairs of surfaces that face each other, and the mesh that has them: with names of sides if
    the file has too few.

    Args:
        parts: the mesh of the file.
        supports: supports, whose surfaces do not touch others.
        wider: True if sides may have names that the file does not have.
    """

    def pairs_of(mesh: NamedParts) -> list[tuple[Tag, Tag]]:
        used = {support.place for support in supports}
        piece = _pieces(mesh)
        used |= {name for name in piece if _begins(name, PRESSED_NAMES + SYMMETRY_NAMES)}
        return _facing(mesh, {name: number for name, number in piece.items() if name not in used})

    facing = pairs_of(parts)
    if facing or not wider:
        return parts, facing
    divided = NamedParts(with_sides(parts.raw))
    facing = pairs_of(divided)
    return (divided, facing) if facing or len(_pieces(parts)) < 2 else (parts, [])


def _begins(name: Tag, words: tuple[str, ...]) -> bool:
    return isinstance(name, str) and name.lower().startswith(words)


def _by_names(
    parts: NamedParts, source: str, todo: list[Left]
) -> tuple[list[Support], list[DeckLoad], list[DeckLoad]]:
    """Supports, loads and inclined planes of symmetry of outer surfaces whose names say what they
    are.
    """
    dim = parts.raw.dim
    names = [
        name for name in parts.surfaces if isinstance(name, str) and (parts.owners(name) >= 0).all()
    ]
    supports = [
        Support(name, k, 0.0, source)
        for name in names
        if _begins(name, HELD_NAMES)
        for k in range(dim)
    ]
    planes = []
    for name in (name for name in names if _begins(name, SYMMETRY_NAMES)):
        normal = parts.flat_normal(name)
        if normal is None:
            todo.append(
                Left(
                    source, name, "a surface of symmetry that is not flat: hold it by a constraint"
                )
            )
        elif np.abs(normal).max() < 1 - FLAT_SURFACE:
            text = f"hhr.DirectedDisplacement({name!r}, {tuple(normal.tolist())})"
            planes.append(DeckLoad("", text, 0.0, source))
        else:
            supports.append(Support(name, int(np.abs(normal).argmax()), 0.0, source))
    loads = [
        DeckLoad("pressure", f"hhr.Pressure({name!r}, {{}})", 1.0, source)
        for name in names
        if _begins(name, PRESSED_NAMES)
    ]
    return supports, loads, planes


def _by_places(
    parts: NamedParts,
    piece: Mapping[Tag, int],
    pair: tuple[Tag, Tag],
    source: str,
    todo: list[Left],
    named: Container[Tag],
) -> tuple[list[Support], list[DeckLoad]]:
    """Supports and a pressure on the far sides of the bodies of a contact pair, on those that the
    file names first.

    The body is pressed that has a surface with such a name, or that of the first surface of the
    pair.
    """
    slave = pair[0]
    pressed = next((piece[name] for name in piece if _begins(name, PRESSED_NAMES)), piece[slave])
    supports: list[Support] = []
    loads: list[DeckLoad] = []
    for number in sorted({piece[name] for name in pair}):
        surface, opposite = sorted(pair, key=lambda name: piece[name] != number)
        sides = [
            name
            for name in piece
            if piece[name] == number and name not in pair and not _begins(name, SYMMETRY_NAMES)
        ]
        far = _far(parts, [name for name in sides if name in named], slave) or _far(
            parts, sides, slave
        )
        far = far or _facing_away(parts, sides, opposite)
        if far is None:
            todo.append(
                Left(source, "support", f"no named surface to hold the body of {surface!r}")
            )
            continue
        along = int(np.abs(parts.normals(far).mean(axis=0)).argmax()) if number == pressed else -1
        supports += [Support(far, k, 0.0, source) for k in range(parts.raw.dim) if k != along]
        if number == pressed:
            loads = [DeckLoad("pressure", f"hhr.Pressure({far!r}, {{}})", 1.0, source)]
    return supports, loads


def _by_ends(
    parts: NamedParts, piece: Mapping[Tag, int], held: Sequence[Tag], source: str
) -> tuple[list[Support], list[DeckLoad]]:
    """Supports of each piece at its first end along the longest axis, and a pressure on the other
    end of the last.

    The ends of pieces with surfaces that are ``held`` are these.
    """
    points = parts.raw.points
    supports: list[Support] = []
    loads: list[DeckLoad] = []
    for number in sorted(set(piece.values())):
        names = [name for name in piece if piece[name] == number]
        corners = np.concatenate([points[parts.nodes(name)] for name in names])
        axis = int(np.ptp(corners, axis=0).argmax())
        end = min(
            names, key=lambda name: (name not in held, points[parts.nodes(name), axis].mean())
        )
        supports += [Support(end, k, 0.0, source) for k in range(parts.raw.dim)]
        far = _far(parts, names, end)
        loads = (
            []
            if far is None
            else [DeckLoad("pressure", f"hhr.Pressure({far!r}, {{}})", 1.0, source)]
        )
    return supports, loads


def with_springs(deck: Deck, parts: NamedParts) -> Deck:
    """Add soft springs along components that neither supports nor constraints hold.

    Laws admit no free body.

    Args:
        deck: the deck.
        parts: bodies, surfaces and sets of the mesh.
    """
    labels = components_of_nodes(len(parts.raw.points), parts.raw.cells)
    supports = [(support.place, support.component) for support in deck.supports]
    for names, text in (
        (parts.named_in(constraint.text), constraint.text) for constraint in deck.constraints
    ):
        if motion := re.match(r"hhr\.MeanMotion\(.*?, (\d)", text):
            supports += [(name, int(motion[1])) for name in names]
        elif text.startswith(("hhr.Tie", "hhr.Periodic", "hhr.Preload")):
            joined = [
                labels[parts.nodes(name)[0]]
                for name in (*names, f"{names[0]}_other")
                if name in parts.surfaces
            ]
            labels[np.isin(labels, joined)] = joined[0]
    held = {
        (number, k)
        for target, k in supports
        for number in set(labels[parts.nodes(target)].tolist())
    }
    first = {
        labels[parts.nodes(name)[0]]: name
        for pair in deck.pairs[::-1]
        for name in parts.named_in(pair.text)
    }
    springs = []
    for number, name in reversed(first.items()):
        young = max(section.material.young for section in deck.sections)
        stiffness = (
            BEDDING_STIFFNESS * young / np.ptp(parts.raw.points[labels == number], axis=0).max()
        )
        for k in (k for k in range(parts.raw.dim) if (number, k) not in held):
            text = f"hhr.Springs({name!r}, {k}, {float(f'{stiffness:.1g}')!r}, bedding=True)"
            springs.append(
                DeckLoad("springs", text, 0.0, "soft: without them contact alone holds this body")
            )
    reason = (
        "bodies must be held without contact where one has a law: soft springs are added to "
        "loads, check them"
    )
    todo = [Left(deck.pairs[0].source, "contact", reason)] if springs else []
    return replace(deck, loads=(*deck.loads, *springs), left=(*deck.left, *todo))


def _bolts(parts: NamedParts, source: str) -> Iterator[tuple[str, DeckLoad]]:
    """Flat named surfaces inside of a body, each with a shortening of the body along its normal."""
    raw = parts.raw
    for tag in parts.apart():
        cells = raw.cells[raw.bodies[tag]]
        outer = {tuple(row) for row in np.sort(outer_faces(raw.kind, cells), axis=1).tolist()}
        for name, facets in parts.surfaces.items():
            rows = np.sort(facets, axis=1).tolist()
            if (
                not isinstance(name, str)
                or not np.isin(facets, cells).all()
                or outer & set(map(tuple, rows))
            ):
                continue
            section_points = raw.points[np.unique(facets)]
            middle = section_points.mean(axis=0)
            normal = np.linalg.svd(section_points - middle)[2][-1]
            if (
                np.abs((section_points - middle) @ normal).max()
                < FLAT_SURFACE * np.ptp(section_points, axis=0).max()
            ):
                length = float(np.ptp(raw.points[np.unique(cells)] @ normal))
                shortening = float(f"{STRAIN * length:.2g}")
                reason = f"{source}: {STRAIN:.1%} of the length"
                yield name, DeckLoad("preload", f"hhr.Preload({name!r}, {{}})", shortening, reason)


def _pieces(parts: NamedParts) -> dict[Tag, int]:
    """Number of the connected piece of the mesh of each outer surface of one piece.

    Names come before numbers.
    """
    labels = components_of_nodes(len(parts.raw.points), parts.raw.cells)
    names: list[Tag] = [name for name in parts.surfaces if isinstance(name, str)]
    of = {
        name: set(labels[parts.nodes(name)].tolist())
        for name in names or parts.surfaces
        if (parts.owners(name) >= 0).all()
    }
    # gmsh writes a surface by its number, then by the name of its group: the last of equal ones
    # counts
    last = {tuple(parts.nodes(name).tolist()): name for name in of}.values()
    return {
        name: numbers.pop() for name, numbers in of.items() if len(numbers) == 1 and name in last
    }


def _facing(parts: NamedParts, piece: Mapping[Tag, int]) -> list[tuple[Tag, Tag]]:
    """Surfaces of different pieces that face each other, the finer one first: the nearest pair, and
    all near ones.
    """
    outer = OuterFacets.of(parts.raw)
    rows = {name: outer.rows(parts.surfaces[name]) for name in piece}
    size = {
        name: float(np.median(np.ptp(outer.corners[facet_rows], axis=1).max(axis=1)))
        for name, facet_rows in rows.items()
    }
    candidates: list[tuple[float, Tag, Tag]] = []
    for first, second in permutations(piece, 2):
        if piece[first] != piece[second]:
            gaps = outer.gaps(rows[first], rows[second])[:, -1]  # of middles
            facing = np.isfinite(gaps)
            if facing.mean() > FACING_SHARE:
                candidates.append((float(np.median(np.abs(gaps[facing]))), first, second))
    pairs: list[tuple[Tag, Tag]] = []
    for distance, *pair in sorted(candidates, key=lambda candidate: candidate[0]):
        extent = min(np.ptp(parts.raw.points[parts.nodes(name)], axis=0).max() for name in pair)
        if not {*pair} & {name for chosen_pair in pairs for name in chosen_pair} and (
            not pairs or distance < FURTHER_PAIR * extent
        ):
            first, second = sorted(pair, key=lambda name: size[name])
            pairs.append((first, second))
    return pairs


def _pair(parts: NamedParts, slave: Tag, master: Tag, source: str) -> Pair:
    """The contact pair, with its force as an output if the surface is flat."""
    normal = parts.flat_normal(slave)
    direction = () if normal is None else tuple((0.0 - normal).tolist())
    return replace(parts.pair(slave, master, 0.0, source), direction=direction)


def _facing_away(parts: NamedParts, names: Iterable[Tag], name: Tag) -> Tag | None:
    """The surface whose normals are most like those of a surface of another body, within 60 degrees
    of them.
    """
    normal = parts.normals(name).mean(axis=0)
    normal /= np.linalg.norm(normal)
    cosines = {surface: float(parts.normals(surface).mean(axis=0) @ normal) for surface in names}
    best = max(cosines, key=cosines.__getitem__, default=None)
    return best if best is not None and cosines[best] > 0.5 else None


def _far(parts: NamedParts, names: Iterable[Tag], name: Tag) -> Tag | None:
    """The surface that is farthest from another one, among those without common nodes."""
    points = parts.raw.points
    middle = points[parts.nodes(name)].mean(axis=0)
    candidates = [
        surface for surface in names if not np.isin(parts.nodes(surface), parts.nodes(name)).any()
    ]
    return max(
        candidates,
        key=lambda surface: np.linalg.norm(points[parts.nodes(surface)].mean(axis=0) - middle),
        default=None,
    )
