"""Contact pairs of a deck, their friction, and rigid surfaces."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.plugins.decks.deck import Left, Pair
from hhr_dolfinx.plugins.decks.inp_nodes import DeckNodes
from hhr_dolfinx.plugins.decks.inp_steps import Imposed, KeywordBlock, of_kind
from hhr_dolfinx.plugins.decks.inp_ties import tied_pairs
from hhr_dolfinx.plugins.decks.inp_tools import Tool, tool_of
from hhr_dolfinx.plugins.decks.named import NamedParts
from hhr_dolfinx.plugins.decks.planes import Plane, plane_through
from hhr_dolfinx.plugins.soft_contact.pair_laws import SoftContact

_TIED = (
    "surfaces that do not open nor slide slide here while they are pulled: hhr.Tie(SLAVE, MASTER) "
    "in constraints holds them"
)
_HOLDS = "surfaces hold from the end of the step in which they have pressed"
ROUGH_SURFACES = 1e6
"""Coefficient of friction of surfaces that never slip while they touch, as *FRICTION, ROUGH has
them: forces have the same digits from 1e3 on.
"""
_HARD = "contact is hard here, surfaces do not overlap. If that stiffness is meant, give the pair"
_EXPONENTIAL = "the pressure is 1 % at the clearance, as in CalculiX; in Abaqus it ends there"
_TABULAR = "beyond its last point the pressure goes on to grow, as in Abaqus; CalculiX keeps it"


class Interaction(NamedTuple):
    """What the surfaces of a pair do where they touch."""

    coefficient: float = 0.0  #: of friction
    limit: float = math.inf  #: largest shear stress of friction
    curve: str = ""  #: soft contact as text of Python, empty where surfaces do not overlap


def pairs_of(
    blocks: Sequence[KeywordBlock],
    parts: NamedParts,
    nodes: DeckNodes,
    state: Sequence[Imposed],
    todo: list[Left],
) -> tuple[Pair, ...]:
    """Contact pairs and obstacles; those without counterpart become TODO lines.

    Args:
        blocks: keyword blocks of the deck, in the order of its lines.
        parts: bodies, surfaces and sets of the mesh.
        nodes: nodes of the deck by number.
        state: rows of supports and loads that act.
        todo: list to which TODO lines are appended.
    """
    interactions = _interactions(blocks, todo)
    rigid = _rigid(blocks, parts, nodes, state, todo)
    cleared = of_kind(blocks, "CLEARANCE")
    used: set[str] = set()
    pairs = []
    tied = tied_pairs(blocks)
    for block in (
        pair_block for pair_block in of_kind(blocks, "CONTACT PAIR") if pair_block not in tied
    ):
        word = block.word("INTERACTION")
        if word and word not in interactions:
            todo.append(
                block.left(f"there is no *SURFACE INTERACTION '{word}', so that its friction is 0")
            )
        for row in block.rows:
            names = [word.upper() for word in row if word][:2]
            interaction = interactions.get(word, Interaction())
            pair = _pair(block, names, parts, rigid, interaction.coefficient, todo)
            clearance = next(
                (candidate for candidate in cleared[::-1] if _clears(candidate, block, names)), None
            )
            if pair is None:
                continue
            if clearance is not None and pair.motion:
                todo.append(
                    clearance.left("the distance of a curved rigid surface is that of the mesh")
                )
            elif clearance is not None:
                gap = pair.gap + clearance.number(clearance.option("VALUE"))
                pair = replace(pair, gap=gap, overwrites=True)
            used |= {clearance.source} if clearance is not None else set()
            pairs.append(replace(pair, limit=interaction.limit, curve=interaction.curve))
    todo += [
        candidate.left(_unused(candidate, cleared))
        for candidate in cleared
        if candidate.source not in used
    ]
    return tuple(pairs)


def _pair(
    block: KeywordBlock,
    names: Sequence[str],
    parts: NamedParts,
    rigid: tuple[Mapping[str, Plane], Mapping[str, tuple[Tool, np.ndarray]]],
    friction: float,
    todo: list[Left],
) -> Pair | None:
    """Pair of a slave and a master by their names in capitals; None for one that is left."""
    if len(names) < 2:
        todo.append(block.left("a pair needs two surfaces"))
        return None
    planes, tools = rigid
    slave, master = (parts.surface(name) for name in names)
    if slave is not None and master is not None:
        return parts.pair(slave, master, friction, block.source)
    lost = names[0] if slave is None else names[1]
    deformable = slave if slave is not None else master
    if lost in planes and deformable is not None:
        point, normal, motion = planes[lost]
        todo += _dragging(block, friction, motion - (motion @ normal) * normal)
        pair = parts.on_plane(deformable, point, normal, friction, block.source)
        return replace(pair, gap=float(motion @ parts.towards(deformable, normal)))
    if lost in tools and deformable is not None:
        tool, motion = tools[lost]
        middles = parts.raw.points[parts.surfaces[deformable]].mean(axis=1)
        text = tool.written(deformable, middles, parts.normals(deformable))
        todo += _dragging(block, friction, motion)
        return Pair(text, friction, block.source, motion=tuple(motion.tolist()), origin=tool.origin)
    todo.append(
        block.left(
            f"'{lost}' is no surface with facets of the mesh, nor a rigid surface that is read"
        )
    )
    return None


def _unused(clearance: KeywordBlock, cleared: Sequence[KeywordBlock]) -> str:
    """Reason why a *CLEARANCE has no effect: CalculiX 2.20 takes the last one of a pair."""
    later = [
        other_clearance for other_clearance in cleared if other_clearance.line > clearance.line
    ]
    same = [
        other_clearance
        for other_clearance in later
        if all(
            other_clearance.word(key) == clearance.word(key) for key in ("SLAVE", "MASTER", "CPSET")
        )
    ]
    if same:
        return f"the one of {same[-1].source} on the same pair counts"
    return (
        "no pair has this slave and master: hhr.Opening(CONTACT, VALUE, overwrites=True) in "
        "openings"
    )


def _clears(clearance: KeywordBlock, pair: KeywordBlock, names: Sequence[str]) -> bool:
    """True for the *CLEARANCE of a pair, by its slave and master or by its set of pairs."""
    if "CPSET" in clearance.options:
        return clearance.word("CPSET") == pair.word("CPSET")
    return [clearance.word("SLAVE"), clearance.word("MASTER")] == [*names]


def _dragging(block: KeywordBlock, friction: float, motion: np.ndarray) -> list[Left]:
    """The motion of a rigid surface with friction along itself, which is lost."""
    reason = (
        "a rigid surface that moves along the body does not drag it by friction here: hhr.drive("
        "scene, CONTACT, at=.., motion={..}) does"
    )
    return [block.left(reason)] if friction and motion.any() else []


def _interactions(blocks: Sequence[KeywordBlock], todo: list[Left]) -> dict[str, Interaction]:
    """Friction and soft contact by the name of the interaction in capitals."""
    interactions: dict[str, Interaction] = {}
    blocks_of: dict[str, KeywordBlock] = {}
    name: str | None = None
    for block in blocks:
        if block.keyword == "SURFACE INTERACTION":
            name = block.option("NAME").upper()
            interactions[name] = Interaction()
        elif block.keyword.startswith("CHANGE "):
            name = None  # of a later step, which is left
        elif block.keyword == "SURFACE BEHAVIOR" and name is not None:
            interactions[name] = interactions[name]._replace(curve=_curve(block, todo))
        elif block.keyword == "FRICTION" and "ROUGH" in block.options and name is not None:
            interactions[name] = interactions[name]._replace(coefficient=ROUGH_SURFACES)
            blocks_of[name] = block
        elif block.keyword == "FRICTION" and block.rows and name is not None:
            limit = block.number(block.options["TAUMAX"]) if "TAUMAX" in block.options else math.inf
            coefficient = block.value(block.rows[0], 0)
            interactions[name] = interactions[name]._replace(coefficient=coefficient, limit=limit)
            if len(block.rows) > 1:
                reason = (
                    "friction does not depend on the pressure, the speed or the temperature: its "
                    "first line counts"
                )
                todo.append(block.left(f"{reason}, {coefficient:g}"))
    for name, found in interactions.items():
        if found.curve == "hhr.NoSeparation()" and found.coefficient == ROUGH_SURFACES:
            todo.append(blocks_of[name].left(_TIED))
    return interactions


def _curve(block: KeywordBlock, todo: list[Left]) -> str:
    """Soft contact of a *SURFACE BEHAVIOR as text of Python, empty for hard contact.

    The stiffness of LINEAR is most often that of hard contact in a code that has no other one.
    """
    kind = block.word("PRESSURE-OVERCLOSURE")
    holds = "NO SEPARATION" in block.options
    if holds and kind in ("", "HARD"):
        todo.append(block.left(_HOLDS))
        return "hhr.NoSeparation()"
    if holds and kind != "LINEAR":
        todo.append(block.left("a pair has one law of its pressures: this curve may open here"))
    try:
        numbers = [block.numbers(row) for row in block.rows]
        if kind == "LINEAR":
            soft = SoftContact(stiffness=numbers[0][0])
            todo.append(block.left(f"{_HARD}: law=hhr.SoftContact(stiffness={soft.stiffness!r})"))
            return "hhr.NoSeparation()" if holds else ""
        if kind == "EXPONENTIAL":
            clearance, pressure, *_ = itertools.chain(*numbers)
            soft = SoftContact(exponential=(clearance, pressure))
            todo.append(block.left(_EXPONENTIAL))
            return f"hhr.SoftContact(exponential={soft.exponential!r})"
        if kind == "TABULAR":
            if any(len(row) > 3 for row in numbers):
                raise SceneError("a line of a table has a pressure, an overclosure, a temperature")
            soft = SoftContact(table=tuple((row[1], row[0]) for row in numbers))
            todo.append(block.left(_TABULAR))
            return f"hhr.SoftContact(table={soft.table!r})"
    except (SceneError, ValueError, IndexError) as error:
        todo.append(block.left(f"contact is hard here, as its curve is refused: {error}"))
    return ""


def is_tool(block: KeywordBlock, parts: NamedParts) -> bool:
    """True for a *RIGID BODY without cells of the mesh.

    Args:
        block: the *RIGID BODY.
        parts: bodies, surfaces and sets of the mesh.
    """
    return "NSET" not in block.options and parts.body(block.word("ELSET")) is None


def without_driving(
    blocks: Sequence[KeywordBlock],
    acting: Sequence[Imposed],
    parts: NamedParts,
    nodes: DeckNodes,
    thickness: float,
    todo: list[Left],
) -> list[Imposed]:
    """Rows without forces on rigid surfaces, which become TODO lines with the tool to paste.

    Args:
        blocks: keyword blocks of the deck.
        acting: rows of supports and loads that act.
        parts: bodies, surfaces and sets of the mesh.
        nodes: nodes of the deck by number.
        thickness: thickness of plane bodies, a length; forces are divided by it.
        todo: list to which TODO lines are appended.
    """
    dim = parts.raw.dim
    turns = {5: 2} if dim == 2 else {}  # the moment across the plane
    rest = list(acting)
    for block in of_kind(blocks, "RIGID BODY"):
        reference = block.word("REF NODE")
        if not is_tool(block, parts) or not reference.isdigit():
            continue
        forces: dict[int, float] = {}
        for row in rest:
            if row.block.keyword == "CLOAD" and row.row[0].upper() == reference and row.factor:
                along = turns.get(row.component, row.component)
                forces[along] = forces.get(along, 0.0) + row.factor / thickness
        if not forces:
            continue
        rest = [
            row for row in rest if row.block.keyword != "CLOAD" or row.row[0].upper() != reference
        ]
        point = tuple(nodes.point(int(reference))[:dim].tolist())
        todo.append(
            block.left(
                "a force on its reference node drives it. In the place of a motion of its obstacle "
                f"write scene = hhr.drive(scene, CONTACT, at={point}, force={forces}) below the "
                "scene, with the number of its contact, and motion={..} of moved components"
            )
        )
    return rest


def _rigid(
    blocks: Sequence[KeywordBlock],
    parts: NamedParts,
    nodes: DeckNodes,
    state: Sequence[Imposed],
    todo: list[Left],
) -> tuple[dict[str, Plane], dict[str, tuple[Tool, np.ndarray]]]:
    """Rigid surfaces by their names in capitals: planes, and curved ones with their motions."""
    dim = parts.raw.dim
    motions: dict[str, np.ndarray] = {}
    for block in of_kind(blocks, "RIGID BODY"):
        if not is_tool(block, parts):
            continue
        motion = motions.setdefault(
            block.word("ANALYTICAL SURFACE") or block.word("ELSET"), np.zeros(dim)
        )
        for imposed in state:
            if (
                imposed.row[0].upper() == block.word("REF NODE")
                and imposed.moves(dim)
                and imposed.component < dim
            ):
                motion[imposed.component] = imposed.factor
    planes = {}
    tools: dict[str, tuple[Tool, np.ndarray]] = {}
    for block in (
        surface for surface in of_kind(blocks, "SURFACE") if not _in_moved_part(blocks, surface)
    ):
        name = owner = block.option("NAME").upper()
        firsts = [row[0].upper() for row in block.rows]
        points: list[list[float]] = []
        profile = block.word("TYPE") in ("SEGMENTS", "CYLINDER", "REVOLUTION")
        if (
            block.word("TYPE") != "REVOLUTION"
            and profile
            and firsts[:1] == ["START"]
            and set(firsts[1:]) == {"LINE"}
        ):
            points = [[*[*block.numbers(row, 1), 0.0, 0.0][:2], 0.0] for row in block.rows]
        elif not profile and firsts and firsts[0] in motions and parts.surface(name) is None:
            owner = firsts[0]
            points = _points_of(blocks, owner)
        if (
            "FILLET RADIUS" in block.options
            and sum(word in ("LINE", "CIRCL") for word in firsts) > 1
        ):
            todo.append(block.left("FILLET RADIUS: corners of the profile stay sharp"))
        plane = plane_through(np.array(points), sweep=profile or dim == 2)
        motion = motions.get(owner, np.zeros(dim))
        if plane is not None:
            planes[name] = plane[0][:dim], plane[1][:dim], motion
        elif (profile or owner in motions) and (
            tool := tool_of(block, "" if profile else owner, nodes, dim)
        ):
            tools[name] = tool, motion
    return planes, tools


def _in_moved_part(blocks: Sequence[KeywordBlock], surface: KeywordBlock) -> bool:
    """True for an analytical surface of a part, or in an instance, that the assembly moves."""
    if not surface.word("TYPE"):
        return False
    around = [
        part_block
        for part_block in of_kind(blocks, "PART", "END PART", "INSTANCE", "END INSTANCE")
        if part_block.line < surface.line
    ]
    inner = around[-1] if around else surface
    part_name = inner.word("NAME") if inner.keyword == "PART" else None
    instances = [
        part_block
        for part_block in of_kind(blocks, "INSTANCE")
        if part_block is inner or (part_name and part_block.word("PART") == part_name)
    ]
    return any(any(part_block.numbers(row)) for part_block in instances for row in part_block.rows)


def _points_of(blocks: Sequence[KeywordBlock], elset: str) -> list[list[float]]:
    """Coordinates of the nodes of the elements of blocks with a set."""
    elements = [
        row
        for block in of_kind(blocks, "ELEMENT")
        if block.word("ELSET") == elset
        for row in block.rows
    ]
    numbers = {word for row in elements for word in row[1:]}
    nodes = [
        (block, row) for block in of_kind(blocks, "NODE") for row in block.rows if row[0] in numbers
    ]
    return [[*block.numbers(row, 1), 0.0, 0.0, 0.0][:3] for block, row in nodes]
