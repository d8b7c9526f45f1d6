"""Models on disk: what is read is what was written, and nothing else is read."""

import json
import subprocess
import sys
from dataclasses import fields, replace

import numpy as np
import pellet_cladding
import pytest
from bare import rewrite_signed

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import FileError, ModelFileError
from hhr_dolfinx.online import model_file


@pytest.fixture
def path(hertz_reduction, tmp_path):
    hhr.save_model(tmp_path / "model.npz", hertz_reduction)
    return tmp_path / "model.npz"


def test_round_trip(path, hertz_reduction):
    stored = hhr.load_model(path)
    for mu in (0.168, 0.4321):
        mine, theirs = stored.model.solve(mu), hertz_reduction.model.solve(mu)
        assert np.array_equal(mine.forces, theirs.forces) and np.array_equal(mine.primal, theirs.primal)
        displacement, forces = hertz_reduction.solve_everywhere(mu)
        assert all(map(np.array_equal, stored.solve_everywhere(mu), (displacement, forces)))


def test_answers_without_dolfinx_gmsh_and_plots(path, hertz_reduction):
    """The online side is light: another process answers and has loaded none of the offline side."""
    program = (
        "import sys, hhr_dolfinx as hhr\n"
        f"print(hhr.load_model({str(path)!r}).model.solve(0.3).forces.tolist())\n"
        "heavy = {'dolfinx', 'ufl', 'gmsh', 'pyvista', 'matplotlib', 'slepc4py'} & set(sys.modules)\n"
        "assert not heavy, heavy\n"
    )
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert json.loads(run.stdout) == hertz_reduction.model.solve(0.3).forces.tolist()


def test_an_old_file_survives_a_failed_write(path, hertz_reduction, monkeypatch):
    before = path.read_bytes()
    monkeypatch.setattr(np, "savez", lambda *_, **__: (_ for _ in ()).throw(OSError("disk full")))
    with pytest.raises(FileError, match=r"model\.npz cannot be written \(disk full\)"):
        hhr.save_model(path, hertz_reduction)
    assert path.read_bytes() == before and len(list(path.parent.iterdir())) == 1


def rewrite(path, change):
    with np.load(path) as file:
        arrays = dict(file)
    change(arrays)
    with open(path, "wb") as file:
        np.savez(file, **arrays)


def test_a_changed_number_is_found(path):
    rewrite(path, lambda arrays: arrays["reduced.stiffness"].__setitem__((0, 0), 1.0))
    with pytest.raises(ModelFileError, match="checksum"):
        hhr.load_model(path)


def test_a_changed_box_is_found(path):
    def widen(arrays):
        header = json.loads(str(arrays["header"]))
        header["parameters"]["upper"] = [9.0]
        arrays["header"] = np.array(json.dumps(header))

    rewrite(path, widen)
    with pytest.raises(ModelFileError, match="checksum"):
        hhr.load_model(path)


def test_another_version_is_named(path):
    def age(arrays):
        header = json.loads(str(arrays["header"])) | {"version": 99}
        arrays["header"] = np.array(json.dumps(header))

    rewrite(path, age)
    with pytest.raises(ModelFileError, match="version 99"):
        hhr.load_model(path)


@pytest.mark.parametrize(
    "damage", [lambda b: b[: len(b) // 2], lambda b: b"", lambda b: b"not a model", lambda b: b[:-40]]
)
def test_a_damaged_file_is_refused(path, damage):
    path.write_bytes(damage(path.read_bytes()))
    with pytest.raises(ModelFileError, match="damaged"):
        hhr.load_model(path)


def test_pickles_are_not_read(path):
    rewrite(path, lambda arrays: arrays.__setitem__("reduced.loads", np.array([{}], dtype=object)))
    with pytest.raises(ModelFileError, match="damaged"):
        hhr.load_model(path)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(ModelFileError, match="no model file"):
        hhr.load_model(tmp_path / "nothing.npz")


def test_a_folder_or_a_pipe_is_no_model(tmp_path):
    with pytest.raises(ModelFileError, match="no regular file"):
        hhr.load_model(tmp_path)


@pytest.fixture(scope="module")
def pellet_reduction():
    """A model with a pressure on a part of a line: 42 terms, of which 41 move no imposed dof."""
    full_order = hhr.FullOrderModel(pellet_cladding.scene(**pellet_cladding.QUICK_MESH))
    points = full_order.problem.parameters.grid([8, 8])
    return hhr.build_reduced_model(full_order, hhr.compute_snapshots(full_order, points))


@pytest.fixture
def pellet_path(pellet_reduction, tmp_path):
    hhr.save_model(str(tmp_path / "pellet.npz"), pellet_reduction)
    return tmp_path / "pellet.npz"


def test_a_partial_pressure_comes_back_to_the_last_bit(pellet_path, pellet_reduction):
    stored = hhr.load_model(str(pellet_path))
    for mu in ((170.0, 3.2), (5.0, 0.6)):
        for mine, theirs in zip(stored.solve_everywhere(mu), pellet_reduction.solve_everywhere(mu), strict=True):
            assert mine.tobytes() == theirs.tobytes()
    mine, theirs = stored.reconstruction, pellet_reduction.reconstruction
    for item in fields(theirs):
        one, two = (getattr(part, item.name) for part in (mine, theirs))
        if item.name == "lifts":
            one, two = one.toarray(), two.toarray()
        assert np.array_equal(one, two), item.name
    assert stored.model.amplitudes.firsts == pellet_reduction.model.amplitudes.firsts


def test_zeros_are_not_stored(pellet_path, pellet_reduction):
    """Of the (N, 1 + T) lifts no entry is not zero: the basis is the largest array."""
    with np.load(pellet_path) as file:
        sizes = {name: file[name].nbytes for name in file.files}
    assert max(sizes, key=sizes.get) == "reconstruction.basis"
    assert sum(size for name, size in sizes.items() if "lifts" in name) < 1000


def test_more_than_ten_partial_pressures_keep_their_order(pellet_reduction, tmp_path):
    """Named by numbers, coverage10 comes behind coverage9, not behind coverage1."""
    model = pellet_reduction.model
    line = model.amplitudes.nonaffine[0]
    lines = tuple(replace(line, positions=line.positions[:2], constant=float(k)) for k in range(12))
    amplitudes = replace(model.amplitudes, nonaffine=lines)

    def cut(part):
        """As many terms as twelve lines of two nodes have; no answer is asked for."""
        wide = {name: getattr(part, name) for name in ("loads", "gaps", "lifts") if hasattr(part, name)}
        return replace(part, **{name: array[:, :37] for name, array in wide.items()})

    changed = hhr.ReducedModel(cut(model.problem), model.parameters, amplitudes, model.known)
    reconstruction = cut(pellet_reduction.reconstruction)
    hhr.save_model(tmp_path / "lines.npz", model_file.OnlineModel(changed, reconstruction, 2))
    stored = hhr.load_model(tmp_path / "lines.npz").model.amplitudes.nonaffine
    assert [coverage.constant for coverage in stored] == [float(k) for k in range(12)]


def test_the_table_has_a_line_for_every_field():
    """A field that is added to a part of a model must not be forgotten in its file."""
    names = {f"{part}.{item.name}" for part, kind in model_file._PARTS.items() for item in fields(kind)}
    names |= {"trained.lower", "trained.upper"}  # its names are those of the parameters
    lines = {".".join(name.split(".")[:2]) for name in model_file.LAYOUT}
    assert names - lines == {"amplitudes.nonaffine"} and lines <= names
    assert set(model_file.INDICES) <= set(model_file.LAYOUT)


def entry(name, index, value):
    return lambda header, arrays: arrays[name].__setitem__(index, value)


def array(name, change):
    return lambda header, arrays: arrays.update({name: np.asarray(change(arrays[name]))})


def header(**values):
    return lambda header, arrays: header.update(values)


def box(**values):
    return lambda header, arrays: header["parameters"].update(values)


SIGNED = {
    "basis.* is not finite": entry("reconstruction.basis", (0, 0), np.nan),
    "known.points.* is not finite": entry("known.points", (0, 0), np.inf),
    "basis has type int32": array("reconstruction.basis", lambda a: a.astype(np.int32)),
    "basis.npy is no plain array": array("reconstruction.basis", lambda a: a.astype(np.float32)),
    "active has type float64": array("known.active", lambda a: a.astype(float)),
    "A_lambda has type float64": array("reconstruction.A_lambda", lambda a: a.astype(float)),
    "contact_test has shape": array("reduced.contact_test", lambda a: a[:-1]),
    "loads has shape": array("reduced.loads", lambda a: a[:, 0]),
    "basis has shape": array("reconstruction.basis", lambda a: a.T),
    "slopes has shape": array("amplitudes.slopes", lambda a: a[:, :1]),
    "active has shape": array("known.active", lambda a: a[:, :-1]),
    "gap_scale has shape": array("reconstruction.gap_scale", lambda a: a[None]),
    "gap_scale has the entry 0.0": array("reconstruction.gap_scale", lambda a: 0.0 * a),
    "A_lambda has indices outside": entry("reconstruction.A_lambda", 0, 10**6),
    "A_lambda has indices outside 0": entry("reconstruction.A_lambda", 0, -1),
    "are dependent": entry("reconstruction.A_lambda", 0, 1),
    "singular": entry("reduced.stiffness", slice(None), 0.0),
    "first amplitude must be": entry("amplitudes.constant", 0, 2.0),
    "extent has indices outside": array("coverage0.extent", lambda a: a + 9),
    "positions must .* increase": array("coverage0.positions", lambda a: a[::-1].copy()),
    "positions has shape": array("coverage0.positions", lambda a: a[:-1]),
    "the amplitudes are": lambda header, arrays: (
        arrays.update({"coverage0.positions": arrays["coverage0.positions"][:-1]}),
        header["sizes"].update(nodes0=header["sizes"]["nodes0"] - 1),
    ),
    "basis has shape .* must be": array("reconstruction.basis", lambda a: a[:-2]),
    "dofs are no nodes": lambda header, arrays: (
        arrays.update({"reconstruction.basis": arrays["reconstruction.basis"][:-1]}),
        header["sizes"].update(N=header["sizes"]["N"] - 1),
    ),
    "force_snapshots has shape": array("reconstruction.force_snapshots", lambda a: a[:, :-1]),
    "sizes in its header must be integers": header(sizes={"N": "two"}),
    "sizes in its header are not those": lambda header, arrays: header["sizes"].update(more=1),
    "sizes .* are zero": lambda header, arrays: (
        arrays.update({"known.points": arrays["known.points"][:0], "known.active": arrays["known.active"][:0]}),
        header["sizes"].update(S=0),
    ),
    r"\['known.points'\] are missing": lambda header, arrays: arrays.pop("known.points"),
    r"\['known.more'\] are unknown": lambda header, arrays: arrays.update({"known.more": np.zeros(1)}),
    "dimension must be 2 or 3, not 'two'": header(dimension="two"),
    "dimension must be 2 or 3, not 2.0": header(dimension=2.0),
    "dimension must be 2 or 3, not 4": header(dimension=4),
    "its header has the keys": header(more=1),
    "the parameters must have": header(parameters=[1, 2]),
    "names of the parameters must be a list of str": box(names=[1, 2]),
    "names of the parameters must be a list": box(names="ab"),
    "lower of the parameters must be a list of float": box(lower=[None, 1.0]),
    "have one name": box(names=["h1", "h1"]),
    "must be increasing": box(upper=[0.0, 0.0]),
    "need one lower and one upper": box(upper=[1.0]),
    "not those of its arrays and parameters": box(names=["a", "b", "c"]),
}


@pytest.mark.parametrize("why", SIGNED)
def test_a_signed_file_of_other_content_is_refused_where_it_is_read(why, pellet_path):
    rewrite_signed(pellet_path, SIGNED[why])
    with pytest.raises(ModelFileError, match=f"{why}.*build the model again"):
        hhr.load_model(pellet_path)


def test_a_signed_file_that_was_not_changed_is_read(pellet_path):
    """Else the test above would pass with a wrong signature."""
    rewrite_signed(pellet_path, lambda header, arrays: None)
    hhr.load_model(pellet_path)


def test_what_could_not_be_read_is_not_written(hertz_reduction, tmp_path):
    broken = replace(hertz_reduction.reconstruction, gap_scale=np.nan)
    with pytest.raises(ModelFileError, match="cannot be kept"):
        hhr.save_model(tmp_path / "model.npz", model_file.OnlineModel(hertz_reduction.model, broken, 2))
    assert not list(tmp_path.iterdir())
