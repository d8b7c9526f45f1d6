"""Falsified stiffness files: each is refused with its place, or named."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from foreign_formats import condensed, foreign_scene, own_block, write_sti, write_superelement
from foreign_lies import BY_CASE, LIES, matrix_of, retained
from needs import needs
from scipy.sparse import triu

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import (
    FileContentError,
    HHRError,
    NotSolvableError,
    SceneError,
    SceneWarning,
)


@pytest.fixture(scope="module")
def own():
    """Our block, with a case that was solved; K is whole and has its supports."""
    return own_block()


@pytest.mark.parametrize("name", BY_CASE)
def test_a_solved_case_shows_the_lie(own, name):
    """Refused with the largest difference and its node; the same K without the case is accepted,
    and said so.
    """
    lie = BY_CASE[name](own)
    said = r"differ from those by its K by .* most at node \d+ in direction [123]"
    with pytest.raises(
        (SceneError, NotSolvableError), match=f"{said}|is singular with the supports"
    ):
        _ = replace(own, stiffness=lie).placed
    with pytest.warns(SceneWarning, match="is unchecked"):
        _ = replace(own, stiffness=lie, case=None, unchecked=True).placed


def test_factors_are_named(own):
    lie = matrix_of(own, 1000 * own.stiffness.matrix)
    with pytest.raises(SceneError, match=r"by a factor of 0\.001"):
        _ = replace(own, stiffness=lie).placed


def test_a_case_of_another_load_is_refused(own):
    case = own.case
    forces = {node: tuple(2 * one for one in value) for node, value in case.forces.items()}
    other = hhr.SolvedCase(forces, case.displacements, case.held, case.tolerance)
    with pytest.raises(SceneError, match="by a factor of 2"):
        _ = replace(own, case=other).placed


def test_a_dropped_support_is_refused(own):
    other = hhr.SolvedCase(own.case.forces, own.case.displacements, tolerance=own.case.tolerance)
    with pytest.raises(NotSolvableError, match="singular"):
        _ = replace(own, case=other).placed


def test_reversed_sign_is_refused(own):
    with pytest.raises(FileContentError, match="its sign is reversed"):
        _ = replace(own, stiffness=matrix_of(own, -own.stiffness.matrix)).placed


def test_a_half_as_a_whole_is_refused(own):
    with pytest.raises(FileContentError, match="one half of it is stored"):
        _ = replace(own, stiffness=matrix_of(own, triu(own.stiffness.matrix))).placed


def test_an_unsymmetric_matrix_is_refused(own):
    matrix = own.stiffness.matrix.copy().tolil()
    matrix[0, 1] += 0.01 * matrix[0, 0]
    with pytest.raises(FileContentError, match=r"not symmetric: rows [12] and [12] differ"):
        _ = replace(own, stiffness=matrix_of(own, matrix)).placed


def test_entries_that_are_not_finite_are_refused(own):
    matrix = own.stiffness.matrix.copy()
    matrix.data[7] = np.nan
    with pytest.raises(FileContentError, match="not finite"):
        _ = replace(own, stiffness=matrix_of(own, matrix)).placed


def test_multipliers_are_refused(own):
    """Lagrange multipliers have no stiffness of their own."""
    matrix = own.stiffness.matrix.copy().tolil()
    matrix[5, 5] = 0.0
    with pytest.raises(FileContentError, match=r"1 of \d+ diagonal entries"):
        _ = replace(own, stiffness=matrix_of(own, matrix)).placed


def test_a_dof_that_is_named_twice_is_refused(own):
    directions = own.stiffness.directions.copy()
    directions[1] = 1
    with pytest.raises(FileContentError, match=r"names 1\.1 twice"):
        _ = replace(own, stiffness=matrix_of(own, directions=directions)).placed


def test_directions_beyond_rotations_are_refused(own):
    directions = own.stiffness.directions.copy()
    directions[4] = 11
    with pytest.raises(FileContentError, match="direction 11"):
        _ = replace(own, stiffness=matrix_of(own, directions=directions)).placed


def test_nodes_of_another_mesh_are_refused(own):
    nodes = hhr.ForeignNodes(own.nodes.labels + 10_000, own.nodes.points)
    with pytest.raises(SceneError, match="no row of falsified is a dof"):
        _ = replace(own, stiffness=matrix_of(own), nodes=nodes).placed


def test_a_missing_row_is_refused(own, tmp_path):
    path = write_sti(own.stiffness, tmp_path)
    table = tmp_path / "k.dof"
    table.write_text("".join(table.read_text().splitlines(keepends=True)[:-1]))
    with pytest.raises(FileContentError, match="a row is missing"):
        _ = replace(own, stiffness=path).placed


def test_a_file_that_was_cut_is_refused(own, tmp_path):
    path = write_sti(own.stiffness, tmp_path)
    lines = path.read_text().splitlines(keepends=True)
    path.write_text("".join(lines[: len(lines) // 2]))
    with pytest.raises(FileContentError, match="not of one run"):
        _ = replace(own, stiffness=path).placed


def test_two_matrices_in_one_file_are_refused(own, tmp_path):
    path = write_sti(own.stiffness, tmp_path)
    path.write_text(2 * path.read_text())
    with pytest.raises(FileContentError, match="states an entry twice"):
        _ = replace(own, stiffness=path).placed


def test_single_precision_is_named(own):
    lie = matrix_of(own, own.stiffness.matrix.astype(np.float32).astype(float))
    with (
        pytest.warns(SceneWarning, match="single precision"),
        pytest.raises(HHRError, match="differ"),
    ):
        _ = replace(
            own,
            stiffness=lie,
            case=hhr.SolvedCase(
                own.case.forces, own.case.displacements, own.case.held, tolerance=1e-10
            ),
        ).placed


def test_a_superelement_that_is_not_condensed_is_refused(own, tmp_path):
    """The block of K of its retained dofs, as CalculiX 2.20 of Debian writes it."""
    rows = retained(own)
    found = own.stiffness
    block = hhr.ForeignMatrix(
        found.matrix[rows][:, rows], found.nodes[rows], found.directions[rows], "block"
    )
    with pytest.raises(SceneError, match="was not condensed"):
        hhr.read_stiffness(write_superelement(block, tmp_path))
    assert hhr.read_stiffness(write_superelement(condensed(found, rows), tmp_path)).superelement


def test_a_superelement_that_was_cut_is_refused(own, tmp_path):
    path = write_superelement(condensed(own.stiffness, retained(own)), tmp_path)
    path.write_text(path.read_text()[:-40])
    with pytest.raises(FileContentError, match="entries of K"):
        hhr.read_stiffness(path)


@needs("nonmatching")
def test_a_block_without_a_case_must_say_so(own):
    with pytest.raises(SceneError, match="has no solved case"):
        replace(own, case=None)
    block = replace(own, case=None, unchecked=True)
    with pytest.raises(SceneError, match="each answer must say so"):
        hhr.FullOrderModel(foreign_scene(block))
    with pytest.warns(SceneWarning, match="is unchecked"):
        full = hhr.FullOrderModel(
            foreign_scene(replace(block), outputs=(hhr.UncheckedStiffness(),))
        )
    assert full.solve((10.0, 0.2)).outputs().values == {"unchecked stiffness": 1.0}
    model = hhr.condense(full)
    assert model.solve((10.0, 0.2)).outputs().values == {"unchecked stiffness": 1.0}


@pytest.mark.filterwarnings("ignore:block")
def test_the_list_of_the_benchmark_is_refused_or_named(own):
    """What `benchmarks/foreign.py` reports; each lie in it has a test of its own above."""
    assert len(LIES) >= 20
    for name, made in LIES.items():
        with pytest.raises((HHRError, SceneWarning), match=r"."), warnings.catch_warnings():
            warnings.simplefilter("error", SceneWarning)
            _ = made(own).placed
            pytest.fail(f"{name} is accepted")
