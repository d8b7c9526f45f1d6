"""Models on disk: what is read is what was written, and nothing else is read."""

import json
import subprocess
import sys

import numpy as np
import pytest

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import ModelFileError


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
    with pytest.raises(OSError, match="disk full"):
        hhr.save_model(path, hertz_reduction)
    assert path.read_bytes() == before


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
