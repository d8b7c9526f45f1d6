"""Decks of CalculiX and Abaqus: their bodies, and what is left of them.

Other parts have modules of their names.

The sets and surfaces are those that the mesh reader names. It also names the nodes and faces that
loads and supports give by their numbers, see
:func:`~hhr_dolfinx.geometries.abaqus_blocks.name_of_loaded`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.plugins.decks.bodies import bodies_of
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
from hhr_dolfinx.plugins.decks.inp_contacts import is_tool, pairs_of, without_driving
from hhr_dolfinx.plugins.decks.inp_couplings import coupled_of
from hhr_dolfinx.plugins.decks.inp_equations import equations_of
from hhr_dolfinx.plugins.decks.inp_gaps import gaps_of
from hhr_dolfinx.plugins.decks.inp_heat import heat_of, is_heat, with_conductances
from hhr_dolfinx.plugins.decks.inp_history import in_order, with_history
from hhr_dolfinx.plugins.decks.inp_loads import loads_of
from hhr_dolfinx.plugins.decks.inp_materials import materials_of
from hhr_dolfinx.plugins.decks.inp_nodes import DeckNodes
from hhr_dolfinx.plugins.decks.inp_steps import (
    Imposed,
    KeywordBlock,
    imposed_of,
    merged,
    of_kind,
    period_of,
)
from hhr_dolfinx.plugins.decks.inp_temperatures import heated_of
from hhr_dolfinx.plugins.decks.inp_ties import (
    BoltSection,
    preloads_of,
    sections_of,
    tied_pairs,
    ties_of,
)
from hhr_dolfinx.plugins.decks.inp_transforms import directed_of
from hhr_dolfinx.plugins.decks.named import NamedParts
from hhr_dolfinx.plugins.decks.template import with_springs
from hhr_dolfinx.plugins.decks.with_outside import OUTSIDE_SURFACE

_HYPOTHESES = {"CPE": "plane_strain", "CPS": "plane_stress", "CAX": "axisymmetric"}


def read_inp(
    path: Path,
    blocks: Sequence[KeywordBlock],
    parts: NamedParts,
    nodes: DeckNodes,
    unread: Sequence[Left] = (),
) -> Deck:
    """Read bodies, supports, loads and contacts of a deck.

    Args:
        path: the deck.
        blocks: its keyword blocks, with the options that are read.
        parts: bodies, surfaces and sets of its mesh.
        nodes: nodes of the deck by number.
        unread: TODO lines of the options that are not read.

    Raises:
        SceneError: for a deck without sections or supports, or with a material that is not elastic,
            with the line.
        FileContentError: for words that are not the numbers that a keyword needs, with the line.
    """
    todo = [*unread, *_perturbed(blocks)]
    uncut = parts
    cuts, parts = sections_of(blocks, parts, nodes, todo)
    hypothesis = hypothesis_of(blocks, parts, todo)
    sections, thickness = _sections(blocks, materials_of(blocks, todo), parts, hypothesis, todo)
    if hypothesis == "axisymmetric":
        thickness = 1.0
    reader = _DeckParts(
        path, blocks, uncut, parts, nodes, hypothesis, tuple(sections), thickness, cuts, tuple(todo)
    )
    final = imposed_of(blocks)
    reader = replace(
        reader, left=(*todo, *_overlapping(final, parts), *_creeping(blocks, sections))
    )
    deck = reader.deck(final)
    remembers = any(section.material.law for section in sections) or any(
        pair.friction for pair in deck.pairs
    )
    return with_history(deck, blocks, reader.deck) if remembers else deck


@dataclass(frozen=True)
class _DeckParts:
    """Parts of a deck that are the same in all of its steps."""

    path: Path
    found: Sequence[KeywordBlock]
    whole: NamedParts  #: before it is cut
    parts: NamedParts
    nodes: DeckNodes
    hypothesis: str
    sections: tuple[Section, ...]
    thickness: float  #: of a plane body, a length
    cuts: Sequence[BoltSection]
    left: tuple[Left, ...]

    def deck(self, state: Sequence[Imposed]) -> Deck:
        """Contents of the deck with some supports and loads.

        Args:
            state: rows of supports and loads that act.

        Raises:
            SceneError: for a deck without supports, contact pairs and constraints that are read.
        """
        blocks = self.found
        parts = self.parts
        nodes = self.nodes
        todo = list(self.left)
        acting = [row for row in self._without_tools(state) if not is_heat(row)]
        gaps, grounds = gaps_of(blocks, parts, nodes, state, todo)
        acting = [
            imposed
            for imposed in acting
            if not grounds or not set(nodes.numbers(imposed.row[0])) <= grounds
        ]
        acting = without_driving(blocks, acting, parts, nodes, self.thickness, todo)
        acting, constraints, forces = self._constrained(acting, todo)
        constraints += ties_of(blocks, parts, todo)
        materials = {section.tag: section.material for section in self.sections}
        axis = 1 if self.hypothesis == "axisymmetric" else 2
        supports, loads = loads_of(merged(acting), parts, materials, self.thickness, todo, axis)
        loads += heated_of(blocks, acting, nodes, materials, todo)
        touching = (*pairs_of(blocks, parts, nodes, state, todo), *gaps)
        option = [*constraints, *_serendipity(nodes)]
        heat = heat_of(blocks, state, self.sections, option, parts, nodes, todo)
        if heat is not None:
            touching = with_conductances(blocks, touching, todo)
        sides = any(not parts.named_in(pair.text) for pair in gaps)
        if not (touching or supports or constraints):
            raise SceneError(
                f"{self.path.name}: no support and no contact pair of it has a counterpart, so "
                "its bodies are free: "
                "hold them by *BOUNDARY" + "".join(f". {entry}" for entry in todo)
            )
        stated = of_kind(blocks, "CONTACT PAIR", "CONTACT", "GAP")
        deck = Deck(
            self.path,
            self.hypothesis,
            self.sections,
            tuple(supports),
            (*loads, *forces),
            touching or _out_of_reach(self.whole, parts, supports, constraints),
            in_order(todo),
            sum(map(period_of, of_kind(blocks, "STATIC", "VISCO"))) or 1.0,
            tuple(constraints),
            tuple(bolt.name for bolt in self.cuts),
            sides=sides,
            contact_lost=not touching and len(stated) > len(tied_pairs(blocks)),
            heat=heat,
        )
        flows = any(section.material.law for section in self.sections)
        return _with_20_nodes(with_springs(deck, parts) if touching and flows else deck, nodes)

    def _without_tools(self, state: Sequence[Imposed]) -> list[Imposed]:
        """Rows imposed on nodes of cells.

        Nodes that move rigid tools are no nodes of cells: their motions are gaps.
        """
        parts = self.parts
        tools = {
            block.word("REF NODE")
            for block in of_kind(self.found, "RIGID BODY")
            if is_tool(block, parts)
        }
        return [
            imposed
            for imposed in state
            if imposed.row[0].upper() not in tools or not imposed.moves(parts.raw.dim)
        ]

    def _constrained(
        self, acting: list[Imposed], todo: list[Left]
    ) -> tuple[list[Imposed], list[DeckLoad], list[DeckLoad]]:
        """Rows that impose no constraint; constraints and forces of the others."""
        blocks = self.found
        parts = self.parts
        nodes = self.nodes
        thickness = self.thickness
        constraints: list[DeckLoad] = []
        forces: list[DeckLoad] = []
        for convert in (
            lambda rows: preloads_of(self.cuts, rows, nodes, thickness, todo),
            lambda rows: coupled_of(blocks, rows, parts, nodes, self.hypothesis, thickness, todo),
            lambda rows: equations_of(blocks, rows, parts, nodes, thickness, todo),
            lambda rows: directed_of(blocks, rows, parts, nodes, thickness, todo),
        ):
            acting, *more = convert(acting)
            constraints += more[0]
            forces += more[1]
        return acting, constraints, forces


def _with_20_nodes(deck: Deck, nodes: DeckNodes) -> Deck:
    """Elements of 20 nodes are those of the scene too if all are integrated fully, as these."""
    return replace(deck, constraints=(*deck.constraints, *_serendipity(nodes)))


def _serendipity(nodes: DeckNodes) -> list[DeckLoad]:
    kinds = nodes.types
    if not kinds or not kinds <= {"C3D20", "CPE8"}:
        return []
    return [DeckLoad("", "hhr.Serendipity()", 0.0, f"elements {', '.join(sorted(kinds))}")]


def _overlapping(state: Sequence[Imposed], parts: NamedParts) -> Iterator[Left]:
    """Supports and forces of which a later step gives some nodes anew: their sets are not split."""
    # nodes by numbers with one value have one place
    rows = {(imposed.block.keyword, imposed.component, imposed.place): imposed for imposed in state}
    first: dict[tuple[str, int], np.ndarray] = {}
    for (keyword, component, name), imposed in sorted(
        rows.items(), key=lambda keyed: keyed[1].since
    ):
        target = parts.place(name) if keyword in ("BOUNDARY", "CLOAD") else None
        if target is not None:
            nodes = parts.nodes(target)
            since = first.setdefault((keyword, component), np.full(len(parts.raw.points), np.inf))
            if since[nodes].min() < imposed.since:
                yield imposed.block.left(
                    "nodes of it have values of an earlier step too: both act here"
                )
            since[nodes] = np.minimum(since[nodes], imposed.since)


def _perturbed(blocks: Sequence[KeywordBlock]) -> Iterator[Left]:
    """Steps that are linear responses to small changes, which several steps of a deck add up."""
    steps = of_kind(blocks, "STEP")
    for block in steps:
        if "PERTURBATION" in block.options and len(steps) > 1:
            yield block.left(
                "PERTURBATION: loads of earlier steps stay here, and the response is that of both"
            )


def _creeping(blocks: Sequence[KeywordBlock], sections: Sequence[Section]) -> Iterator[Left]:
    """Steps without creep of a deck with creep."""
    if any(
        "Norton" in section.material.law or "Creep" in section.material.law for section in sections
    ):
        for block in of_kind(blocks, "STATIC"):
            yield block.left("bodies creep in this step too: shorten its leg if they must not")


def _out_of_reach(
    whole: NamedParts,
    parts: NamedParts,
    supports: Sequence[Support],
    constraints: Sequence[DeckLoad],
) -> tuple[Pair, ...]:
    """A plane out of reach, of a surface of the whole mesh, or of a section if the file names no
    other surface.

    A set of nodes may hold no whole facet of the mesh that is cut. Nodes of rigid motions may all
    be imposed.
    """
    rigid = [
        name
        for constraint in constraints
        if "RigidMotion" in constraint.text
        for name in whole.named_in(constraint.text)
    ]
    held = [*supports, *(Support(name, k, 0.0, "") for name in rigid for k in range(whole.raw.dim))]
    pairs = whole.out_of_reach(held, parts.surfaces)
    unnamed = any(repr(OUTSIDE_SURFACE) in pair.text for pair in pairs)
    return parts.out_of_reach(supports) if unnamed and parts is not whole else pairs


def hypothesis_of(blocks: Sequence[KeywordBlock], parts: NamedParts, todo: list[Left]) -> str:
    """Hypothesis of the first plane elements; elements of other hypotheses become TODO lines.

    Args:
        blocks: keyword blocks of the deck, in the order of its lines.
        parts: bodies, surfaces and sets of the mesh.
        todo: list to which TODO lines are appended.
    """
    if parts.raw.dim == 3:
        return "solid"
    kinds = [
        (_HYPOTHESES.get(block.word("TYPE")[:3]), block) for block in of_kind(blocks, "ELEMENT")
    ]
    first = next((kind for kind, _ in kinds if kind), "plane_strain")
    todo += [
        block.left(f"all elements are those of {first}")
        for kind, block in kinds
        if kind not in (None, first)
    ]
    return first


def _sections(
    blocks: Sequence[KeywordBlock],
    materials: Mapping[str, DeckMaterial],
    parts: NamedParts,
    hypothesis: str,
    todo: list[Left],
) -> tuple[list[Section], float]:
    """Bodies, and the thickness of plane ones, a length.

    SceneError for a section without a material.
    """
    sections: list[Section] = []
    thickness = 1.0
    free = np.ones(len(parts.raw.cells), dtype=bool)
    for block, tags in _counting(blocks, parts, todo):
        name = block.option("MATERIAL")
        if not tags:
            todo.append(block.left(f"set {block.option('ELSET')} holds no cells of the mesh"))
            continue
        if name.upper() not in materials:
            raise SceneError(
                f"{block.source} *SOLID SECTION: material '{name}' has no *ELASTIC with E and nu"
            )
        for tag in tags:
            free[parts.raw.bodies[tag]] = False
            sections.append(Section(tag, materials[name.upper()], block.source))
        if block.rows and block.rows[0][0] and parts.raw.dim == 2:
            before, thickness = thickness, block.number(block.rows[0][0])
            if len(sections) > len(tags) and hypothesis != "axisymmetric" and thickness != before:
                todo.append(
                    block.left(
                        f"'{tags[0]}' is {thickness:g} thick, and bodies before it {before:g}; a "
                        "scene has one thickness: multiply moduli of these, and pressures on "
                        f"them, by {before / thickness:g}"
                    )
                )
    if not sections:
        lost = [
            parts.raw.left_out[block.word("ELSET")]
            for block in of_kind(blocks, "SOLID SECTION")
            if block.word("ELSET") in parts.raw.left_out
        ]
        reason = "; ".join(lost) or "give its bodies materials"
        raise SceneError(f"{blocks[0].file} has no *SOLID SECTION with cells of the mesh: {reason}")
    if free.any():
        todo.append(
            Left(
                sections[-1].source,
                "*SOLID SECTION",
                f"{int(free.sum())} cells belong to no section",
            )
        )
    return sections, thickness


def _counting(
    blocks: Sequence[KeywordBlock], parts: NamedParts, todo: list[Left]
) -> Iterator[tuple[KeywordBlock, list[Tag]]]:
    """Sections with their bodies: of several for one cell the last counts, as in CalculiX 2.20, and
    others are left.
    """
    sections = [
        (block, _bodies_of(blocks, block, parts)) for block in of_kind(blocks, "SOLID SECTION")
    ]
    titles = [f"{block.source} *SOLID SECTION" for block, _ in sections]
    for (block, tags), remaining in zip(
        sections, bodies_of(parts, [tags for _, tags in sections], titles), strict=True
    ):
        if {*tags} - {*remaining}:
            todo.append(block.left("later sections count for cells of it"))
        if remaining or not tags:
            yield block, remaining


def _bodies_of(
    blocks: Sequence[KeywordBlock], section: KeywordBlock, parts: NamedParts
) -> list[Tag]:
    """Body of the set of a section, or one for each instance of the part that the section is in."""
    name = section.option("ELSET")
    before = blocks[: next(k for k, block in enumerate(blocks) if block is section)]
    around = of_kind(before, "PART", "END PART")
    part_name = around[-1].word("NAME") if around else ""
    instances = [
        block
        for block in of_kind(blocks, "INSTANCE")
        if part_name and block.word("PART") == part_name
    ]
    full = {f"{block.option('NAME')}.{name}".upper() for block in instances}
    tags = [tag for tag in parts.raw.bodies if str(tag).upper() in full]
    single = parts.body(name)
    return [single] if single is not None and len(tags) < 2 else tags
