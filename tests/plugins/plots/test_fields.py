"""Fields for ParaView are those of the answers, one by one and along histories; read back by
VTK.
"""

import copy
from xml.etree import ElementTree

import numpy as np
import pytest
import pyvista
import your_scene
from mpi4py import MPI
from needs import needs

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import FileError, SceneError


@pytest.fixture(scope="module")
def spring():
    full = hhr.FullOrderModel(your_scene.scene(), MPI.COMM_SELF)
    return full, full.solve((0.9, 0.1))


@needs("nonmatching")
@pytest.mark.parametrize("ending", [".vtkhdf", ".vtu"])
def test_an_answer_is_what_is_in_the_file(ending, spring, tmp_path):
    full, answer = spring
    (path,) = hhr.write_fields(tmp_path / "sub" / f"fields{ending}", full, answer)
    grid = pyvista.read(path)
    field = answer.displacement().reshape(-1, 2)
    np.testing.assert_allclose(grid["displacement"][:, :2], field, atol=1e-14)
    np.testing.assert_allclose(grid.points[:, :2], full.problem.points, atol=1e-12)
    # volumes of the cells say that their nodes are in VTK's order
    assert grid.compute_cell_sizes()["Area"].sum() == pytest.approx(
        full.problem.mass.sum() / 2, rel=1e-10
    )
    forces = np.zeros(len(field))
    np.add.at(forces, full.problem.contact_slaves, answer.forces())
    areas = np.ones(len(field))
    areas[full.problem.contact_slaves] = full.problem.contact_areas
    loaded = forces > 0
    np.testing.assert_allclose(
        grid["contact_pressure"][loaded], (forces / areas)[loaded], rtol=1e-10
    )
    assert np.nanmin(grid["gap"]) > -1e-12 and np.abs(grid["gap"][loaded]).max() < 1e-12
    assert set(np.unique(grid["body"])) == {0, 1, 2} and grid["von_mises"].max() > 100


@needs("nonmatching")
def test_a_model_from_a_file_has_no_mesh_but_its_answers_have(spring, tmp_path):
    full, _ = spring
    model = hhr.train(full.scene, hhr.Sobol(16), held_out=0, comm=MPI.COMM_SELF).build(
        checked=False
    )
    hhr.save_model(tmp_path / "model.npz", model)
    loaded = hhr.load_model(tmp_path / "model.npz")
    answer = loaded.solve((0.9, 0.1))
    with pytest.raises(
        SceneError, match="fields need a mesh, and a ReducedModel has none: give FullOrderModel"
    ):
        hhr.write_fields(tmp_path / "fields.vtu", copy.deepcopy(loaded), answer)
    (path,) = hhr.write_fields(tmp_path / "fields.vtu", full, answer)
    exact = full.stress_of(answer.displacement(), answer.parameter)
    np.testing.assert_allclose(
        pyvista.read(path)["stress_kelvin"], exact, atol=1e-9 * np.abs(exact).max()
    )


@needs("inelastic", "nonmatching")
def test_steps_of_a_history_stand_with_their_times(tmp_path):
    from flowing import STEPS, demo, flowing_full

    full = flowing_full()
    history = full.march(demo.path(10.0, STEPS))
    collection, *steps = hhr.write_fields(tmp_path / "pellet.vtu", full, history)
    rows = list(ElementTree.parse(collection).getroot().iter("DataSet"))
    assert [float(row.get("timestep")) for row in rows] == [
        answer.time for answer in history.answers
    ]
    assert [row.get("file") for row in rows] == [step.name for step in steps] and len(steps) == len(
        history.answers
    )
    last = pyvista.read(steps[-1])
    np.testing.assert_allclose(
        last["displacement"][:, :2].ravel(), history.answers[-1].displacement(), atol=1e-12
    )
    assert len(last["stress_kelvin"]) == len(full.problem.cell_nodes)


@needs("nonmatching")
def test_other_endings_are_refused(spring, tmp_path):
    with pytest.raises(FileError, match=r"fields.xyz: fields are written as .vtkhdf or .vtu"):
        hhr.write_fields(tmp_path / "fields.xyz", *spring)
