"""Ranks with a full model each, or one together: by the memory that there is."""

from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI
from mpirun import run_program
from scenes import pressed_block
from scipy.sparse import csr_matrix

import hhr_dolfinx as hhr
from hhr_dolfinx.group import group_of
from hhr_dolfinx.models import full
from hhr_dolfinx.plugins.ranks import expected, sharing
from hhr_dolfinx.plugins.ranks.group import Ranks


class TwoRanks:
    """A communicator of two ranks of one machine, of which this is the first."""

    rank, size = 0, 2

    def Split_type(self, _kind):
        return self

    def Free(self):
        pass

    def allgather(self, value):
        return [value, value]


def test_memory_that_is_left(tmp_path):
    meminfo = tmp_path / "meminfo"
    meminfo.write_text("MemTotal:       24000000 kB\nMemAvailable:   10000000 kB\n")
    assert sharing.free_gigabytes(meminfo) == pytest.approx(10.24)
    for text in ("MemTotal: 1 kB", "MemAvailable:\n", "rubbish"):
        meminfo.write_text(text)
        assert sharing.free_gigabytes(meminfo) is None
    assert sharing.free_gigabytes(tmp_path / "none") is None


def test_ranks_have_a_model_each_where_there_is_room(monkeypatch):
    scene = pressed_block("solid", simplices=True)
    needed = expected.expected_in_space(
        hhr.FullOrderModel(scene, MPI.COMM_SELF).problem.contact
    ).gigabytes
    for room, why in ((3.0 * needed, ""), (2.0 * needed, "2 full models of about")):
        monkeypatch.setattr(sharing, "free_gigabytes", lambda room=room: room)
        found = Ranks(TwoRanks()).no_room_side_by_side(scene)
        assert found.startswith(why) and bool(found) == bool(why)
    monkeypatch.setattr(sharing, "free_gigabytes", lambda: None)
    assert Ranks(TwoRanks()).no_room_side_by_side(scene) == ""


def test_one_rank_and_the_plane_are_not_looked_at(monkeypatch):
    monkeypatch.setattr(sharing, "free_gigabytes", lambda: 0.0)
    assert (
        group_of(MPI.COMM_SELF).no_room_side_by_side(pressed_block("solid", simplices=True)) == ""
    )
    assert Ranks(TwoRanks()).no_room_side_by_side(pressed_block("plane_strain")) == ""


def test_columns_and_schur_complements_are_reckoned_with(monkeypatch):
    """Columns that have no room take no memory, and no time where contact can be eliminated
    last.
    """
    contact = csr_matrix((np.ones(900), (np.arange(900), np.arange(900))), shape=(900, 300_000))
    dropped = expected.expected_in_space(contact)
    assert not dropped.keeps_columns
    monkeypatch.setattr(full, "RESPONSE_BYTES", 1e10)
    monkeypatch.setattr(expected, "RESPONSE_BYTES", 1e10)
    kept = expected.expected_in_space(contact)
    assert (
        kept.keeps_columns
        and kept.gigabytes > dropped.gigabytes + 2.0
        and kept.seconds > dropped.seconds
    )


HELPERS = Path(__file__).parents[2] / "helpers"


def test_the_command_trains_on_ranks_together(tmp_path):
    """The model is that of one rank: its figures, and what a page draws, are there."""
    scene = tmp_path / "scene.py"
    scene.write_text(
        f"import sys\nsys.path.insert(0, {str(HELPERS)!r})\n"
        "from scenes import pressed_block\nscene = pressed_block('plane_strain')\n"
    )
    program = "from hhr_dolfinx.command.main import hhr; hhr()"
    run = run_program(
        2, ["-c", program, "train", "scene.py", "--grid", "8", "--together"], tmp_path
    )
    assert run.returncode == 0, run.stdout[-2000:] + run.stderr[-2000:]
    said = " ".join(run.stdout.split())
    assert "2 ranks solve one problem after another together, since it was requested" in said
    assert "errors of its answers: bound, proved" in said
    folder = next((tmp_path / "out").iterdir())
    assert (folder / "scenery.npz").is_file()
    model, exact = (
        hhr.load_model(folder / "hhr.npz"),
        hhr.FullOrderModel(pressed_block("plane_strain"), MPI.COMM_SELF),
    )
    answer, forces = (one.solve(model.parameters.middle) for one in (model, exact))
    error = np.linalg.norm(answer.forces() - forces.forces())
    assert error <= answer.estimate().forces_euclid + 1e-9 * np.linalg.norm(forces.forces())
