"""Parts and instances of Abaqus decks: places, names, and what is refused.

Two instances of a unit cube are 0.01 apart and closed by 0.03, with E = 1000 and nu = 0: the
pressure is 10.
"""

import numpy as np
import pytest
from cubes_in_files import (
    CORNERS,
    CUBE,
    PLACED,
    SECOND,
    nodes_of_deck,
    pressure,
    reasons,
    size_of,
    two_cubes,
    written,
)
from mpi4py import MPI
from needs import needs
from scipy.spatial.transform import Rotation

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import FileContentError, SceneError

NAMES = ("Low-1.Whole", "Up-1", "Low-1.Bottom", "Low-1.Top", "Up-1.Top", "Up-1.Bottom")


@needs("nonmatching")
def test_a_part_that_is_placed_twice(tmp_path):
    path = written(tmp_path / "a.inp", f"*HEADING\n{CUBE}{PLACED}*END ASSEMBLY\n*STEP\n*END STEP\n")
    assert pressure(path, NAMES) == pytest.approx(10.0, rel=1e-9)


def test_loads_by_numbers_of_an_instance_have_names(tmp_path):
    """Nodes and faces of the flat deck.

    A load of something else, which no scene names, refuses nothing.
    """
    loads = (
        "*BOUNDARY\nUp-1.3, 1, 3\nLow-1.Bottom, 2\nweld.7, 1\n*CLOAD\nUp-1.8, 3, 2.\n"
        "*DLOAD\nUp-1.1, P2, 5.\n"
    )
    text = f"{CUBE}{PLACED}*END ASSEMBLY\n*STEP\n{loads}*END STEP\n"
    raw = hhr.MeshFile(written(tmp_path / "a.inp", text)).read()
    line = {row: 1 + number for number, row in enumerate(text.splitlines()) if row.startswith("*")}
    turned = np.array([CORNERS[2], CORNERS[7]]) * (1, -1, -1) + (0, 1, 2.01)
    for name, place in zip(
        (f"BOUNDARY:{line['*BOUNDARY']} 1 3", f"CLOAD:{line['*CLOAD']} 3 2."), turned, strict=True
    ):
        assert raw.points[raw.nodes[name]] == pytest.approx(place[None])
    face = raw.points[raw.surfaces[f"DLOAD:{line['*DLOAD']} P2 5."]]
    assert face.shape == (1, 4, 3) and face[0, :, 2] == pytest.approx([1.01] * 4)


SURFACES = {
    "sets of an instance": (
        "*ELSET, ELSET=_S1, INTERNAL, INSTANCE=up-1\n1,\n*SURFACE, NAME=Under\n_S1, S2\n"
        "*SURFACE, NAME=Over\nLow-1.Whole, S2\n*NSET, NSET=Lid, INSTANCE=Up-1\nBottom\n"
        "*NSET, NSET=Floor, INSTANCE=Low-1, GENERATE\n1, 4, 1\n"
    ),
    "numbers and names with that of the instance": (
        "*SURFACE, NAME=Under\nUp-1.1, S2\n*SURFACE, NAME=Over, COMBINE=UNION\nLow-1.Top,\n"
        "*NSET, NSET=Lid\nUp-1.1, up-1.2, Up-1.3, Up-1.4\n*SURFACE, TYPE=NODE, "
        "NAME=Floor\nLow-1.Bottom, 1.\n"
    ),
    "beside nodes of the assembly": (
        "*NODE\n1, 9., 9., 9.\n*NSET, NSET=Reference\n1,\n*ELEMENT, TYPE=MASS, ELSET=Point\n1, 1\n"
        "*SURFACE, NAME=Under\nUp-1.Whole, S2\n*SURFACE, NAME=Over\nLow-1.1, S2\n"
        "*NSET, NSET=Lid, ELSET=Up-1\n*NSET, NSET=Floor, INSTANCE=Low-1\n1, 2, 3, 4\n"
    ),
}


@needs("nonmatching")
@pytest.mark.parametrize("what", SURFACES)
def test_sets_and_surfaces_of_the_assembly(what, tmp_path):
    path = written(tmp_path / "a.inp", f"{CUBE}{PLACED}{SURFACES[what]}*END ASSEMBLY\n")
    found = hhr.MeshFile(path).read()
    assert len(found.points) == 16 and "Reference" not in found.all_surfaces()
    if what == "beside nodes of the assembly":
        assert sorted(found.points[found.nodes["Lid"]][:, 2].round(2)) == [1.01] * 4 + [2.01] * 4
        assert found.left_out["Point"].startswith("1 element of type MASS")
        names = ("Low-1", "Up-1", "Floor", "Over", "Under", "Up-1.Bottom")
    else:
        names = ("Low-1", "Up-1", "Floor", "Over", "Under", "Lid")
    assert pressure(path, names) == pytest.approx(10.0, rel=1e-9)


@needs("nonmatching")
def test_short_names_are_names_where_one_set_has_them(tmp_path):
    other = CUBE.replace("Cube", "Other").replace("Top", "Under").replace("Whole", "Block")
    path = written(tmp_path / "a.inp", CUBE + other + PLACED.replace("CUBE", "Other"))
    names = ("Whole", "Block", "Low-1.Bottom", "Top", "Under", "Up-1.Bottom")
    assert pressure(path, names) == pytest.approx(10.0, rel=1e-9)
    assert reasons(path) == {
        "Bottom": "is in several instances: name it 'Low-1.Bottom' or 'Up-1.Bottom'"
    }
    with pytest.raises(
        SceneError,
        match=r"'Bottom' is in the file: is in several instances: name it 'Low-1\.Bottom'",
    ):
        pressure(path, (*names[:2], "Bottom", *names[3:]))


def test_the_place_of_an_instance_is_that_of_the_manual(tmp_path):
    """Moved first and then turned by the right hand about the axis from the first point to the
    second one.
    """
    start, end, angle, shift = (
        np.array([0.3, -1.0, 2.0]),
        np.array([1.0, 4.0, -2.5]),
        77.0,
        np.array([3.0, 0.5, -7.0]),
    )
    row = ", ".join(f"{x!r}" for x in [*start.tolist(), *end.tolist(), angle])
    axis = (end - start) / np.linalg.norm(end - start)
    turn = Rotation.from_rotvec(np.deg2rad(angle) * axis)
    moved = turn.apply(np.array(CORNERS) + shift - start) + start
    only_turned = turn.apply(np.array(CORNERS) - start) + start
    by = ", ".join(map(str, shift))
    for rows, right in (
        (f"{by}\n{row}\n", moved),
        (f"{by}\n", CORNERS + shift),
        (f"{row}\n", only_turned),
    ):
        path = written(
            tmp_path / "a.inp", f"{CUBE}*INSTANCE, NAME=A, PART=Cube\n{rows}*END INSTANCE\n"
        )
        np.testing.assert_allclose(hhr.MeshFile(path).read().points, right, atol=1e-12)


@pytest.mark.parametrize("kind", SECOND)
def test_parts_of_second_order(kind, tmp_path):
    """Sizes of two instances, and of the first face of each.

    The nodes of sides are turned with the corners.
    """
    corners, edges, size = SECOND[kind]
    points = [
        *corners,
        *(tuple(np.mean([corners[a], corners[b]], axis=0).tolist()) for a, b in edges),
    ]
    numbers = list(range(1, len(points) + 1))
    element = ", ".join(map(str, [1, *numbers[:10]])) + "".join(f",\n{n}" for n in numbers[10:])
    text = f"*PART, NAME=P\n{nodes_of_deck(points)}*ELEMENT, TYPE={kind}, ELSET=E\n{element}\n"
    text += "*SURFACE, NAME=First\nE, S1\n*END PART\n*INSTANCE, NAME=A, PART=P\n*END INSTANCE\n"
    text += "*INSTANCE, NAME=B, PART=P\n5., 0., 0.\n5., 0., 0., 5., 0., 1., 30.\n*END INSTANCE\n"
    found = hhr.MeshFile(written(tmp_path / "a.inp", text))(MPI.COMM_SELF)
    dim = found[0].topology.dim
    for name in ("A", "B", "A.E", "B.E"):
        assert size_of(found, name, dim) == pytest.approx(size, rel=1e-12), name
    assert size_of(found, "A.First", dim - 1) == pytest.approx(2.0)
    assert size_of(found, "B.First", dim - 1) == pytest.approx(2.0)


def test_names_with_blanks_are_in_quotes(tmp_path):
    text = f'{CUBE}*INSTANCE, NAME="the lower one", PART=Cube\n*END INSTANCE\n'
    text += (
        '*NSET, NSET="a pin"\n"the lower one".7,\n'
        '*SURFACE, NAME="all of it"\n"the lower one".Whole,\n'
    )
    found = hhr.MeshFile(written(tmp_path / "a.inp", text)).read()
    assert (
        found.points[found.nodes["a pin"]].tolist() == [[1.0, 1.0, 1.0]]
        and len(found.surfaces["all of it"]) == 6
    )
    assert "the lower one.Top" in found.surfaces


def test_parts_in_included_files_of_a_folder_and_a_mesh_in_the_instance(tmp_path):
    (tmp_path / "parts").mkdir()
    written(
        tmp_path / "parts" / "cube.inp",
        CUBE.replace(nodes_of_deck(CORNERS), "*INCLUDE, INPUT=nodes.inp\n"),
    )
    written(tmp_path / "parts" / "nodes.inp", nodes_of_deck(CORNERS))
    own = CUBE.partition("\n")[2].replace("*END PART\n", "").replace("Whole", "Mine")
    instance = (
        "*PART, NAME=Empty\n*END PART\n*INSTANCE, NAME=B, PART=Empty\n0., 0., 5.\n"
        f"{own}*END INSTANCE\n"
    )
    deck = (
        f"*INCLUDE, INPUT=parts/cube.inp\n*INSTANCE, NAME=A, PART=Cube\n*END INSTANCE\n{instance}"
    )
    found = hhr.MeshFile(written(tmp_path / "a.inp", deck)).read()
    assert len(found.cells) == 2 and found.bodies.keys() == {
        "A",
        "B",
        "A.Whole",
        "B.Mine",
        "Whole",
        "Mine",
    }


def test_parts_that_nothing_places(tmp_path):
    other = CUBE.replace("Cube", "Idle")
    path = written(
        tmp_path / "a.inp", f"{CUBE}{other}*INSTANCE, NAME=A, PART=Cube\n*END INSTANCE\n"
    )
    assert reasons(path) == {"Idle": "a part that no instance places"}
    assert hhr.MeshFile(written(tmp_path / "a.inp", CUBE)).read().bodies.keys() == {
        "Cube",
        "Cube.Whole",
        "Whole",
    }


WRONG = {
    "*INSTANCE, NAME=A, PART=Cub\n": r"\*INSTANCE at line 20: there is no part 'Cub' before it",
    "*INSTANCE, NAME=A, LIBRARY=job, INSTANCE=A\n": "results of another analysis are not supported",
    "*INSTANCE, NAME=A, PART=Cube\n0,0,0\n0,0,0,1,0,0\n": (
        "has two points and an angle, and not 6 numbers"
    ),
    "*INSTANCE, NAME=A, PART=Cube\n0,0,0\n0,0,0,0,0,0,9.\n": "two points that are the same",
    "*INSTANCE, NAME=A, PART=Cube\n*END INSTANCE\n*NSET, NSET=S\nB.1\n": (
        "there is no instance 'B' before it"
    ),
    "*INSTANCE, NAME=A, PART=Cube\n*END INSTANCE\n*NSET, NSET=S, INSTANCE=A\nnone\n": (
        "there is no set 'A.none' before"
    ),
    "*INSTANCE, NAME=A, PART=Cube\n*ELEMENT, TYPE=C3D8\n7, 1, 2, 3, 4, 5, 6, 7, 99\n": (
        r"element A\.7 has a node"
    ),
    "*INSTANCE, NAME=A, PART=Cube\n*END INSTANCE\n*SURFACE, NAME=S\nA.1, S9\n": (
        r"'A\.1, S9' is no face of cells"
    ),
    "*NODE, SYSTEM=X\n1, 1., 90.\n": "there is no coordinate system X, but R, C and S",
}


@pytest.mark.parametrize("text", WRONG)
def test_decks_of_parts_that_are_refused(text, tmp_path):
    path = written(tmp_path / "a.inp", CUBE + text)
    with pytest.raises(FileContentError, match=WRONG[text]):
        hhr.MeshFile(path).read()


@needs("nonmatching")
def test_a_missing_name_is_answered_with_those_of_instances(tmp_path):
    path = written(tmp_path / "a.inp", CUBE + PLACED)
    with pytest.raises(SceneError, match="no surface of the mesh is called 'Top'") as found:
        hhr.FullOrderModel(two_cubes(path, (*NAMES[:3], "Top", *NAMES[4:])), MPI.COMM_SELF)
    assert "Low-1.Top" in str(found.value)
