"""Decks of CalculiX and Abaqus: blocks of keywords, and what they say of bodies, supports, loads and contacts.

The sets and surfaces are those that the mesh reader names. It also names the nodes and faces that loads and supports
give by their numbers, see :func:`~hhr_dolfinx.geometries.abaqus_deck.name_of_loaded`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.geometries.abaqus_deck import blocks
from hhr_dolfinx.geometries.raw_mesh import RawMesh
from hhr_dolfinx.plugins.decks.deck import Deck, Left, Material, Section
from hhr_dolfinx.plugins.decks.inp_contacts import pairs_of
from hhr_dolfinx.plugins.decks.inp_loads import loads_of
from hhr_dolfinx.plugins.decks.inp_materials import OF_MATERIALS, materials_of
from hhr_dolfinx.plugins.decks.inp_steps import imposed_of, initial_temperatures, seconds_of
from hhr_dolfinx.plugins.decks.inp_words import Block
from hhr_dolfinx.plugins.decks.named import NamedParts

_KNOWN = frozenset(
    "NODE|ELEMENT|NSET|ELSET|SURFACE|HEADING|INCLUDE|PART|END PART|ASSEMBLY|END ASSEMBLY|INSTANCE|END INSTANCE|PREPRINT|"
    "SOLID SECTION|STEP|END STEP|STATIC|VISCO|AMPLITUDE|BOUNDARY|CLOAD|DLOAD|DSLOAD|TEMPERATURE|INITIAL CONDITIONS|"
    "CONTACT PAIR|SURFACE INTERACTION|SURFACE BEHAVIOR|FRICTION|CLEARANCE|RIGID BODY|PHYSICAL CONSTANTS|NGEN|NFILL|"
    "NODE FILE|EL FILE|NODE PRINT|EL PRINT|CONTACT FILE|CONTACT PRINT|OUTPUT|NODE OUTPUT|ELEMENT OUTPUT|FILE FORMAT|"
    "CONTACT OUTPUT|ENERGY OUTPUT|ENERGY PRINT|ENERGY FILE|RESTART|MONITOR|PRINT|SECTION PRINT|CONTROLS|TIME POINTS|"
    "SOLUTION TECHNIQUE|SOLVER CONTROLS|CONTACT CONTROLS|ELEMENT FILE|FILTER|ORIENTATION|FACE PRINT".split("|")
)
"""Keywords that are read, or have no effect on the answer."""
_REASONS = {
    "EQUATION": "linear constraints of displacements have no counterpart",
    "MPC": "constraints of several nodes have no counterpart",
    "TIE": "surfaces are not tied: join the meshes, or give the pair a friction that holds",
    "COUPLING": "a reference point has no counterpart: impose the displacement or a traction on the surface itself",
    "DISTRIBUTING COUPLING": "give the surface a traction instead",
    "KINEMATIC": "part of a coupling",
    "DISTRIBUTING": "part of a coupling",
    "PRE-TENSION SECTION": "preload of bolts has no counterpart: shorten the bolt by an Eigenstrain",
    "SHELL SECTION": "shells have no counterpart",
    "BEAM SECTION": "beams have no counterpart",
    "MEMBRANE SECTION": "membranes have no counterpart",
    "SPRING": "springs have no counterpart",
    "DASHPOT": "dashpots have no counterpart",
    "TRANSFORM": "supports and forces in local axes have no counterpart: those of these nodes act along the axes here",
    "CONTACT": "general contact has no counterpart: name the pairs of surfaces that may touch",
    "CONTACT INCLUSIONS": "part of general contact",
    "DYNAMIC": "inertia is left out: the state is that at rest",
    "FREQUENCY": "there are no frequencies: the state is that at rest",
    "BUCKLE": "there is no buckling analysis: the state is that before it",
    "HEAT TRANSFER": "temperatures are not solved for: give them as loads",
    "UNCOUPLED TEMPERATURE-DISPLACEMENT": "temperatures are not solved for: give them as loads",
    "COUPLED TEMPERATURE-DISPLACEMENT": "temperatures are not solved for: give them as loads",
    "MODEL CHANGE": "parts that appear or vanish have no counterpart",
}
_HYPOTHESES = {"CPE": "plane_strain", "CPS": "plane_stress", "CAX": "axisymmetric", "C3D": "solid"}


def read_inp(path: Path, raw: RawMesh) -> Deck:
    """Read bodies, supports, loads and contacts of a deck with the mesh ``raw``.

    Raises:
        SceneError: for a deck without sections, or with a material that is not elastic, with the line.
        FileContentError: for words that are not the numbers that a keyword needs, with the line.
    """
    found = tuple(Block(path.name, *block) for block in blocks(path))
    parts = NamedParts(raw, path)
    materials, left = materials_of(found)
    sections, thickness, lost = _sections(found, materials, parts)
    state = imposed_of(found)
    tags = {item.tag: item.material for item in sections}
    supports, loads, missing = loads_of(state, parts, tags, thickness, tuple(initial_temperatures(found)))
    pairs, pairless = pairs_of(found, parts, state)
    if not pairs and (plane := parts.out_of_reach(supports)) is not None:
        pairs = [plane]
    left = [*_ignored(found), *left, *lost, *missing, *pairless]
    return Deck(
        path,
        _hypothesis(found, raw),
        tuple(sections),
        tuple(supports),
        tuple(loads),
        tuple(pairs),
        tuple(sorted(left, key=lambda item: int(item.source.rpartition(":")[2] or 0))),
        seconds_of(found),
    )


def _hypothesis(found: Sequence[Block], raw: RawMesh) -> str:
    for block in found:
        kind = block.options.get("TYPE", "")[:3].upper()
        if block.keyword == "ELEMENT" and kind in _HYPOTHESES and (kind == "C3D") == (raw.dim == 3):
            return _HYPOTHESES[kind]
    return "solid" if raw.dim == 3 else "plane_strain"


def _sections(
    found: Sequence[Block], materials: Mapping[str, Material], parts: NamedParts
) -> tuple[list[Section], float, list[Left]]:
    """Bodies, the thickness of plane ones, and sections without cells."""
    sections = []
    left = []
    thickness = 1.0
    free = np.ones(len(parts.raw.cells), dtype=bool)
    for block in found:
        if block.keyword != "SOLID SECTION":
            continue
        tag = parts.body(block.option("ELSET"))
        if tag is None:
            left.append(block.left(f"set {block.option('ELSET')} holds no cells of the mesh"))
            continue
        name = block.option("MATERIAL")
        if name.upper() not in materials:
            raise SceneError(
                f"{block.source} *SOLID SECTION: material '{name}' has no *ELASTIC with E and nu in the deck"
            )
        if not free[parts.raw.bodies[tag]].all():
            raise SceneError(f"{block.source} *SOLID SECTION: cells of '{tag}' are in another section too")
        free[parts.raw.bodies[tag]] = False
        if block.rows and block.rows[0][0] and parts.raw.dim == 2:
            thickness = block.number(block.rows[0][0])
        sections.append(Section(tag, materials[name.upper()], block.source))
    if not sections:
        raise SceneError(f"{found[0].file if found else 'the deck'} has no *SOLID SECTION with cells of the mesh: "
                         "give its bodies materials")  # fmt: skip
    if free.any():
        left.append(Left(sections[-1].source, "*SOLID SECTION", f"{int(free.sum())} cells belong to no section"))
    return sections, thickness, left


def _ignored(found: Sequence[Block]) -> Iterator[Left]:
    """Blocks without counterpart, each keyword of the reasons once for each block."""
    for block in found:
        if block.keyword in _REASONS:
            yield block.left(_REASONS[block.keyword])
        elif block.keyword == "STEP" and "NLGEOM" in block.options and block.options["NLGEOM"].upper() != "NO":
            yield block.left("NLGEOM, large displacements: strains and rotations are small here")
        elif block.keyword not in _KNOWN and block.keyword not in OF_MATERIALS:
            yield block.left("not read")
