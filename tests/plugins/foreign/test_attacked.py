"""Files and decks that gave wrong answers without a word, or a traceback: right or named."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from foreign_formats import foreign_scene, own_block
from needs import needs
from scipy.io import mmwrite
from scipy.sparse import coo_matrix, csr_matrix, identity

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import FileContentError, NotSolvableError, SceneError, SceneWarning
from hhr_dolfinx.plugins.foreign.case import compare_case
from hhr_dolfinx.plugins.foreign.loads import read_load
from hhr_dolfinx.plugins.foreign.nodes import read_nodes
from hhr_dolfinx.plugins.foreign.plain import write_npz
from hhr_dolfinx.plugins.foreign.start import write_scene

COLUMN = """*NODE
1, 0, 0, 0
2, 1, 0, 0
3, 1, 1, 0
4, 0, 1, 0
5, 0, 0, 1
6, 1, 0, 1
7, 1, 1, 1
8, 0, 1, 1
*NODE, NSET=PLATE
11, 0, 0, 1.1
12, 1, 0, 1.1
13, 1, 1, 1.1
14, 0, 1, 1.1
15, 0, 0, 2
16, 1, 0, 2
17, 1, 1, 2
18, 0, 1, 2
*ELEMENT, TYPE=C3D8, ELSET=BODY
1, 1, 2, 3, 4, 5, 6, 7, 8
*ELEMENT, TYPE=C3D8, ELSET=TOOL
2, 11, 12, 13, 14, 15, 16, 17, 18
*NSET, NSET=FOOT
1, 2, 3, 4
*SURFACE, NAME=TOP
1, S2
*SURFACE, NAME=LOW
2, S1
*SURFACE INTERACTION, NAME=TOUCH
{behavior}*CONTACT PAIR, INTERACTION=TOUCH{pair}
TOP, LOW
*BOUNDARY
FOOT, 1, 3
PLATE, 1, 3
*STEP
*STATIC
{step}*END STEP
"""
"""A cube of one element below a plate that is held, 0.1 above it."""
FRD = """    1C
    2C
 -1         5 0.00000E+00 0.00000E+00 1.00000E+00
 -3
 -4  DISP        4    1
 -5  D1          1    2    1    0
 -1         5 0.00000E+00 0.00000E+00 1.00000E+00
 -3
 9999
"""
"""Results of CalculiX with a displacement."""


@pytest.fixture
def start(tmp_path):
    """Text of the scene of the column for parts of its deck, with K of a stiffness of one."""

    def written(step="*CLOAD\n7, 3, 1.0\n", behavior="", pair=""):
        deck = tmp_path / "column.inp"
        deck.write_text(COLUMN.format(step=step, behavior=behavior, pair=pair))
        labels = np.repeat(np.arange(5, 9), 3)
        known = hhr.ForeignMatrix(
            csr_matrix(identity(12)), labels, np.tile([1, 2, 3], 4), "column.npz"
        )
        write_npz(tmp_path / "column.npz", known)
        todo = write_scene(deck, tmp_path / "column.npz", tmp_path / "column.py", None, None)
        return (tmp_path / "column.py").read_text(), todo

    return written


def test_lines_of_one_pressure_are_one_load(start):
    text, _ = start("*DLOAD\n1, P4, 0.5\n1, P4, 0.5\n")
    assert text.count("hhr.Pressure(") == 1


def test_a_deck_of_two_steps_is_refused(start):
    with pytest.raises(FileContentError, match=r"one step is read, and the deck has 2"):
        start("*CLOAD\n7, 3, 1.0\n*END STEP\n*STEP\n*STATIC\n*CLOAD\n7, 3, 2.0\n")


def test_a_plate_that_moves_opens_or_closes_its_gap(start):
    """The plate comes down by .02 in z: the gap of .1 closes by as much."""
    text, todo = start("*BOUNDARY\nPLATE, 3, 3, -0.02\n")
    assert 'hhr.Opening(0, hhr.Amplitude(slopes={"motion": 1.0}))' in text and todo == []
    assert '("motion",), lower=(-0.024,), upper=(-0.016,)' in text
    text, _ = start("*BOUNDARY\nPLATE, 3, 3, 0.02\n")
    assert "lower=(0.016,), upper=(0.024,)" in text
    _, todo = start("*BOUNDARY\n11, 3, 3, 0.02\n")
    assert "move apart from each other" in "".join(todo)


def test_soft_contact_and_adjust_are_read_or_named(start):
    text, _ = start(behavior="*SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE=EXPONENTIAL\n0.01, 5.\n")
    assert "law=hhr.SoftContact(exponential=(0.01, 5.0))" in text
    text, _ = start(behavior="*SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE=TABULAR\n0., 0.\n3., .1\n")
    assert "law=hhr.SoftContact(table=((0.0, 0.0), (0.1, 3.0)))" in text
    text, todo = start(behavior="*SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE=LINEAR\n10.\n")
    assert "law=" not in text.split("scene =")[1] and "stiffness=10.0" in "".join(todo)
    _, todo = start(pair=", ADJUST=0.03")
    assert "ADJUST" in "".join(todo)


def test_friction_and_pairs_without_separation_are_read(start):
    behavior = "*SURFACE BEHAVIOR, NO SEPARATION\n"
    text, todo = start(behavior=f"{behavior}*FRICTION, TAUMAX=5.\n.3\n")
    assert "friction=hhr.Coulomb(0.3, 5.0), law=hhr.NoSeparation()" in text
    assert "have pressed" in "".join(todo)
    text, _ = start(behavior="*FRICTION, ROUGH\n")
    assert "friction=1e6" in text
    soft = "*SURFACE BEHAVIOR, NO SEPARATION, PRESSURE-OVERCLOSURE=EXPONENTIAL\n0.01, 5.\n"
    text, todo = start(behavior=f"{soft}*FRICTION\n.2\n")
    assert "friction=0.2, law=hhr.SoftContact" in text and "may open here" in "".join(todo)


def test_a_later_support_replaces_the_one_before(start):
    text, _ = start("*BOUNDARY\nFOOT, 3, 3, -0.01\n")
    assert text.count('hhr.Displacement("FOOT", 2') == 1
    assert 'hhr.Displacement("FOOT", 2, "displacement")' in text
    _, todo = start("*BOUNDARY, OP=NEW\nFOOT, 3, 3\n*CLOAD, AMPLITUDE=A\n7, 3, 1.\n")
    assert "OP=NEW" in "".join(todo) and "AMPLITUDE" in "".join(todo)
    text, todo = start("*TEMPERATURE\nFOOT, 20.\n*CLOAD\n7, 3, 1.\n")
    assert "ForeignLoad" in "".join(todo) and "but for the TODO lines" in text


def test_a_deck_whose_k_is_stale(tmp_path):
    """Another modulus, or a support taken away, with K and case of the deck before."""
    material = "*MATERIAL, NAME=M\n*ELASTIC\n{young}, .3\n*SOLID SECTION, ELSET=BODY, MATERIAL=M\n"
    whole = COLUMN.format(step="*CLOAD\n7, 3, 1.0\n", behavior="", pair="")
    head, _, tail = whole.partition("*SURFACE INTERACTION")
    deck, case = tmp_path / "column.inp", tmp_path / "case.inp"
    middle = material.format(young=1000) + "*SURFACE INTERACTION"
    deck.write_text(head + middle + tail)
    shorter = "".join(
        part for part in (head, material.format(young=1000), "*BOUNDARY\nFOOT, 1, 3\n")
    )
    case.write_text(shorter + "*STEP\n*STATIC\n*CLOAD\n7, 3, 1.0\n*END STEP\n")
    case.with_suffix(".frd").write_text(FRD)
    labels = np.repeat(np.arange(5, 9), 3)
    known = hhr.ForeignMatrix(csr_matrix(identity(12)), labels, np.tile([1, 2, 3], 4), "k.npz")
    write_npz(tmp_path / "k.npz", known)
    given = tmp_path / "k.npz", tmp_path / "column.py", case, None
    write_scene(deck, *given)
    deck.write_text(head + middle.replace("1000", "700") + tail)
    with pytest.raises(FileContentError, match=r"ELASTIC of case.inp is not in column.inp"):
        write_scene(deck, *given)
    deck.write_text(head + middle + tail.replace("FOOT, 1, 3", "FOOT, 1, 2"))
    with pytest.raises(FileContentError, match=r"case.inp holds dof [1-4].3, which K has left out"):
        write_scene(deck, *given)


def test_labels_that_the_deck_lacks(tmp_path):
    deck = tmp_path / "deck.inp"
    whole = COLUMN.format(step="", behavior="", pair="")
    deck.write_text(whole.replace("1, S2", "9, S2"))
    with pytest.raises(FileContentError, match="surface TOP has element 9, which the deck"):
        read_nodes(deck)
    deck.write_text(whole.replace("1, S2", "NONE, S2"))
    with pytest.raises(FileContentError, match="surface TOP has the set NONE"):
        read_nodes(deck)
    deck.write_text(whole.replace("1, 2, 3, 4\n*SURF", "1, 2, 3, 99\n*SURF"))
    with pytest.warns(SceneWarning, match="set FOOT has 1 nodes that the deck does not have"):
        read_nodes(deck)
    deck.write_text("*HEADING\n")
    with pytest.raises(FileContentError, match="has no \\*NODE"):
        read_nodes(deck)


def test_foreign_loads_have_directions_from_one_on_and_sizes(tmp_path):
    for forces, reason in (
        ({(3, 0): 1.0}, "directions are 1 to 3"),
        ({(3, 7): 1.0}, "directions are 1 to 3"),
        ({}, "has no force"),
        ({(3, 1): np.nan}, "must be finite"),
    ):
        with pytest.raises(SceneError, match=reason):
            hhr.ForeignLoad(forces)
    (tmp_path / "empty.load").write_text("# nothing\n")
    assert read_load(tmp_path / "empty.load") == {}


@pytest.fixture
def matrix(tmp_path):
    """Reads a MatrixMarket text with a table of two dofs beside it."""

    def read(text, name="k.mm"):
        path = tmp_path / name
        path.write_text(text)
        path.with_suffix(".dof").write_text("1.1\n1.2\n")
        return hhr.read_stiffness(path)

    return read


def test_texts_that_scipy_reads_as_something_else(matrix):
    head = "%%MatrixMarket matrix coordinate real symmetric\n2 2 "
    whole = matrix(head + "3\n1 1 2.0\n2 1 0.5\n2 2 3.0\n").matrix.toarray()
    np.testing.assert_array_equal(whole, [[2.0, 0.5], [0.5, 3.0]])
    both = matrix(head + "4\n1 1 2.0\n2 1 0.5\n1 2 0.5\n2 2 3.0\n").matrix.toarray()
    np.testing.assert_array_equal(both, whole)
    for entry, reason in (("2.0D+00", "exponents with D"), ("2,0", "commas")):
        with pytest.raises(FileContentError, match=reason):
            matrix(head + f"3\n1 1 {entry}\n2 1 0.5\n2 2 3.0\n")
    for kind in ("pattern", "complex"):
        text = head.replace("real", kind) + "1\n1 1 1\n"
        with pytest.raises(FileContentError, match=f"is {kind}, and a stiffness is real"):
            matrix(text)


def test_npz_files_that_are_none(tmp_path):
    names = {"nodes": np.array([1, 1]), "directions": np.array([1, 2])}
    entries = {"row": np.array([0, 1]), "col": np.array([0, 1]), "data": np.ones(2)}
    for parts in (
        {"row": np.array([1, 2])},
        {"row": np.array([0, -1])},
        {"data": np.ones(3)},
    ):
        np.savez(tmp_path / "k.npz", **names, **(entries | parts))
        with pytest.raises(FileContentError):
            hhr.read_stiffness(tmp_path / "k.npz")
    (tmp_path / "k.npz").write_bytes(b"no zip")
    with pytest.raises(FileContentError):
        hhr.read_stiffness(tmp_path / "k.npz")
    np.savez(tmp_path / "k.npz", **names, **(entries | {"data": np.array([1.0, 1.0 + 0.1j])}))
    with pytest.raises(FileContentError, match="complex"), warnings.catch_warnings():
        warnings.simplefilter("error")
        hhr.read_stiffness(tmp_path / "k.npz")


def test_an_indefinite_stiffness_is_refused():
    """K less half of the identity has modes below zero, and a case that this K has solved."""
    block = own_block()
    known = block.stiffness
    lowest = np.linalg.eigvalsh(known.matrix.toarray())
    shift = float(lowest[lowest > 1e-9 * lowest[-1]][6] * 1.5)
    wrong = replace(known, matrix=csr_matrix(known.matrix - shift * identity(len(known.nodes))))
    with pytest.raises((NotSolvableError, SceneError), match=r"indefinite|differ"):
        _ = replace(block, stiffness=wrong).placed
    with pytest.raises(NotSolvableError, match="indefinite"):
        placed = replace(block, stiffness=wrong).read[0]
        compare_case(placed, block.case, "part")


def test_cases_that_say_nothing_of_a_body_are_refused():
    block = own_block()
    placed, case = block.read
    with pytest.raises(SceneError, match="no displacement of its solved case is at a dof of K"):
        held = {label: (0.0, 0.0, 0.0) for label, _ in case.held}
        compare_case(placed, replace(case, displacements=held), "part")
    far = {label: tuple(point) for label, point in zip(placed.nodes.labels.tolist(),
           placed.nodes.points.tolist(), strict=True)}  # fmt: skip
    compare_case(placed, replace(case, points=far), "part")
    first = next(iter(far))
    far[first] = (far[first][0] + 0.01, *far[first][1:])
    with pytest.raises(SceneError, match=f"node {first} lies 0.01 from its place in the solved"):
        compare_case(placed, replace(case, points=far), "part")


def test_a_matrix_of_another_type_is_refused_at_the_door(tmp_path):
    with pytest.raises(SceneError, match="must be a file or a ForeignMatrix"):
        hhr.ForeignBlock(None, tmp_path / "deck.inp", unchecked=True)
    mmwrite(tmp_path / "k.mtx", coo_matrix(np.eye(2)))
    table = tmp_path / "case.csv"
    table.write_text("")
    with pytest.raises(FileContentError, match="is empty"):
        hhr.plugins.foreign.case.read_case(table)


@needs("soft_contact")
def test_written_curves_are_laws():
    assert hhr.SoftContact(exponential=(0.01, 5.0)).exponential == (0.01, 5.0)


@needs("studies", "nonmatching")
def test_a_study_of_a_foreign_scene_writes_its_report(tmp_path):
    """Without the mesh error, the naive baseline and pictures, which need elements."""
    scene = foreign_scene(own_block())
    settings = hhr.StudySettings(hhr.Sobol(12), tests=4, queries=8)
    study = hhr.study_scene(scene, settings, tmp_path)
    study.write(tmp_path, view=hhr.View(points=((10.0, 0.2),)))
    assert (tmp_path / "report.html").stat().st_size > 5000
    left = {row["stage"]: row["why"] for row in study.report["skipped"]}
    assert "not of elements" in left["fom_naive"] and "another code" in left["discretisation"]
