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
        """
        first, second = self.points
        third = np.cross(first, second)
        found = (first, np.cross(third, first), third)[component]
        if self.round:
            found = second - first
            if component < 2 and found.any():
                return ("radial", "tangential")[component]
        return (
            tuple((found / np.linalg.norm(found)).round(12).tolist()[:dim]) if found.any() else ()
        )

    def more(self, component: int, dim: int) -> str:
        """Further arguments: the axis of a direction around one."""
        first, second = self.points
        if not self.round or component > 1:
            return ""
        direction = f", axis_direction={tuple((second - first).tolist())!r}" if dim == 3 else ""
        return f", axis_point={tuple(first[:dim].tolist())!r}{direction}"


def directed_of(
    found: Sequence[KeywordBlock],
    state: Sequence[Imposed],
    parts: NamedParts,
    nodes: DeckNodes,
    thickness: float,
    left: list[Left],
) -> tuple[list[Imposed], list[DeckLoad], list[DeckLoad]]:
    """Supports and forces along the axes of the mesh, and others as constraints and forces.

    Supports of all components of a set need no local axes.
    """
    axes: dict[int, Axes] = {}
    for block in of_kind(found, "TRANSFORM"):
        # one object for all of its nodes, by which they are compared
        axes |= dict.fromkeys(nodes.numbers(block.option("NSET")), Axes(block))
    if not axes:
        return list(state), [], []
    dim = parts.raw.dim
    held = {
        (item.place, item.component)
        for item in state
        if item.block.keyword == "BOUNDARY" and not item.factor
    }
    kept: list[Imposed] = []
    turned: list[Imposed] = []
    for item in state:
        of_nodes = item.block.keyword in ("BOUNDARY", "CLOAD") and 0 <= item.component < dim
        clamped = item.block.keyword == "BOUNDARY" and all(
            (item.place, k) in held for k in range(dim)
        )
        straight = (
            not of_nodes
            or clamped
            or _directions(item, nodes, axes, dim) == {(_unit(item.component, dim), "")}
        )
        (kept if straight else turned).append(item)
    constraints: list[DeckLoad] = []
    forces: list[DeckLoad] = []
    for item in merged(turned):
        block = item.block
        place = parts.place(item.place)
        own = _directions(item, nodes, axes, dim)
        direction, more = next(iter(own), ((), ""))
        if place is None or len(own) != 1 or not direction:
            left.append(
                block.left(
                    "its nodes have several systems of axes, or none by the points of *TRANSFORM"
                )
            )
        elif block.keyword == "BOUNDARY":
            text = f"hhr.DirectedDisplacement({place!r}, {direction!r}, {{}}{more})"
            constraints.append(DeckLoad("displacement", text, item.factor, block.source))
        elif isinstance(direction, str):
            left.append(block.left(f"no counterpart: {direction} forces at nodes"))
        elif item.factor:
            text = f"hhr.NodalForce({place!r}, {direction}, {{}})"
            forces.append(DeckLoad("force", text, item.factor / thickness, block.source))
    return kept, constraints, forces


def _unit(component: int, dim: int) -> Direction:
    return tuple(np.eye(dim)[component].tolist())


def _directions(
    item: Imposed, nodes: DeckNodes, axes: dict[int, Axes], dim: int
) -> set[tuple[Direction, str]]:
    """Directions of the nodes of a row, and of the others that have its name in the mesh, with
    their axes as text.
    """
    alike = [row for row in item.block.rows if [*row[1:]] == [*item.row[1:]]]
    words = [item.row[0]] if item.place == item.row[0] else [row[0] for row in alike]
    systems = dict.fromkeys(axes.get(number) for word in words for number in nodes.numbers(word))
    k = item.component
    return {
        (one.direction(k, dim), one.more(k, dim)) if one else (_unit(k, dim), "") for one in systems
    }
