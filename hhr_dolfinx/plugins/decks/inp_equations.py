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
        """Add a multiple of another one."""
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
            why = (
                "it has too few words"
                if not terms or len(terms[-1]) < 3
                else self._take_one(block, terms)
            )
            if why:
                self.left.append(block.left(why))

    def _take_one(self, block: KeywordBlock, terms: Sequence[Sequence[str]]) -> str:
        """Add an equation; the reason if it has no counterpart."""
        found = Combination()
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
                found.add(self._motion(node, component), coefficient)
                self.pilots.add(node)
                continue
            if component >= self.parts.raw.dim:
                return f"no counterpart: component {component + 1}"
            if self.nodes.single(word) is None and word not in sets:
                sets.append(word)
            by_number = word.rpartition(".")[2].isdigit()
            name = name_of_loaded(f"EQUATION:{block.line}", [word]) if by_number else word
            place = self.parts.place(name)
            if place is None:
                return f"'{word}' is no node of the mesh"
            found.add(Combination({(place, component): 1.0}), coefficient)
        return self._placed(block, found, sets)

    def _motion(self, node: int, component: int) -> Combination:
        """A displacement of a node without cells by its support or its equation, or as an
        unknown.
        """
        for item in self.state:
            held = item.block.keyword == "BOUNDARY" and item.component == component
            if held and node in self.nodes.numbers(item.row[0]):
                return Combination(constant=item.factor, source=item.block.source)
        if (node, component) in self.known:
            return self.known[node, component]
        return Combination(others={(node, component): 1.0})

    def _placed(self, block: KeywordBlock, found: Combination, sets: Sequence[str]) -> str:
        """Write an equation, or solve it for the displacement of a node without cells."""
        if not self._in_order(sets):
            return "sets of nodes are paired in another order than that of their coordinates"
        open_ways = [way for way, value in found.others.items() if value]
        if len(open_ways) > 1 or (open_ways and len(sets) > 1):
            return "several nodes that belong to no cell are free in it"
        if open_ways and sets:
            ((_, component), value), *more = found.own.items()
            first, others = (
                self.parts.place(f"EQUATION:{block.line} {sets[0]} {k}")
                for k in ("first", "others")
            )
            if more or first is None or others is None:
                return "a set and a node that belongs to no cell have other terms too"
            self._write(block, Combination({(others, component): 1.0, (first, component): -1.0}))
            found.own = {(first, component): value}
        if open_ways:
            way = open_ways[0]
            solved = Combination(source=found.source)
            solved.add(
                Combination(found.own, {}, found.constant, found.source), -1.0 / found.others[way]
            )
            self.known[way] = solved
            return ""
        own = {dof: value for dof, value in found.own.items() if value}
        if own:
            self._write(block, Combination(own, {}, found.constant, found.source))
        return ""

    def _write(self, block: KeywordBlock, found: Combination) -> None:
        terms = tuple((place, component, value) for (place, component), value in found.own.items())
        text = f"hhr.Equation({terms!r}, {{}})"
        self.constraints.append(
            DeckLoad("displacement", text, -found.constant, found.source or block.source)
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
        """Forces on nodes of cells of a force on a node without cells: None if no equation has
        it.
        """
        node = self.nodes.single(item.row[0])
        known = self.known.get((node, item.component)) if node is not None else None
        if item.block.keyword != "CLOAD" or known is None:
            return None
        return [
            (place, component, value * item.factor)
            for (place, component), value in known.own.items()
        ]


def equations_of(
    found: Sequence[KeywordBlock],
    state: Sequence[Imposed],
    parts: NamedParts,
    nodes: DeckNodes,
    thickness: float,
    left: list[Left],
) -> tuple[list[Imposed], list[DeckLoad], list[DeckLoad]]:
    """Supports and loads on nodes of cells, equations, and forces there of loads on the nodes that
    they eliminate.
    """
    equations = DeckEquations(parts, nodes, state, left)
    for block in of_kind(found, "EQUATION"):
        equations.take(block)
    kept: list[Imposed] = []
    forces: list[DeckLoad] = []
    for item in state:
        own = equations.forces(item)
        if own is not None:
            for place, component, value in own:
                unit = tuple(float(k == component) for k in range(parts.raw.dim))
                text = f"hhr.NodalForce({place!r}, {unit!r}, {{}})"
                forces += (
                    [DeckLoad("force", text, value / thickness, item.block.source)] if value else []
                )
        elif (
            item.block.keyword != "BOUNDARY"
            or not set(nodes.numbers(item.row[0])) & equations.pilots
        ):
            kept.append(item)
    return kept, equations.constraints, forces
