"""Reference nodes of a deck: rigid bodies, kinematic and distributing couplings, mean rotations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hhr_dolfinx.plugins.constraints.couplings import ROTATION_PLANES, fit_of
from hhr_dolfinx.plugins.decks.deck import DeckLoad, Left, Tag
from hhr_dolfinx.plugins.decks.inp_nodes import DeckNodes
from hhr_dolfinx.plugins.decks.inp_steps import Imposed, KeywordBlock, of_kind
from hhr_dolfinx.plugins.decks.named import NamedParts

REFERENCE_KEYWORDS = ("RIGID BODY", "COUPLING", "DISTRIBUTING COUPLING", "MPC")
"""Keywords with reference nodes."""


@dataclass(frozen=True)
class Coupling:
    """Nodes that a reference node moves, or that carry its forces."""

    block: KeywordBlock
    place: Tag
    rigid: bool
    components: tuple[int, ...] | None  #: those of the nodes that are coupled, None for all of them
    point: (
        tuple[float, ...] | None
    )  #: coordinates of the reference node, None for the centre of the nodes
    ways: Mapping[
        tuple[int, int], int
    ]  #: component of the motion by the node and its degree of freedom, 0 to 5
    by_area: bool | str = True  #: how nodes count, as in CoupledForce

    def text(self, kind: str, component: int, amplitude: str) -> str:
        """A motion or a force as text of Python.

        Args:
            kind: class of the scene, ``MeanMotion`` or ``CoupledForce``.
            component: component of the motion, rotations after translations.
            amplitude: amplitude as text of Python.
        """
        more = "" if self.point is None else f", point={self.point!r}"
        more += "" if self.components is None else f", components={self.components!r}"
        more += "" if self.by_area is True else f", by_area={self.by_area!r}"
        return f"hhr.{kind}({self.place!r}, {component}, {amplitude}{more})"

    def shows(self, parts: NamedParts, component: int, hypothesis: str) -> bool:
        """True if the motion of the nodes determines a component of that of the point.

        Args:
            parts: bodies, surfaces and sets of the mesh.
            component: component of the motion, rotations after translations.
            hypothesis: hypothesis of the scene, such as ``plane_strain``.
        """
        dim = parts.raw.dim
        points = parts.raw.points[parts.nodes(self.place)]
        turns = () if hypothesis == "axisymmetric" else ROTATION_PLANES[dim]
        coupled = np.array(self.components or range(dim))
        weights = np.full(len(points), 1.0 / len(points))
        return component < dim + len(turns) and (
            fit_of(points, weights, component, self.point, coupled, turns) is not None
        )


def _couplings(
    blocks: Sequence[KeywordBlock],
    parts: NamedParts,
    nodes: DeckNodes,
    hypothesis: str,
    todo: list[Left],
) -> list[Coupling]:
    """Couplings of a deck; those without counterpart are left."""
    couplings = []
    pilots: set[int] = set()
    for block, after in zip(blocks, [*blocks[1:], None], strict=True):
        if block.keyword not in REFERENCE_KEYWORDS or (
            block.keyword == "RIGID BODY" and _without_cells(block, parts)
        ):
            continue
        coupling = _coupling(blocks, block, after, parts, nodes)
        if isinstance(coupling, Coupling) and coupling.rigid and hypothesis == "axisymmetric":
            coupling = "no counterpart: a rigid coupling in axisymmetry"
        references = (
            {number for number, _ in coupling.ways} if isinstance(coupling, Coupling) else set()
        )
        if references & pilots:
            coupling = "its reference node has another coupling too"
        pilots |= references
        if isinstance(coupling, str):
            todo.append(block.left(coupling))
            continue
        couplings.append(coupling)
        if block.keyword == "DISTRIBUTING COUPLING" and coupling.ways:
            points = parts.raw.points[parts.nodes(coupling.place)]
            off = points.mean(axis=0) - nodes.point(next(iter(references)))[: parts.raw.dim]
            if np.abs(off).max() > 1e-6 * np.ptp(points, axis=0).max():
                todo.append(
                    block.left(
                        "as in CalculiX, its reference node counts as the centre of its nodes"
                    )
                )
    return couplings


def _without_cells(block: KeywordBlock, parts: NamedParts) -> bool:
    return "NSET" not in block.options and parts.place(f"RIGID BODY:{block.line}") is None


def _coupling(
    blocks: Sequence[KeywordBlock],
    block: KeywordBlock,
    after: KeywordBlock | None,
    parts: NamedParts,
    nodes: DeckNodes,
) -> Coupling | str:
    """Coupling of a block, or the reason why it has no counterpart."""
    dim = parts.raw.dim
    rigid = block.keyword == "RIGID BODY"
    words = [block.word("REF NODE"), block.word("ROT NODE")]
    target = parts.place(f"{block.keyword}:{block.line}")
    components = None
    if block.keyword == "COUPLING":
        kind = after.keyword if after is not None else ""
        if (
            kind not in ("KINEMATIC", "DISTRIBUTING")
            or after is None
            or "CYCLIC SYMMETRY" in after.options
        ):
            return "needs *KINEMATIC or *DISTRIBUTING after it, without cyclic symmetry"
        rigid = kind == "KINEMATIC"
        components = _components(after, dim) if rigid else None
        if "ORIENTATION" in block.options and components is not None:  # all components need no axes
            return "no counterpart: local axes (ORIENTATION)"
        target = parts.surface(block.word("SURFACE"))
        target = parts.place(block.word("SURFACE")) if target is None else target
    elif "NSET" in block.options:
        target = parts.place(block.option("NSET"))
    elif block.keyword == "DISTRIBUTING COUPLING":
        elements = [
            element_block
            for element_block in of_kind(blocks, "ELEMENT")
            if element_block.word("ELSET") == block.word("ELSET")
        ]
        words = [
            elements[0].rows[0][1] if elements and elements[0].rows else block.word("ELSET"),
            "",
        ]
        if len({row[1] for row in block.rows if len(row) > 1}) > 1:
            return "no counterpart: its nodes have different weights"
    elif block.keyword == "MPC":
        kinds = [row[0].upper() for row in block.rows if row and not row[0].isdigit()]
        if kinds != ["MEANROT"]:
            return f"no counterpart: {', '.join(kinds)}; hhr.Equation or hhr.RigidMotion may be one"
        words = [next(word for word in reversed(block.rows[-1]) if word), ""]
    if target is None:
        return "it has no nodes of the mesh"
    pilot, turned = (nodes.single(word) if word else None for word in words)
    if pilot is None and any(words):
        return f"'{words[0]}' is not one node"
    return _with_ways(block, target, rigid, components, pilot, turned, parts, nodes)


def _with_ways(
    block: KeywordBlock,
    place: Tag,
    rigid: bool,
    components: tuple[int, ...] | None,
    pilot: int | None,
    turned: int | None,
    parts: NamedParts,
    nodes: DeckNodes,
) -> Coupling | str:
    """Coupling with the components that degrees of freedom of its reference nodes move."""
    dim = parts.raw.dim
    ways: dict[tuple[int, int], int] = {}
    point = None
    if pilot is None:
        return Coupling(block, place, rigid, components, None, {})
    place_of = nodes.point(pilot)
    if block.keyword == "MPC":
        axis = int(np.abs(place_of).argmax())
        if np.count_nonzero(place_of) != 1 or place_of[axis] < 0 or dim == 2:
            return "no counterpart: its pilot node is on no axis of the mesh"
        return Coupling(block, place, False, None, None, {(pilot, 0): dim + axis}, "angles")
    if (
        block.keyword == "DISTRIBUTING COUPLING"
    ):  # in CalculiX the mean of its nodes, without rotations
        return Coupling(
            block, place, False, None, None, {(pilot, k): k for k in range(dim)}, by_area=False
        )
    point = tuple(place_of[:dim].tolist())
    if (
        pilot in nodes.of_cells
        and rigid
        and np.abs(parts.raw.points[parts.nodes(place)] - point).max(axis=1).min() > 0
    ):
        return "its reference node is one of cells outside of its nodes"
    rotations = range(3) if dim == 3 else (2,)
    ways |= {(pilot, k): k for k in range(dim) if pilot not in nodes.of_cells}
    for k, axis in enumerate(rotations):
        ways[(pilot, 3 + axis)] = dim + k
        if turned is not None:
            ways[(turned, axis)] = dim + k
    # areas do not matter on nodes that move as a rigid body
    return Coupling(
        block,
        place,
        rigid,
        components,
        point,
        ways,
        "edges" if not rigid and nodes.types == {"C3D20"} else True,
    )


def _components(block: KeywordBlock, dim: int) -> tuple[int, ...] | None:
    """Components of *KINEMATIC, None for all of them."""
    numbers = [
        [int(word.upper().lstrip("U").replace("R", "")) for word in row if word]
        for row in block.rows
    ]
    listed = {k - 1 for row in numbers if row for k in range(row[0], row[-1] + 1)} & set(range(dim))
    return None if not listed or len(listed) == dim else tuple(sorted(listed))


def coupled_of(
    blocks: Sequence[KeywordBlock],
    state: Sequence[Imposed],
    parts: NamedParts,
    nodes: DeckNodes,
    hypothesis: str,
    thickness: float,
    todo: list[Left],
) -> tuple[list[Imposed], list[DeckLoad], list[DeckLoad]]:
    """Constraints of couplings, and forces on their reference nodes.

    Args:
        blocks: keyword blocks of the deck, in the order of its lines.
        state: rows of supports and loads that act.
        parts: bodies, surfaces and sets of the mesh.
        nodes: nodes of the deck by number.
        hypothesis: hypothesis of the scene, such as ``plane_strain``.
        thickness: thickness of plane bodies, a length; forces are divided by it.
        todo: list to which TODO lines are appended.

    Returns:
        Supports and loads on other nodes, constraints, and forces.
    """
    couplings = _couplings(blocks, parts, nodes, hypothesis, todo)
    constraints = [
        DeckLoad(
            "", f"hhr.RigidMotion({coupling.place!r}{_more(coupling)})", 0.0, coupling.block.source
        )
        for coupling in couplings
        if coupling.rigid
    ]
    forces: list[DeckLoad] = []
    remaining = []
    by_way = {
        way: (coupling, component)
        for coupling in couplings
        for way, component in coupling.ways.items()
    }
    pilots = {number for number, _ in by_way}
    for imposed in state:
        number = nodes.single(imposed.row[0])
        if (
            imposed.block.keyword not in ("BOUNDARY", "CLOAD")
            or number is None
            or number not in pilots
        ):
            remaining.append(imposed)
        elif (number, imposed.component) in by_way:
            coupling, component = by_way[number, imposed.component]
            load = _made(coupling, component, imposed, thickness)
            if not coupling.shows(parts, component, hypothesis):
                todo += [
                    imposed.block.left(
                        f"the nodes of its coupling do not determine component {component + 1}"
                    )
                ] * (imposed.factor != 0)
            elif imposed.block.keyword == "BOUNDARY":
                constraints.append(load)
            elif imposed.factor:
                forces.append(load)
        elif number in nodes.of_cells:
            remaining.append(imposed)
        elif imposed.factor:
            todo.append(
                imposed.block.left(f"'{imposed.row[0]}' has no component {imposed.component + 1}")
            )
    return remaining, constraints, forces


def _more(coupling: Coupling) -> str:
    return "" if coupling.components is None else f", components={coupling.components!r}"


def _made(coupling: Coupling, component: int, imposed: Imposed, thickness: float) -> DeckLoad:
    dim = 3 if coupling.point is None else len(coupling.point)
    turns = component >= dim
    if imposed.block.keyword == "BOUNDARY":
        return DeckLoad(
            "turn" if turns else "displacement",
            coupling.text("MeanMotion", component, "{}"),
            imposed.factor,
            imposed.block.source,
        )
    text = coupling.text("CoupledForce", component, "{}")
    return DeckLoad(
        "moment" if turns else "force", text, imposed.factor / thickness, imposed.block.source
    )
