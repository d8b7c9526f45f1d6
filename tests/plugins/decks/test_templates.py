"""Templates of meshes whose names say what surfaces are: supports, symmetry, pressures, sections of
bolts.
"""

from dataclasses import replace

import numpy as np
import pytest
from needs import needs
from shell import invoke

import hhr_dolfinx as hhr
from hhr_dolfinx.command.loading import scene_of
from hhr_dolfinx.geometries.mesh_file import MeshFile

LENGTH, YOUNG = 3.0, 210e3


def column(folder, end="FIXED_END", side="SYMMETRY_X"):
    """A column of 1 x 1 x 3 with a section at a height of 1, and a cap of 1 x 1 x 1 on it with
    nodes of its own.
    """
    square = [(0, 0), (1, 0), (1, 1), (0, 1)]
    heights = [0, 1, 2, 3, 3, 4]
    rows = ["*NODE"]
    rows += [
        f"{4 * k + n + 1}, {x}, {y}, {z}"
        for k, z in enumerate(heights)
        for n, (x, y) in enumerate(square)
    ]
    for name, layers in (("BOLT", (0, 1, 2)), ("CAP", (4,))):
        rows.append(f"*ELEMENT, TYPE=C3D8, ELSET={name}")
        rows += [f"{k + 1}, {', '.join(str(4 * k + n) for n in range(1, 9))}" for k in layers]
    surfaces = {
        end: [(1, 1)],
        "BOLT_SECTION": [(1, 2)],
        "TOP": [(3, 2)],
        "CAP_FOOT": [(5, 1)],
        "Pressure_lid": [(5, 2)],
        side: [(k, 6) for k in (1, 2, 3, 5)],
        "SYMMETRY_Y": [(k, 3) for k in (1, 2, 3, 5)],
    }
    for name, faces in surfaces.items():
        rows += [f"*SURFACE, NAME={name}", *(f"{cell}, S{face}" for cell, face in faces)]
    path = folder / "column.inp"
    path.write_text("\n".join(rows) + "\n")
    return path


@needs("floating")
@pytest.mark.parametrize("end", ["FIXED_END", "symmetry_z"])
def test_names_lead_to_a_scene_that_runs(end, tmp_path):
    """The bolt is shortened and pressed, and its force is that of the pressure.

    Contact alone holds the cap.
    """
    code, output = invoke("start", column(tmp_path, end))
    assert code == 0 and output.count("TODO") == 1, output  # the materials
    scene = scene_of(str(tmp_path / "column.py"))
    assert scene.geometry.sections == ("BOLT_SECTION",) and len(scene.contacts) == 1
    assert scene.parameters.names == ("preload", "pressure")
    assert scene.parameters.middle == pytest.approx([1e-3 * LENGTH, 1.0])
    imposed = {(item.tag, item.component) for item in scene.displacements}
    held = {(end, k) for k in ((0, 1, 2) if end == "FIXED_END" else (2,))}
    assert imposed == {("SYMMETRY_X", 0), ("SYMMETRY_Y", 1)} | held
    wide = hhr.ParameterSpace(scene.parameters.names, (0.0, 0.0), (0.01, 10.0))
    full = hhr.FullOrderModel(replace(scene, parameters=wide))
    answer = full.solve([0.003, 10.0])
    force = answer.outputs()["force 0"]
    lid, top = (np.isclose(full.problem.points[:, 2], z) for z in (LENGTH + 1, LENGTH))
    u = answer.displacement().reshape(-1, 3)[:, 2]
    if end == "symmetry_z":  # nothing hinders the ends from getting wider
        assert u[top] == pytest.approx(np.full(8, -0.003 - force * LENGTH / YOUNG), rel=1e-6)
        assert u[lid] == pytest.approx(
            np.full(4, u[top].mean() - (force + 10.0) / 2 / YOUNG), rel=1e-3
        )
    assert force == pytest.approx(10.0, rel=1e-9)


@needs("floating")
def test_symmetry_alone_does_not_hold_a_body(tmp_path):
    """Planes of symmetry along x and y: along z the far end of the column is held, and the lid
    guided.
    """
    code, output = invoke("start", column(tmp_path, "FOOT"))
    assert code == 0 and output.count("TODO") == 1, output
    scene = scene_of(str(tmp_path / "column.py"))
    held = {(item.tag, item.component) for item in scene.displacements}
    assert (
        held >= {("SYMMETRY_X", 0), ("SYMMETRY_Y", 1), ("FOOT", 2)}
        and ("Pressure_lid", 2) not in held
    )
    assert [load.tag for load in scene.loads] == ["Pressure_lid"]
    assert hhr.FullOrderModel(scene).solve(scene.parameters.middle).forces().sum() == pytest.approx(
        1.0, rel=1e-6
    )


def test_two_names_of_a_surface_give_one_pair(tmp_path):
    """Gmsh writes each surface as SurfaceN, too: the name of the user counts, and conditions are
    not there twice.
    """
    path = column(tmp_path)
    more = "*SURFACE, NAME=Surface7\n3, S2\n*SURFACE, NAME=Surface9\n5, S1\n*SURFACE, NAME"
    path.write_text(path.read_text().replace("*SURFACE, NAME", more, 1))
    assert invoke("start", path)[0] == 0
    assert [
        (pair.first, pair.second) for pair in scene_of(str(tmp_path / "column.py")).contacts
    ] == [("TOP", "CAP_FOOT")]


def test_an_inclined_plane_of_symmetry(tmp_path):
    """Its nodes stay in it."""
    path = column(tmp_path, side="SYMMETRY_TURNED")
    turn = np.array([[0.8, -0.6], [0.6, 0.8]])
    rows = path.read_text().splitlines()
    for k, row in enumerate(rows[1:25], start=1):
        number, x, y, z = row.split(", ")
        x, y = turn @ (float(x), float(y))
        rows[k] = f"{number}, {x}, {y}, {z}"
    path.write_text("\n".join(rows) + "\n")
    code, output = invoke("start", path)
    assert code == 0 and output.count("TODO") == 1
    constraints = scene_of(str(tmp_path / "column.py")).constraints
    planes = {
        one.place: one.direction for one in constraints if isinstance(one, hhr.DirectedDisplacement)
    }
    assert planes["SYMMETRY_TURNED"] == pytest.approx((-0.8, -0.6, 0.0))
    assert planes["SYMMETRY_Y"] == pytest.approx((0.6, -0.8, 0.0))


def test_a_check_takes_the_sides_of_a_section_and_springs_as_used(tmp_path):
    """The section doubles nodes on purpose, and springs act though their ground stays."""
    invoke("start", column(tmp_path))
    text = (tmp_path / "column.py").read_text()
    (tmp_path / "column.py").write_text(
        text.replace("loads=(", "loads=(hhr.Springs('CAP_FOOT', 2, 0.1, bedding=True),")
    )
    _, output = invoke("check", tmp_path / "column.py", "--picture", tmp_path / "column.png")
    assert (
        "nothing names" not in output
        and "falls apart" not in output
        and "does nothing" not in output
    )
    assert "body 'BOLT' is made of 2 pieces" in output and "hold every body" in output


@needs("floating")
def test_sides_of_bodies_where_the_file_names_no_surface(tmp_path):
    """The sides that touch are the top of the bolt and the foot of the cap.

    The pressure on the lid passes through.
    """
    path = column(tmp_path)
    path.write_text(path.read_text().partition("*SURFACE")[0])
    assert not MeshFile(path).read().surfaces
    code, output = invoke("start", path)
    assert code == 0 and output.count("TODO") == 1, output  # the materials
    scene = scene_of(str(tmp_path / "column.py"))
    assert {scene.contacts[0].first, scene.contacts[0].second} == {"BOLT z = 3", "CAP z = 3"}
    assert {item.tag for item in scene.displacements} == {"BOLT z = 0", "CAP z = 4"}
    assert hhr.FullOrderModel(scene).solve([1.1]).outputs()["force 0"] == pytest.approx(
        1.1, rel=1e-9
    )


def test_sides_end_at_edges_and_go_on_around_a_mantle(tmp_path):
    """A prism of 16 sides, 22.5 degrees each, has three sides, and one of 6 has eight.

    Areas are those of polygons.
    """
    for count, wanted in ((16, 3), (6, 8)):
        angles = 2 * np.pi * np.arange(count) / count
        ring = [(np.cos(a), np.sin(a)) for a in angles]
        points = [(x, y, z) for z in (0.0, 1.0) for x, y in ((0.0, 0.0), *ring)]
        top = count + 1
        wedges = [(1, 2 + k, 2 + (k + 1) % count) for k in range(count)]
        # three tetrahedra of each wedge, divided alike on common sides
        cells = []
        for bottom in wedges:
            a, b, c = sorted(bottom)
            cells += [(a, b, c, c + top), (a, b, b + top, c + top), (a, a + top, b + top, c + top)]
        rows = ["*NODE", *(f"{k}, {x}, {y}, {z}" for k, (x, y, z) in enumerate(points, 1))]
        rows += [
            "*ELEMENT, TYPE=C3D4, ELSET=ROD",
            *(f"{k}, {', '.join(map(str, c))}" for k, c in enumerate(cells, 1)),
        ]
        (tmp_path / "rod.inp").write_text("\n".join(rows) + "\n")
        raw = hhr.WithOutside(tmp_path / "rod.inp", sides=True).read()
        sides = {name: rows for name, rows in raw.surfaces.items() if str(name).startswith("ROD")}
        assert len(sides) == wanted and {"ROD z = 0", "ROD z = 1"} < sides.keys()
        area = {}
        for name, facets in sides.items():
            a, b, c = np.moveaxis(raw.points[facets], 1, 0)
            area[name] = np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2
        assert area.pop("ROD z = 0") == pytest.approx(count / 2 * np.sin(2 * np.pi / count))
        area.pop("ROD z = 1")
        mantle = 2 * count * np.sin(np.pi / count)
        assert list(area.values()) == pytest.approx([mantle / len(area)] * len(area))


def test_shells_are_refused_and_named(tmp_path):
    """Faces of a body without the body; a plane mesh must lie across z."""
    text = (
        "*NODE\n1, 0, 0, 0\n2, 1, 0, 0\n3, 1, 0, 1\n4, 0, 0, 1\n"
        "*ELEMENT, TYPE=S4, ELSET=SIDE\n1, 1, 2, 3, 4\n"
    )
    (tmp_path / "shell.inp").write_text(text)
    code, output = invoke("start", tmp_path / "shell.inp")
    assert (
        code == 3
        and "cells of dimension 2 in a space of dimension 3: shells are not supported" in output
    )
    code, output = invoke("check", tmp_path / "shell.inp")
    assert code == 0 and "the cells are shells in space, which are not supported" in output


def test_a_bar_with_one_named_surface_is_held_and_pressed_at_its_ends(tmp_path):
    """Of a bar of 1 x 1 x 3 the surface FIXED is held, another one is not.

    The pressure acts on the far end.
    """
    path = column(tmp_path)
    head = path.read_text().partition("*ELEMENT, TYPE=C3D8, ELSET=CAP")[0]
    for more, end in (
        ("*SURFACE, NAME=HOLE\n2, S3\n", "BOLT z = 0"),
        ("*SURFACE, NAME=FIXED\n1, S1\n", "FIXED"),
    ):
        path.write_text(head + more)
        code, output = invoke("start", path, "--force")
        assert code == 0 and "contact: no surfaces of two bodies" in output, output
        scene = scene_of(str(tmp_path / "column.py"))
        assert [(item.tag, item.component) for item in scene.displacements] == [
            (end, k) for k in range(3)
        ]
        assert [load.tag for load in scene.loads] == ["BOLT z = 3"]
        rigid = replace(scene, bodies=(hhr.Body("BOLT", 1e3, 0.0),))
        found = hhr.FullOrderModel(rigid).solve(scene.parameters.middle).displacement()
        assert np.abs(found).max() == pytest.approx(1.0 * LENGTH / 1e3)


def plates(folder, thickness=1.0, gap=0.002, named=(("LOWER", 1), ("UPPER", 3))):
    """Two squares above each other, of which only some sides have names: S1 is the bottom of a
    cell, S3 its top.
    """
    heights = (0.0, thickness, thickness + gap, 2 * thickness + gap)
    rows = [
        "*NODE",
        *(f"{2 * k + n + 1}, {2.0 * n}, {y!r}" for k, y in enumerate(heights) for n in range(2)),
    ]
    for number, (name, first) in enumerate((("LOWER", 1), ("UPPER", 5)), 1):
        rows += [
            f"*ELEMENT, TYPE=CPE4, ELSET={name}",
            f"{number}, {first}, {first + 1}, {first + 3}, {first + 2}",
        ]
    for name, face in named:
        rows += [f"*SURFACE, NAME={name}_SIDE", f"{name}, S{face}"]
    path = folder / "plates.inp"
    path.write_text("\n".join(rows) + "\n")
    return path


@needs("floating")
@pytest.mark.parametrize("thickness", [1.0, 0.004])
def test_sides_that_look_away_from_each_other_are_no_pair(thickness, tmp_path):
    """The floor of the lower plate and the lid of the upper one: sides of the bodies touch, and 2 p
    passes through.

    Plates thinner than a hundredth of their length are no deeper behind each other than surfaces
    that overlap.
    """
    code, output = invoke("start", plates(tmp_path, thickness))
    assert code == 0, output
    scene = scene_of(str(tmp_path / "plates.py"))
    between = {f"LOWER y = {thickness:g}", f"UPPER y = {thickness + 0.002:g}"}
    assert {scene.contacts[0].slave, scene.contacts[0].master} == between
    assert {item.tag for item in scene.displacements} == {"LOWER_SIDE", "UPPER_SIDE"}
    thick = replace(
        scene, bodies=tuple(replace(body, young=1e6, poisson=0.0) for body in scene.bodies)
    )
    assert hhr.FullOrderModel(thick).solve([1.0]).outputs()["force 0"] == pytest.approx(
        2.0, rel=1e-9
    )


def test_surfaces_that_overlap_face_each_other(tmp_path):
    """A press fit drawn with an overlap of half a percent of its bodies."""
    assert invoke("start", plates(tmp_path, 1.0, -0.005, (("LOWER", 3), ("UPPER", 1))))[0] == 0
    scene = scene_of(str(tmp_path / "plates.py"))
    assert {scene.contacts[0].slave, scene.contacts[0].master} == {"LOWER_SIDE", "UPPER_SIDE"}


def test_a_ball_has_nothing_to_hold_and_to_press(tmp_path):
    """Its one side is its whole outside: no scene is written that cannot be read."""
    import gmsh

    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.model.occ.addSphere(0, 0, 0, 1)
    gmsh.model.occ.synchronize()
    gmsh.option.setNumber("Mesh.MeshSizeMax", 0.6)
    gmsh.model.mesh.generate(3)
    gmsh.write(str(tmp_path / "ball.msh"))
    gmsh.finalize()
    code, output = invoke("start", tmp_path / "ball.msh")
    assert code == 3 and "Name the surfaces to hold and to press" in output, output
    assert not (tmp_path / "ball.py").exists()
