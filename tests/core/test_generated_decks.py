"""Decks that generate nodes and elements or read them from files, sets that keep their order, odd
types and systems.

Two unit cubes of 2 x 2 x 2 cells, 0.01 apart and closed by 0.03, with E = 1000 and nu = 0: the
pressure is 10.
"""

import numpy as np
import pytest
from cubes_in_files import DECK, NAMES, pressure, reasons, written
from needs import needs

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import FileContentError
from hhr_dolfinx.geometries.abaqus_deck import flat_deck


def cube(first, height, names, element):
    """Corners, lines between them, two layers filled between these, and one element that is
    copied.
    """
    body, low, high = names
    rows = []
    for z, name, start in ((height, low, first), (height + 1.0, high, first + 200)):
        rows += ["*NODE"]
        rows += [f"{start + 2 * x + 20 * y}, {x}., {y}., {z}" for x in (0, 1) for y in (0, 1)]
        rows += [f"*NGEN, NSET=FRONT{start}", f"{start}, {start + 2}"]
        rows += [f"*NGEN, NSET=BACK{start}", f"{start + 20}, {start + 22}, 1"]
        rows += [f"*NFILL, NSET={name}", f"FRONT{start}, BACK{start}, 2, 10"]
    rows += [f"*NFILL, NSET=ALL{first}", f"{low}, {high}, 2, 100", "*ELEMENT, TYPE=C3D8"]
    corners = [first + k for k in (0, 1, 11, 10, 100, 101, 111, 110)]
    rows += [f"{element}, {', '.join(map(str, corners))}"]
    return "\n".join(
        [*rows, f"*ELGEN, ELSET={body}", f"{element}, 2, 1, 1, 2, 10, 2, 2, 100, 4", ""]
    )


LOWER = cube(1, 0.0, ("LOWER", "FLOOR", "MASTER"), 1)
UPPER = cube(1001, 1.01, ("UPPER", "SLAVE", "LID"), 11)


@needs("nonmatching")
def test_two_generated_cubes(tmp_path):
    path = written(tmp_path / "cubes.inp", LOWER + UPPER)
    assert pressure(path, NAMES) == pytest.approx(10.0, rel=1e-9)
    found = hhr.MeshFile(path).read()
    assert len(found.points) == 54 and found.bodies["UPPER"].tolist() == [*range(8, 16)]
    # bounds are in the sets, too
    assert [len(found.nodes[name]) for name in ("FRONT1", "FLOOR", "ALL1")] == [3, 9, 27]
    assert sorted(set(found.points[found.nodes["ALL1"], 2].tolist())) == [0.0, 0.5, 1.0]


@needs("nonmatching")
def test_generated_parts_that_are_placed(tmp_path):
    text = f"*PART, NAME=P\n{LOWER}*END PART\n*PART, NAME=Q\n{UPPER}*END PART\n*ASSEMBLY, NAME=A\n"
    text += (
        "".join(f"*INSTANCE, NAME={name}-1, PART={name}\n*END INSTANCE\n" for name in "PQ")
        + "*END ASSEMBLY\n"
    )
    assert pressure(written(tmp_path / "parts.inp", text), NAMES) == pytest.approx(10.0, rel=1e-9)


def test_middle_nodes_of_generated_cells(tmp_path):
    """Cells of eight nodes on lines of five nodes: increments of two."""
    rows = [
        "*NODE",
        "1, 0., 0.",
        "5, 2., 0.",
        "21, 0., 1.",
        "25, 2., 1.",
        "*NGEN, NSET=A",
        "1, 5",
        "*NGEN, NSET=B",
    ]
    rows += [
        "21, 25",
        "*NFILL",
        "A, B, 2, 10",
        "*ELEMENT, TYPE=CPS8, ELSET=PLATE",
        "1, 1, 3, 23, 21, 2, 13, 22, 11",
    ]
    text = "\n".join([*rows, "*ELGEN, ELSET=PLATE", "1, 2, 2", ""])
    found = hhr.MeshFile(written(tmp_path / "plate.inp", text)).read()
    assert found.points[found.sides].tolist()[1] == [[1.5, 0.0], [2.0, 0.5], [1.5, 1.0], [1.0, 0.5]]


def test_nodes_on_arcs(tmp_path):
    """Five of a quarter of a circle about a node, and three on an arc about a point in space."""
    text = (
        "*NODE\n1, 2., 0., 1.\n5, 0., 2., 1.\n9, 0., 0., 1.\n11, 1., 1., 3.\n13, 1., 4., 0.\n"
        "*NGEN, LINE=C\n"
    )
    deck = flat_deck(written(tmp_path / "d.inp", f"{text}1, 5, 1, 9\n11, 13, , , 1., 1., 0.\n"))
    angles = np.pi / 8 * np.arange(5)
    wanted = np.column_stack([2 * np.cos(angles), 2 * np.sin(angles), np.ones(5)])
    assert np.array([deck.nodes[k] for k in range(1, 6)]) == pytest.approx(wanted)
    assert deck.nodes[12] == pytest.approx([1, 1 + 3 / np.sqrt(2), 3 / np.sqrt(2)])


REFUSED = {
    "parabola": (
        "*NGEN, LINE=P\n1, 3, 1, 9\n",
        "block *NGEN at line 2: LINE= are not read: write the deck with all",
    ),
    "centre": (
        "*NGEN, LINE=C\n1, 3, 1, 99\n",
        "block *NGEN at line 2: there is no node 99 before it",
    ),
    "straight arc": (
        "*NODE\n1, 0, 0\n3, 2, 0\n*NGEN, LINE=C, SYSTEM=RC\n1, 3, 1, , 1., 0., 0.\n",
        "line 5: an arc from [0.0, 0.0, 0.0] to [2.0, 0.0, 0.0] has no plane about [1.0, 0.0, 0.0]",
    ),
    "system": ("*NGEN, LINE=C, SYSTEM=C\n1, 3, 1, , 1., 0., 0.\n", "line 2: SYSTEM= are not read"),
    "half": (
        "*NGEN, LINE=C\n1, 3, 1, , 0, 0, 0, 0, 0, 1\n",
        "line 2: arcs of 180 degrees and more, with a normal",
    ),
    "bias": ("*NFILL, BIAS=0.8\nA, B, 3, 10\n", "block *NFILL at line 2: BIAS= are not read"),
    "copy": (
        "*NCOPY, CHANGE NUMBER=100, OLD SET=A, SHIFT\n0, 0, 1\n",
        "block *NCOPY at line 2: copies and maps",
    ),
    "copied elements": (
        "*ELCOPY, OLD SET=A\n",
        "block *ELCOPY at line 2: copies and maps are not read",
    ),
    "steps": (
        "*NODE\n1, 0, 0\n4, 1, 0\n*NGEN\n1, 4, 2\n",
        "line 5: nodes 1 and 4 are not there, or not 2 apart",
    ),
    "nodes": ("*NODE\n1, 0, 0\n*NGEN\n1, 4\n", "line 4: nodes 1 and 4 are not there"),
    "sets": ("*NFILL\nA, B, 2, 10\n", "line 2: sets 'A' and 'B' have 0 and 0 nodes"),
    "element": ("*ELGEN\n7, 2\n", "line 2: there is no element 7 before it"),
    "nothing": ("*ELGEN\n,\n", "line 2"),
    "range": (
        "*NSET, NSET=A, GENERATE\n4, 1\n",
        "block *NSET at line 2: no numbers go from 4 to 1 in steps of 1",
    ),
    "no step": (
        "*NSET, NSET=A, GENERATE\n1, 4, 0\n",
        "block *NSET at line 2: no numbers go from 1 to 4 in steps of 0",
    ),
    "zero": (
        "*NODE\n1, 0, 0\n4, 1, 0\n*NGEN\n1, 4, 0\n",
        "line 5: nodes 1 and 4 are not there, or not 0 apart",
    ),
}


@pytest.mark.parametrize("what", REFUSED)
def test_what_is_not_generated_is_refused_with_its_line(what, tmp_path):
    text, why = REFUSED[what]
    with pytest.raises(FileContentError) as found:
        hhr.MeshFile(written(tmp_path / "d.inp", f"*HEADING\n{text}{DECK}")).read()
    assert why in str(found.value)


def test_sets_that_are_not_sorted_keep_their_order(tmp_path):
    sets = "*NSET, NSET=A, UNSORTED\n6, 5, 8, 7\n*NSET, NSET=B\n6, 5, 8, 7, 5\n"
    deck = flat_deck(written(tmp_path / "d.inp", DECK + sets))
    assert deck.members("A") == [6, 5, 8, 7] and deck.members("B") == [5, 6, 7, 8]
    part = (
        f"*PART, NAME=P\n{DECK}{sets}*END PART\n*ASSEMBLY, NAME=X\n*INSTANCE, NAME=I, PART=P\n"
        "*END INSTANCE\n"
    )
    deck = flat_deck(written(tmp_path / "d.inp", part))
    for name in ("A", "I.A"):
        assert [number % 100 for number in deck.members(name)] == [6, 5, 8, 7]


def test_types_that_do_not_exist_are_no_cells(tmp_path):
    """C3D9 has no meaning; a cell with another number of nodes than its type says is refused."""
    path = written(
        tmp_path / "d.inp",
        f"{DECK}*ELEMENT, TYPE=C3D9, ELSET=ODD\n9, 9, 10, 11, 12, 13, 14, 15, 16\n",
    )
    assert reasons(path) == {
        "ODD": "1 element of type C3D9 in it, neither cells nor sides of cells"
    }
    with pytest.raises(
        FileContentError, match=r"no elements of the plane or of space that are understood: C3D9"
    ):
        hhr.MeshFile(written(tmp_path / "e.inp", DECK.replace("C3D8", "C3D9"))).read()
    with pytest.raises(
        FileContentError, match="element 1 of type C3D6 has 8 nodes, which is not understood"
    ):
        hhr.MeshFile(written(tmp_path / "f.inp", DECK.replace("C3D8", "C3D6"))).read()
    assert np.isclose(
        len(hhr.MeshFile(written(tmp_path / "g.inp", DECK.replace("C3D8", "C3D8R"))).read().cells),
        2,
    )


def test_nodes_in_cylindrical_and_spherical_coordinates(tmp_path):
    """Angles are in degrees, from x, and that of a sphere from the plane."""
    text = (
        "*NODE, SYSTEM=C\n1, 2., 90., 5.\n*NODE, SYSTEM=S\n2, 2., 90., 30.\n"
        "*NODE, SYSTEM=R\n3, 1., 2., 3.\n"
    )
    deck = flat_deck(written(tmp_path / "d.inp", text))
    root = np.sqrt(3.0)
    for number, place in ((1, [0, 2, 5]), (2, [0, root, 1]), (3, [1, 2, 3])):
        assert deck.nodes[number] == pytest.approx(place, abs=1e-12)


@needs("nonmatching")
def test_nodes_and_elements_of_other_files(tmp_path):
    """Data of a block in a file of its own, by INPUT=."""
    head, rest = DECK.split("*ELEMENT", 1)
    written(tmp_path / "nodes.txt", head.partition("\n")[2])
    cell = "2, 9, 10, 11, 12, 13, 14, 15, 16\n"
    written(tmp_path / "upper.txt", cell)
    (tmp_path / "sub").mkdir()
    (tmp_path / "nodes.txt").rename(tmp_path / "sub" / "nodes.txt")
    text = f"*NODE, INPUT=sub\\nodes.txt\n*ELEMENT{rest}".replace(
        "ELSET=UPPER\n" + cell, "INPUT=upper.txt, ELSET=UPPER\n"
    )
    path = written(tmp_path / "d.inp", text)
    assert pressure(path, NAMES) == pytest.approx(10.0, rel=1e-9)
    (tmp_path / "upper.txt").unlink()
    with pytest.raises(
        FileContentError,
        match=r"d\.inp:4 \*ELEMENT: the file .*upper\.txt does not exist: put it there",
    ):
        hhr.MeshFile(path).read()


def test_a_block_without_an_option_that_it_needs(tmp_path):
    path = written(
        tmp_path / "d.inp",
        DECK.replace("*ELEMENT, TYPE=C3D8, ELSET=UPPER", "*ELEMENT, ELSET=UPPER"),
    )
    with pytest.raises(
        FileContentError, match=r"block \*ELEMENT at line 20: it has no option 'TYPE'"
    ):
        hhr.MeshFile(path).read()
