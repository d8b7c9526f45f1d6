"""Pressures, figures and fields of models in files, from the scenery beside them: those of the full
model's mesh.
"""

import dataclasses

import numpy as np
import pytest
import split_interface
import your_scene
from mpi4py import MPI
from needs import needs, present
from processes import python
from scenes import pressed_block, stacked
from sheared_blocks import driven
from shell import AT, SPRING, invoke

import hhr_dolfinx as hhr
from hhr_dolfinx import registry
from hhr_dolfinx.errors import FileContentError, NotOfferedError
from hhr_dolfinx.plugins.pages.scenery import Scenery


def halves():
    """Two contacts share a node in the middle, off the middle of the pressure."""
    pairs = [
        hhr.NodeToNode(*tags, (0, -1))
        for tags in zip(split_interface.UPPER, split_interface.LOWER, strict=True)
    ]
    bodies = (
        hhr.Body(split_interface.FIRST, young=1e3, poisson=0.1),
        hhr.Body(split_interface.SECOND, young=1e3, poisson=0.4),
    )
    return split_interface.scene(
        pairs, bodies=bodies, parameters=hhr.ParameterSpace(("press",), (1.0,), (20.0,))
    )


SCENES = {
    "quadrilaterals": lambda: pressed_block("plane_strain"),
    "triangles": lambda: pressed_block("plane_stress", simplices=True),
    "round": lambda: pressed_block("axisymmetric"),
    "tetrahedra": lambda: stacked(3, simplices=True),
    "hexahedra": lambda: stacked(3),
    "a node of two contacts": halves,
}


@pytest.fixture(scope="module")
def kept(tmp_path_factory):
    """The full model of a scene, the file of its condensed model, with the scenery beside it, by
    name.
    """
    known = {}

    def of(name):
        if name not in known:
            folder = tmp_path_factory.mktemp("kept")
            full = hhr.FullOrderModel(SCENES[name](), MPI.COMM_SELF)
            hhr.save_model(folder / "model.npz", hhr.condense(full, fields=True))
            hhr.scenery_of(full).write(folder / "scenery.npz")
            known[name] = full, folder / "model.npz"
        return known[name]

    return of


def answered(kept, name):
    """The full model, and the answer of the model in the file near the upper end of the box."""
    full, file = kept(name)
    model = hhr.load_model(file)
    box = model.parameters
    return full, model.solve(0.1 * np.array(box.lower) + 0.9 * np.array(box.upper))


@needs("floating", "shared_nodes")
@pytest.mark.parametrize("name", SCENES)
def test_pressures_are_those_of_the_mesh(name, kept):
    full, answer = answered(kept, name)
    pressure = answer.pressure()
    assert np.nanmax(pressure) > 0
    np.testing.assert_array_equal(pressure, answer.pressure(full))


def test_pressures_of_a_uniform_strip(kept):
    """E / (1 - nu^2) (push - gap) / 2, the uniform stress of ``scenes.pressed_block``."""
    answer = hhr.load_model(kept("quadrilaterals")[1]).solve(0.05)
    np.testing.assert_allclose(answer.pressure(), 3.0 / 0.91 * 0.04 / 2, rtol=1e-9)


@needs("plots", "floating", "shared_nodes")
@pytest.mark.parametrize("name", SCENES)
def test_fields_are_those_of_the_mesh(name, kept, tmp_path):
    """Written by the full model, whose VTK mesh is that of DOLFINx."""
    pyvista = pytest.importorskip("pyvista")
    full, answer = answered(kept, name)
    loaded = hhr.load_model(kept(name)[1])
    (right,) = hhr.write_fields(tmp_path / "right.vtu", full, answer)
    (other,) = hhr.write_fields(tmp_path / "other.vtu", loaded, answer)
    right, other = pyvista.read(right), pyvista.read(other)
    np.testing.assert_array_equal(other.points, right.points)
    np.testing.assert_array_equal(other.cells, right.cells)
    np.testing.assert_array_equal(other.celltypes, right.celltypes)
    assert set(other.point_data.keys()) == set(right.point_data.keys())
    for key in ("displacement", "contact_pressure", "gap", "status"):
        np.testing.assert_array_equal(other[key], right[key])
    np.testing.assert_array_equal(other["body"], right["body"])
    flat = right.points[:, 2].max() == right.points[:, 2].min()
    assert ("von_mises" in other.cell_data) == flat
    if flat:  # of a scenery in space the surface alone has strains
        np.testing.assert_allclose(other["von_mises"], right["von_mises"], rtol=1e-9)


def drawn(figure):
    """Numbers of all that a figure draws, and its words."""
    numbers = []
    for axes in figure.axes:
        numbers += [line.get_xydata() for line in axes.lines]
        for item in axes.collections:
            colours = item.get_array()  # none of outlines
            numbers += [] if colours is None else [np.asarray(colours)]
            numbers += [path.vertices for path in item.get_paths()]
    return numbers, [
        figure.get_suptitle(),
        *(axes.get_xlabel() + axes.get_ylabel() for axes in figure.axes),
    ]


@needs("plots", "floating", "shared_nodes")
@pytest.mark.parametrize(
    "name", ["quadrilaterals", "triangles", "round", "hexahedra", "a node of two contacts"]
)
def test_figures_are_those_of_the_mesh(name, kept, tmp_path):
    pytest.importorskip("matplotlib")
    full, answer = answered(kept, name)
    right, words = drawn(answer.plot(full=full))
    other, same = drawn(answer.plot(tmp_path / "answer.png"))
    assert (
        words == same
        and len(right) == len(other)
        and (tmp_path / "answer.png").stat().st_size > 1000
    )
    for one, two in zip(right, other, strict=True):  # stress of strains has the round-off of these
        np.testing.assert_allclose(one, two, rtol=1e-9, atol=1e-9 * np.abs(two).max(initial=0.0))


@needs("plots")
def test_a_hyper_reduced_model_in_a_file_has_them_too(tmp_path):
    training = hhr.train(pressed_block("plane_strain"), [4], held_out=0, comm=MPI.COMM_SELF)
    model = training.build(checked=False)
    hhr.save_model(tmp_path / "hhr.npz", model)
    hhr.scenery_of(training.full_order).write(tmp_path / "scenery.npz")
    answer = hhr.load_model(tmp_path / "hhr.npz").solve(0.05)
    np.testing.assert_array_equal(answer.pressure(), answer.pressure(training.full_order))
    np.testing.assert_allclose(answer.pressure(), model.solve(0.05).pressure(), rtol=1e-12)
    right, other = drawn(answer.plot(full=training.full_order)), drawn(answer.plot())
    assert right[1] == other[1] and all(map(np.allclose, right[0], other[0]))


@needs("plots", "friction")
def test_with_friction_pressures_are_those_of_normals(kept, tmp_path):
    full = hhr.FullOrderModel(driven(), MPI.COMM_SELF)
    model = hhr.condense(full, fields=True)
    hhr.save_model(tmp_path / "model.npz", model)
    hhr.scenery_of(full).write(tmp_path / "scenery.npz")
    loaded = hhr.load_model(tmp_path / "model.npz")
    answer = loaded.solve(loaded.parameters.upper)
    np.testing.assert_array_equal(answer.pressure(), answer.pressure(full))
    (file,) = hhr.write_fields(tmp_path / "a.vtu", loaded, answer)
    (right,) = hhr.write_fields(tmp_path / "b.vtu", full, answer)
    pyvista = pytest.importorskip("pyvista")
    np.testing.assert_array_equal(
        pyvista.read(file)["contact_pressure"], pyvista.read(right)["contact_pressure"]
    )


@needs("plots")
def test_without_the_scenery_one_sentence_says_what_to_do(kept, tmp_path, monkeypatch):
    model = tmp_path / "alone.npz"
    model.write_bytes(kept("quadrilaterals")[1].read_bytes())
    monkeypatch.chdir(tmp_path)
    loaded = hhr.load_model("alone.npz")
    monkeypatch.chdir(tmp_path.parent)  # the path of the file counts, not where it is asked
    answer = loaded.solve(0.05)
    why = (
        f"there is no scenery.npz beside {model}, and a model in a file has no mesh: name the "
        "scene, --scene FILE.py, "
        rf"or in Python give the full model, full=hhr.FullOrderModel\(scene\); "
        rf"hhr.scenery_of\(full\).write\('{tmp_path}/scenery.npz'\) makes the file"
    )
    for ask in (
        answer.pressure,
        answer.plot,
        lambda: hhr.write_fields(tmp_path / "sub" / "a.vtu", loaded, answer),
    ):
        with pytest.raises(NotOfferedError, match=f"^{why}$"):
            ask()
    assert not (tmp_path / "sub").exists()
    full, _ = kept("quadrilaterals")
    hhr.scenery_of(full).write(tmp_path / "scenery.npz")  # as the sentence says
    np.testing.assert_array_equal(answer.pressure(), answer.pressure(full))


@needs("plots", "floating")
def test_other_sceneries_are_refused(kept, tmp_path):
    """Of an earlier release, of shapes that vary, of another mesh, and a damaged one."""
    full, file = kept("quadrilaterals")
    scenery = Scenery.read(file.with_name("scenery.npz"))
    point = 0.05

    def with_scenery(changed):
        folder = tmp_path / str(len(list(tmp_path.iterdir())))
        folder.mkdir()
        (folder / "model.npz").write_bytes(file.read_bytes())
        changed.write(folder / "scenery.npz")
        return hhr.load_model(folder / "model.npz").solve(point)

    earlier = with_scenery(dataclasses.replace(scenery, mesh=None))
    np.testing.assert_array_equal(earlier.pressure(), earlier.pressure(full))
    with pytest.raises(
        NotOfferedError, match="is of an earlier release: name the scene, --scene FILE"
    ):
        earlier.plot()
    with pytest.raises(NotOfferedError, match="shapes of bodies are parameters"):
        with_scenery(dataclasses.replace(scenery, moves=True)).pressure()
    other = hhr.scenery_of(kept("hexahedra")[0])
    with pytest.raises(NotOfferedError, match="they are of two scenes or meshes"):
        with_scenery(other).pressure()
    softer = hhr.scenery_of(
        hhr.FullOrderModel(pressed_block("plane_strain", young=2.0), MPI.COMM_SELF)
    )
    with pytest.raises(NotOfferedError, match="its contact is stiffer or softer"):
        with_scenery(softer).pressure()
    finer = hhr.scenery_of(
        hhr.FullOrderModel(pressed_block("plane_strain", simplices=True), MPI.COMM_SELF)
    )
    cut = dataclasses.replace(finer.mesh, all_points=finer.mesh.all_points[:-1])
    with pytest.raises(FileContentError, match="name nodes that are not there"):
        with_scenery(dataclasses.replace(finer, mesh=cut)).pressure()
    longer = dataclasses.replace(
        scenery.mesh, all_points=np.vstack([scenery.mesh.all_points, np.zeros(2)])
    )
    with pytest.raises(NotOfferedError, match="they are of two scenes or meshes"):
        with_scenery(dataclasses.replace(scenery, mesh=longer)).plot()


ALONE = """
import sys
missing = ["dolfinx", "ufl", "basix", "gmsh", "petsc4py", "slepc4py", "mpi4py"]
sys.modules.update(dict.fromkeys(missing))
import hhr_dolfinx as hhr
model = hhr.load_model(sys.argv[1])
assert "hhr_dolfinx.plugins.pages.scenery" not in sys.modules
answer = model.solve(0.05)
print(answer.pressure().tobytes().hex())
answer.plot(sys.argv[2] + "/answer.png")
hhr.write_fields(sys.argv[2] + "/answer.vtu", model, answer)
"""


@needs("plots")
def test_another_process_has_them_without_dolfinx(kept, tmp_path):
    pytest.importorskip("pyvista"), pytest.importorskip("matplotlib")
    full, file = kept("quadrilaterals")
    said = python("-W", "ignore", "-c", ALONE, str(file), str(tmp_path)).stdout.split()
    assert said == [hhr.load_model(file).solve(0.05).pressure(full).tobytes().hex()]
    assert {path.name for path in tmp_path.iterdir()} == {"answer.png", "answer.vtu"}


@needs("plots", "nonmatching")
def test_the_command_writes_fields_of_a_model_in_a_file(tmp_path):
    pyvista = pytest.importorskip("pyvista")
    full = hhr.FullOrderModel(your_scene.scene(), MPI.COMM_SELF)
    file = tmp_path / "condensed.npz"
    hhr.save_model(file, hhr.condense(full, fields=True))
    registry.write_companions(full, tmp_path)  # as the commands do
    code, output = invoke("solve", file, *AT, "--out", tmp_path / "a.vtu")
    assert (
        code == 0
        and f"fields: {tmp_path / 'a.vtu'}, as far as the files beside the model have them"
        in output
    )
    code, output = invoke("solve", file, *AT, "--scene", SPRING, "--out", tmp_path / "b.vtu")
    assert code == 0 and output.endswith(f"fields: {tmp_path / 'b.vtu'}\n")
    one, two = pyvista.read(tmp_path / "a.vtu"), pyvista.read(tmp_path / "b.vtu")
    for key in ("displacement", "contact_pressure", "body"):
        np.testing.assert_array_equal(one[key], two[key])
    # strains of cells that hardly deform are differences of displacements: round-off is that of the
    # largest stress
    np.testing.assert_allclose(
        one["von_mises"], two["von_mises"], atol=1e-12 * two["von_mises"].max()
    )
    assert "gap" in two.point_data
    (tmp_path / "scenery.npz").unlink()
    code, output = invoke("solve", file, *AT, "--out", tmp_path / "c.vtu")
    assert code == 3 and "there is no scenery.npz beside" in output and "--scene FILE.py" in output
    assert "largest displacement" not in output
    assert invoke("solve", file, *AT, "--scene", SPRING)[0] == 2


def test_without_a_reader_of_scenery_models_have_no_mesh(kept, monkeypatch):
    """As where this plug-in is deleted."""
    _, file = kept("quadrilaterals")
    offered = registry.offered
    monkeypatch.setattr(
        registry, "offered", lambda word: None if word == "mesh_beside" else offered(word)
    )
    with pytest.raises(
        NotOfferedError,
        match=r"a model that was copied or read from a file has no mesh, and pressures",
    ):
        hhr.load_model(file).solve(0.05).pressure()
    if present("plots"):
        code, output = invoke("solve", file, "--at", "push=0.05", "--out", file.with_name("a.vtu"))
        assert (
            code == 2
            and "--out needs a mesh, which a model in a file has not: name the scene, --scene"
            in output
        )
