"""Decks of CalculiX with elements that this package lacks: a part above a rigid floor, pressed at
its end.

Each deck has three runs: one that writes K, one that solves a load case without contact, and one
with CalculiX' own contact, node to surface with a stiff penalty, on a fixed plate.
"""

from __future__ import annotations

import os
import subprocess
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from foreign_formats import write_dmig

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import HHRError

GAPS = {"solid": 0.001, "shell": 0.2, "beam": 0.3}
"""Distance of the floor, in mm, by the kind of part: about half of what it would move without a
floor, or less.
"""
PENALTY = "1e9,1e-3"
"""Slope of the pressure of CalculiX' contact, and its pull where it is open: the default pull, some
per cent of the force on slender parts, would hold them down."""
STORED = Path(__file__).parents[1] / "demos/meshes/shell_plate.zip"
WITHIN = 2e-3
"""Difference of forces from those of CalculiX' penalty; 1.5e-5 seen."""
STORE = "*STEP\n*FREQUENCY,SOLVER=MATRIXSTORAGE\n1\n*END STEP\n"

SOLIDS = ("C3D8", "C3D8I", "C3D8R", "C3D6", "C3D15", "C3D20R", "C3D20", "mixed")
SHELLS = ("S4", "S8R")
BEAMS = ("B31", "B32")

Case = dict[str, Any]


@dataclass(frozen=True)
class Part:
    """A part of one kind of element.

    Attributes:
        kind: type of its elements.
        model: mesh, sets, material and section of the deck.
        supports: ``*BOUNDARY`` of the deck.
        push: force at each node of the set TIP, in N.
        gap: distance of the floor, in mm.
        floor: height of the floor in mm.
        slaves: surface of CalculiX' contact.
    """

    kind: str
    model: str
    supports: str
    push: float
    gap: float
    floor: float
    slaves: str


def numbered(numbers: Sequence[int]) -> str:
    """A row of numbers for each line of a set."""
    return "\n".join(",".join(map(str, numbers[k : k + 12])) for k in range(0, len(numbers), 12))


def grid(size: Sequence[float], cells: Sequence[int], order: int) -> tuple[dict, dict]:
    """Coordinates of nodes and numbers by their indices in a grid, of order 2 with those
    between.
    """
    steps = [order * count for count in cells]
    places, numbers = {}, {}
    for k in range(steps[2] + 1):
        for j in range(steps[1] + 1):
            for i in range(steps[0] + 1):
                if order == 2 and i % 2 + j % 2 + k % 2 > 1:
                    continue
                numbers[i, j, k] = len(numbers) + 1
                places[len(numbers)] = tuple(
                    length * index / max(count, 1)
                    for length, index, count in zip(size, (i, j, k), steps, strict=True)
                )
    return places, numbers


CUBE = ((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1))
EDGES = (
    (0, 1),
    (1, 2),
    (2, 3),
    (3, 0),
    (4, 5),
    (5, 6),
    (6, 7),
    (7, 4),
    (0, 4),
    (1, 5),
    (2, 6),
    (3, 7),
)
WEDGES = ((0, 1, 2, 4, 5, 6), (0, 2, 3, 4, 6, 7))
WEDGE_EDGES = ((0, 1), (1, 2), (2, 0), (3, 4), (4, 5), (5, 3), (0, 3), (1, 4), (2, 5))


def hexahedron(numbers: dict, at: Sequence[int], order: int) -> list[int]:
    """Nodes of a hexahedron of 8 or 20 nodes at a place of the grid."""
    corners = [tuple(order * (a + b) for a, b in zip(at, corner, strict=True)) for corner in CUBE]
    middles = [
        tuple((a + b) // 2 for a, b in zip(corners[i], corners[j], strict=True)) for i, j in EDGES
    ]
    return [numbers[one] for one in (corners + middles if order == 2 else corners)]


def wedges(numbers: dict, at: Sequence[int], order: int) -> list[list[int]]:
    """Nodes of two wedges of 6 or 15 nodes at a place of the grid, which must have the middles of
    faces.
    """
    corners = [tuple(order * (a + b) for a, b in zip(at, corner, strict=True)) for corner in CUBE]
    found = []
    for wedge in WEDGES:
        own = [corners[k] for k in wedge]
        middles = [
            tuple((a + b) // 2 for a, b in zip(own[i], own[j], strict=True)) for i, j in WEDGE_EDGES
        ]
        found.append([numbers[one] for one in (own + middles if order == 2 else own)])
    return found


def block(kind: str, cells: Sequence[int] = (16, 8, 4)) -> Part:
    """A block 4 x 2 x 1 mm of solids, clamped at x = 0, pressed at the upper edge of its end."""
    order = 2 if kind in ("C3D15", "C3D20R", "C3D20") else 1
    cells = [max(1, count // order) for count in cells]
    size = (4.0, 2.0, 1.0)
    places, numbers = grid(size, cells, order)
    if kind == "C3D15":  # diagonals of faces z = const have nodes too
        for k in range(0, 2 * cells[2] + 1, 2):
            for j in range(1, 2 * cells[1], 2):
                for i in range(1, 2 * cells[0], 2):
                    numbers[i, j, k] = len(numbers) + 1
                    place = (
                        4.0 * i / (2 * cells[0]),
                        2.0 * j / (2 * cells[1]),
                        1.0 * k / (2 * cells[2]),
                    )
                    places[len(numbers)] = place
    every = [(i, j, k) for k in range(cells[2]) for j in range(cells[1]) for i in range(cells[0])]
    groups: dict[str, list[list[int]]] = {}
    for at in every:
        if kind in ("C3D6", "C3D15") or (kind == "mixed" and 2 * at[0] >= cells[0]):
            groups.setdefault("C3D15" if kind == "C3D15" else "C3D6", []).extend(
                wedges(numbers, at, order)
            )
        else:
            groups.setdefault("C3D8I" if kind == "mixed" else kind, []).append(
                hexahedron(numbers, at, order)
            )
    end = order * cells[0]
    top = order * cells[2]
    sets = {
        "FIX": [n for (i, _, _), n in numbers.items() if i == 0],
        "BOT": [n for (i, _, k), n in numbers.items() if k == 0 and i > 0],
        "TIP": [n for (i, _, k), n in numbers.items() if k == top and i == end],
    }
    model = deck_of(places, groups, sets) + "*SOLID SECTION,ELSET=E,MATERIAL=M\n"
    slaves = "*SURFACE,NAME=S1,TYPE=NODE\nBOT\n"
    return Part(
        kind,
        model,
        "*BOUNDARY\nFIX,1,3\n",
        300.0 / len(sets["TIP"]),
        GAPS["solid"],
        -GAPS["solid"],
        slaves,
    )


def plate(kind: str, cells: Sequence[int] = (16, 8)) -> Part:
    """A plate 4 x 2 mm of shells, 0.2 mm thick, clamped at x = 0, pressed at its end."""
    order = 2 if kind == "S8R" else 1
    cells = [count // order for count in cells]
    places, numbers = grid((4.0, 2.0, 0.0), (*cells, 0), order)
    rows = [
        hexahedron_of_plate(numbers, (i, j), order)
        for j in range(cells[1])
        for i in range(cells[0])
    ]
    end = order * cells[0]
    sets = {
        "FIX": [n for (i, _, _), n in numbers.items() if i == 0],
        "BOT": [n for (i, _, _), n in numbers.items() if i > 0],
        "TIP": [n for (i, _, _), n in numbers.items() if i == end],
    }
    model = deck_of(places, {kind: rows}, sets) + "*SHELL SECTION,ELSET=E,MATERIAL=M\n.2\n"
    model += "*SURFACE,NAME=LOW,TYPE=ELEMENT\nE,SNEG\n"
    slaves = "*SURFACE,NAME=S1\nE,SNEG\n"
    gap = GAPS["shell"]
    return Part(
        kind, model, "*BOUNDARY\nFIX,1,6\n", 6.0 / len(sets["TIP"]), gap, -0.1 - gap, slaves
    )


def hexahedron_of_plate(numbers: dict, at: Sequence[int], order: int) -> list[int]:
    """Nodes of a shell of 4 or 8 nodes at a place of the grid."""
    corners = [
        (order * (at[0] + a), order * (at[1] + b), 0) for a, b in ((0, 0), (1, 0), (1, 1), (0, 1))
    ]
    middles = [
        tuple((a + b) // 2 for a, b in zip(corners[k], corners[k - 3], strict=True))
        for k in range(4)
    ]
    return [numbers[one] for one in (corners + middles if order == 2 else corners)]


def beam(kind: str, cells: int = 16) -> Part:
    """A beam of 4 mm, section 0.2 x 0.2 mm, clamped at x = 0, pressed at its end."""
    order = 2 if kind == "B32" else 1
    count = cells + 1
    places = {k + 1: (4.0 * k / cells, 0.0, 0.0) for k in range(count)}
    rows = [list(range(k + 1, k + order + 2)) for k in range(0, cells, order)]
    sets = {"FIX": [1], "BOT": list(range(2, count + 1)), "TIP": [count]}
    model = deck_of(places, {kind: rows}, sets)
    model += "*BEAM SECTION,ELSET=E,MATERIAL=M,SECTION=RECT\n.2,.2\n0.,1.,0.\n"
    slaves = "*SURFACE,NAME=S1,TYPE=NODE\nBOT\n"
    return Part(kind, model, "*BOUNDARY\nFIX,1,6\n", 1.0, GAPS["beam"], -GAPS["beam"], slaves)


def deck_of(places: dict, groups: dict[str, list[list[int]]], sets: dict[str, list[int]]) -> str:
    """Nodes, elements, sets and the material of a deck."""
    lines = [
        "*NODE,NSET=NALL",
        *(f"{n},{x:.12g},{y:.12g},{z:.12g}" for n, (x, y, z) in places.items()),
    ]
    number = 0
    for kind, rows in groups.items():
        lines.append(f"*ELEMENT,TYPE={kind},ELSET=E")
        for row in rows:
            number += 1
            words = [str(number), *map(str, row)]
            lines += [
                ",".join(words[k : k + 10]) + ("," if k + 10 < len(words) else "")
                for k in range(0, len(words), 10)
            ]
    for name, own in sets.items():
        lines += [f"*NSET,NSET={name}", numbered(own)]
    return "\n".join(
        [*lines, "*MATERIAL,NAME=M", "*ELASTIC", "210000,.3", "*DENSITY", "7.8e-9", ""]
    )


def part_of(kind: str) -> Part:
    """The part of a kind of element."""
    if kind in SHELLS:
        return plate(kind)
    return beam(kind) if kind in BEAMS else block(kind)


def write_runs(part: Part, folder: Path) -> None:
    """Write the three decks of a part: ``store``, ``case`` and ``contact``."""
    folder.mkdir(parents=True, exist_ok=True)
    tip = f"*CLOAD\nTIP,3,{-part.push!r}\n"
    result = "*NODE FILE,OUTPUT=3D\nU\n"
    (folder / "store.inp").write_text(part.model + part.supports + STORE)
    (folder / "case.inp").write_text(
        part.model + part.supports + "*STEP\n*STATIC\n" + tip + result + "*END STEP\n"
    )
    corners = [(x, y) for x, y in ((-1, -1), (5, -1), (5, 3), (-1, 3))]
    plate = "*NODE\n" + "".join(
        f"{90001 + 4 * low + k},{x},{y},{part.floor - low:.12g}\n"
        for low in (0, 1)
        for k, (x, y) in enumerate(corners)
    )
    plate += "*ELEMENT,TYPE=C3D8,ELSET=P\n90001,90005,90006,90007,90008,90001,90002,90003,90004\n"
    plate += "*SOLID SECTION,ELSET=P,MATERIAL=M\n*NSET,NSET=PN,GENERATE\n90001,90008\n"
    plate += "*BOUNDARY\nPN,1,3\n"
    pair = part.slaves + "*SURFACE,NAME=S2\n90001,S2\n*SURFACE INTERACTION,NAME=I\n"
    pair += f"*SURFACE BEHAVIOR,PRESSURE-OVERCLOSURE=LINEAR\n{PENALTY}\n"
    pair += "*CONTACT PAIR,INTERACTION=I,TYPE=NODE TO SURFACE\nS1,S2\n"
    step = (
        "*STEP,INC=200\n*STATIC\n.1,1.\n" + tip + "*NODE PRINT,NSET=PN,TOTALS=ONLY\nRF\n*END STEP\n"
    )
    (folder / "contact.inp").write_text(part.model + part.supports + plate + pair + step)


def run(folder: Path, job: str, patience: float = 300.0) -> None:
    """Run CalculiX on a deck of a folder, on one core."""
    one = os.environ | {"OMP_NUM_THREADS": "1", "CCX_NPROC_EQUATION_SOLVER": "1"}
    subprocess.run(
        ["ccx", job], cwd=folder, capture_output=True, timeout=patience, env=one, check=False
    )


def force_of_calculix(folder: Path) -> float:
    """Total force on the floor at the end of the run with contact, upwards on the part, in N."""
    words = (folder / "contact.dat").read_text().split()
    return float(words[-1])


def case_of(code: str, elements: str, ours: float, theirs: float, within: float) -> Case:
    """A row of the report."""
    off = abs(ours / theirs - 1)
    outcome = "right" if off <= within else f"off by {off:.1e}"
    return {"code": code, "elements": elements, "outcome": outcome, "ours": ours, "theirs": theirs}


def scene_of(part: Part, folder: Path) -> hhr.Scene:
    """The part with the K that CalculiX wrote, above the floor."""
    files = folder / "store.sti", folder / "case.inp"
    foreign = hhr.ForeignStiffness(hhr.ForeignBlock(*files, case=folder / "case.inp", name="part"))
    contact: Any = hhr.NodesToGround("BOT", (0.0, 0.0, -1.0), part.gap)
    if part.kind in SHELLS:
        contact = hhr.Obstacle("LOW", (0.0, 0.0, -1.0), -part.floor)
    return foreign.scene(
        "part",
        contacts=(contact,),
        displacements=hhr.Displacement.clamp("FIX", 3),
        loads=(hhr.NodalForce("TIP", (0.0, 0.0, -1.0), "push"),),
        outputs=(hhr.ContactForce("force", 0, direction=(0.0, 0.0, 1.0)),),
        parameters=hhr.ParameterSpace(("push",), (0.0,), (2 * part.push,)),
    )


SOFT = 300.0
"""Modulus of the solid below the plate of two codes, in MPa: a rigid one changes the force by 2 %."""


def solid_below(floor: float) -> tuple[str, str, str]:
    """A block of C3D8I below the plate, clamped at its lower side, in a deck and in the deck of
    another part: its nodes, elements and sets, then its material and section, and its supports.
    """
    cells = (12, 8, 2)
    places, numbers = grid((6.0, 4.0, 1.0), cells, 1)
    shifted = {n + 50000: (x - 1, y - 1, z - 1 + floor) for n, (x, y, z) in places.items()}
    every = [(i, j, k) for k in range(cells[2]) for j in range(cells[1]) for i in range(cells[0])]
    lines = [
        "*NODE,NSET=SALL",
        *(f"{n},{x:.12g},{y:.12g},{z:.12g}" for n, (x, y, z) in shifted.items()),
    ]
    lines.append("*ELEMENT,TYPE=C3D8I,ELSET=S")
    upper = []
    for number, at in enumerate(every, 50001):
        nodes = [n + 50000 for n in hexahedron(numbers, at, 1)]
        lines.append(",".join(map(str, (number, *nodes))))
        if at[2] == cells[2] - 1:
            upper.append(f"{number},S2")
    ends = {"DOWN": 0, "UP": cells[2]}
    for name, k in ends.items():
        level = [n + 50000 for at, n in numbers.items() if at[2] == k]
        lines += [f"*NSET,NSET={name}", numbered(level)]
    lines += ["*SURFACE,NAME=S2", *upper]
    material = f"*MATERIAL,NAME=SOFT\n*ELASTIC\n{SOFT},.3\n*DENSITY\n1e-9\n"
    material += "*SOLID SECTION,ELSET=S,MATERIAL=SOFT\n"
    return "\n".join(lines) + "\n", material, "*BOUNDARY\nDOWN,1,3\n"


def write_two_parts(part: Part, folder: Path) -> None:
    """Decks of a plate of shells and of the solid below it, alone and together."""
    write_runs(part, folder)
    mesh, material, supports = solid_below(part.floor)
    load = "*CLOAD\nUP,3,-1.\nUP,1,.5\n"
    step = "*STEP\n*STATIC\n" + load + "*NODE FILE\nU\n*END STEP\n"
    (folder / "solid.inp").write_text(mesh + material + supports + STORE)
    (folder / "solidcase.inp").write_text(mesh + material + supports + step)
    pair = part.slaves + "*SURFACE INTERACTION,NAME=I\n"
    pair += f"*SURFACE BEHAVIOR,PRESSURE-OVERCLOSURE=LINEAR\n{PENALTY}\n"
    pair += "*CONTACT PAIR,INTERACTION=I,TYPE=NODE TO SURFACE\nS1,S2\n"
    push = f"*STEP,INC=200\n*STATIC\n.1,1.\n*CLOAD\nTIP,3,{-part.push!r}\n"
    push += "*NODE PRINT,NSET=DOWN,TOTALS=ONLY\nRF\n*END STEP\n"
    both = part.model + mesh + material + part.supports + supports + pair + push
    (folder / "contact.inp").write_text(both)


def of_two_codes(folder: Path) -> Case:
    """A plate of shells by the K of CalculiX on a solid by the K of a file of Nastran, beside
    CalculiX' own contact of both.
    """
    part = part_of("S4")
    write_two_parts(part, folder)
    for job in ("store", "case", "solid", "solidcase", "contact"):
        run(folder, job)
    found = hhr.read_stiffness(folder / "solid.sti", folder / "solid.dof")
    punched = write_dmig(found, folder)
    foreign = hhr.ForeignStiffness(
        hhr.ForeignBlock(
            folder / "store.sti", folder / "case.inp", case=folder / "case.inp", name="plate"
        ),
        hhr.ForeignBlock(
            punched, folder / "solid.inp", case=folder / "solidcase.inp", name="solid"
        ),
    )
    scene = foreign.scene(
        "two",
        contacts=(hhr.NodeToSurface("plate.LOW", "solid.S2"),),
        displacements=(
            *hhr.Displacement.clamp("plate.FIX", 3),
            *hhr.Displacement.clamp("solid.DOWN", 3),
        ),
        loads=(hhr.NodalForce("plate.TIP", (0.0, 0.0, -1.0), "push"),),
        outputs=(hhr.ContactForce("force", 0, direction=(0.0, 0.0, 1.0)),),
        parameters=hhr.ParameterSpace(("push",), (0.0,), (2 * part.push,)),
    )
    ours = hhr.FullOrderModel(scene).outputs((part.push,))["force"]
    return case_of("CalculiX and Nastran", "S4 on C3D8I", ours, force_of_calculix(folder), WITHIN)


def of_stored(folder: Path) -> list[Case]:
    """Forces of the stored plate of S4 shells, for five pushes: files of CalculiX, which need not
    be here.
    """
    with zipfile.ZipFile(STORED) as archive:
        archive.extractall(folder)
    files = folder / "plate.sti", folder / "plate.inp"
    block = hhr.ForeignBlock(*files, case=folder / "case.inp", results=folder / "case.frd")
    scene = hhr.ForeignStiffness(block).scene(
        "stored",
        contacts=(hhr.Obstacle("S1", (0.0, 0.0, -1.0), 0.3),),
        displacements=hhr.Displacement.clamp("FIX", 3),
        loads=(hhr.NodalForce("TIP", (0.0, 0.0, -1.0), "push"),),
        outputs=(hhr.ContactForce("force", 0, direction=(0.0, 0.0, 1.0)),),
        parameters=hhr.ParameterSpace(("push",), (0.0,), (2.0,)),
    )
    full = hhr.FullOrderModel(scene)
    rows = [row.split(",") for row in (folder / "theirs.csv").read_text().split()[1:]]
    return [
        case_of(
            "CalculiX, stored", "S4", full.outputs((float(push),))["force"], float(force), WITHIN
        )
        for push, force in rows
    ]


def of_calculix(kind: str, folder: Path) -> Case:
    """Force of one kind of element."""
    part = part_of(kind)
    write_runs(part, folder)
    for job in ("store", "case", "contact"):
        run(folder, job)
    try:
        ours = hhr.FullOrderModel(scene_of(part, folder)).outputs((part.push,))["force"]
    except HHRError as error:
        return {
            "code": "CalculiX",
            "elements": kind,
            "outcome": f"refused: {error}",
            "ours": None,
            "theirs": None,
        }
    return case_of("CalculiX", kind, ours, force_of_calculix(folder), WITHIN)
