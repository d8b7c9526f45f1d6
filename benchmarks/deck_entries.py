"""Decks of the makes of CalculiX' own tests and examples, written anew: small, with their kinds of
cells and keywords.

References are closed forms, or displacements that CalculiX 2.20 prints for these very decks
(``--again`` runs it).
"""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from deck_writer import Box, Writer, at, both

import hhr_dolfinx as hhr


@dataclass(frozen=True)
class Answer:
    """Printed rows of ``hhr solve`` of a scene file by name, and places and displacements of nodes,
    (n, 3).
    """

    scene: Path
    rows: dict[str, float]
    points: np.ndarray
    moved: np.ndarray

    def energy(self) -> float:
        """Elastic energy of the scene, which is solved once more for it."""
        spec = importlib.util.spec_from_file_location(self.scene.stem, self.scene)
        assert spec is not None and spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        given = replace(module.scene, outputs=(hhr.ElasticEnergy("energy"),))
        return float(hhr.FullOrderModel(given).solve(given.parameters.middle).outputs()["energy"])

    def at(self, place: tuple[float, ...], axis: int) -> float:
        """Displacement of the node nearest to a place, one of a pair of coinciding ones."""
        return float(self.moved[np.linalg.norm(self.points - place, axis=1).argmin(), axis])

    def row(self, name: str) -> float:
        """The first row whose name begins so."""
        return next(value for key, value in self.rows.items() if key.startswith(name))


Read = Callable[[Answer], float]


@dataclass(frozen=True)
class Entry:
    """A deck: ``write`` makes its text.

    A text as ``reference`` is part of a sentence that refuses it.
    """

    source: str
    kind: str
    write: Callable[[], str]
    quantity: str
    read: Read
    reference: float | str
    by: str = "closed form"
    within: float = 0.01


@dataclass(frozen=True)
class Case:
    """A scene: ``run`` gives its number.

    A text as ``reference`` is part of a sentence that refuses it.
    """

    source: str
    kind: str
    run: Callable[[Path], float]
    quantity: str
    reference: float | str
    by: str = "closed form"
    within: float = 0.01


def node(place: tuple[float, ...], axis: int) -> Read:
    """Displacement of a node."""
    return lambda answer: answer.at(place, axis)


def row(name: str) -> Read:
    """A row of what is printed."""
    return lambda answer: answer.row(name)


FORCE, PRESSURE = row("sum of"), row("largest pressure 0")


def cubes(
    kind: str,
    poisson: float,
    law: str,
    pair: str,
    step: str,
    comma: str = "",
    more: str = "",
    cells: tuple = (1, 1),
) -> tuple[Writer, Box, Box]:
    """Two unit cubes, one on the other: BOTTOM, TOP, the nodes LINE of the upper one, SLAVE on
    MASTER; then a step.
    """
    deck = Writer()
    low = deck.box("EALL", kind, (cells[0],) * 3, (0, 0, 0), (1, 1, 1), comma=comma)
    up = deck.box("EALL", kind, (cells[1],) * 3, (0, 0, 1), (1, 1, 2), comma=comma)
    deck.nset("BOTTOM", low.nodes(at(2, 0)))
    deck.nset("TOP", up.nodes(at(2, 2)))
    deck.nset("CORNER", up.nodes(both(at(2, 2), at(0, 1), at(1, 1))))
    deck.surface("MASTER", low.faces(at(2, 1)))
    deck.surface("SLAVE", up.faces(at(2, 1)))
    deck.surface("LID", up.faces(at(2, 2)))
    deck.material(poisson=poisson, more=more)
    deck.section()
    if law:
        deck.pair("SLAVE", "MASTER", law, pair)
    deck.add("*BOUNDARY/BOTTOM, 1, 3")
    deck.add(
        step.replace(
            "{lid}", "/".join(f"{cell}, P{face}, 100." for cell, face in up.faces(at(2, 2)))
        )
    )
    deck.add("*NODE PRINT, NSET=NALL/U/*END STEP")
    return deck, low, up


HELD = "*BOUNDARY/TOP, 1, 2/"
PRESSED = "*STEP, NLGEOM/*STATIC/.5, 1./*DLOAD/{lid}"
SQUASH = -100 * 2 / 210000  # of two cubes in series under a pressure of 100
STIFF = "LINEAR/1.E9"


def _cubes(*words: str | float, **options: object) -> Callable[[], str]:
    return lambda: cubes(*words, **options)[0].text  # type: ignore[arg-type]


def equal_nodes() -> str:
    """Four equations let the lid of the lower cube move as one; its slave is a set of nodes."""
    deck = Writer()
    low = deck.box("EALL", "C3D8", (1, 1, 1), (0, 0, 0), (1, 1, 1))
    up = deck.box("EALL", "C3D8", (1, 1, 1), (0.25, 0.25, 1), (0.75, 0.75, 2))
    deck.nset("BOTTOM", low.nodes(at(2, 0)))
    deck.nset("TOP", up.nodes(at(2, 2)))
    lid = low.nodes(at(2, 1))
    deck.add("*EQUATION/" + "/".join(f"2/{one}, 3, 1., {lid[0]}, 3, -1." for one in lid[1:]))
    deck.nset("SIDES", [*lid, *up.nodes(at(2, 1)), *up.nodes(at(2, 2))])
    deck.material()
    deck.section()
    deck.surface("MASTER", low.faces(at(2, 1)))
    deck.nodal_surface("SLAVE", up.nodes(at(2, 1)))
    deck.pair("SLAVE", "MASTER", "LINEAR/1.E9, 3.", "NODE TO SURFACE")
    deck.add("*BOUNDARY/BOTTOM, 1, 3/SIDES, 1, 2/*STEP, NLGEOM/*STATIC/*CLOAD/TOP, 3, -25.")
    deck.add("*NODE PRINT, NSET=NALL/U/*END STEP")
    return deck.text


def stepped_blocks(kind: str, small: int, wide: int, pair: str, step: str, more: str = "") -> str:
    """A cube on one of twice its side; their nodes do not meet; symmetric in x and y."""
    deck = Writer()
    low = deck.box("EALL", kind, (wide, wide, wide), (0, 0, -2), (2, 2, 0))
    up = deck.box("EALL", kind, (small, small, small), (0, 0, 0), (1, 1, 1))
    deck.nset("BOTTOM", low.nodes(at(2, -2)))
    deck.nset("TOP", up.nodes(at(2, 1)))
    for axis in (0, 1):
        deck.nset(f"SYM{axis + 1}", [*low.nodes(at(axis, 0)), *up.nodes(at(axis, 0))])
    deck.surface("MASTER", low.faces(at(2, 0)))
    deck.surface("SLAVE", up.faces(at(2, 0)))
    deck.surface("LID", up.faces(at(2, 1)))
    deck.material()
    deck.section()
    deck.pair("SLAVE", "MASTER", "LINEAR/1.E8, 3.", pair, more)
    deck.add("*BOUNDARY/BOTTOM, 1, 3/SYM1, 1/SYM2, 2")
    deck.add(
        step.replace(
            "{lid}", "/".join(f"{cell}, P{face}, 100." for cell, face in up.faces(at(2, 1)))
        )
    )
    deck.add("*NODE PRINT, NSET=NALL/U/*END STEP")
    return deck.text


def rings(kind: str, step: str, more: str = "", friction: str = "", section: str = "") -> str:
    """Two rings in the plane of the axis, 0.9 to 1 and 1 to 1.2, 0.1 high.

    The inner one is a set N1.
    """
    deck = Writer()
    inner = deck.box("EALL", kind, (2, 2), (0.9, 0), (1, 0.1))
    outer = deck.box("EALL", kind, (4, 2), (1, 0), (1.2, 0.1))
    deck.material(more=more)
    deck.section(more=section)
    deck.surface("SLAVE", outer.faces(at(0, 1)))
    deck.surface("MASTER", inner.faces(at(0, 1)))
    deck.pair("SLAVE", "MASTER", "LINEAR/1.E9, 3.", more=friction)
    deck.nset("N1", inner.numbers)
    deck.nset("N2", outer.numbers)
    deck.nset("LOW", [*inner.nodes(at(1, 0)), *outer.nodes(at(1, 0))])
    deck.add("*INITIAL CONDITIONS, TYPE=TEMPERATURE/NALL, 273./*BOUNDARY/LOW, 2, 2")
    deck.add(step + "/*NODE PRINT, NSET=NALL/U/*END STEP")
    return deck.text


def shrunk() -> float:
    """Pressure between the rings after 727 K at 12e-6 in the inner one, by Lame: ends are free,
    plane stress.
    """
    a, b, c, young, poisson = 0.9, 1.0, 1.2, 210e3, 0.3
    inner = ((b**2 + a**2) / (b**2 - a**2) - poisson) / young
    outer = ((c**2 + b**2) / (c**2 - b**2) + poisson) / young
    return 727 * 12e-6 / (inner + outer)


def beam(
    kind: str = "C3D20R",
    counts: tuple[int, int, int] = (2, 2, 8),
    cut: bool = False,
    shifted: bool = False,
) -> tuple[Writer, Box, Box]:
    """A beam along z, 1 x 1 x 8, in one or two boxes: FIX at z = 0, LOAD at z = 8, its surface
    END.
    """
    deck = Writer()
    if cut:
        there = (counts[0] + shifted, counts[1] + shifted, counts[2] // 2)
        low = deck.box("EALL", kind, (*counts[:2], counts[2] // 2), (0, 0, 0), (1, 1, 4))
        up = deck.box("EALL", kind, there, (0, 0, 4), (1, 1, 8))
        deck.surface("INDF", low.faces(at(2, 4)))
        deck.surface("DEPF", up.faces(at(2, 4)))
        deck.nodal_surface("DEPN", up.nodes(at(2, 4)))
    else:
        low = up = deck.box("EALL", kind, counts, (0, 0, 0), (1, 1, 8))
    deck.nset("FIX", low.nodes(at(2, 0)))
    deck.nset("LOAD", up.nodes(at(2, 8)))
    deck.surface("END", up.faces(at(2, 8)))
    deck.material()
    deck.section()
    deck.add("*BOUNDARY/FIX, 1, 3")
    return deck, low, up


def beam_with(
    blocks: str, kind: str = "C3D20", cut: bool = False, shifted: bool = False, extra: bool = False
) -> str:
    """A beam, blocks with {reference}, a node in the middle of its end, and what is printed."""
    deck, _, _ = beam(kind, cut=cut, shifted=shifted)
    names = (
        {"reference": deck.node(0.5, 0.5, 8.0), "turns": deck.node(0.5, 0.5, 8.0)} if extra else {}
    )
    deck.add(blocks.format(**names) + "/*NODE PRINT, NSET=NALL/U/*END STEP")
    return deck.text


def equal_end() -> str:
    """The end of a beam stays flat: equations with a node that is in no element, which is
    loaded.
    """
    deck, _, up = beam("C3D8", (2, 2, 8))
    free = deck.node(0.5, 0.5, 9.0)
    end = up.nodes(at(2, 8))
    deck.add("*EQUATION/" + "/".join(f"2/{one}, 2, 1., {free}, 2, -1." for one in end))
    deck.add(f"*STEP/*STATIC/*CLOAD/{free}, 2, 9./*NODE PRINT, NSET=NALL/U/*END STEP")
    return deck.text


def half_and_half() -> str:
    """A node between two others, half and half, and free of elements.

    The beam is loaded at its end.
    """
    deck, _, up = beam("C3D8", (2, 2, 8))
    free = deck.node(0.5, 0.0, 7.9)
    one, two = (up.nodes(both(at(0, x), at(1, 0), at(2, 8)))[0] for x in (0, 1))
    for axis in (1, 2, 3):
        deck.add(f"*EQUATION/3/{free}, {axis}, 1., {one}, {axis}, -.5, {two}, {axis}, -.5")
    deck.add("*STEP/*STATIC/*CLOAD/LOAD, 2, 1./*NODE PRINT, NSET=NALL/U/*END STEP")
    return deck.text


def pretension(kind: str, load: str) -> str:
    """A bar along x, 4 x 1 x 1 or in the plane, held at both ends in x, cut in its middle by a
    pretension section.
    """
    deck = Writer()
    dim = 2 if kind.startswith("C") and kind[1:3] == "AX" else 3
    counts = (4, 2) if dim == 2 else (4, 1, 1)
    axis = 1 if dim == 2 else 0
    counts = (2, 4) if dim == 2 else counts
    upper = (1, 4) if dim == 2 else (4, 1, 1)
    bar = deck.box("EALL", kind, counts, (0,) * dim, upper)
    middle = [(cell, face) for cell, face in bar.faces(at(axis, 2)) if (cell - bar.first) % 4 == 1]
    deck.surface("CUT", middle)
    deck.nset("ENDS", [*bar.nodes(at(axis, 0)), *bar.nodes(at(axis, 4))])
    deck.material(poisson=0.0)
    deck.section()
    reference = deck.node(*(0.0,) * 3)
    if dim == 3:
        deck.nset("SIDE", [*bar.nodes(at(1, 0))])
        deck.nset("BACK", [*bar.nodes(at(2, 0))])
        deck.add("*BOUNDARY/ENDS, 1, 1/SIDE, 2, 2/BACK, 3, 3")
        deck.add(f"*PRE-TENSION SECTION, SURFACE=CUT, NODE={reference}/1., 0., 0.")
    else:
        deck.add("*BOUNDARY/ENDS, 1, 2")
        deck.add(f"*PRE-TENSION SECTION, SURFACE=CUT, NODE={reference}/0., 1.")
    deck.add(f"*STEP/*STATIC/{load.format(reference)}/*NODE PRINT, NSET=NALL/U/*END STEP")
    return deck.text


def slabs() -> str:
    """Two slabs of different materials on one another, pressed and sheared by forces at nodes."""
    deck = Writer()
    one = deck.box("E1", "C3D8", (6, 1, 3), (0, 0, 0), (0.02, 0.005, 0.01))
    two = deck.box("E2", "C3D8", (8, 1, 4), (0, 0, 0.01), (0.02, 0.005, 0.02))
    deck.material(15e9, 0.2, "M1")
    deck.material(20e9, 0.4, "M2")
    deck.section("E1", "M1")
    deck.section("E2", "M2")
    deck.nset("BOTTOM", one.nodes(at(2, 0)))
    deck.nset("BACK", [*one.nodes(at(1, 0)), *two.nodes(at(1, 0))])
    deck.nset("LEFT", two.nodes(at(0, 0)))
    deck.nset("TOP", two.nodes(at(2, 0.02)))
    deck.surface("MASTER", one.faces(at(2, 0.01)))
    deck.surface("SLAVE", two.faces(at(2, 0.01)))
    deck.pair("SLAVE", "MASTER", "LINEAR/1.E15, 3.")
    deck.add(
        "*BOUNDARY/BOTTOM, 1, 3/BACK, 2/LEFT, 1/*STEP/*STATIC/*CLOAD/TOP, 3, -100./TOP, 1, 10."
    )
    deck.add("*NODE PRINT, NSET=NALL/U/*END STEP")
    return deck.text


def plates(kind: str = "CPS8R", temperature: str = "") -> str:
    """A plate of the plane on another one, thickness 2, pulled by forces at the nodes of its lower
    edge.
    """
    deck = Writer()
    one = deck.box("EALL", kind, (1, 1), (0, 0), (4, 4))
    two = deck.box("CONUP", kind, (1, 1), (0, 4), (4, 8))
    deck.add("*ELSET, ELSET=BOTH/EALL, CONUP")
    deck.material(210000.0, 0.0)
    deck.section("BOTH", more="2.")
    deck.surface("LOWER", one.faces(at(1, 4)))
    deck.surface("UPPER", two.faces(at(1, 4)))
    deck.add("*CONTACT PAIR, INTERACTION=IN1, SMALL SLIDING, TYPE=SURFACE TO SURFACE/UPPER, LOWER")
    deck.add(
        "*SURFACE INTERACTION, NAME=IN1/*SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE=LINEAR/1.E8, 3."
    )
    deck.nset("FLOOR", one.nodes(at(1, 0)))
    deck.nset("LID", two.nodes(at(1, 8)))
    deck.nset("SIDE", two.nodes(at(0, 0)))
    ends = [two.nodes(both(at(1, 8), at(0, x)))[0] for x in (0, 4)]
    middle = two.nodes(both(at(1, 8), at(0, 2)))[0]
    forces = f"{ends[0]}, 2, -100./{ends[1]}, 2, -100./{middle}, 2, -400."
    deck.add(
        "*BOUNDARY/FLOOR, 1, 2, 0/LID, 1, 1, 0/SIDE, 1, 1/*STEP, NLGEOM/*STATIC/1.E-2, "
        f"1./*CLOAD/{forces}"
    )
    deck.add("*NODE PRINT, NSET=NALL/U/*END STEP")
    return deck.text


def disc(turns: float = 30.0) -> tuple[Callable[[np.ndarray], np.ndarray], float]:
    """Bend (radius, degrees, z) into a sector."""

    def bend(points: np.ndarray) -> np.ndarray:
        angle = np.radians(points[:, 1])
        return np.stack(
            [points[:, 0] * np.cos(angle), points[:, 0] * np.sin(angle), points[:, 2]], axis=1
        )

    return bend, turns


def sectors(second: str) -> str:
    """Sectors of 30 degrees of two discs on one another, cyclic symmetry by ties.

    A pressure, or another step.
    """
    deck = Writer()
    bend, turn = disc()
    low = deck.box("ES1", "C3D8", (4, 3, 2), (0.5, 0, 0), (1, turn, 0.25), bend)
    up = deck.box("ES2", "C3D8", (4, 3, 2), (0.5, 0, 0.25), (1, turn, 0.5), bend)
    deck.add("*ELSET, ELSET=EALL/ES1, ES2")
    for number, box in enumerate((low, up), 1):
        deck.nodal_surface(f"SDEP{number}", box.nodes(at(1, 0)))
        deck.nodal_surface(f"SIND{number}", box.nodes(at(1, turn)))
        deck.add(
            f"*TIE, NAME=T{number}, CYCLIC SYMMETRY, POSITION TOLERANCE=.001/SDEP{number}, "
            f"SIND{number}"
        )
        deck.add(
            f"*CYCLIC SYMMETRY MODEL, N=12, TIE=T{number}, ELSET=ES{number}/0., 0., 0., 0., 0., 1."
        )
    deck.material(poisson=0.0, more="*DENSITY/7.8E-9")
    deck.section()
    deck.surface("MASTER", low.faces(at(2, 0.25)))
    deck.surface("SLAVE", up.faces(at(2, 0.25)))
    deck.pair("SLAVE", "MASTER", "LINEAR/1.E9")
    deck.nset("FLOOR", low.nodes(at(2, 0)))
    deck.nset("RIM", up.nodes(at(0, 1)))
    deck.add("*BOUNDARY/FLOOR, 1, 3")
    lid = "/".join(f"{cell}, P{face}, 100." for cell, face in up.faces(at(2, 0.5)))
    deck.add(second.replace("{lid}", lid) + "/*NODE PRINT, NSET=NALL/U/*END STEP")
    return deck.text


def stops() -> str:
    """A beam between two stops, C3D20 and C3D8: its end is pushed on one of them."""
    deck, _, up = beam("C3D20", (1, 1, 8))
    blocks = [deck.box("EALL", "C3D8", (2, 2, 2), (x, 0, 7), (x + 1, 1, 8)) for x in (1.05, -1.05)]
    for number, (block, x) in enumerate(zip(blocks, (1.0, 0.0), strict=True), 1):
        deck.surface(f"SLAV{number}", up.faces(at(0, x)))
        deck.surface(f"MAST{number}", block.faces(at(0, 1.05 if number == 1 else -0.05)))
        deck.nset(f"BACK{number}", block.nodes(at(0, 2.05 if number == 1 else -1.05)))
    deck.add("*BOUNDARY/BACK1, 1, 3/BACK2, 1, 3")
    deck.add("*CONTACT PAIR, INTERACTION=SI1, TYPE=SURFACE TO SURFACE/SLAV1, MAST1/SLAV2, MAST2")
    deck.add(
        "*SURFACE INTERACTION, NAME=SI1/*SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE=LINEAR/1.E8, 3."
    )
    deck.add("*STEP, NLGEOM/*STATIC/*CLOAD/LOAD, 1, 20./*NODE PRINT, NSET=NALL/U/*END STEP")
    return deck.text


def wedges() -> str:
    """A bar of wedges under a pressure on its end."""
    deck = Writer()
    bar = deck.box("P3", "C3D15", (1, 1, 3), (0, 0, 0), (1, 1, 3))
    deck.material(29e6, 0.32, more="*DENSITY/7.E-4")
    deck.section("P3")
    deck.nset("FLOOR", bar.nodes(at(2, 0)))
    deck.nset("SIDE", bar.nodes(at(0, 0)))
    deck.nset("BACK", bar.nodes(at(1, 0)))
    lid = "/".join(f"{cell}, P{face}, 20." for cell, face in bar.faces(at(2, 3)))
    deck.add(f"*BOUNDARY/FLOOR, 3, 3/SIDE, 1, 1/BACK, 2, 2/*STEP/*STATIC/*DLOAD/{lid}")
    deck.add("*NODE PRINT, NSET=NALL/U/*END STEP")
    return deck.text


def floor_of_a_ball() -> str:
    """A block that falls on a floor of shells, in time."""
    deck = Writer()
    block = deck.box("EALL", "C3D8", (1, 1, 1), (0, 0, 1), (1, 1, 2))
    numbers = [
        deck.node(*place)
        for place in ((-1.0, -1.0, 0.0), (2.0, -1.0, 0.0), (2.0, 2.0, 0.0), (-1.0, 2.0, 0.0))
    ]
    deck.add(f"*ELEMENT, TYPE=S4, ELSET=FLOOR/800, {', '.join(map(str, numbers))}")
    deck.add("*NSET, NSET=NFLOOR/" + ", ".join(map(str, numbers)) + "/*BOUNDARY/NFLOOR, 1, 6")
    deck.material(1000.0, 0.3, more="*DENSITY/2.5E-9")
    deck.section()
    deck.add("*SHELL SECTION, ELSET=FLOOR, MATERIAL=EL/.01/*SURFACE, NAME=SFLOOR/FLOOR, SPOS")
    deck.nodal_surface("BALL", block.nodes(at(2, 1)))
    deck.pair("BALL", "SFLOOR", "EXPONENTIAL/.001, 1.", "NODE TO SURFACE")
    deck.add("*STEP, NLGEOM/*DYNAMIC/.001, .001/*DLOAD/EALL, GRAV, 9810., 0., 0., -1./*END STEP")
    return deck.text


def mixed_cubes() -> str:
    """Cells of both kinds of second order, tied by their contact."""
    deck = Writer()
    low = deck.box("EALL", "C3D20", (1, 1, 1), (0, 0, 0), (1, 1, 1))
    up = deck.box("EALL", "C3D10", (2, 2, 2), (0, 0, 1), (1, 1, 2))
    deck.nset("BOTTOM", low.nodes(at(2, 0)))
    deck.nset("TOP", up.nodes(at(2, 2)))
    deck.surface("MASTER", low.faces(at(2, 1)))
    deck.surface("SLAVE", up.faces(at(2, 1)))
    deck.material()
    deck.section()
    deck.pair("SLAVE", "MASTER", "TIED/1.E7", more="*FRICTION/1.E30, 1.E7")
    deck.add(
        "*STEP/*STATIC/*BOUNDARY/BOTTOM, 1, 3/TOP, 3, 3, -.01/*NODE PRINT, NSET=NALL/U/*END STEP"
    )
    return deck.text


def hertz(kind: str, radius: float = 50.0, push: float = 0.4) -> str:
    """A quarter of a half cylinder on a block, by a displacement of its top, along arcs that grow
    away from contact.
    """
    deck = Writer()

    def arcs(points: np.ndarray) -> np.ndarray:
        turn, depth = points[:, 0] ** 1.5 * np.pi / 2, points[:, 1]
        there = np.stack([radius * np.sin(turn), radius * (1 - np.cos(turn)), points[:, 2]], axis=1)
        middle = np.stack([points[:, 0] * radius, np.full_like(turn, radius), points[:, 2]], axis=1)
        return there + depth[:, None] ** 2 * (middle - there)

    def block(points: np.ndarray) -> np.ndarray:
        return np.stack(
            [60 * points[:, 0] ** 1.6, -60 * (1 - points[:, 1]) ** 2, points[:, 2]], axis=1
        )

    up = deck.box("EALL", kind, (50, 20), (0, 0), (1, 1), arcs)
    low = deck.box("EALL", kind, (60, 20), (0, 0), (1, 1), block)
    deck.surface("SCYL", up.faces(at(1, 0)))
    deck.surface("SBLK", low.faces(at(1, 1)))
    deck.nset("X0", [*up.nodes(at(0, 0)), *low.nodes(at(0, 0))])
    deck.nset("Y0", low.nodes(at(1, 0)))
    deck.nset("CONTROL", up.nodes(at(1, 1)))
    deck.material()
    deck.section()
    deck.pair("SCYL", "SBLK", "LINEAR/1.E7, .1, .01")
    deck.add(
        f"*BOUNDARY/X0, 1/Y0, 2/*STEP, NLGEOM, INC=200/*STATIC/*BOUNDARY/CONTROL, 2, 2, {-push}"
    )
    deck.add("*NODE PRINT, NSET=Y0, TOTALS=ONLY/RF/*NODE PRINT, NSET=NALL/U/*END STEP")
    return deck.text


def leaf_spring(
    cells: Sequence[int] = (8, 16, 24, 32, 40, 48), across: int = 2, kind: str = "C3D20"
) -> str:
    """A quarter of a leaf spring: half span 300 mm, half width 20, leaves 5 high, each 50 mm longer
    than the last.

    Leaves have ``cells`` along them.
    """
    deck = Writer()
    count = len(cells)
    leaves = [
        deck.box(
            "EALL",
            kind,
            (along, across, 1),
            (0, 0, 5 * (number - 1)),
            (50 * number, 20, 5 * number),
        )
        for number, along in enumerate(cells, 1)
    ]
    for number, (low, up) in enumerate(pairwise(leaves), 1):
        deck.surface(f"TOP{number}", low.faces(at(2, 5 * number)))
        deck.surface(f"BOT{number + 1}", up.faces(at(2, 5 * number)))
    for axis in (0, 1):
        deck.nset(f"SYM{axis + 1}", [one for leaf in leaves for one in leaf.nodes(at(axis, 0))])
    deck.nset("NSUPPORT", leaves[-1].nodes(both(at(0, 50 * count), at(2, 5 * (count - 1)))))
    deck.material()
    deck.section()
    deck.add("*BOUNDARY/SYM1, 1/SYM2, 2/NSUPPORT, 3/*SURFACE INTERACTION, NAME=LEAF")
    deck.add("*SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE=LINEAR/1000000, .001, 1")
    pairs = "/".join(f"TOP{number}, BOT{number + 1}" for number in range(1, count))
    deck.add(f"*CONTACT PAIR, INTERACTION=LEAF, TYPE=SURFACE TO SURFACE/{pairs}")
    deck.add("*STEP, NLGEOM, INC=500/*STATIC/.0001, 1/*BOUNDARY/SYM1, 3, 3, 10.")
    deck.add("*NODE PRINT, NSET=NSUPPORT, TOTALS=ONLY/RF/*NODE PRINT, NSET=NALL/U/*END STEP")
    return deck.text


def plate_of_nafems(radial: int = 6, around: int = 8) -> tuple[Writer, Box]:
    """NAFEMS LE10, a quarter of a thick elliptic plate: supports, the node MID of its outer face,
    and LID.
    """

    def ellipses(points: np.ndarray) -> np.ndarray:
        outwards, turn, z = points[:, 0] ** 1.3, points[:, 1], points[:, 2]
        wide, high = 2 + 1.25 * outwards, 1 + 1.75 * outwards
        return np.stack([wide * np.cos(turn), high * np.sin(turn), z], axis=1)

    deck = Writer()
    plate = deck.box(
        "PLATE", "C3D20", (radial, around, 4), (0, 0, 0), (1, np.pi / 2, 0.6), ellipses
    )
    deck.surface("LID", plate.faces(at(2, 0.6)))
    deck.nset("YSYM", plate.nodes(at(1, 0)))
    deck.nset("XSYM", plate.nodes(at(1, np.pi / 2)))
    deck.nset("RIM", plate.nodes(at(0, 1)))
    deck.nset("MID", plate.nodes(both(at(0, 1), at(2, 0.3))))
    return deck, plate


def stress_at_d(answer: Answer) -> float:
    """Stress along y in MPa at (2, 0, .6): gradients along the three edges of second order that
    meet there.
    """
    nodes = answer.points
    place = np.array((2.0, 0.0, 0.6))

    def along(direction: Callable[[np.ndarray], np.ndarray], axis: int) -> np.ndarray:
        edge = np.flatnonzero(direction(nodes))
        first = edge[np.argsort(np.abs(nodes[edge, axis] - place[axis]))[:3]]
        return np.hstack(
            [np.array([-3.0, 4.0, -1.0]) @ table[first] for table in (nodes, answer.moved)]
        )

    inner = np.abs(nodes[:, 0] ** 2 / 4 + nodes[:, 1] ** 2 - 1) < 1e-6
    top, flat = np.abs(nodes[:, 2] - 0.6) < 1e-9, np.abs(nodes[:, 1]) < 1e-9
    rows = [
        along(lambda _: top & flat, 0),
        along(lambda _: top & inner, 1),
        along(lambda _: inner & flat, 2),
    ]
    table = np.stack(rows)
    strain = np.linalg.solve(table[:, :3], table[:, 3:])
    shear, bulk = 210e3 / 2.6, 210e3 * 0.3 / (1.3 * 0.4)
    return float(2 * shear * strain[1, 1] + bulk * np.trace(strain))


def _le10() -> str:
    deck, _ = plate_of_nafems()
    deck.material()
    deck.section("PLATE")
    deck.add("*BOUNDARY/YSYM, 2/XSYM, 1/RIM, 1, 2/MID, 3/*STEP/*STATIC/*DSLOAD/LID, P, 1.")
    deck.add("*NODE PRINT, NSET=NALL/U/*END STEP")
    return deck.text


S2S, N2S = "SURFACE TO SURFACE", "NODE TO SURFACE"
BEAM_END = "*STEP/*STATIC/*CLOAD/LOAD, 2, 1."
HEATED = "*STEP, NLGEOM/*STATIC/*TEMPERATURE/N1, 1000./N2, 273."
TOP2, END = (1.0, 1.0, 2.0), (1.0, 1.0, 8.0)
LID_DOWN, END_ASIDE = node(TOP2, 2), node(END, 1)
LID = "displacement of the lid"
_SQUASHED = "displacement of a corner of the lid"
_BENT = "deflection of a corner of the end"


def _hertz_ratio(answer: Answer) -> float:
    line = 2 * answer.row("sum of")
    return answer.row("largest pressure 0") / float(
        np.sqrt(line * 210e3 / (2 * 0.91) / (np.pi * 50))
    )


def _leaf_force(answer: Answer) -> float:
    """Reaction of the support: contact without friction and gaps does no work, and the energy is
    half of R times 10.
    """
    return answer.energy() / 5


def _two(
    source: str,
    kind: str,
    law: str,
    step: str,
    reference: float | str = SQUASH,
    by: str = "closed form",
    quantity: str = _SQUASHED,
    read: Read = LID_DOWN,
    pair: str = S2S,
    poisson: float = 0.0,
    **more: Any,
) -> Entry:
    """Two cubes of cells whose name begins ``kind``."""
    write = partial(_cubes, kind.partition(",")[0], poisson, law, pair, step, **more)
    return Entry(source, kind, lambda: write()(), quantity, read, reference, by)


def _refused(source: str, kind: str, words: str, write: Callable[[], str]) -> Entry:
    return Entry(source, kind, write, "", FORCE, words)


CCX = "CalculiX 2.20"
HOT = (
    "*BOUNDARY/TOP, 1, 2/*INITIAL CONDITIONS, TYPE=TEMPERATURE/NALL, 273./*STEP, NLGEOM, "
    "INC=100/*STATIC/"
)
HOT += "*TEMPERATURE/NALL, 473./*DLOAD/{lid}"
ORTHOTROPIC = (
    "*ELASTIC, TYPE=ORTHO/5.E5, 1.572E5, 4.E5, 1.572E5, 1.572E5, 3.E5, 1.262E5, 1.262E5,/1.262E5, "
    "294."
)
SLIDES = (
    "*STEP, NLGEOM/*STATIC/*BOUNDARY/TOP, 1, 2/*DLOAD/{lid}/*END STEP/*STEP, "
    "NLGEOM/*STATIC/*BOUNDARY/TOP, 1, 1, .001"
)
CHANGED = (
    "*STEP/*STATIC/*DLOAD/{lid}/*END STEP/*STEP/*STATIC/*CHANGE FRICTION, "
    "INTERACTION=SI1/*FRICTION/.1, 80"
)
REMOVED = (
    "*BOUNDARY/TOP, 1, 3/*STEP, NLGEOM/*STATIC/*MODEL CHANGE, TYPE=CONTACT PAIR, REMOVE/SLAVE, "
    "MASTER"
)
EXPLICIT = "*STEP, INC=1000, NLGEOM/*DYNAMIC, EXPLICIT/1.E-8, 5.E-6/*DLOAD/{lid}"
CONDUCTS = "*BOUNDARY/TOP, 1, 3/*STEP/*HEAT TRANSFER/.0001, .006/*BOUNDARY/BOTTOM, 11, 11, 0."
RISING = "*AMPLITUDE, NAME=A1/0., 1., 1., 1./*STEP, NLGEOM/*STATIC/*DLOAD, AMPLITUDE=A1/{lid}"
ALONG = (
    "*CONTACT PAIR, INTERACTION=SI1, TYPE=SURFACE TO SURFACE/DEPF, INDF/*SURFACE INTERACTION, "
    "NAME=SI1/"
)
ALONG += (
    "*SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE=LINEAR/1.E9, 3./*BOUNDARY/LOAD, 1, 2/*STEP, NLGEOM/"
)
ALONG += "*STATIC/*BOUNDARY/LOAD, 3, 3, -.05"
COUPLED = "*COUPLING, REF NODE={reference}, SURFACE=END, CONSTRAINT NAME=CN1/"
KINEMATIC = (
    COUPLED + "*KINEMATIC/3, 3/*STEP/*STATIC/*CLOAD/{reference}, 3, 1./*BOUNDARY/{reference}, 4, 6"
)
DISTRIBUTED = COUPLED + "*DISTRIBUTING/2, 2/*STEP/*STATIC/*CLOAD/{reference}, 2, 9."
RIGID = (
    "*RIGID BODY, NSET=LOAD, REF NODE={reference}, ROT "
    "NODE={turns}/*STEP/*STATIC/*CLOAD/{reference}, 2, 1."
)
RUBBED = "*STEP, NLGEOM/*COUPLED TEMPERATURE-DISPLACEMENT"
GAP_HEAT = "*FRICTION/.3, 1.E5/*GAP HEAT GENERATION/.9, .3, 200."
FRICTION = "/*FRICTION/.2, 1.E8"
PULLED = HELD + "*STEP, NLGEOM/*STATIC/*DLOAD/{lid}/*CLOAD/"
CLEAR = "HARD/*CLEARANCE, MASTER=MASTER, SLAVE=SLAVE, VALUE=-0.1"
PUNCHED = "*STEP, NLGEOM/*STATIC/1., 1./*DLOAD/{lid}"
HELD_UP = "*BOUNDARY/TOP, 1, 3/*STEP, NLGEOM/*STATIC"
ADJUSTED = S2S + ", SMALL SLIDING, ADJUST=.005"
EDGE, EXPANDS = node((0.02, 0.005, 0.02), 0), "*EXPANSION/12.E-6"
FINE = (
    "CalculiX 2.20 on these cells, at 15 % of the load; 220.3 is its figure on the few cells of "
    "the example"
)


def _on_wide(source: str, kind: str, words: tuple[Any, ...], reference: float) -> Entry:
    return Entry(
        source, kind, lambda: stepped_blocks(*words), _SQUASHED, node((0, 0, 1), 2), reference, CCX
    )


def _bent(
    source: str, kind: str, blocks: str, reference: float, read: Read = END_ASIDE, **more: bool
) -> Entry:
    return Entry(
        source,
        kind,
        lambda: beam_with(blocks, **more),
        "displacement of a node",
        read,
        reference,
        CCX,
    )


def two_rings() -> str:
    """Rings in sets of their own."""
    text = rings("CAX8", HEATED, EXPANDS).replace("ELSET=EALL", "ELSET=INNER", 1)
    section = "*SOLID SECTION, ELSET=EALL"
    return text.replace(section, f"*SOLID SECTION, ELSET=INNER, MATERIAL=EL\n{section}")


def pulled() -> str:
    """A bar with a pretension force."""
    return pretension("C3D20R", "*CLOAD/{}, 1, -10.")


def shortened() -> str:
    """A bar that its pretension section shortens."""
    return pretension("CAX8", "*BOUNDARY/{}, 1, 1, .01")


RUBS = STIFF + FRICTION
OPPOSITE = node((0.0, 0.0, 2.0), 2)
ENTRIES = (
    _two("contact4", "C3D20, hard, pressure", "HARD", HELD + PRESSED),
    _two("cubes", "C3D20, friction", RUBS, HELD + PRESSED),
    _two("cubesmortar", "C3D20, mortar, friction", RUBS, HELD + PRESSED, pair="MORTAR"),
    _two(
        "testmortar",
        "C3D8, commas at the ends of lines",
        "HARD",
        HELD + PRESSED,
        pair="MORTAR",
        comma=",",
    ),
    _two(
        "contact2",
        "C3D20, no expansion",
        STIFF,
        HOT,
        -0.0008565314,
        CCX,
        poisson=0.3,
        more="*EXPANSION/0.",
    ),
    _two(
        "contact5",
        "C3D20, force at a corner",
        RUBS,
        PULLED + "CORNER, 3, -1.",
        -0.0009490737,
        CCX,
        read=OPPOSITE,
    ),
    _two(
        "fricloop",
        "C3D8, slides in two steps",
        RUBS,
        SLIDES,
        100.0,
        "closed form",
        "force",
        FORCE,
        poisson=0.3,
    ),
    _two(
        "friction2",
        "C3D8, CHANGE FRICTION",
        RUBS,
        HELD + CHANGED,
        100.0,
        "closed form",
        "force",
        FORCE,
        N2S,
        0.3,
    ),
    _two(
        "contact14",
        "C3D20, CLEARANCE -.1",
        CLEAR,
        HELD_UP,
        10500.0,
        "closed form",
        "pressure",
        PRESSURE,
    ),
    _two("contact13", "C3D20, MODEL CHANGE", "HARD", REMOVED, "MODEL CHANGE"),
    _two(
        "contact15",
        "C3D8, explicit dynamics",
        "HARD",
        HELD + EXPLICIT,
        "DYNAMIC",
        pair="MASSLESS",
        comma=",",
    ),
    _two(
        "contact7",
        "C3D8I, heat transfer",
        STIFF,
        CONDUCTS,
        "HEAT TRANSFER",
        pair=N2S,
        more="*CONDUCTIVITY/.01",
    ),
    _two("contact10", "C3D20, orthotropic", STIFF, HELD + PRESSED, "ELASTIC", more=ORTHOTROPIC),
    _two(
        "cubes, C3D4",
        "C3D4, do not meet",
        STIFF,
        HELD + PRESSED,
        100.0,
        "",
        "pressure",
        PRESSURE,
        cells=(2, 3),
    ),
    _two("cubes, C3D10", "C3D10, do not meet", STIFF, HELD + PRESSED, cells=(2, 3)),
    _on_wide(
        "cubespring",
        "C3D8, node to surface, do not meet",
        ("C3D8", 3, 4, N2S, PUNCHED),
        -0.0009793159,
    ),
    _on_wide(
        "punch1", "C3D20, small sliding, ADJUST", ("C3D20", 2, 3, ADJUSTED, PUNCHED), -0.001014528
    ),
    _on_wide(
        "friction1",
        "C3D8, friction",
        ("C3D8", 4, 4, N2S, RISING, "*FRICTION/.2, 1.E8"),
        -0.0009056599,
    ),
    Entry(
        "contact3",
        "C3D8, EQUATION, nodes",
        equal_nodes,
        LID,
        node((0.25, 0.25, 2), 2),
        -0.001771993,
        CCX,
    ),
    Entry(
        "hueeber1", "C3D8, two materials", slabs, "displacement of an edge", EDGE, 1.348123e-05, CCX
    ),
    Entry(
        "plate",
        "CPS8R, thickness",
        plates,
        "displacement of the lid",
        node((4, 8, 0), 1),
        -600 / 2 / 4 * 8 / 210000,
    ),
    Entry(
        "ring1",
        "CAX8, temperatures in one set",
        partial(rings, "CAX8", HEATED, EXPANDS),
        "pressure",
        PRESSURE,
        shrunk(),
    ),
    Entry("ring1, two sets", "CAX8, a heated ring", two_rings, "pressure", PRESSURE, shrunk()),
    _refused(
        "ring3",
        "CAX8, heat of friction",
        "COUPLED TEMP",
        partial(rings, "CAX8", RUBBED, friction=GAP_HEAT),
    ),
    Entry(
        "scheibe2f2f",
        "C3D8, cyclic symmetry",
        partial(sectors, PUNCHED),
        LID,
        node((1, 0, 0.5), 2),
        -50 / 210000,
    ),
    _bent(
        "beamptied1",
        "C3D20, TIE of nodes",
        "*TIE, NAME=T1/DEPN, INDF/" + BEAM_END,
        0.2034654,
        cut=True,
    ),
    _bent(
        "beamptied2",
        "C3D20, TIE",
        "*TIE, NAME=T1/DEPF, INDF/" + BEAM_END,
        0.3875936,
        cut=True,
        shifted=True,
    ),
    _bent("beamptied3", "C3D20, pressed", ALONG, -0.03765736, node((1, 1, 6), 2), cut=True),
    _refused("beamcontact", "C3D20 and C3D8", "cells of one order", stops),
    _refused("cubef2f1", "C3D20 and C3D10, tied contact", "cells of one kind", mixed_cubes),
    _bent(
        "coupling1", "C3D20, kinematic coupling", KINEMATIC, 3.786941e-05, node(END, 2), extra=True
    ),
    _bent("distcoup", "C3D20, distributing coupling", DISTRIBUTED, 0.08716415, extra=True),
    _bent("beamprb", "C3D20, RIGID BODY", RIGID, 0.009683853, extra=True),
    Entry(
        "beam8p_mpc",
        "C3D8, EQUATION of a free node",
        half_and_half,
        _BENT,
        node(END, 1),
        0.06098799,
        CCX,
    ),
    Entry(
        "beamequset",
        "C3D8, EQUATION, a loaded node",
        equal_end,
        _BENT,
        node(END, 1),
        0.06097396,
        CCX,
    ),
    Entry("pret1", "C3D20R, PRE-TENSION", pulled, "displacement", node((1, 0, 0), 0), -10 / 210000),
    Entry(
        "pret2",
        "CAX8, PRE-TENSION, shortened",
        shortened,
        "displacement",
        node((1, 1, 0), 1),
        0.0025,
    ),
    _refused("c3d15", "C3D15", "prisms", wedges),
    _refused("ball", "C3D8 and shells, dynamics", "DYNAMIC", floor_of_a_ball),
    Entry(
        "Hertz_2D (examples)",
        "CPE4",
        partial(hertz, "CPE4"),
        "pressure over that of Hertz",
        _hertz_ratio,
        1.0,
    ),
    Entry(
        "Leafspring (examples)",
        "C3D20, six leaves",
        leaf_spring,
        "force at 10 mm in N",
        _leaf_force,
        210.65,
        FINE,
    ),
    Entry(
        "LE10.inp", "C3D20, DSLOAD", _le10, "stress at D in MPa", stress_at_d, -5.38, "NAFEMS", 0.02
    ),
)
