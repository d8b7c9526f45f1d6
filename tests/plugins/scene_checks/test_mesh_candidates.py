"""Surfaces of mesh files that can be contacts, and pictures of mesh files."""

import numpy as np
import pytest
import your_scene
from cubes_in_files import (
    CORNERS,
    CUBE,
    CUBES,
    DECK,
    FACES,
    NAMES,
    PLACED,
    POINTS,
    by_meshio,
    nodes_of_deck,
    written,
)
from scipy.spatial.transform import Rotation
from shell import invoke

import hhr_dolfinx as hhr
from hhr_dolfinx.geometries.raw_mesh import RawMesh
from hhr_dolfinx.plugins.scene_checks import drawing
from hhr_dolfinx.plugins.scene_checks.candidates import contact_candidates
from hhr_dolfinx.plugins.scene_checks.drawing import figure_of_mesh


def cubes(gap, turn=None, scale=1.0):
    """Two cubes, the upper one above the lower one by a gap, shifted sideways by a third."""
    points = np.array(POINTS)
    points[8:] += (1 / 3, 0.0, gap - 0.01)
    points = scale * (points if turn is None else turn.apply(points))
    faces = dict(zip(NAMES[2:], FACES.values(), strict=True))
    surfaces = {name: np.array([face]) - 1 for name, face in faces.items()}
    bodies = {"LOWER": np.array([0]), "UPPER": np.array([1]), "EVERY": np.array([0, 1])}
    return RawMesh(points, "hexahedron", np.array(CUBES) - 1, bodies, surfaces)


@pytest.mark.parametrize("scale", [1e-3, 1.0])
@pytest.mark.parametrize("gap", [0.0, 0.01, 0.0999, -0.005])
def test_the_gap_of_two_cubes_in_any_position(gap, scale):
    for turn in (None, *Rotation.random(3, rng=np.random.default_rng(0))):
        ((names, found),) = contact_candidates(cubes(gap, turn, scale))
        assert names == "MASTER and SLAVE" and found == pytest.approx(scale * gap, abs=1e-12)


@pytest.mark.parametrize("gap", [0.11, -0.02, 3.0])
def test_surfaces_that_are_far_or_deep_inside_are_no_pair(gap):
    assert contact_candidates(cubes(gap)) == []


def test_surfaces_of_one_piece_are_no_pair():
    """A slit that ends at a node: its sides face each other, and their cells share the node."""
    points = np.array([(x, y) for y in (0.0, 1.0, 1.02, 2.0) for x in (0.0, 1.0)])
    cells = np.array([[0, 1, 3, 2], [4, 5, 7, 6]])
    raw = RawMesh(
        points,
        "quadrilateral",
        cells,
        {"all": np.arange(2)},
        {"low": cells[:1, 2:], "high": cells[1:, :2]},
    )
    assert contact_candidates(raw) == [("low and high", pytest.approx(0.02))]
    cells[1, 1] = 3
    assert contact_candidates(raw) == []


def test_pairs_of_the_demo_are_those_of_its_scene():
    found = contact_candidates(hhr.MeshFile(your_scene.MESH).read())
    wanted = {
        frozenset(pair.tags): 0.2 if "stop_round" in pair.tags else 0.0
        for pair in your_scene.scene().contacts
    }
    assert {frozenset(names.split(" and ")): gap for names, gap in found} == pytest.approx(
        wanted, abs=1e-9
    )


def test_a_mesh_file_is_shown_with_its_pairs_and_drawn(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    written(tmp_path / "parts.inp", CUBE + PLACED)
    code, said = invoke("check", "parts.inp", "--picture", "it.png")
    assert (
        code == 0
        and "the smallest gaps of flat facets:\n    Low-1.Top and Up-1.Top: gap 0.01\n" in said
    )
    assert "picture: it.png" in said and (tmp_path / "it.png").stat().st_size > 10_000
    assert "y 0 to 1, z 1.01 to 2.01" in said  # without the round-off of the turn
    far = CUBE + PLACED.replace("1.01", "3.01")
    code, said = invoke("check", written(tmp_path / "far.inp", far))
    assert code == 0 and "for contacts" not in said and not (tmp_path / "far_check.png").exists()
    code, said = invoke("check", "parts.inp", "--picture", "it.txt")
    assert code == 3 and "it.txt must end in .png" in said
    assert invoke("check", "parts.inp", "--mesh-error")[0] == 2


def test_shells_alone_have_no_pairs_and_are_drawn(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    text = (
        nodes_of_deck(CORNERS)
        + "*ELEMENT, TYPE=S4, ELSET=A\n1, 1, 2, 3, 4\n2, 5, 6, 7, 8\n3, 1, 2, 6, 5\n"
    )
    written(tmp_path / "shells.inp", f"{text}*NSET, NSET=EDGE\n1, 4\n")
    code, said = invoke("check", "shells.inp", "--picture", "it.png")
    assert (
        code == 0
        and "    EDGE  1 line" in said
        and "for contacts" not in said
        and (tmp_path / "it.png").exists()
    )


@pytest.mark.parametrize("name", ["blocks.inp", "cubes.msh"])
def test_a_picture_has_each_body_and_surface_once(name, tmp_path):
    """Sets of all cells, and numbers of what has a name, are not drawn again.

    Cells in no body are grey.
    """
    if name == "blocks.inp":
        more = nodes_of_deck([(x + 3, y, z) for x, y, z in CORNERS], 100)
        more += (
            f"*ELEMENT, TYPE=C3D8\n9, {', '.join(str(100 + k) for k in range(8))}\n"
            "*ELSET, ELSET=ALL\nLOWER, UPPER\n"
        )
        path = written(tmp_path / name, DECK + more)
        wanted = [
            "body LOWER",
            "body UPPER",
            "in no body",
            *(f"surface {one}" for one in NAMES[2:]),
        ]
    else:
        path = by_meshio(
            tmp_path / name, **{"gmsh:physical": [1, 2, *FACES], "gmsh:geometrical": [1, 2, *FACES]}
        )
        wanted = ["body 1", "body 2", *(f"surface {one}" for one in FACES)]
    figure = figure_of_mesh(hhr.MeshFile(path).read(), name)
    assert [text.get_text() for text in figure.legends[0].get_texts()] == wanted


def test_the_outside_of_a_body_hides_no_surface(tmp_path, monkeypatch):
    """Each facet belongs to the smallest set: of the outside of the upper cube four sides are
    left.
    """
    path = written(tmp_path / "skin.inp", DECK + "*SURFACE, NAME=A_SKIN\nUPPER,\n")
    drawn = {}
    monkeypatch.setattr(
        drawing, "_draw_facets", lambda _, facets, __, label: drawn.update({label: len(facets)})
    )
    figure_of_mesh(hhr.MeshFile(path).read(), "skin")
    assert drawn["surface SLAVE"] == drawn["surface LID"] == 1 and drawn["surface A_SKIN"] == 4
