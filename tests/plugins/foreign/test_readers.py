"""Our own K through the writer and the reader of each format, and files of other writers."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from foreign_formats import (
    WRITERS,
    condensed,
    foreign_scene,
    own_block,
    own_scene,
    write_superelement,
)
from needs import needs

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import FileContentError, FileError
from hhr_dolfinx.plugins.foreign.dof_table import read_dofs
from hhr_dolfinx.plugins.foreign.nastran import read_dmig
from hhr_dolfinx.plugins.foreign.op4 import read_matrices

pytestmark = needs("nonmatching")

DATA = Path(__file__).parent / "data"
POINT = (10.0, 0.2)


@pytest.fixture(scope="module")
def own():
    """Our block, and forces of our own model."""
    return own_block(), hhr.FullOrderModel(own_scene()).solve(POINT).forces()


@pytest.mark.parametrize("write", WRITERS)
def test_own_stiffness_through_each_format(own, write, tmp_path):
    """Formats with 16 digits change forces by round-off times the condition of K, 1e4: far below
    1e-10.
    """
    block, forces = own
    given = replace(block, stiffness=write(block.stiffness, tmp_path))
    found = hhr.FullOrderModel(foreign_scene(given)).solve(POINT).forces()
    assert np.count_nonzero(forces) == 12
    assert np.abs(found - forces).max() <= 1e-10 * forces.max()


def test_a_superelement_of_text_is_the_whole(own, tmp_path):
    """Guyan's condensation is exact for forces on retained dofs."""
    block, forces = own
    tags = [name for name in block.nodes.surfaces]
    used = np.unique(np.concatenate([block.nodes.surfaces[tag].members for tag in tags]))
    labels = [*block.nodes.labels[used], *block.case.forces]
    kept = np.flatnonzero(np.isin(block.stiffness.nodes, labels))
    small = condensed(block.stiffness, kept)
    path = write_superelement(small, tmp_path)
    case = replace_case(block.case, set(small.nodes.tolist()))
    given = replace(block, stiffness=path, case=case)
    found = hhr.FullOrderModel(foreign_scene(given)).solve(POINT).forces()
    assert len(small.nodes) < len(block.stiffness.nodes)
    assert np.abs(found - forces).max() <= 1e-12 * forces.max()


def replace_case(case, labels):
    """The case at retained nodes alone."""
    kept = {node: value for node, value in case.displacements.items() if node in labels}
    return hhr.SolvedCase(case.forces, kept, case.held, case.tolerance)


def six():
    """The matrix of the files in data, to the last bit or two: its product is of BLAS."""
    rng = np.random.default_rng(3)
    half = rng.standard_normal((6, 6))
    found = half @ half.T + 6 * np.eye(6)
    found[abs(found) < 1.0] = 0
    return (found + found.T) / 2


@pytest.mark.parametrize("name", ["pynastran_text_full", "pynastran_text_sparse"])
def test_text_that_pynastran_wrote(name):
    """OUTPUT4 by ``OP4().write_op4`` of pyNastran 1.4.1, with all digits."""
    found = read_matrices(DATA / f"{name}.op4")["KGG"].toarray()
    assert np.abs(found - six()).max() <= 1e-14


@pytest.mark.parametrize("name", ["full", "sparse", "big"])
def test_binary_that_pynastran_reads(name):
    """Records as Nastran writes them; ``read_op4`` of pyNastran 1.4.1 made the same matrix of these
    files.
    """
    found = read_matrices(DATA / f"binary_{name}.op4")["KGG"].toarray()
    assert np.abs(found - six()).max() <= 1e-14


def test_dmig_that_pynastran_wrote():
    """Bulk data by ``write_bdf`` of pyNastran 1.4.1: ten digits."""
    found = read_dmig(DATA / "pynastran.bdf")
    assert np.abs(found.matrix.toarray() - six()).max() <= 1e-9
    assert (
        found.nodes.tolist() == [11] * 3 + [27] * 3 and found.directions.tolist() == [1, 2, 3] * 2
    )


def test_dmig_in_small_and_large_fields(tmp_path):
    """Fields of 8 and 16 characters, continuations, and numbers without an E."""
    small = (
        "$ a comment\n"
        "DMIG    KAAX    0       6       1       0\n"
        "DMIG    KAAX    7       1               7       1       2.5+1\n"
        "        7       2       -1.5\n"
        "DMIG*   KAAX                           7               2\n"
        "*                      7               2          3.0D+1\n"
    )
    (tmp_path / "k.pch").write_text(small)
    found = read_dmig(tmp_path / "k.pch")
    assert np.array_equal(found.matrix.toarray(), [[25.0, -1.5], [-1.5, 30.0]])


def test_words_of_codes_in_tables_of_dofs(tmp_path):
    """CalculiX, Ansys and code_aster; rows in another order are sorted by their numbers."""
    with_rows = "row node dof\n1 3 UX\n2 3 UY\n3 9 ROTZ\n"
    for text in (
        "3.1\n3.2\n9.6\n",
        with_rows,
        "N3;DX\nN3;DY\nN9;DRZ\n",
        "3 9 R3\n1 3 T1\n2 3 T2\n",
    ):
        (tmp_path / "k.dof").write_text(text)
        nodes, directions = read_dofs(tmp_path / "k.dof")
        assert nodes.tolist() == [3, 3, 9] and directions.tolist() == [1, 2, 6]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("3.1\n3.x\n", "is no dof"),
        ("1 3 UX\n3 3 UY\n", "counted from 1"),
        ("3.1\n3.9\n", "is no dof"),
    ],
)
def test_damaged_tables_are_refused(text, said, tmp_path):
    (tmp_path / "k.dof").write_text(text)
    with pytest.raises(FileContentError, match=said):
        read_dofs(tmp_path / "k.dof")


def test_several_matrices_need_a_name(tmp_path):
    text = "DMIG,KA,0,6,1,0\nDMIG,KA,1,1,,1,1,2.0\nDMIG,MA,0,6,1,0\nDMIG,MA,1,1,,1,1,5.0\n"
    (tmp_path / "k.pch").write_text(text)
    with pytest.raises(FileContentError, match="matrices KA, MA"):
        hhr.read_stiffness(tmp_path / "k.pch")
    assert hhr.read_stiffness(tmp_path / "k.pch", matrix="MA").matrix.toarray() == [[5.0]]


def test_files_that_are_not_there_are_named(tmp_path):
    with pytest.raises(FileError, match="no stiffness"):
        hhr.read_stiffness(tmp_path / "k.sti")
    (tmp_path / "k.xyz").write_text("")
    with pytest.raises(FileError, match=r"ending of k\.xyz"):
        hhr.read_stiffness(tmp_path / "k.xyz")
    (tmp_path / "k.sti").write_text("1 1 2.0\n")
    with pytest.raises(FileError, match="table of dofs"):
        hhr.read_stiffness(tmp_path / "k.sti")


def test_rows_of_penalties_are_imposed(tmp_path):
    """Abaqus gives imposed dofs a diagonal of 1e36."""
    (tmp_path / "k.mtx").write_text("1,1, 1,1, 1e36\n1,1, 2,1, -3.0\n2,1, 2,1, 3.5\n")
    found = hhr.read_stiffness(tmp_path / "k.mtx")
    assert found.nodes.tolist() == [2] and found.matrix.toarray() == [[3.5]]
