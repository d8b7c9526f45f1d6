"""Ties and cyclic symmetry of a deck, and sections of preloaded bolts."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from hhr_dolfinx.errors import FileContentError
from hhr_dolfinx.plugins.constraints.cut import cut
from hhr_dolfinx.plugins.constraints.equations import COINCIDENT_NODES, Periodic
from hhr_dolfinx.plugins.decks.deck import DeckLoad, Left, Tag
from hhr_dolfinx.plugins.decks.inp_nodes import DeckNodes
from hhr_dolfinx.plugins.decks.inp_steps import Imposed, KeywordBlock, of_kind
from hhr_dolfinx.plugins.decks.named import NamedParts
from hhr_dolfinx.plugins.scene_checks.candidates import OuterFacets

ROUNDED = 1e-4
"""Distance of nodes over the size of the mesh up to which they coincide: some decks have five
digits.
"""
TILTED = 1.0
"""Angle in degrees up to which a normal is that of a section: decks have few digits."""


class BoltSection(NamedTuple):
    """Section of a preloaded bolt: its block, the surface, and the sign of loads that draw its
    sides together.
    """

    block: KeywordBlock
    name: str
    sign: float


def tied_pairs(blocks: Sequence[KeywordBlock]) -> list[KeywordBlock]:
    """Contact pairs whose surfaces neither open nor slide: those with TIED, and those of CalculiX
    whose *SURFACE BEHAVIOR is TIED.

    Args:
        blocks: keyword blocks of the deck, in the order of its lines.
    """
    tied = set()
    name = ""
    for block in of_kind(blocks, "SURFACE INTERACTION", "SURFACE BEHAVIOR"):
        if block.keyword == "SURFACE INTERACTION":
            name = block.word("NAME")
        elif name and block.word("PRESSURE-OVERCLOSURE") == "TIED":
            tied.add(name)
    return [
        block
        for block in of_kind(blocks, "CONTACT PAIR")
        if "TIED" in block.options or block.word("INTERACTION") in tied
    ]


def ties_of(blocks: Sequence[KeywordBlock], parts: NamedParts, todo: list[Left]) -> list[DeckLoad]:
    """Ties and periodic surfaces; those without counterpart become TODO lines.

    Args:
        blocks: keyword blocks of the deck, in the order of its lines.
        parts: bodies, surfaces and sets of the mesh.
        todo: list to which TODO lines are appended.
    """
    ties = []
    models = of_kind(blocks, "CYCLIC SYMMETRY MODEL")
    for block in (*of_kind(blocks, "TIE"), *tied_pairs(blocks)):
        for row in block.rows:
            names = [word for word in row if word][:2]
            if len(names) < 2:
                todo.append(block.left("no counterpart: a tie of two surfaces is read"))
            elif "CYCLIC SYMMETRY" in block.options:
                matching = [
                    model for model in models if model.word("TIE") in ("", block.word("NAME"))
                ]
                text = (
                    _periodic(names, matching[0], parts)
                    if matching
                    else "it has no *CYCLIC SYMMETRY MODEL"
                )
                if text.startswith("hhr"):
                    ties.append(DeckLoad("", text, 0.0, block.source))
                else:
                    todo.append(block.left(text))
            else:
                slave, master = (parts.surface(name) for name in names)
                if slave is None or master is None:
                    todo.append(
                        block.left(
                            f"'{names[slave is not None]}' is no surface with facets of the mesh"
                        )
                    )
                else:
                    ties.append(DeckLoad("", f"hhr.Tie({slave!r}, {master!r})", 0.0, block.source))
                    todo += _beyond(block, slave, master, parts)
    return ties


def _beyond(block: KeywordBlock, slave: Tag, master: Tag, parts: NamedParts) -> list[Left]:
    """Tied nodes beyond the tolerance of a deck, which it leaves free."""
    if "POSITION TOLERANCE" not in block.options:
        return []
    outer = OuterFacets.of(parts.raw)
    gaps = outer.gaps(*(outer.rows(parts.surfaces[name]) for name in (slave, master)))[:, :-1]
    far = np.abs(gaps[np.isfinite(gaps)]).max(initial=0.0)
    tolerance = block.number(block.options["POSITION TOLERANCE"])
    reason = f"POSITION TOLERANCE={tolerance:g}: nodes up to {far:g} apart are tied, too"
    return [block.left(reason)] if far > tolerance else []


def _periodic(names: Sequence[str], model: KeywordBlock, parts: NamedParts) -> str:
    """Text of a periodic pair of surfaces, or the reason why it has no counterpart."""
    targets = [parts.place(name) for name in names]
    follower, leader = targets
    if follower is None or leader is None:
        return f"'{names[follower is not None]}' is no set of nodes of the mesh"
    dim = parts.raw.dim
    ends = (
        np.array([*model.numbers(model.rows[0]), *(0.0,) * 6][:6]).reshape(2, 3)
        if model.rows
        else np.zeros((2, 3))
    )
    along = ends[1] - ends[0]
    axis = int(np.abs(along).argmax())
    off = np.delete(ends, axis, axis=1)
    if (
        not along.any()
        or np.abs(off).max() > COINCIDENT_NODES * np.abs(along).max()
        or (dim == 2 and axis != 2)
    ):
        return "its axis is not an axis of the mesh through the origin"
    follower_points, leader_points = (
        parts.raw.points[parts.nodes(target)] for target in (follower, leader)
    )
    size = np.ptp(parts.raw.points, axis=0).max()
    for sign in (1.0, -1.0):
        angle = sign * 2 * np.pi / model.number(model.option("N"))
        turn = Periodic(follower, leader, angle=angle, axis=axis).turn(dim)
        far = cKDTree(leader_points @ turn.T).query(follower_points)[0].max() / size
        if far <= ROUNDED:
            more = f", tolerance={ROUNDED!r}" if far > COINCIDENT_NODES else ""
            return f"hhr.Periodic({follower!r}, {leader!r}, angle={angle!r}, axis={axis}{more})"
    return "nodes of its surfaces, turned by the angle, do not coincide"


def sections_of(
    blocks: Sequence[KeywordBlock], parts: NamedParts, nodes: DeckNodes, todo: list[Left]
) -> tuple[list[BoltSection], NamedParts]:
    """Sections of preloaded bolts, and the mesh that is cut there.

    Args:
        blocks: keyword blocks of the deck, in the order of its lines.
        parts: bodies, surfaces and sets of the mesh.
        nodes: nodes of the deck by number.
        todo: list to which TODO lines are appended.
    """
    sections: list[BoltSection] = []
    for block in of_kind(blocks, "PRE-TENSION SECTION"):
        name = parts.surface(block.word("SURFACE")) if "SURFACE" in block.options else None
        if not isinstance(name, str):
            todo.append(
                block.left("no counterpart: its SURFACE= is no surface with facets of the mesh")
            )
            continue
        corners = parts.raw.points[parts.surfaces[name]].reshape(-1, parts.raw.dim)
        sign = _sign(block, corners.mean(axis=0), nodes)
        off = _off(block, corners)
        try:
            parts = NamedParts(cut(parts.raw, name))
        except FileContentError as error:
            todo.append(block.left(f"the mesh cannot be cut there: {error}"))
            continue
        sections.append(BoltSection(block, name, sign))
        if off > TILTED:
            todo.append(
                block.left(
                    f"its normal is {off:.2g} degrees off that of its section, which counts here"
                )
            )
    return sections, parts


def _off(block: KeywordBlock, corners: np.ndarray) -> float:
    """Angle between the normal that a section is given and that of its corners, (n, dim), in
    degrees; 0 without one.
    """
    stated = np.array(
        [*(block.numbers(block.rows[0]) if block.rows else ()), 0.0, 0.0, 0.0][: corners.shape[1]]
    )
    if not stated.any():
        return 0.0
    normal = np.linalg.svd(corners - corners.mean(axis=0), full_matrices=False)[2][-1]
    return float(np.rad2deg(np.arccos(min(abs(stated @ normal) / np.linalg.norm(stated), 1.0))))


def _sign(block: KeywordBlock, middle: np.ndarray, nodes: DeckNodes) -> float:
    """Sign of the loads of a section around a point, (dim,): its normal may point into the elements
    of its surface.

    CalculiX then draws the sides apart by positive loads.
    """
    deck = nodes.deck
    words = [word for word, _ in deck.faces.get(block.word("SURFACE"), ())]
    owners = [
        int(word) if word.isdigit() else deck.element_sets.get(word.upper(), [0])[0]
        for word in words[:1]
    ]
    if not block.rows or not owners or owners[0] not in deck.elements:
        return 1.0
    element_centre = np.mean([deck.nodes[node] for node in deck.elements[owners[0]][1]], axis=0)
    normal = np.array([*block.numbers(block.rows[0]), 0.0, 0.0, 0.0][: middle.size])
    return -1.0 if (middle - element_centre[: middle.size]) @ normal < 0 else 1.0


def preloads_of(
    sections: Sequence[BoltSection],
    state: Sequence[Imposed],
    nodes: DeckNodes,
    thickness: float,
    todo: list[Left],
) -> tuple[list[Imposed], list[DeckLoad], list[DeckLoad]]:
    """Constraints of the sections of bolts, and forces in bolts.

    Args:
        sections: sections of the bolts.
        state: rows of supports and loads that act.
        nodes: nodes of the deck by number.
        thickness: thickness of plane bodies, a length; forces are divided by it.
        todo: list to which TODO lines are appended.

    Returns:
        Supports and loads on other nodes, constraints, and forces.
    """
    pilots = {nodes.single(section.block.word("NODE")): section.name for section in sections}
    by_name: dict[str, list[Imposed]] = {section.name: [] for section in sections}
    remaining = []
    for row in state:
        of_node = row.block.keyword in ("BOUNDARY", "CLOAD") and nodes.single(row.row[0]) in pilots
        if not of_node or nodes.single(row.row[0]) is None:
            remaining.append(row)
        elif row.component == 0:
            by_name[pilots[nodes.single(row.row[0])]].append(row)
    constraints = []
    forces = []
    for block, name, sign in sections:
        drawn = [row for row in by_name[name] if row.block.keyword == "CLOAD" and row.factor]
        # a bolt that is FIXED after a force drew it keeps the force: its length then is not known
        # here
        acting = [row for row in by_name[name] if not (drawn and "FIXED" in row.block.options)]
        imposed = [row for row in acting if row.block.keyword == "BOUNDARY"]
        if imposed:
            # a shortening of 0 has an amplitude, too
            text = (
                f"hhr.Preload({name!r}, {{}})"
                if imposed[-1].factor
                else f"hhr.Preload({name!r}, 0.0)"
            )
            constraints.append(
                DeckLoad("shortening", text, sign * imposed[-1].factor, imposed[-1].block.source)
            )
        else:
            constraints.append(DeckLoad("", f"hhr.ForcedSection({name!r})", 0.0, block.source))
        for row in () if imposed else drawn:
            text = f"hhr.BoltForce({name!r}, {{}})"
            forces.append(
                DeckLoad("preload", text, sign * row.factor / thickness, row.block.source)
            )
        if imposed and drawn:
            todo.append(drawn[-1].block.left("its section has a shortening too, which counts"))
    return remaining, constraints, forces
