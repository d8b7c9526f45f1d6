"""Local axes of nodes of a deck: supports and forces along other directions than those of the
mesh.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hhr_dolfinx.plugins.decks.deck import DeckLoad, Left
from hhr_dolfinx.plugins.decks.inp_nodes import DeckNodes
from hhr_dolfinx.plugins.decks.inp_steps import Imposed, KeywordBlock, merged, of_kind
from hhr_dolfinx.plugins.decks.named import NamedParts

Direction = tuple[float, ...] | str
"""A unit vector, or ``radial`` or ``tangential``."""


@dataclass(frozen=True, eq=False)
class Axes:
    """Local axes of nodes: three vectors, or those about an axis through a point."""

    block: KeywordBlock

    @property
    def points(self) -> np.ndarray:
        """Both points of the block, (2, 3)."""
        row = self.block.numbers(self.block.rows[0]) if self.block.rows else []
        return np.array([*row, *(0.0,) * 6][:6]).reshape(2, 3)

    @property
    def round(self) -> bool:
        """True for cylindrical axes."""
        return self.block.word("TYPE") == "C"

    def direction(self, component: int, dim: int) -> Direction:
        """Direction of a component as ``DirectedDisplacement`` has it.

        Empty if its points do not define it.

        Args:
            component: component in the local axes, 0 to 2.
            dim: dimension of the mesh, 2 or 3.
        """
        first, second = self.points
        third = np.cross(first, second)
        vector = (first, np.cross(third, first), third)[component]
        if self.round:
            vector = second - first
            if component < 2 and vector.any():
                return ("radial", "tangential")[component]
        return (
            tuple((vector / np.linalg.norm(vector)).round(12).tolist()[:dim])
            if vector.any()
            else ()
        )

    def more(self, component: int, dim: int) -> str:
        """Further arguments: the axis of a direction around one.

        Args:
            component: component in the local axes, 0 to 2.
            dim: dimension of the mesh, 2 or 3.
        """
        first, second = self.points
        if not self.round or component > 1:
            return ""
        direction = f", axis_direction={tuple((second - first).tolist())!r}" if dim == 3 else ""
        return f", axis_point={tuple(first[:dim].tolist())!r}{direction}"


def directed_of(
    blocks: Sequence[KeywordBlock],
    state: Sequence[Imposed],
    parts: NamedParts,
    nodes: DeckNodes,
    thickness: float,
    todo: list[Left],
) -> tuple[list[Imposed], list[DeckLoad], list[DeckLoad]]:
    """Supports and forces along local axes, as constraints and forces.

    Supports of all components of a set need no local axes.

    Args:
        blocks: keyword blocks of the deck, in the order of its lines.
        state: rows of supports and loads that act.
        parts: bodies, surfaces and sets of the mesh.
        nodes: nodes of the deck by number.
        thickness: thickness of plane bodies, a length; forces are divided by it.
        todo: list to which TODO lines are appended.

    Returns:
        Supports and loads along the axes of the mesh, constraints, and forces.
    """
    axes: dict[int, Axes] = {}
    for block in of_kind(blocks, "TRANSFORM"):
        # one object for all of its nodes, by which they are compared
        axes |= dict.fromkeys(nodes.numbers(block.option("NSET")), Axes(block))
    if not axes:
        return list(state), [], []
    dim = parts.raw.dim
    held = {
        (imposed.place, imposed.component)
        for imposed in state
        if imposed.block.keyword == "BOUNDARY" and not imposed.factor
    }
    aligned: list[Imposed] = []
    turned: list[Imposed] = []
    for imposed in state:
        of_nodes = imposed.block.keyword in ("BOUNDARY", "CLOAD") and 0 <= imposed.component < dim
        clamped = imposed.block.keyword == "BOUNDARY" and all(
            (imposed.place, k) in held for k in range(dim)
        )
        straight = (
            not of_nodes
            or clamped
            or _directions(imposed, nodes, axes, dim) == {(_unit(imposed.component, dim), "")}
        )
        (aligned if straight else turned).append(imposed)
    constraints: list[DeckLoad] = []
    forces: list[DeckLoad] = []
    for imposed in merged(turned):
        block = imposed.block
        target = parts.place(imposed.place)
        directions = _directions(imposed, nodes, axes, dim)
        direction, more = next(iter(directions), ((), ""))
        if target is None or len(directions) != 1 or not direction:
            todo.append(
                block.left(
                    "its nodes have several systems of axes, or none by the points of *TRANSFORM"
                )
            )
        elif block.keyword == "BOUNDARY":
            text = f"hhr.DirectedDisplacement({target!r}, {direction!r}, {{}}{more})"
            constraints.append(DeckLoad("displacement", text, imposed.factor, block.source))
        elif isinstance(direction, str):
            todo.append(block.left(f"no counterpart: {direction} forces at nodes"))
        elif imposed.factor:
            text = f"hhr.NodalForce({target!r}, {direction}, {{}})"
            forces.append(DeckLoad("force", text, imposed.factor / thickness, block.source))
    return aligned, constraints, forces


def _unit(component: int, dim: int) -> Direction:
    return tuple(np.eye(dim)[component].tolist())


def _directions(
    imposed: Imposed, nodes: DeckNodes, axes: dict[int, Axes], dim: int
) -> set[tuple[Direction, str]]:
    """Directions of the nodes of a row, and of the others that have its name in the mesh, with
    their axes as text.
    """
    alike = [row for row in imposed.block.rows if [*row[1:]] == [*imposed.row[1:]]]
    words = [imposed.row[0]] if imposed.place == imposed.row[0] else [row[0] for row in alike]
    systems = dict.fromkeys(axes.get(number) for word in words for number in nodes.numbers(word))
    k = imposed.component
    return {
        (system.direction(k, dim), system.more(k, dim)) if system else (_unit(k, dim), "")
        for system in systems
    }
