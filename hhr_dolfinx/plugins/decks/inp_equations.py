"""*EQUATION of a deck; nodes that belong to no cell are eliminated, as those that drive periodic
cells.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from hhr_dolfinx.geometries.abaqus_blocks import name_of_loaded
from hhr_dolfinx.plugins.decks.deck import DeckLoad, Left, Tag
from hhr_dolfinx.plugins.decks.inp_nodes import DeckNodes
from hhr_dolfinx.plugins.decks.inp_steps import Imposed, KeywordBlock, of_kind
from hhr_dolfinx.plugins.decks.named import NamedParts

Dof = tuple[Tag, int]
"""Place and component of a displacement."""


@dataclass
class Combination:
    """Sum of coefficients times displacements, and a constant with the line that gives it."""

    own: dict[Dof, float] = field(default_factory=dict)  #: of nodes of cells
    others: dict[tuple[int, int], float] = field(
        default_factory=dict
    )  #: of other nodes, by number and component
    constant: float = 0.0
    source: str = ""

    def add(self, other: Combination, factor: float) -> None:
        """Add a multiple of another combination.

        Args:
            other: the other combination.
            factor: its factor.
        """
        for dof, value in other.own.items():
            self.own[dof] = self.own.get(dof, 0.0) + factor * value
        for way, value in other.others.items():
            self.others[way] = self.others.get(way, 0.0) + factor * value
        self.constant += factor * other.constant
        self.source = self.source or (other.source if other.constant else "")


@dataclass
class DeckEquations:
    """Equations of a deck, in the order of its lines.

    Attributes:
        state: supports and loads of the deck.
        known: displacements of nodes without cells.
        pilots: nodes without cells that equations have.
        constraints: equations between nodes of cells.
    """

    parts: NamedParts
    nodes: DeckNodes
    state: Sequence[Imposed]
    left: list[Left]
    known: dict[tuple[int, int], Combination] = field(default_factory=dict)
    pilots: set[int] = field(default_factory=set)
    constraints: list[DeckLoad] = field(default_factory=list)

    def take(self, block: KeywordBlock) -> None:
        """Add the equations of a block; those without counterpart are left."""
        words = [word for row in block.rows for word in row if word]
        while words:
            count = int(block.number(words.pop(0)))
            terms = [words[3 * k : 3 * k + 3] for k in range(count)]
            words = words[3 * count :]
            reason = (
                "it has too few words"
                if not terms or len(terms[-1]) < 3
                else self._take_one(block, terms)
            )
            if reason:
                self.left.append(block.left(reason))

    def _take_one(self, block: KeywordBlock, terms: Sequence[Sequence[str]]) -> str:
        """Add an equation; the reason if it has no counterpart."""
        combination = Combination()
        sets: list[str] = []
        for word, number, value in terms:
            component = int(block.number(number)) - 1
            coefficient = block.number(value)
            if not self.nodes.numbers(word):
                return f"'{word}' has no node"
            if not coefficient:
                continue
            if self.nodes.free_of_cells(word):
                if (node := self.nodes.single(word)) is None:
                    return f"'{word}' has several nodes that belong to no cell"
                combination.add(self._motion(node, component), coefficient)
                self.pilots.add(node)
                continue
            if component >= self.parts.raw.dim:
                return f"no counterpart: component {component + 1}"
            if self.nodes.single(word) is None and word not in sets:
                sets.append(word)
            by_number = word.rpartition(".")[2].isdigit()
            name = name_of_loaded(f"EQUATION:{block.line}", [word]) if by_number else word
            target = self.parts.place(name)
            if target is None:
                return f"'{word}' is no node of the mesh"
            combination.add(Combination({(target, component): 1.0}), coefficient)
        return self._placed(block, combination, sets)

    def _motion(self, node: int, component: int) -> Combination:
        """A displacement of a node without cells by its support or its equation, or as an
        unknown.
        """
        for imposed in self.state:
            held = imposed.block.keyword == "BOUNDARY" and imposed.component == component
            if held and node in self.nodes.numbers(imposed.row[0]):
                return Combination(constant=imposed.factor, source=imposed.block.source)
        if (node, component) in self.known:
            return self.known[node, component]
        return Combination(others={(node, component): 1.0})

    def _placed(self, block: KeywordBlock, combination: Combination, sets: Sequence[str]) -> str:
        """Write an equation, or solve it for the displacement of a node without cells."""
        if not self._in_order(sets):
            return "sets of nodes are paired in another order than that of their coordinates"
        open_ways = [way for way, value in combination.others.items() if value]
        if len(open_ways) > 1 or (open_ways and len(sets) > 1):
            return "several nodes that belong to no cell are free in it"
        if open_ways and sets:
            ((_, component), value), *more = combination.own.items()
            first, remaining = (
                self.parts.place(f"EQUATION:{block.line} {sets[0]} {k}")
                for k in ("first", "others")
            )
            if more or first is None or remaining is None:
                return "a set and a node that belongs to no cell have other terms too"
            self._write(block, Combination({(remaining, component): 1.0, (first, component): -1.0}))
            combination.own = {(first, component): value}
        if open_ways:
            way = open_ways[0]
            solved = Combination(source=combination.source)
            solved.add(
                Combination(combination.own, {}, combination.constant, combination.source),
                -1.0 / combination.others[way],
            )
            self.known[way] = solved
            return ""
        terms = {dof: value for dof, value in combination.own.items() if value}
        if terms:
            self._write(block, Combination(terms, {}, combination.constant, combination.source))
        return ""

    def _write(self, block: KeywordBlock, combination: Combination) -> None:
        terms = tuple(
            (target, component, value) for (target, component), value in combination.own.items()
        )
        text = f"hhr.Equation({terms!r}, {{}})"
        self.constraints.append(
            DeckLoad(
                "displacement", text, -combination.constant, combination.source or block.source
            )
        )

    def _in_order(self, sets: Sequence[str]) -> bool:
        """True for sets whose nodes, by their numbers and by their coordinates, pair alike."""
        orders = []
        for word in sets:
            points = np.array([self.nodes.point(number) for number in self.nodes.numbers(word)])
            size = np.ptp(points, axis=0).max() or 1.0
            orders.append(tuple(np.lexsort(np.round(points.T[::-1] / (1e-6 * size))).tolist()))
        return len(set(orders)) < 2

    def forces(self, item: Imposed) -> list[tuple[Tag, int, float]] | None:
        """Forces on nodes of cells by a force on a node without cells.

        None if no equation has the node.
        """
        node = self.nodes.single(item.row[0])
        solved = self.known.get((node, item.component)) if node is not None else None
        if item.block.keyword != "CLOAD" or solved is None:
            return None
        return [
            (target, component, value * item.factor)
            for (target, component), value in solved.own.items()
        ]


def equations_of(
    blocks: Sequence[KeywordBlock],
    state: Sequence[Imposed],
    parts: NamedParts,
    nodes: DeckNodes,
    thickness: float,
    todo: list[Left],
) -> tuple[list[Imposed], list[DeckLoad], list[DeckLoad]]:
    """Equations of a deck, and forces on nodes of cells by the nodes that they eliminate.

    Args:
        blocks: keyword blocks of the deck, in the order of its lines.
        state: rows of supports and loads that act.
        parts: bodies, surfaces and sets of the mesh.
        nodes: nodes of the deck by number.
        thickness: thickness of plane bodies, a length; forces are divided by it.
        todo: list to which TODO lines are appended.

    Returns:
        Supports and loads on nodes of cells, equations, and forces.
    """
    equations = DeckEquations(parts, nodes, state, todo)
    for block in of_kind(blocks, "EQUATION"):
        equations.take(block)
    remaining: list[Imposed] = []
    forces: list[DeckLoad] = []
    for imposed in state:
        nodal_forces = equations.forces(imposed)
        if nodal_forces is not None:
            for target, component, value in nodal_forces:
                unit = tuple(float(k == component) for k in range(parts.raw.dim))
                text = f"hhr.NodalForce({target!r}, {unit!r}, {{}})"
                forces += (
                    [DeckLoad("force", text, value / thickness, imposed.block.source)]
                    if value
                    else []
                )
        elif (
            imposed.block.keyword != "BOUNDARY"
            or not set(nodes.numbers(imposed.row[0])) & equations.pilots
        ):
            remaining.append(imposed)
    return remaining, equations.constraints, forces
