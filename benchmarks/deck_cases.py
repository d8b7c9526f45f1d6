"""Scenes in Python beside the decks: LE10 in other formats, and faults that were once found."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import meshio
import numpy as np
from deck_entries import Answer, Case, cubes, leaf_spring, plate_of_nafems, stress_at_d
from deck_writer import Box, Where, Writer, at

import hhr_dolfinx as hhr

FRICTION = 0.1


def _facets(box: Box, where: Where) -> np.ndarray:
    """Faces of second order, (f, 8) places among the nodes of a box."""
    meant = np.flatnonzero(where(box.points))
    faces = [[0, 1, 2, 3, 8, 9, 10, 11], [4, 5, 6, 7, 12, 13, 14, 15], [1, 2, 6, 5, 9, 18, 13, 17]]
    rows = [box.cells[:, face] for face in faces]
    table = np.concatenate(rows)
    return table[np.isin(table, meant).all(axis=1)]


def _mail(path: Path, places: np.ndarray, plate: Box) -> None:
    """Text of code_aster with groups of nodes and of faces."""
    rows = [f"N{number} {x!r} {y!r} {z!r}" for number, (x, y, z) in enumerate(places.tolist())]
    order = [
        *range(12),
        16,
        17,
        18,
        19,
        12,
        13,
        14,
        15,
    ]  # edges upright come before those of the lid
    text = ["COOR_3D", *rows, "FINSF", "HEXA20"]
    text += [
        f"M{row} " + " ".join(f"N{node}" for node in cell[order])
        for row, cell in enumerate(plate.cells)
    ]
    text += ["FINSF", "QUAD8"]
    lid = _facets(plate, at(2, 0.6))
    text += [f"F{row} " + " ".join(f"N{node}" for node in face) for row, face in enumerate(lid)]
    text += ["FINSF", "GROUP_MA PLATE", *(f"M{row}" for row in range(len(plate.cells))), "FINSF"]
    text += ["GROUP_MA LID", *(f"F{row}" for row in range(len(lid))), "FINSF"]
    for name, where in SUPPORTS.items():
        text += [
            f"GROUP_NO {name}",
            *(f"N{node}" for node in np.flatnonzero(where(plate.points))),
            "FINSF",
        ]
    path.write_text("\n".join([*text, "FIN", ""]))


SUPPORTS: dict[str, Where] = {
    "YSYM": at(1, 0),
    "XSYM": at(1, np.pi / 2),
    "RIM": at(0, 1),
    "MID": lambda points: at(0, 1)(points) & at(2, 0.3)(points),
}


def le10(ending: str, folder: Path) -> float:
    """Stress at D by a scene on a file of that format."""
    deck, plate = plate_of_nafems()
    source = folder / "le10_mesh.inp"
    source.write_text(deck.text)
    mesh = meshio.read(source)
    path = folder / f"le10_mesh{ending}"
    if ending == ".mail":
        _mail(path, mesh.points, plate)
    else:
        faces = {
            11: _facets(plate, at(2, 0.6)),
            12: _sides(plate, at(1, 0)),
            13: _sides(plate, at(1, np.pi / 2)),
            14: _sides(plate, at(0, 1)),
        }
        middle = _sides(plate, at(0, 1))
        lines = np.concatenate(
            [middle[:, [a, b, c]] for a, b, c in ((0, 1, 4), (1, 2, 5), (2, 3, 6), (3, 0, 7))]
        )
        lines = lines[np.isin(lines, np.flatnonzero(SUPPORTS["MID"](plate.points))).all(axis=1)]
        blocks = [
            ("hexahedron20", plate.cells),
            *(("quad8", face) for face in faces.values()),
            ("line3", lines),
        ]
        tags = [
            np.full(len(cells), tag)
            for (_, cells), tag in zip(blocks, (1, *faces, 15), strict=True)
        ]
        data = {"gmsh:physical": tags, "gmsh:geometrical": tags}
        names = {"PLATE": 1, "LID": 11, "YSYM": 12, "XSYM": 13, "RIM": 14, "MID": 15}
        field = {
            name: np.array([tag, 3 if tag == 1 else 1 if tag == 15 else 2])
            for name, tag in names.items()
        }
        meshio.Mesh(mesh.points, blocks, cell_data=data, field_data=field).write(
            path, file_format="gmsh22", binary=False
        )
    scene = hhr.Scene(
        "le10",
        hhr.MeshFile(path),
        "solid",
        (hhr.Body("PLATE", 210e3, 0.3),),
        (hhr.Obstacle("LID", (0.0, 0.0, 1.0), 50.0),),
        hhr.ParameterSpace(("p",), (0.0,), (2.0,)),
        displacements=(
            hhr.Displacement("YSYM", 1),
            hhr.Displacement("XSYM", 0),
            hhr.Displacement("RIM", 0),
            hhr.Displacement("RIM", 1),
            hhr.Displacement("MID", 2),
        ),
        loads=(hhr.Pressure("LID", "p"),),
    )
    full = hhr.FullOrderModel(scene)
    moved = full.solve(1.0).displacement().reshape(-1, 3)
    return stress_at_d(Answer(path, {}, full.problem.points, moved))


def _sides(box: Box, where: Where) -> np.ndarray:
    """Faces of second order of any side, (f, 8) places."""
    sides = (
        (0, 1, 5, 4, 8, 17, 12, 16),
        (1, 2, 6, 5, 9, 18, 13, 17),
        (2, 3, 7, 6, 10, 19, 14, 18),
        (3, 0, 4, 7, 11, 16, 15, 19),
    )
    table = np.concatenate([box.cells[:, side] for side in sides])
    return table[np.isin(table, np.flatnonzero(where(box.points))).all(axis=1)]


def two_cubes(
    folder: Path, gap: float = 0.0, more: str = "", pairing: Any = hhr.NodeToSurface
) -> float:
    """Pressure of two unit cubes with E = 1000, nu = 0 that are closed by .02: 10.

    ``more`` is added to the deck.
    """
    deck, _, _ = cubes("C3D8", 0.0, "", "", "", comma=",")
    lines = deck.text.partition("*MATERIAL")[0]
    words = [line.split(", ") for line in lines.splitlines()]
    lifted = [
        f"{line[0]}, {line[1]}, {line[2]}, {float(line[3]) + gap * (int(line[0]) > 8)}"
        if len(line) == 4 and "." not in line[0] and line[0].isdigit()
        else ", ".join(line)
        for line in words
    ]
    path = folder / "two_cubes.inp"
    path.write_text("\n".join([*lifted, *more.split("/"), ""]))
    scene = hhr.Scene(
        "two_cubes",
        hhr.MeshFile(path),
        "solid",
        (hhr.Body("EALL", 1e3, 0.0),),
        (pairing("SLAVE", "MASTER"),),
        hhr.ParameterSpace(("down",), (0.0,), (2 * gap + 0.05,)),
        displacements=(
            *hhr.Displacement.clamp("BOTTOM", 3),
            *hhr.Displacement.clamp("TOP", 2),
            hhr.Displacement("TOP", 2, hhr.Amplitude(slopes={"down": -1.0})),
        ),
        outputs=(hhr.LargestPressure("pressure", contact=0),),
    )
    return hhr.FullOrderModel(scene).solve(gap + 0.02).outputs()["pressure"]


def _scene(
    path: Path, hypothesis: str, tags: dict[str, float], contact: Any, *parts: Any, **more: Any
) -> Any:
    """Outputs at a point of parameters; bodies by name with their moduli, nu = 0 if not given."""
    names, point, outputs = more["names"], more["point"], more["outputs"]
    bodies = tuple(hhr.Body(tag, young, more.get("poisson", 0.0)) for tag, young in tags.items())
    space = hhr.ParameterSpace(names, (0.0,) * len(names), tuple(2 * value for value in point))
    given = hhr.Scene(
        "case",
        hhr.MeshFile(path),
        hypothesis,
        bodies,
        (contact,),
        space,
        displacements=parts,
        loads=more.get("loads", ()),
        outputs=outputs,
    )
    return hhr.FullOrderModel(given).solve(point).outputs()


def whole_outsides(pairing: Any, kind: str, folder: Path) -> float:
    """Force between two unit squares or cubes, .01 apart, closed by .03.

    Surfaces are their whole outsides: 10.
    """
    deck = Writer()
    up_to = 1 if kind == "CPE4" else 2
    side, count = (1.0,) * up_to, 4 if kind == "CPE4" else 3
    low = deck.box("LOWER", kind, (count,) * (up_to + 1), (0.0,) * (up_to + 1), (*side, 1.0))
    up = deck.box("UPPER", kind, (count,) * (up_to + 1), (0.0,) * up_to + (1.01,), (*side, 2.01))
    for name, box, bottom in (("LOW", low, 0.0), ("UP", up, 1.01)):
        sides = [at(axis, place) for axis in range(up_to) for place in (0, 1)]
        sides += [at(up_to, bottom), at(up_to, bottom + 1)]
        deck.surface(f"ALL{name}", [face for side in sides for face in box.faces(side)])
    deck.surface("FLOOR", low.faces(at(up_to, 0)))
    deck.surface("LID", up.faces(at(up_to, 2.01)))
    path = folder / "outsides.inp"
    path.write_text(deck.text)
    held = (
        *hhr.Displacement.clamp("FLOOR", up_to + 1),
        *hhr.Displacement.clamp("LID", up_to),
        hhr.Displacement("LID", up_to, "-down"),
    )
    found = _scene(
        path,
        "plane_strain" if up_to == 1 else "solid",
        {"LOWER": 1e3, "UPPER": 1e3},
        pairing("ALLUP", "ALLLOW"),
        *held,
        names=("down",),
        point=(0.03,),
        outputs=(hhr.ContactForce("force", 0, direction=(0.0,) * up_to + (1.0,)),),
    )
    return found["force"]


def lines_of_supports(folder: Path) -> float:
    """Force of a floor .01 below a beam of four cubes on two lines of nodes and two pins."""
    deck = Writer()
    beam = deck.box("BEAM", "C3D8", (4, 1, 1), (0, 0, 0), (4, 1, 1))
    lines = {
        name: beam.nodes(lambda points, x=x: at(0, x)(points) & at(2, 0)(points))
        for name, x in (("L", 0), ("R", 4))
    }
    first = beam.nodes(
        lambda points: np.isin(points[:, 0], (0.0, 4.0)) & at(1, 0)(points) & at(2, 0)(points)
    )
    for name, nodes in (*lines.items(), ("PIN", first[:1]), ("PINS", first)):
        deck.nset(name, nodes)
    deck.surface("BELLY", beam.faces(at(2, 0)))
    deck.surface("LID", beam.faces(at(2, 1)))
    path = folder / "lines.inp"
    path.write_text(deck.text)
    places = (("L", 2), ("R", 2), ("PIN", 0), ("PINS", 1))
    found = _scene(
        path,
        "solid",
        {"BEAM": 1e3},
        hhr.Obstacle("BELLY", (0, 0, -1), 0.01),
        *(hhr.Displacement(*one) for one in places),
        names=("push",),
        point=(5.0,),
        loads=(hhr.Pressure("LID", "push"),),
        outputs=(hhr.ContactForce("force", 0, direction=(0.0, 0.0, 1.0)),),
        poisson=0.3,
    )
    return found["force"]


def imposed_on_both(folder: Path) -> float:
    """Friction over mu N of a block that slips on a floor, its left side moved as well, corner
    included.
    """
    deck = Writer()
    block = deck.box("BLOCK", "CPE4", (4, 1), (0, 0), (4, 1))
    for name, where in (("FOOT", at(1, 0)), ("LID", at(1, 1)), ("LEFT", at(0, 0))):
        deck.surface(name, block.faces(where))
    path = folder / "slips.inp"
    path.write_text(deck.text)
    moved = [
        hhr.Displacement("LID", 1, "-down"),
        *(hhr.Displacement(tag, 0, "slip") for tag in ("LID", "LEFT")),
    ]
    directions = {"normal": (0.0, 1.0), "friction": (1.0, 0.0)}
    found = _scene(
        path,
        "plane_strain",
        {"BLOCK": 1e3},
        hhr.Obstacle("FOOT", (0, -1), 0.0, friction=FRICTION),
        *moved,
        names=("down", "slip"),
        point=(0.01, 0.05),
        outputs=tuple(hhr.ContactForce(name, 0, direction=way) for name, way in directions.items()),
    )
    return abs(found["friction"]) / (FRICTION * found["normal"])


TOOL = "*NODE/100, 0., 0., 9./101, 1., 0., 9./102, 1., 1., 9./103, 0., 1., 9./"
GLUE = "*NODE/104, 0., 0., 9./105, 1., 0., 9./106, 1., 1., 9./107, 0., 1., 9./"
GLUE += "*ELEMENT, TYPE={}, ELSET=GLUE/30, 100, 101, 102, 103, 104, 105, 106, 107"
PASSED = {
    "rigid tool": TOOL
    + "*ELEMENT, TYPE=R3D4, ELSET=TOOL/30, 100, 101, 102, 103/*SURFACE, NAME=STOOL/TOOL, SNEG",
    "skin of shells": (
        "*ELEMENT, TYPE=S4, ELSET=SKIN/30, 13, 14, 16, 15/*SURFACE, NAME=SSKIN/SKIN, SPOS"
    ),
    "beam": "*ELEMENT, TYPE=B31, ELSET=ROD/30, 1, 16/*SURFACE, NAME=SROD/30, S1",
    "pipe": "*ELEMENT, TYPE=PIPE31, ELSET=ROD/30, 1, 16",
    "cohesive cell": TOOL + GLUE.format("COH3D8"),
    "gasket": TOOL + GLUE.format("GK3D8"),
    "wedge of another body": TOOL
    + "*NODE/104, 0., 0., 8./105, 1., 0., 8./"
    + "*ELEMENT, TYPE=C3D6, ELSET=OTHER/30, 100, 104, 103, 101, 105, 102",
    "axisymmetric cell": TOOL + "*ELEMENT, TYPE=CGAX4, ELSET=TOOL/30, 100, 101, 102, 103",
    "analytical surface": "*SURFACE, TYPE=CYLINDER, NAME=RIGID/START, 0., 0./LINE, 1., 0.",
    "union": "*SURFACE, NAME=BOTH, COMBINE=UNION/MASTER, SLAVE",
}


def leaf_spring_of_20_nodes(folder: Path, push: float = 10.0) -> float:
    """Force of the leaf spring on the cells of the example, with elements and contact as CalculiX
    has them.

    CalculiX has 218.0 N per 10 mm for small displacements, and 220.0 with NLGEOM; its contact is
    that of displaced surfaces.
    """
    path = folder / "leaf_spring_of_20_nodes.inp"
    path.write_text(leaf_spring((1, 3, 4, 5, 6, 8), across=1))
    scene = hhr.Scene(
        "leaf_spring",
        hhr.MeshFile(path),
        "solid",
        (hhr.Body("EALL", 210e3, 0.3),),
        tuple(
            hhr.NodeToSurface(f"TOP{number}", f"BOT{number + 1}", at_nodes=True)
            for number in range(1, 6)
        ),
        hhr.ParameterSpace(("push",), (0.0,), (20.0,)),
        displacements=(
            hhr.Displacement("SYM1", 0),
            hhr.Displacement("SYM2", 1),
            hhr.Displacement("NSUPPORT", 2),
            hhr.Displacement("SYM1", 2, "push"),
        ),
        constraints=(hhr.Serendipity(),),
        outputs=(hhr.ElasticEnergy("energy"),),
    )
    return 2 * hhr.FullOrderModel(scene).solve(push).outputs()["energy"] / push


CASES: tuple[Case, ...] = (
    *(
        Case(
            f"LE10{ending}",
            "C3D20, no contact",
            partial(le10, ending),
            "stress at D in MPa",
            -5.38,
            "NAFEMS",
            0.02,
        )
        for ending in (".msh", ".mail")
    ),
    *(
        Case(f"case A9, {name}", "C3D8", partial(two_cubes, more=more), "pressure", 10.0)
        for name, more in PASSED.items()
    ),
    Case(
        "Leafspring, its few cells",
        "C3D20, contact at nodes",
        leaf_spring_of_20_nodes,
        "force at 10 mm in N",
        220.3,
        "the example, with NLGEOM",
        0.02,
    ),
    Case("case A10, commas", "C3D8", two_cubes, "pressure", 10.0),
    Case(
        "case A1, gap wider than a cell",
        "C3D8, mortar",
        partial(two_cubes, gap=1.5, pairing=hhr.Mortar),
        "pressure",
        10.0,
    ),
    *(
        Case(
            f"case A5, {pairing.__name__}, {kind}",
            "whole outsides",
            partial(whole_outsides, pairing, kind),
            "force",
            10.0,
        )
        for kind in ("CPE4", "C3D4")
        for pairing in (hhr.NodeToSurface, hhr.DoublePass, hhr.Mortar)
    ),
    Case(
        "case A7, lines and nodes",
        "C3D8",
        lines_of_supports,
        "force",
        13.3106,
        "own elements and active set",
    ),
    Case(
        "case B1, both sides imposed", "CPE4, friction", imposed_on_both, "friction over mu N", 1.0
    ),
)
