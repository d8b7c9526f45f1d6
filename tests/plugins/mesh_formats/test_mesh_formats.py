"""Mesh files of other programs: two pressed cubes, cells of second order, and damaged files.

The cubes are those of tests/core/test_file_contents.py: their pressure is 10, a closed form.
"""

import re

import gmsh
import meshio
import numpy as np
import pytest
from cubes_in_files import CUBES, FACES, NAMES, POINTS, SECOND, pressure, reasons, size_of, written
from mpi4py import MPI
from needs import needs

import hhr_dolfinx as hhr
from hhr_dolfinx.compat import degree_of, netcdf4
from hhr_dolfinx.errors import FileContentError, SceneError
from hhr_dolfinx.geometries.cells import EDGE_ORDERS
from hhr_dolfinx.plugins.mesh_formats.med import groups_of_nodes

BODIES = ("LOWER", "UPPER")
SURFACES = dict(zip(NAMES[2:], FACES.values(), strict=True))


def joined(words, between=" "):
    return between.join(map(str, words))


def mail():
    """Names after NOM and as first words; the lid is a group of nodes."""
    rows = ["TITRE", "cubes % of a test", "FINSF", "COOR_3D NBOBJ = 16", "  NBLIGE= 1"]
    rows += [f" N{k}  {x:.10E} {y}D0 {z}" for k, (x, y, z) in enumerate(POINTS, 1)]
    rows += ["FINSF", "%", "HEXA8"]
    # a row may go on in the next line
    rows += [
        f"M{k} " + joined(f"N{n}" for n in cube[:5]) + "\n  " + joined(f"N{n}" for n in cube[5:])
        for k, cube in enumerate(CUBES, 1)
    ]
    rows += ["FINSF", "QUAD4"] + [
        f"Q{k} " + joined(f"N{n}" for n in face) for k, face in FACES.items()
    ]
    rows += ["FINSF", "GROUP_MA NOM = LOWER", "M1", "FINSF", "GROUP_MA", "UPPER  M2", "FINSF"]
    for name, number in zip(NAMES[2:5], FACES, strict=False):
        rows += ["GROUP_MA", name, f"Q{number}", "FINSF"]
    rows += ["GROUP_NO NOM=LID", joined(f"N{n}" for n in FACES[14]), "FINSF", "FIN", ""]
    return "\n".join(rows)


def feb(version="4.0"):
    """Sets of numbers as text from version 4 on, as elements before."""
    new = version == "4.0"
    rows = [
        '<?xml version="1.0" encoding="ISO-8859-1"?>',
        f'<febio_spec version="{version}">',
        "<Material/>",
    ]
    rows += ["<Mesh>" if version >= "3" else "<Geometry>", '<Nodes name="all">']
    rows += [f'<node id="{k}">{joined(place, ",")}</node>' for k, place in enumerate(POINTS, 1)] + [
        "</Nodes>"
    ]
    for k, (name, cube) in enumerate(zip(BODIES, CUBES, strict=True), 1):
        rows += [
            f'<Elements type="hex8" mat="{k}" name="{name}">',
            f'<elem id="{k}"> {joined(cube, ", ")} </elem>',
        ]
        rows += ["</Elements>"]
    for name, face in list(SURFACES.items())[:3]:
        rows += [
            f'<Surface name="{name}">',
            f'<quad4 id="1">{joined(face, ",")}</quad4>',
            "</Surface>",
        ]
    members = joined(FACES[14], ",\n") if new else "".join(f'<node id="{k}"/>' for k in FACES[14])
    rows += [
        f'<NodeSet name="LID">{members}</NodeSet>',
        '<SurfacePair name="pair"><primary>MASTER</primary></SurfacePair>',
    ]
    rows += [
        '<ElementSet name="both">'
        + ("1,2" if new else '<elem id="1"/><elem id="2"/>')
        + "</ElementSet>"
    ]
    return "\n".join([*rows, "</Mesh>" if version >= "3" else "</Geometry>", "</febio_spec>", ""])


def keywords(form="fixed", title=True):
    """Fixed fields of 8, 10 and 16, or 10 and 16, or 20, or words between commas.

    Solids in one row or two.
    """
    width = {"fixed": 8, "i10": 10, "long": 20, "commas": 0}[form]
    option = {"long": " LONG=Y", "i10": " I10=Y"}.get(form, "")

    def row(words, wide=width):
        return (
            joined(words, ",")
            if not width
            else "".join(f"{word!s:>{max(wide, width)}}" for word in words)
        )

    rows = ["$ a comment", f"*KEYWORD{option}", "*TITLE", "cubes", "*NODE"]
    for k, place in enumerate(POINTS, 1):
        rows += [row([k]) + ("" if width else ",") + row(place, 16)]
    rows += ["*PART", "LOWER", row([1, 1, 1], 10), "UPPER", row([2, 1, 1], 10), "*ELEMENT_SOLID"]
    rows += [row([1, 1, *CUBES[0]]), row([2, 2]), row(CUBES[1])]
    for number, (name, face) in enumerate(list(SURFACES.items())[:3], 11):
        rows += ["*SET_SEGMENT_TITLE", name] if title else ["*SET_SEGMENT"]
        rows += [row([number, 0.0], 10), row(face, 10)]
    rows += ["*SET_NODE_LIST_TITLE", "LID", row([14], 10), row([*FACES[14], 0, 0], 10)]
    rows += [
        "*SET_BEAM",
        row([1], 10),
        "*CONTACT_SURFACE_TO_SURFACE",
        row([1], 10),
        "*END",
        "*NODE",
        "not read",
    ]
    return "\n".join([*rows, ""])


def mdpa():
    """Parts of the model within parts, and a table within properties."""
    rows = [
        "Begin ModelPartData // nothing",
        "End ModelPartData",
        "Begin Properties 1",
        "Begin Table 1 A B",
        "0 1",
    ]
    rows += ["End Table", "End Properties", "Begin Nodes"]
    rows += [f" {k} {joined(place)}" for k, place in enumerate(POINTS, 1)] + ["End Nodes"]
    rows += ["Begin Elements SmallDisplacementElement3D8N// of GiD"]
    rows += [f" {k} {k} {joined(cube)}" for k, cube in enumerate(CUBES, 1)] + ["End Elements"]
    rows += ["Begin Conditions SurfaceCondition3D4N"]
    rows += [f" {k} 0 {joined(face)}" for k, face in enumerate(FACES.values(), 1)] + [
        "End Conditions"
    ]
    rows += ["Begin SubModelPart Parts", "Begin SubModelPartTables", "1", "End SubModelPartTables"]
    for k, name in enumerate(BODIES, 1):
        rows += [
            f"Begin SubModelPart {name}",
            "Begin SubModelPartElements",
            f"{k}",
            "End SubModelPartElements",
        ]
        rows += ["End SubModelPart"]
    rows += ["End SubModelPart"]
    for k, name in enumerate(NAMES[2:5], 1):
        rows += [
            f"Begin SubModelPart {name}",
            "Begin SubModelPartNodes",
            "1",
            "2",
            "End SubModelPartNodes",
        ]
        rows += [
            "Begin SubModelPartConditions",
            f"{k}",
            "End SubModelPartConditions",
            "End SubModelPart",
        ]
    rows += [
        "Begin SubModelPart LID",
        "Begin SubModelPartNodes",
        *map(str, FACES[14]),
        "End SubModelPartNodes",
    ]
    return "\n".join([*rows, "End SubModelPart", ""])


FILES = {
    "c.mail": mail(),
    "c.feb": feb(),
    "three.feb": feb("3.0"),
    "two.feb": feb("2.5"),
    "c.k": keywords(),
    "commas.key": keywords("commas"),
    "long.k": keywords("long"),
    "c.mdpa": mdpa(),
}


@needs("nonmatching")
@pytest.mark.parametrize("name", FILES)
def test_the_pressure_of_two_cubes(name, tmp_path):
    assert pressure(written(tmp_path / name, FILES[name]), NAMES) == pytest.approx(10.0, rel=1e-9)


@needs("nonmatching")
def test_numbers_of_parts_and_sets(tmp_path):
    """Parts and segments without titles, properties of Kratos, and names within others."""
    path = written(tmp_path / "c.k", keywords(title=False))
    assert pressure(path, (1, "UPPER", 11, 12, 13, "LID")) == pytest.approx(10.0, rel=1e-9)
    path = written(tmp_path / "c.mdpa", mdpa())
    assert pressure(path, (1, "Parts.UPPER", *NAMES[2:])) == pytest.approx(10.0, rel=1e-9)
    assert hhr.MeshFile(written(tmp_path / "c.feb", feb())).read().bodies["both"].tolist() == [0, 1]


def test_what_is_not_read_is_said(tmp_path):
    assert reasons(written(tmp_path / "c.k", keywords())) == {
        "*SET_BEAM": "blocks of this kind are not read"
    }
    text = feb().replace(
        "<NodeSet", '<Elements type="tet15" name="soft"><elem id="9">1</elem></Elements><NodeSet'
    )
    assert reasons(written(tmp_path / "c.feb", text)) == {
        "soft": "elements of type tet15 are not read"
    }
    text = mail().replace("GROUP_NO", "HEXA9\nM7 N1\nFINSF\nGROUP_NO")
    assert reasons(written(tmp_path / "c.mail", text)) == {
        "HEXA9": "elements of this kind are not read"
    }


ORDERS = {"vtk": None, "exodus": EDGE_ORDERS["exodus"]["hexahedron"]}


def of_second_order(ending, kind, order):
    """One cell as the formats write it: upright edges of hexahedra come last in FEBio, and before
    the top elsewhere.
    """
    corners, edges, _ = SECOND[kind]
    edges = ORDERS[order] or edges
    points = [
        *corners,
        *(tuple(np.mean([corners[a], corners[b]], axis=0).tolist()) for a, b in edges),
    ]
    numbers = [*range(1, len(points) + 1)]
    if ending == ".mail":
        rows = [f"N{k} {joined(p)}" for k, p in enumerate(points, 1)]
        return "\n".join(["COOR_3D", *rows, "FINSF", {10: "TETRA10", 20: "HEXA20"}[len(points)],
                          "M1", *(f"N{n}" for n in numbers), "FINSF", "FIN"])  # fmt: skip
    if ending == ".feb":
        rows = [f'<node id="{k}">{joined(p, ",")}</node>' for k, p in enumerate(points, 1)]
        element = f'<elem id="1">{joined(numbers, ",")}</elem>'
        type_ = {10: "tet10", 20: "hex20"}[len(points)]
        return (
            f'<febio_spec version="4.0"><Mesh><Nodes>{"".join(rows)}</Nodes>'
            f'<Elements type="{type_}" name="E">'
            f"{element}</Elements></Mesh></febio_spec>"
        )
    if ending == ".k":
        rows = [joined([k, *p], ",") for k, p in enumerate(points, 1)]
        return "\n".join(
            ["*KEYWORD", "*NODE", *rows, "*ELEMENT_SOLID", "1,1", joined(numbers, ","), "*END"]
        )
    rows = [joined([k, *p]) for k, p in enumerate(points, 1)]
    name = f"SmallDisplacementElement3D{len(points)}N"
    return "\n".join(
        [
            "Begin Nodes",
            *rows,
            "End Nodes",
            f"Begin Elements {name}",
            joined([1, 1, *numbers]),
            "End Elements",
        ]
    )


@pytest.mark.parametrize(
    ("ending", "kind", "order"),
    [
        (".mail", "C3D10", "vtk"),
        (".feb", "C3D10", "vtk"),
        (".k", "C3D10", "vtk"),
        (".mdpa", "C3D10", "vtk"),
        (".mail", "C3D20R", "exodus"),
        (".feb", "C3D20R", "vtk"),
        (".k", "C3D20R", "exodus"),
        (".mdpa", "C3D20R", "exodus"),
    ],
)
def test_cells_of_second_order(ending, kind, order, tmp_path):
    path = written(tmp_path / f"c{ending}", of_second_order(ending, kind, order))
    found = hhr.MeshFile(path)(MPI.COMM_SELF)
    (name,) = {key for key, _ in found.physical_groups}
    assert degree_of(found[0]) == 2 and size_of(found, name, 3) == pytest.approx(2.0, rel=1e-12)


def test_repeated_nodes_of_ls_dyna_are_simpler_cells(tmp_path):
    """A tetrahedron is a solid whose last nodes are one; segments of three nodes are triangles.

    Includes are read.
    """
    nodes = "*KEYWORD\n*NODE\n1,0,0,0\n2,1,0,0\n3,0,1,0\n4,0,0,1\n5,9,9,9\n*END\n"
    text = (
        "*KEYWORD\n*INCLUDE\nnodes.k\n*ELEMENT_SOLID\n1,7,1,2,3,4,4,4,4,4\n"
        "*ELEMENT_SHELL\n1,8,1,2,3,3\n"
    )
    written(tmp_path / "nodes.k", nodes)
    path = written(tmp_path / "c.k", f"{text}*SET_SEGMENT\n3\n1,2,4,4\n*END\n")
    found = hhr.MeshFile(path).read()
    assert found.kind == "tetrahedron" and found.bodies.keys() == {7} and len(found.points) == 4
    assert found.surfaces[3].tolist() == [[0, 1, 3]]
    assert found.surfaces[8].tolist() == [[0, 1, 2]]


def test_plane_cells_of_code_aster_and_kratos(tmp_path):
    text = (
        "COOR_2D\nA 0 0\nB 1 0\nC 0 1\nFINSF\nTRIA3\nM A B C\nFINSF\nSEG2\nS A B\nFINSF\n"
        "GROUP_MA\nlow S\nFINSF\nFIN\n"
    )
    found = hhr.MeshFile(written(tmp_path / "c.mail", text)).read()
    assert found.dim == 2 and found.surfaces["low"].tolist() == [[0, 1]]
    assert hhr.MeshFile(written(tmp_path / "small.mail", text.lower())).read().surfaces.keys() == {
        "low"
    }
    text = (
        "Begin Nodes\n1 0 0 0\n2 1 0 0\n3 0 1 0\nEnd Nodes\nBegin Elements Element2D3N\n"
        "1 1 1 2 3\nEnd Elements\n"
    )
    text += (
        "Begin Geometries Line2D2\n1 1 2\nEnd Geometries\nBegin SubModelPart low\n"
        "Begin SubModelPartGeometries\n1\n"
    )
    text += "End SubModelPartGeometries\nEnd SubModelPart\n"
    found = hhr.MeshFile(written(tmp_path / "c.mdpa", text)).read()
    assert found.dim == 2 and found.surfaces["low"].tolist() == [[0, 1]]
    text = text.replace("Element2D3N", "ShellOf3D3N").replace("Line2D2", "Line3D2")
    assert hhr.MeshFile(written(tmp_path / "c.mdpa", text)).read().kind == "triangle"


def universal(nodes="2411", elements="2412", groups="2467", points=POINTS):
    """Two cubes in data sets of an age.

    A beam has a further row, and a spring is of a type that is not read.
    """
    rows = [
        "    -1",
        "   164",
        "         1  SI: Meter (newton)         2",
        "    -1",
        "    -1",
        f"  {nodes}",
    ]
    for k, place in enumerate(points, 1):
        place = [f"{x:.16E}".replace("E", "D") for x in place]
        head = [f"{k} 0 0 11"]
        rows += [f"{head[0]} {joined(place)}"] if nodes == "15" else [*head, joined(place)]
    rows += ["    -1", "    -1", f"  {elements}"]
    more = "1 1" if elements == "780" else "1"
    for k, cube in enumerate(CUBES, 1):
        rows += [f"{k} 115 {more} {k if elements == '780' else 1} 7 8", joined(cube)]
    rows += [f"{n} 94 {more} 1 7 4\n{joined(face)}" for n, face in FACES.items()]
    rows += [
        f"20 21 {more} 1 7 2",
        "0 1 1",
        "1 2",
        f"21 136 {more} 1 7 2",
        "3 4",
        "    -1",
        "    -1",
        f"  {groups}",
    ]
    width = 2 if groups in ("2435", "2452", "2467", "2477") else 4
    sets = {
        "LOWER": [(8, 1)],
        "UPPER": [(8, 2)],
        "LID": [(7, n) for n in FACES[14]],
        "EDGE": [(8, 20)],
    }
    sets |= {name: [(8, n)] for name, n in zip(NAMES[2:5], FACES, strict=False)} | {
        "GONE": [(8, 21), (8, 99)]
    }
    for number, (name, members) in enumerate(sets.items(), 1):
        rows += [f"{number} 0 0 0 0 0 0 {len(members)}", name]
        words = [f"{kind} {k} 0 0" if width == 2 else f"{kind} {k}" for kind, k in members]
        rows += [joined(words[k : k + width]) for k in range(0, len(words), width)]
    return "\n".join([*rows, "    -1", ""])


AGES = [
    ("2411", "2412", group)
    for group in ("2467", "2477", "2452", "2435", "2432", "2430", "2429", "2417")
]


@needs("nonmatching")
@pytest.mark.parametrize("age", [*AGES, ("781", "780", "2430"), ("15", "71", "2417")])
def test_universal_files_of_all_ages(age, tmp_path):
    """Of I-DEAS, Salome and gmsh, with groups of elements, of nodes and of a beam."""
    path = written(tmp_path / "c.unv", universal(*age))
    assert pressure(path, NAMES) == pytest.approx(10.0, rel=1e-9)
    found = hhr.MeshFile(path).read()
    assert np.sort(found.points[found.nodes["EDGE"]], axis=0).tolist() == [
        [0.0, 0.0, 0.0],
        [1.0, 0.0, 0.0],
    ]
    assert found.left_out == {
        "type 136": "elements of this type, with 2 nodes, are not read",
        "GONE": "none of its 2 members is in the file",
    }


def test_numbers_of_properties_stand_for_groups_that_are_not_there(tmp_path):
    text = universal(elements="780").partition("    -1\n  2467")[0] + "    -1\n"
    found = hhr.MeshFile(written(tmp_path / "c.unv", text)).read()
    assert {name: len(rows) for name, rows in found.bodies.items()} == {1: 2}
    assert len(found.surfaces[1]) == 4


def test_groups_of_points_that_end_gmsh(tmp_path):
    """gmsh 4.15 ends the process when it reads groups of points that it has written itself."""
    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    box = gmsh.model.occ.addBox(0, 0, 0, 1, 1, 1)
    gmsh.model.occ.synchronize()
    for dim, tag, name in ((3, box, "body"), (2, 1, "left"), (1, 1, "edge"), (0, 3, "pin")):
        gmsh.model.addPhysicalGroup(dim, [tag], name=name)
    gmsh.model.mesh.generate(3)
    gmsh.model.mesh.setOrder(2)
    gmsh.option.setNumber("Mesh.SaveGroupsOfNodes", 1)
    for name in ("g.unv", "g.bdf"):
        gmsh.write(str(tmp_path / name))
    gmsh.finalize()
    found = hhr.MeshFile(tmp_path / "g.unv")(MPI.COMM_SELF)
    assert degree_of(found[0]) == 2
    assert size_of(found, "body", 3) == pytest.approx(1.0) and size_of(
        found, "left", 2
    ) == pytest.approx(1.0)
    raw = hhr.MeshFile(tmp_path / "g.unv").read()
    assert len(raw.nodes["edge"]) >= 3 and raw.points[raw.nodes["pin"]] == pytest.approx(
        np.array([[0, 1, 1]])
    )
    found = hhr.MeshFile(tmp_path / "g.bdf")(MPI.COMM_SELF)
    assert degree_of(found[0]) == 2 and size_of(found, 1, 3) == pytest.approx(1.0)


def bulk(form="small", order=1):
    """Two cubes in small, wide or free fields.

    A rigid element, a set and a case control with a set of its own.
    """
    rows = [
        "SOL 101",
        "CEND",
        "SET 5 = 1 THRU 4",
        "BEGIN BULK",
        "$ a comment",
        "MAT1,1,210.+3,,.3",
        "RBE2,90,1,123,2",
    ]

    def card(name, words):
        words = [*map(str, words)]
        count = 4 if form == "wide" else 8
        lines = [words[k : k + count] for k in range(0, len(words), count)]
        heads = [
            name + "*" * (form == "wide"),
            *["*" if form == "wide" else "+"] * (len(lines) - 1),
        ]
        if form == "free":
            return [",".join([head, *own]) for head, own in zip(heads, lines, strict=True)]
        width = 16 if form == "wide" else 8
        return [
            f"{head:8}" + "".join(f"{word:{width}}" for word in own)
            for head, own in zip(heads, lines, strict=True)
        ]

    for k, (x, y, z) in enumerate(POINTS, 1):
        rows += card("GRID", [k, "", x, f"{y * 10:.1f}-1" if form == "free" else y, z])
    for k, cube in enumerate(CUBES, 1):
        rows += card("CHEXA", [k, k, *cube])
    for n, face in FACES.items():
        rows += card("CQUAD4", [n, n, *face])
    return "\n".join(
        [*rows, "SET1    7       1       THRU    4       13", "ENDDATA", "GRID,1,,9.,9.,9.", ""]
    )


@needs("nonmatching")
@pytest.mark.parametrize("form", ["small", "wide", "free"])
def test_fields_of_nastran(form, tmp_path):
    path = written(tmp_path / "c.bdf", bulk(form))
    assert pressure(path, (1, 2, 11, 12, 13, 14)) == pytest.approx(10.0, rel=1e-9)
    found = hhr.MeshFile(path).read()
    assert found.left_out == {"RBE2": "elements of this kind are not read"}
    assert found.nodes["SET1 7"].tolist() == [0, 1, 2, 3, 12]


def test_coordinate_systems_of_nastran(tmp_path):
    """A quarter of a ring in cylindrical coordinates about an axis along x, and a point in
    spherical ones.
    """
    angles = np.linspace(0.0, 90.0, 46)
    grids = [(r, a, h) for h in (0.0, 1.0) for a in angles for r in (1.0, 2.0)]
    rows = ["BEGIN BULK", "CORD2C,4,,1.,0.,0.,2.,0.,0.,", "+,1.,1.,0."]
    rows += [f"GRID,{k},4,{r},{a},{h}" for k, (r, a, h) in enumerate(grids, 1)]
    for k in range(len(angles) - 1):
        base = [2 * k + 1, 2 * k + 2, 2 * k + 4, 2 * k + 3]
        nodes = [*base, *(n + 2 * len(angles) for n in base)]
        rows += [f"CHEXA,{k + 1},3,{joined(nodes[:6], ',')}", f"+,{joined(nodes[6:], ',')}"]
    found = hhr.MeshFile(written(tmp_path / "ring.nas", "\n".join([*rows, ""])))(MPI.COMM_SELF)
    assert size_of(found, 3, 3) == pytest.approx(np.pi / 4 * 3, rel=1e-3)
    low, high = found[0].geometry.x.min(axis=0), found[0].geometry.x.max(axis=0)
    assert low == pytest.approx([1, 0, 0], abs=1e-12) and high == pytest.approx([2, 2, 2])
    rows = [
        "CORD2S,5,,0.,0.,0.,0.,0.,1.",
        "+,1.,0.,0.",
        "GRID,1,5,2.,90.,90.",
        "GRID,2,,1.,0.,0.",
        "GRID,3,,0.,0.,0.",
    ]
    text = "\n".join([*rows, "CTRIA3,1,1,1,2,3", ""])
    assert hhr.MeshFile(written(tmp_path / "s.nas", text)).read().points[0] == pytest.approx([0, 2])


def test_the_usual_coordinate_system_of_nastran(tmp_path):
    """GRDSET, here after its points, gives a system to those that name none; system 0 is one
    too.
    """
    rows = [
        "CORD2C,4,,0.,0.,0.,0.,0.,1.",
        "+,1.,0.,0.",
        "GRID,1,,2.,90.,0.",
        "GRID,2,0,2.,0.,0.",
        "GRID,3,,0.,0.,0.",
    ]
    text = "\n".join([*rows, "GRDSET,,4", "CTRIA3,1,1,1,2,3", "SET1,5,ALL", ""])
    found = hhr.MeshFile(written(tmp_path / "s.nas", text)).read()
    assert found.points == pytest.approx(np.array([[0.0, 2.0], [2.0, 0.0], [0.0, 0.0]]), abs=1e-12)
    assert found.left_out == {"SET1 5": "its list has other words than numbers and THRU"}


@pytest.mark.parametrize("name", ["c.mail", "c.feb", "c.k", "c.mdpa", "c.unv", "c.bdf"])
def test_a_mark_of_unicode_before_the_text(name, tmp_path):
    """Editors of Windows write one."""
    text = {"c.unv": universal(), "c.bdf": bulk()}.get(name) or FILES[name]
    (tmp_path / name).write_text(f"\ufeff{text}", encoding="utf-8")
    assert len(hhr.MeshFile(tmp_path / name).read().cells) == 2


def test_includes_of_nastran(tmp_path):
    head, points, rest = bulk().partition("GRID")
    grids, cells, last = (points + rest).partition("CHEXA")
    written(tmp_path / "grids.inc", grids)
    path = written(tmp_path / "c.bdf", f"{head}INCLUDE 'grids.inc'\n{cells}{last}")
    assert hhr.MeshFile(path).read().bodies.keys() == {1, 2}


def test_grids_of_vtk_of_version_2(tmp_path):
    """DOLFINx writes version 2 and cells of Lagrange.

    An array names its numbers only if all of them are whole.
    """
    points = np.array(POINTS)
    cells = [("hexahedron", np.array(CUBES) - 1), ("quad", np.array([*FACES.values()]) - 1)]
    data = {"part": [[1, 2], [11, 12, 13, 14]], "heat": [[0.0, 1.0], [0.5, 0.0, 0.0, 0.0]]}
    path = tmp_path / "c.vtu"
    meshio.write(path, meshio.Mesh(points, cells, cell_data=data), compression=None)
    before = hhr.MeshFile(path).read()
    text = path.read_bytes()
    assert b'version="0.1"' in text
    path.write_bytes(text.replace(b'version="0.1"', b'version="2.2"'))
    found = hhr.MeshFile(path).read()
    assert found.bodies.keys() == before.bodies.keys() == {1, 2}
    assert found.surfaces.keys() == {11, 12, 13, 14} and np.array_equal(found.points, points)
    path.write_bytes(
        text.replace(b"UnstructuredGrid", b'UnstructuredGrid" compressor="vtkLZ4DataCompressor', 1)
    )
    with pytest.raises(FileContentError, match="compressed by LZ4: write it by ZLib"):
        hhr.MeshFile(path).read()
    path.write_bytes(text.replace(b'version="0.1"', b'version="2.2"')[:400])
    with pytest.raises(FileContentError, match=f"mesh file {re.escape(str(path))} cannot be read"):
        hhr.MeshFile(path).read()


def test_sets_of_solids_parts_and_ranges_of_ls_dyna(tmp_path):
    more = (
        "*SET_PART_LIST_TITLE\nBOTH\n5\n1,2\n*SET_SOLID\n6\n2\n"
        "*SET_NODE_LIST_GENERATE_TITLE\nTOP\n7\n13,16\n*SET_BEAM"
    )
    found = hhr.MeshFile(
        written(tmp_path / "c.k", keywords("commas").replace("*SET_BEAM", more))
    ).read()
    assert found.bodies["BOTH"].tolist() == [0, 1] and found.bodies["solids 6"].tolist() == [1]
    assert found.nodes["TOP"].tolist() == [12, 13, 14, 15]
    solver = keywords().replace(f"{14:>10}\n", f"{14:>10}" + f"{0.0:>10}" * 4 + "MECH\n")
    assert hhr.MeshFile(written(tmp_path / "e.k", solver)).read().nodes.keys() == {"LID"}
    remark = keywords().replace("*ELEMENT_SOLID", "*ELEMENT_SOLID (ten nodes format)")
    assert len(hhr.MeshFile(written(tmp_path / "f.k", remark)).read().cells) == 2
    early = "*SET_PART_LIST\n5\n1,2\n*PART"
    found = hhr.MeshFile(
        written(tmp_path / "d.k", keywords("commas").replace("*PART", early))
    ).read()
    assert found.bodies["parts 5"].tolist() == [0, 1]


@pytest.mark.parametrize("form", ["long", "i10"])
def test_widths_of_fields_of_ls_dyna(form, tmp_path):
    """Manual of LS-DYNA, Getting Started: ``+``, ``%`` and ``-`` behind a keyword, or LONG=Y and
    I10=Y for all blocks.

    I10 widens fields of 8 letters to 10; ``-`` is the standard format.
    """
    usual = hhr.MeshFile(written(tmp_path / "a.k", keywords())).read()
    option, mark = {"long": (" LONG=Y", "+"), "i10": (" I10=Y", " %")}[form]
    whole = keywords(form)
    marked = re.sub(
        r"(?m)^(\*(NODE|ELEMENT\w+|PART|SET\w+))$", rf"\1{mark}", whole.replace(option, "")
    )
    nodes = keywords().partition("*NODE\n")[2].partition("*PART")[0]
    standard = f"{whole.partition('*NODE')[0]}*NODE-\n{nodes}*PART{whole.partition('*PART')[2]}"
    for text in (whole, marked, standard):
        found = hhr.MeshFile(written(tmp_path / "b.k", text)).read()
        assert np.array_equal(found.points, usual.points) and np.array_equal(
            found.cells, usual.cells
        )
        assert (
            found.surfaces.keys() == usual.surfaces.keys()
            and found.nodes.keys() == usual.nodes.keys()
        )


@pytest.mark.parametrize("kind", ["C3D10", "C3D20R"])
def test_long_rows_of_ls_dyna(kind, tmp_path):
    """Twenty nodes after *ELEMENT_SOLID_H20, and ten in rows that end in a comma, as gmsh writes
    them.
    """
    *head, row, last = of_second_order(
        ".k", kind, "exodus" if kind == "C3D20R" else "vtk"
    ).splitlines()
    words = row.split(",")
    text = "\n".join([*head[:-1], "1,1", ",".join(words[:10]), ",".join(words[10:]), last])
    text = text.replace("*ELEMENT_SOLID", "*ELEMENT_SOLID_H20")
    if kind == "C3D10":
        text = "\n".join([*head[:-1], f"1,1,{','.join(words[:8])},", ",".join(words[8:]), last])
    found = hhr.MeshFile(written(tmp_path / "c.k", text))(MPI.COMM_SELF)
    assert degree_of(found[0]) == 2 and size_of(found, 1, 3) == pytest.approx(2.0, rel=1e-12)


def test_edges_and_old_names_of_febio(tmp_path):
    """Edges are sets of nodes in space; files of version 2 call elements by elset."""
    edge = '<Edge name="EDGE"><line2 id="1">1,2</line2></Edge><NodeSet'
    text = feb("2.5").replace('name="LOWER"', 'elset="LOWER"').replace("<NodeSet", edge, 1)
    found = hhr.MeshFile(written(tmp_path / "c.feb", text)).read()
    assert found.nodes["EDGE"].tolist() == [0, 1] and found.bodies["LOWER"].tolist() == [0]


def test_groups_of_nodes_of_med(tmp_path):
    """The layout of MED by netCDF4; gmsh has the nodes in another order than the file."""
    points = np.array(POINTS)
    families = np.where(points[:, 2] == 2.01, 7, 0)
    with netcdf4("a test").Dataset(tmp_path / "c.med", "w") as data:
        nodes = data.createGroup("ENS_MAA/cubes/step/NOE")
        nodes.createDimension("all", points.size)
        nodes.createDimension("nodes", len(points))
        nodes.createVariable("COO", "f8", ("all",))[:] = points.T.ravel()
        nodes.createVariable("FAM", "i8", ("nodes",))[:] = families
        data.createGroup("FAS/cubes/NOEUD/FAM_7_LID").NUM = 7
    order = np.random.default_rng(0).permutation(len(points))
    found = groups_of_nodes(tmp_path / "c.med", points[order], order + 1)
    assert found.keys() == {"LID"} and sorted(order[found["LID"]].tolist()) == [12, 13, 14, 15]


ATTACK = '<!DOCTYPE x [<!ENTITY a "1"><!ENTITY b "&a;&a;&a;">]>\n'
WRONG = {
    "coordinate.mail": (
        mail().replace(" 0.0D0", " zero", 1),
        r"line 6: could not convert string to float: 'ZERO'",
    ),
    "open.mail": (mail().rpartition("FINSF")[0], r"the block GROUP_NO has no FINSF"),
    "count.mail": (
        mail().replace("Q11 N1", "Q11 "),
        r"line 35: the last item of QUAD4 has 4 words, and not 5",
    ),
    "word.mail": ("OOPS\n", "line 1: 'OOPS' begins no block"),
    "lost.mail": (
        mail().replace("Q11 N1 ", "Q11 N99 "),
        "a quad names node N99, which is not in the file",
    ),
    "empty.mail": ("FIN\n", "it is empty, or of a format"),
    "entities.feb": (
        feb().replace("<febio_spec", ATTACK + "<febio_spec"),
        "line 2: files of FEBio have no <!DOCTYPE>",
    ),
    "torn.feb": (feb()[:-30], r"line \d+: no XML: "),
    "other.feb": ("<html/>", "line 1: there is no <Mesh>"),
    "apart.feb": ('<febio_spec><Mesh from="a.feb"/></febio_spec>', "save all in one file"),
    "place.feb": (
        feb().replace("0.0,0.0,0.0", "a,b,c"),
        r"line 6: could not convert string to float: 'a'",
    ),
    "nodes.feb": (
        feb().replace("1, 2, 3, 4, 5", "1, 2, 3, 4"),
        r"line 24: an element of kind hexahedron has 7 nodes",
    ),
    "id.feb": (feb().replace('<node id="3"', "<node"), r"line 8: there is no 'id'"),
    "word.k": (
        keywords("commas").replace("3,1.0,", "3,one,"),
        r"line 8: could not convert string to float: 'one'",
    ),
    "parameter.k": (
        keywords("commas").replace("3,1.0,", "3,&side,"),
        r"line 8: '&side' is a number of \*PARAMETER, which is not read: write the number there",
    ),
    "nodes.k": (
        keywords("commas").replace("1,1,1,2,3", "1,1,1,2"),
        r"line 28: element 1 has 7 nodes",
    ),
    "row.k": (keywords("commas").replace("2,2\n", "2,2\n*"), r"line 29: element 2 has no nodes"),
    "include.k": ("*KEYWORD\n*INCLUDE\nnone.k\n", "none.k"),
    "end.mdpa": (
        mdpa().replace("End Nodes", "End Elements"),
        r"line 25: 'End Elements' ends no block of Nodes",
    ),
    "open.mdpa": (mdpa().rpartition("End")[0], "a block of SubModelPart has no end"),
    "kind.mdpa": (
        mdpa().replace("1 1 1 2 3", "1 1 1 2"),
        r"line 27: '\w+3D8N' has 7 nodes, which is not understood",
    ),
    "torn.unv": (universal().partition("2 3 4")[0], r"line \d+: element 1 has 1 nodes, and not 8"),
    "word.unv": (
        universal().replace("1.0", "l.0", 1),
        r"line \d+: could not convert string to float",
    ),
    "members.unv": (
        universal().replace("0 4\nLID", "0 9\nLID"),
        r"line \d+: invalid literal for int.*'EDGE'",
    ),
    "lost.unv": (
        universal().replace("1 2 3 4 5 6 7 8", "1 2 3 4 5 6 7 88"),
        "names node 88, which is not in the file",
    ),
    "nodes.bdf": (
        bulk("free").replace("CHEXA,1,1,1,", "CHEXA,1,1,,"),
        r"CHEXA 1 has 7 nodes, and not 8 or 20",
    ),
    "system.bdf": (
        bulk("free").replace("GRID,3,,", "GRID,3,9,"),
        "coordinate system 9, and the file has no CORD2R",
    ),
    "word.bdf": (
        bulk("free").replace("GRID,3,,1.0", "GRID,3,,one"),
        r"line \d+: could not convert .* 'ONE'",
    ),
    "include.bdf": ("BEGIN BULK\nINCLUDE 'none.inc'\n", "none.inc"),
    "nan.mdpa": (
        mdpa().replace(" 3 1.0 1.0", " 3 1.0 nan", 1),
        r"has a node at \[1.0, nan, 0.0\]: correct it",
    ),
    "inf.mail": (mail().replace(" 0.0D0", " 1E300", 1), r"has a node at .*1e\+300.*: correct it"),
    "word.mdpa": ("Nodes\n", "line 1: 'Nodes' begins no block"),
}


@pytest.mark.parametrize("name", WRONG)
def test_damaged_files_are_refused_with_the_line(name, tmp_path):
    text, message = WRONG[name]
    with pytest.raises(FileContentError, match=message):
        hhr.MeshFile(written(tmp_path / name, text)).read()


@needs("nonmatching")
def test_a_name_that_is_not_there_is_answered_by_those_that_are(tmp_path):
    with pytest.raises(SceneError, match="no surface of the mesh is called 'TOP'") as found:
        pressure(written(tmp_path / "c.mdpa", mdpa()), (*NAMES[:3], "TOP", *NAMES[4:]))
    assert "MASTER" in str(found.value)
