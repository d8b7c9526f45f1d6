"""Files of models without fields, in which K^-1 B^T takes nearly all of the room."""

import numpy as np
import pytest
from click.testing import CliRunner
from contract import blocks
from mpi4py import MPI
from needs import needs
from scenes import pressed_pair

import hhr_dolfinx as hhr
from hhr_dolfinx.command.main import hhr as hhr_command
from hhr_dolfinx.errors import NotOfferedError, StudyError

UP = (0.0, 1.0)
OUTPUTS = (
    hhr.LargestPressure("peak", 0),
    hhr.ContactForce("force", 0, UP),
    hhr.DisplacementAt("moved", (2.0, 2.0), 1),
)


@pytest.fixture(scope="module")
def full():
    scene = pressed_pair("plane_strain", ((3.0, 0.3), (5.0, 0.3)), cells=12, outputs=OUTPUTS)
    return hhr.FullOrderModel(scene, MPI.COMM_SELF)


def test_forces_outputs_and_gradients_stay(full, tmp_path):
    """S and rows of outputs are a tenth of a plane file; answers are those of the whole model."""
    whole = hhr.condense(full)
    hhr.save_model(tmp_path / "whole.npz", whole)
    hhr.save_model(tmp_path / "small.npz", whole.without_fields())
    sizes = [(tmp_path / f"{name}.npz").stat().st_size for name in ("whole", "small")]
    assert sizes[1] < 0.2 * sizes[0]
    small = hhr.load_model(tmp_path / "small.npz")
    for point in full.parameters.random(5, 1):
        one, other = (model.solve(point, gradient=True) for model in (whole, small))
        assert np.array_equal(one.active, other.active)
        assert other.forces() == pytest.approx(one.forces(), rel=1e-12, abs=1e-15)
        found, known = other.outputs(), one.outputs()
        for name in known:
            assert found[name] == pytest.approx(known[name], rel=1e-12, abs=1e-15)
            assert found.gradient[name] == pytest.approx(known.gradient[name], rel=1e-9, abs=1e-12)
        assert other.estimate().primal_relative == 0.0
        with pytest.raises(NotOfferedError, match="left out"):
            other.displacement()


def cube(cells):
    """A block in space on another one, pushed down on its lid."""
    return pressed_pair("solid", ((3.0, 0.3), (5.0, 0.3)), cells=cells, outputs=OUTPUTS[:1])


@needs("plots", "pages")
def test_fields_of_the_surface_are_those_of_the_whole_model(tmp_path):
    """Pictures and files of fields need no node within bodies; all displacements are refused."""
    full = hhr.FullOrderModel(cube(6), MPI.COMM_SELF)
    whole = hhr.condense(full, fields=True)
    assert hhr.with_surface_fields(hhr.condense(cube(1), fields=True)).fields.dofs.size > 0
    for name, model in {
        "whole": whole,
        "surface": hhr.with_surface_fields(whole),
        "single": hhr.with_surface_fields(whole, single=True),
    }.items():
        (tmp_path / name).mkdir()
        hhr.save_model(tmp_path / name / "model.npz", model)
        hhr.scenery_of(full).write(tmp_path / name / "scenery.npz")
    loaded = {
        name: hhr.load_model(tmp_path / name / "model.npz")
        for name in ("whole", "surface", "single")
    }
    point = full.parameters.random(1, 3)[0]
    known, seen, rounded = (model.solve(point) for model in loaded.values())
    np.testing.assert_allclose(seen.forces(), known.forces(), rtol=1e-12, atol=1e-18)
    with pytest.raises(NotOfferedError, match="left out"):
        seen.displacement()
    np.testing.assert_allclose(seen.gaps(), known.gaps(), atol=1e-15)
    largest = np.abs(known.displacement()).max()
    for one, tolerance in ((seen, 1e-12), (rounded, 1e-6)):
        shown, of_whole = one.to_pyvista(), known.to_pyvista()
        for body in (0, 1):
            nodes = shown[body].point_data["node"]
            order = np.searchsorted(of_whole[body].point_data["node"], nodes)
            assert 0 < nodes.size < of_whole[body].n_points
            field = of_whole[body].point_data["displacement"][order]
            found = shown[body].point_data["displacement"]
            np.testing.assert_allclose(found, field, rtol=0, atol=tolerance * largest)
    sizes = [(tmp_path / name / "model.npz").stat().st_size for name in loaded]
    assert sizes[2] < 0.7 * sizes[1] and sizes[1] < sizes[0]
    assert seen.plot(tmp_path / "seen.png") is not None
    hhr.write_fields(tmp_path / "seen.vtu", full, seen)
    assert (tmp_path / "seen.vtu").stat().st_size > 1000


@needs("plots")
def test_models_in_the_plane_keep_all_fields(full):
    whole = hhr.condense(full, fields=True)
    assert hhr.with_surface_fields(whole) is whole
    small = whole.without_fields()
    assert hhr.with_surface_fields(small) is small


@needs("floating")
def test_models_that_need_them_keep_fields():
    """Motions of bodies that contact alone holds are found with the field."""
    floats = hhr.condense(hhr.FullOrderModel(blocks(free=True), MPI.COMM_SELF))
    assert floats.without_fields() is floats


@needs("one_call")
def test_by_command(full, tmp_path):
    scene = tmp_path / "pair.py"
    scene.write_text("from contract import blocks\nscene = blocks()\n")
    for fields in ("all", "none"):
        words = ["reduce", str(scene), "--out", str(tmp_path / fields), "--fields", fields]
        done = CliRunner().invoke(hhr_command, words, catch_exceptions=False)
        assert done.exit_code == 0, done.output
    large, small = (hhr.load_model(tmp_path / name / "model.npz") for name in ("all", "none"))
    point = large.parameters.random(1, 0)[0]
    assert small.solve(point).forces() == pytest.approx(large.solve(point).forces(), rel=1e-12)
    assert large.solve(point).displacement().any()
    with pytest.raises(NotOfferedError):
        small.solve(point).displacement()
    with pytest.raises(StudyError, match="needs fields"):
        hhr.reduce(full, of="displacement", fields=False)
