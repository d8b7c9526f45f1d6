"""Gaps and statuses of all conditions: signs and zeros of (1.21), and models in files."""

import dataclasses

import numpy as np
import pytest
from mpi4py import MPI
from needs import needs
from scenes import pressed_block, pressed_pair

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import NotOfferedError
from hhr_dolfinx.plugins.pages.scenery import Scenery

AT = {"push": 0.012, "slide": 0.02, "load": 0.1, "gap": 0.01}
BODIES = (3.0, 0.3), (5.0, 0.2)


@pytest.fixture(scope="module")
def kept(tmp_path_factory):
    folder = tmp_path_factory.mktemp("kept")
    scene = pressed_pair("plane_strain", BODIES, cells=6)
    full = hhr.FullOrderModel(scene, MPI.COMM_SELF)
    training = hhr.train(scene, hhr.Sobol(64), held_out=0, comm=MPI.COMM_SELF)
    for name, model in (
        ("condensed", hhr.condense(full, fields=True)),
        ("hhr", training.build(checked=False)),
    ):
        hhr.save_model(folder / f"{name}.npz", model)
    hhr.scenery_of(full).write(folder / "scenery.npz")
    return full, folder


def test_gaps_are_the_distances_of_the_nodes(kept):
    """Node to node along y: the opening, plus the motion of the upper node, less the lower one."""
    full, _ = kept
    answer = full.solve(AT)
    gaps = answer.gaps()
    statuses = answer.statuses()
    assert set(statuses) == {0, 1} and np.array_equal(statuses == 1, answer.active)
    np.testing.assert_allclose(gaps[statuses == 1], 0.0, atol=1e-14)
    assert gaps[statuses == 0].min() > 1e-6
    field = answer.displacement().reshape(-1, 2)
    points = full.problem.points
    owner = np.zeros(len(points), dtype=int)
    owner[full.problem.cell_nodes.ravel()] = np.repeat(
        full.answer_mesh().bodies, full.problem.cell_nodes.shape[1]
    )
    for k, (x, _) in enumerate(full.problem.contact_points):
        facing = np.flatnonzero(np.isclose(points[:, 0], x) & np.isclose(points[:, 1], 1.0))
        below, above = sorted(facing, key=lambda node: owner[node])
        assert gaps[k] == pytest.approx(AT["gap"] + field[above, 1] - field[below, 1], abs=1e-12)


def test_the_gap_of_an_open_block():
    """A floor 0.01 below a block that is pushed by 0.004, or by -0: the gap is 0.006 everywhere."""
    answer = hhr.FullOrderModel(pressed_block("plane_strain")).solve(0.004)
    np.testing.assert_allclose(answer.gaps(), 0.006, rtol=1e-12)
    assert not answer.statuses().any()


@pytest.mark.parametrize("name", ["condensed", "hhr"])
def test_models_in_files_have_them(kept, name):
    full, folder = kept
    answer = hhr.load_model(folder / f"{name}.npz").solve(AT, outside="ignore")
    exact = full.solve(AT)
    assert {0, 1} == set(exact.statuses())
    scale = np.abs(exact.gaps()).max()
    np.testing.assert_allclose(
        answer.gaps(), exact.gaps(), atol=(1e-10 if name == "condensed" else 0.02) * scale
    )
    if name == "condensed":
        np.testing.assert_array_equal(answer.statuses(), exact.statuses())
    else:
        assert np.mean(answer.statuses() != exact.statuses()) < 0.2


def test_a_file_of_an_earlier_release_is_named(kept, tmp_path):
    _, folder = kept
    scenery = Scenery.read(folder / "scenery.npz")
    earlier = dataclasses.replace(scenery.mesh, contact_rows=None, gap_terms=None)
    dataclasses.replace(scenery, mesh=earlier).write(tmp_path / "scenery.npz")
    (tmp_path / "condensed.npz").write_bytes((folder / "condensed.npz").read_bytes())
    answer = hhr.load_model(tmp_path / "condensed.npz").solve(AT)
    with pytest.raises(NotOfferedError, match=r"is of an earlier release: .*scenery_of"):
        answer.gaps()
    assert answer.plot() is not None and set(answer.statuses()) == {0, 1}
    alone = tmp_path / "alone"
    alone.mkdir()
    (alone / "condensed.npz").write_bytes((folder / "condensed.npz").read_bytes())
    answer = hhr.load_model(alone / "condensed.npz").solve(AT)
    for ask in (answer.gaps, answer.statuses, answer.to_pyvista):
        with pytest.raises(NotOfferedError, match=r"there is no scenery\.npz beside"):
            ask()


@needs("friction")
def test_statuses_of_friction_are_those_of_its_memory():
    from sheared_blocks import PATH, rubbing

    answer = hhr.FullOrderModel(rubbing()).march(PATH).answers[2]
    statuses = answer.statuses()
    pressing = statuses >= 0
    np.testing.assert_array_equal(statuses[pressing], answer.slip.statuses)
    assert 2 in statuses and np.isnan(answer.gaps()[~pressing]).all() and (~pressing).any()
