"""Files: whole or not there, no leftovers, errors that name the file.

Snapshots and tables that are read back.
"""

import csv
import dataclasses
import errno
import hashlib
import os
import pickle
import random
import re
import resource
import shutil
import signal
import subprocess
import sys
import time
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pellet_cladding as demo
import pytest
from bare_problem import BareFull, answer, bare_problem, on_disk, rewrite_signed
from mpi4py import MPI
from needs import needs, present
from processes import SCENE_FOLDERS, python
from rich.console import Console

import hhr_dolfinx as hhr
from hhr_dolfinx import files
from hhr_dolfinx.command.console import make_console
from hhr_dolfinx.errors import FileContentError, FileError, ParameterError, SnapshotFileWarning
from hhr_dolfinx.files import read_arrays, write_arrays
from hhr_dolfinx.snapshots.store import add_to

POINT = np.array([0.25, 3.0])


@pytest.fixture(scope="module")
def small():
    return hhr.FullOrderModel(demo.scene(**demo.QUICK_MESH))


@pytest.fixture(scope="module")
def small_reduction(small):
    return hhr.build(small, hhr.compute_snapshots(small, small.parameters.grid([8, 8])))


# ---------------------------------------------------------------- writing


def write_a_report(folder, reduction):
    from hhr_dolfinx.plugins.studies.report import write_report

    write_report({"a": 1.0}, folder)


def write_an_answer(folder, reduction):
    from hhr_dolfinx.plugins.tables.batch import Answers

    answers = Answers(np.ones((1, 2)), ["ok"], np.ones((1, 3)))
    hhr.write_answers(folder / "answers.csv", reduction.parameters, answers)


WRITERS = {"model.npz": lambda folder, reduction: hhr.save_model(folder / "model.npz", reduction)}
WRITERS |= {"report.json": write_a_report} if present("studies") else {}
WRITERS |= {"answers.csv": write_an_answer} if present("tables") else {}


@pytest.mark.parametrize("name", WRITERS)
@pytest.mark.parametrize(
    "number, remedy", [(errno.ENOSPC, "free some space"), (errno.EROFS, "you may write to")]
)
def test_a_failed_write_leaves_the_old_file(
    name, number, remedy, small_reduction, tmp_path, monkeypatch
):
    """And says what to do."""
    (tmp_path / name).write_text("old")
    monkeypatch.setattr(os, "fsync", Mock(side_effect=OSError(number, os.strerror(number))))
    with pytest.raises(
        FileError, match=rf"{name} cannot be written \({os.strerror(number)}\): .*{remedy}"
    ) as caught:
        WRITERS[name](tmp_path, small_reduction)
    assert isinstance(caught.value, OSError)
    assert (tmp_path / name).read_text() == "old" and os.listdir(tmp_path) == [name]


def test_a_disk_that_is_full(small_reduction, tmp_path):
    """A limit on the size of files stands for the disk: the system refuses in the middle of an
    array.
    """
    hhr.save_model(tmp_path / "model.npz", small_reduction)
    before = (tmp_path / "model.npz").read_bytes()
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    ignored = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, hard))
    try:
        with pytest.raises(FileError, match=r"model\.npz cannot be written"):
            hhr.save_model(tmp_path / "model.npz", small_reduction)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        signal.signal(signal.SIGXFSZ, ignored)
    assert (tmp_path / "model.npz").read_bytes() == before and os.listdir(tmp_path) == ["model.npz"]


@pytest.mark.parametrize("name", WRITERS)
def test_a_file_in_the_place_of_a_folder(name, small_reduction, tmp_path):
    (tmp_path / "out").write_text("a file")
    with pytest.raises(
        FileError, match=r"out cannot be made .*a file stands where a folder is needed"
    ):
        WRITERS[name](tmp_path / "out", small_reduction)
    with pytest.raises(FileError, match="out cannot be made"):
        hhr.SnapshotStore(tmp_path / "out", BareFull())
    (tmp_path / "other" / name).mkdir(parents=True)
    with pytest.raises(FileError, match="a folder has this name"):
        WRITERS[name](tmp_path / "other", small_reduction)
    assert os.listdir(tmp_path / "other") == [name]


def test_the_error_travels_between_ranks():
    error = pickle.loads(pickle.dumps(FileError("a.npz cannot be written")))
    assert isinstance(error, FileError) and str(error) == "a.npz cannot be written"


def test_what_a_living_process_writes_is_no_leftover(tmp_path):
    program = (
        "import sys\nfrom hhr_dolfinx import files\n"
        "with files.replacing(sys.argv[1]) as file:\n"
        "    file.write(b'half')\n    file.flush()\n    print('there', flush=True)\n    "
        "sys.stdin.read()\n"
    )
    command = [sys.executable, "-c", program, str(tmp_path / "a.bin")]
    (tmp_path / "movie.part").write_text("somebody else's")
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stdin=subprocess.PIPE, text=True
    ) as child:
        assert child.stdout.readline() == "there\n"
        hhr.SnapshotStore(tmp_path, BareFull())
        assert len(list(tmp_path.glob("a.bin.*.part"))) == 1
        child.kill()
    assert len(list(tmp_path.glob("a.bin.*.part"))) == 1
    hhr.SnapshotStore(tmp_path, BareFull())
    assert os.listdir(tmp_path) == ["movie.part"]


@pytest.mark.parametrize("name", WRITERS)
def test_the_next_write_clears_its_folder(name, small_reduction, tmp_path):
    (tmp_path / f"{name}.0123456789abcdef.part").write_text("half")
    WRITERS[name](tmp_path, small_reduction)
    assert os.listdir(tmp_path) == [name]


def test_a_process_that_clears_up_harms_none_that_writes(tmp_path):
    """At any moment of a write, the one between making and locking a temporary file included."""
    program = (
        "import sys\nfrom hhr_dolfinx import files\n"
        "for k in range(300):\n"
        "    with files.replacing(sys.argv[1] + f'/{k}.bin', tidy=False) as file:\n"
        "        file.write(b'whole')\n"
    )
    with subprocess.Popen([sys.executable, "-c", program, str(tmp_path)]) as child:
        while child.poll() is None:
            files.clear_leftovers(tmp_path)
    assert child.returncode == 0
    assert sorted(os.listdir(tmp_path)) == sorted(f"{k}.bin" for k in range(300))


SIZES = {"dofs": 100_000, "conditions": 1000}
SAVES = f"""
import sys
sys.path[:0] = {SCENE_FOLDERS!r}
import numpy as np
import hhr_dolfinx as hhr
from bare_problem import BareFull, answer
store = hhr.SnapshotStore(sys.argv[1], BareFull(**{SIZES}))
print("go", flush=True)
for k in range(int(sys.argv[2]), 10**9):
    store.save(answer([k % 20, 1.0], **{SIZES}, seed=k % 20))
"""


@pytest.mark.parametrize("kills", [3, pytest.param(20, marks=pytest.mark.slow)])
def test_kills_leave_whole_snapshots_and_the_next_run_clears_up(kills, tmp_path):
    dice, left = random.Random(kills), 0
    for kill in range(20 * kills):
        if kill >= kills and left:
            break  # a busy machine may leave them no time to begin a file
        command = [sys.executable, "-c", SAVES, str(tmp_path), str(kill)]
        pair = [subprocess.Popen(command, stdout=subprocess.PIPE, text=True) for _ in range(2)]
        for child in pair:
            assert child.stdout.readline() == "go\n"
        time.sleep(dice.uniform(0.0, 0.3))
        for child in pair:
            child.kill()
            child.communicate()
        left += len(list(tmp_path.glob("*.part")))
    assert left > 0, "no process was killed in the middle of a file"
    store = hhr.SnapshotStore(tmp_path, BareFull(**SIZES))
    assert not list(tmp_path.glob("*.part"))
    loaded = [store.load(np.array([k, 1.0])) for k in range(20)]
    assert store.found == len(list(tmp_path.glob("*.npz"))) > 0
    for k, solution in enumerate(loaded):
        assert solution is None or np.array_equal(
            solution.unknown, answer([k, 1.0], **SIZES, seed=k).unknown
        )


# ---------------------------------------------------------------- reading


@pytest.fixture
def store(tmp_path):
    store = hhr.SnapshotStore(tmp_path, BareFull())
    store.save(answer(POINT))
    return store


def only_file(folder):
    (path,) = folder.glob("*.npz")
    return path


def refused(store, why):
    with pytest.warns(SnapshotFileWarning, match=f"{why}.*solved anew"):
        assert store.load(POINT) is None
    store.save(answer(POINT))
    assert np.array_equal(store.load(POINT).unknown, answer(POINT).unknown)


def test_a_snapshot_comes_back(store):
    solution = store.load(POINT)
    for name in ("unknown", "multipliers", "active"):
        assert getattr(solution, name).tobytes() == getattr(answer(POINT), name).tobytes()
    assert solution.converged and store.found == 1


def test_a_snapshot_under_the_name_of_another_point_or_problem_is_not_taken(store, tmp_path):
    here = only_file(tmp_path)
    wider = dataclasses.replace(bare_problem(), gaps=2 * bare_problem().gaps)
    for name, point, full in (
        ("point", POINT + 1.0, BareFull()),
        ("problem", POINT, BareFull(wider)),
    ):
        hhr.SnapshotStore(tmp_path / name, full).save(answer(point, seed=1))
        shutil.copy(only_file(tmp_path / name), here)
        refused(store, f"{here.name} belongs to another problem or parameter")


CHANGES = {
    "has type int64": lambda arrays: arrays.update(unknown=np.arange(6)),
    "has type float64": lambda arrays: arrays.update(active=np.zeros(2)),
    "no plain array of numbers": lambda arrays: arrays.update(multipliers=np.zeros(2, np.float16)),
    "has shape": lambda arrays: arrays.update(unknown=np.zeros((6, 1))),
    r"must be \(N = 6\)": lambda arrays: arrays.update(unknown=np.zeros(5)),
    "is not finite": lambda arrays: arrays.update(multipliers=np.array([np.nan, 0.0])),
    "are missing": lambda arrays: arrays.pop("active"),
    "holds no solution": lambda arrays: arrays.update(multipliers=-arrays["multipliers"]),
    "are unknown": lambda arrays: arrays.update(more=np.zeros(1)),
}


@pytest.mark.parametrize("why", CHANGES)
def test_a_signed_snapshot_of_other_content_is_not_taken(why, store, tmp_path):
    rewrite_signed(only_file(tmp_path), lambda header, arrays: CHANGES[why](arrays))
    refused(store, why)


@pytest.fixture
def at_most_ten_seconds():
    before = signal.signal(signal.SIGALRM, Mock(side_effect=TimeoutError))
    signal.alarm(10)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


@pytest.mark.parametrize("make", [os.mkdir, os.mkfifo], ids=["folder", "pipe"])
def test_a_snapshot_that_is_no_file_stops_nothing(make, store, tmp_path, at_most_ten_seconds):
    path = only_file(tmp_path)
    path.unlink()
    make(path)
    with pytest.warns(SnapshotFileWarning, match="no regular file"):
        assert store.load(POINT) is None


def test_a_wider_box_finds_the_snapshots_of_the_narrower_one(store, tmp_path):
    space = bare_problem().parameters
    wider = dataclasses.replace(
        bare_problem(), parameters=dataclasses.replace(space, upper=(2.0, 20.0))
    )
    assert hhr.SnapshotStore(tmp_path, BareFull(wider)).load(POINT) is not None


def test_another_version_of_the_package_solves_anew(store, tmp_path, monkeypatch):
    assert hhr.__version__.split(".")[0].isdigit()
    monkeypatch.setattr("hhr_dolfinx.snapshots.store.__version__", "999.0")
    assert hhr.SnapshotStore(tmp_path, BareFull()).load(POINT) is None


def test_a_flipped_bit_in_the_description_of_an_array_is_damage(store, tmp_path):
    """It stopped every later run."""
    content = bytearray(only_file(tmp_path).read_bytes())
    content[content.index(b"'shape': (") + 9] ^= 1
    only_file(tmp_path).write_bytes(content)
    refused(store, "damaged")


# ---------------------------------------------------------------- tables

TABLE = "\ufeffh1,P1\n3.2,170\n\n3.2,nan\nnine,100\n3.2,500\n,100\n\n5.25,30\n3,2,170\n"


@needs("tables", "exact_errors")
def test_every_answer_has_all_columns_and_a_bad_one_names_its_column(small_reduction, tmp_path):
    (tmp_path / "points.csv").write_text(TABLE, encoding="utf-8")
    given = hhr.read_points(tmp_path / "points.csv", small_reduction.parameters)
    assert [row.line for row in given] == [2, 4, 5, 6, 7, 9, 10] and given[0].cells == [
        "170",
        "3.2",
    ]
    console = Console(record=True, width=200, file=open(os.devnull, "w"))
    bad = hhr.answer_table(small_reduction, given, tmp_path / "answers.csv", console)
    with open(tmp_path / "answers.csv", newline="") as file:
        header, *rows = csv.reader(file)
    assert bad == 5 and len(rows) == 7
    assert {len(row) for row in rows} == {len(header)} == {8 + len(small_reduction.fields.gaps)}
    assert [row[2] == "ok" for row in rows] == [True, False, False, False, False, True, False]
    assert all(not any(row[3:]) for row in rows if row[2] != "ok")
    assert rows[2][2] == "h1 = 'nine' is no number" and rows[4][2] == "h1 is empty"
    assert rows[6][2].startswith("3 cells where the header has 2: numbers have a decimal point")
    printed = console.export_text()
    assert "line 5 (100, nine): h1 = 'nine' is no number" in printed and "line 10 (" in printed


@needs("tables")
@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"P1;h2\n1;2\n",
        b"P1 [Pa];P1;h1\n1;1;2\n",
        b"P1,h1,P1\n1,2,3\n",
        "P1,h1\n1,2\n".encode("utf-16"),
        b"P1,h1\n\x00\xff\n",
    ],
)
def test_a_file_that_is_no_table(content, small, tmp_path):
    (tmp_path / "points.csv").write_bytes(content)
    with pytest.raises(ParameterError, match=r"points\.csv"):
        hhr.read_points(tmp_path / "points.csv", small.parameters)


@needs("tables")
@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            "P1;h1\n170;3,2\n90,5;4\n",
            ["decimal commas"],
        ),  # as spreadsheets of most European languages save it
        ('\ufeff"P1";"h1"\r\n"170";"3,2"\r\n"90,5";"4"\r\n', ["decimal commas"]),
        ("h1\tP1\n3.2\t170\n4\t90.5\n", []),
        (
            "h1 [mm],P1 [W/m],peak [MPa]\n3.2,170,1\n4,90.5,2\n",
            ["not converted, .*: P1 .W/m., h1 .mm."],
        ),
        ("h1 [mm];P1\n3,2;170\n4;90,5\n", ["not converted", "decimal commas"]),
    ],
)
def test_tables_of_spreadsheets_are_read_by_name(text, said, small, tmp_path):
    (tmp_path / "points.csv").write_bytes(text.encode())
    notes = []
    rows = hhr.read_points(tmp_path / "points.csv", small.parameters, notes.append)
    assert [[float(cell) for cell in row.cells] for row in rows] == [[170.0, 3.2], [90.5, 4.0]]
    assert len(notes) == len(said) and all(
        re.search(word, note) for word, note in zip(said, notes, strict=True)
    )


@needs("tables")
def test_a_table_with_points_and_commas_is_not_guessed(small, tmp_path):
    """1.500 may be a number of a thousand there."""
    (tmp_path / "points.csv").write_text("P1;h1\n170;3,2\n1.500;4\n")
    assert hhr.read_points(tmp_path / "points.csv", small.parameters)[0].cells == ["170", "3,2"]


@needs("studies", "tables")
def test_a_batch_ends_with_1_if_a_row_has_no_answer(small, small_reduction, tmp_path, monkeypatch):
    """As users run it; the training is that of the other tests."""
    training = SimpleNamespace(build=lambda: small_reduction)
    monkeypatch.setattr(hhr, "train", lambda *_, **__: training)
    (tmp_path / "points.csv").write_text(TABLE, encoding="utf-8")
    (tmp_path / "good.csv").write_text("P1,h1\n170,3.2\n")
    for name, code in (("points.csv", 1), ("good.csv", 0)):
        words = ["demo", "--quick", "--batch", str(tmp_path / name), "--out", str(tmp_path)]
        monkeypatch.setattr(sys, "argv", words)
        with pytest.raises(SystemExit) as ended:
            demo.main()
        assert ended.value.code == code


@needs("tables")
def test_a_fault_of_the_program_is_no_reason_of_a_row(small_reduction, monkeypatch):
    points = small_reduction.parameters.random(3, 1)
    monkeypatch.setattr(small_reduction, "solve_many", lambda *_, **__: None + 1)
    with pytest.raises(TypeError):
        hhr.answer_points(small_reduction, points, MPI.COMM_SELF)


# ---------------------------------------------------------------- arrays


@needs("tables")
def test_many_points_as_arrays(small_reduction):
    space = small_reduction.parameters
    points = np.vstack([space.random(5, 3), [[np.nan, 3.0], [1e9, 3.0]]])
    found = hhr.answer_points(small_reduction, points, displacement=True)
    assert (
        found.status[:5] == ["ok"] * 5
        and "is not finite" in found.status[5]
        and "is outside" in found.status[6]
    )
    assert found.forces.shape == (7, len(small_reduction.fields.gaps))
    assert np.isnan(found.forces[5:]).all() and np.isnan(found.largest_displacement[5:]).all()
    for k in range(5):
        answer = small_reduction.solve(points[k])
        # many at once share products of matrices, whose last digits differ from those of one
        assert found.forces[k] == pytest.approx(
            answer.forces(), rel=1e-12, abs=1e-12 * answer.forces().max()
        )
        nodes = answer.displacement().reshape(-1, 2)
        assert found.largest_displacement[k] == pytest.approx(
            np.linalg.norm(nodes, axis=1).max(), rel=1e-12
        )
    none = hhr.answer_points(small_reduction, np.zeros((0, 2)))
    assert none.status == [] and none.forces.shape == (0, found.forces.shape[1])
    with pytest.raises(
        ParameterError, match=r"one row per point and one column for each of \('P1', 'h1'\)"
    ):
        hhr.answer_points(small_reduction, points[:, :1])


@needs("tables", "exact_errors")
def test_answers_without_a_table_are_written_as_numbers(small_reduction, tmp_path):
    space = small_reduction.parameters
    answers = hhr.answer_points(small_reduction, np.array([[170.0, 3.2], [np.nan, 3.2]]))
    assert hhr.write_answers(tmp_path / "answers.csv", space, answers) == 1
    with open(tmp_path / "answers.csv", newline="") as file:
        header, one, two = csv.reader(file)
    bounds = [
        f"bound of {name}" for name in ("displacement", "forces", "pressure", "forces in energy")
    ]
    assert header[:9] == ["P1", "h1", "status", "total_force", *bounds, "force_0"]
    assert one[:3] == ["170.0", "3.2", "ok"] and two[0] == "nan" and not any(two[3:])
    assert float(one[3]) == pytest.approx(
        answers.forces[0].sum(), rel=1e-11
    )  # 12 digits are written


def test_a_link_stays_a_link(small_reduction, tmp_path):
    (tmp_path / "release").mkdir()
    for target in ("release/old.npz", "release/none_yet.npz"):
        (tmp_path / "latest.npz").unlink(missing_ok=True)
        (tmp_path / "latest.npz").symlink_to(target)
        hhr.save_model(tmp_path / "latest.npz", small_reduction)
        assert (tmp_path / "latest.npz").is_symlink() and (tmp_path / target).is_file()
    assert os.listdir(tmp_path) in (["latest.npz", "release"], ["release", "latest.npz"])


@pytest.mark.parametrize("name", WRITERS)
def test_a_pipe_or_a_device_is_never_replaced(name, small_reduction, tmp_path):
    """Root would lose the device: a pipe stands for it here."""
    os.mkfifo(tmp_path / name)
    with pytest.raises(FileError, match=rf"{name} is a device or a pipe.* choose another name"):
        WRITERS[name](tmp_path, small_reduction)
    assert (tmp_path / name).is_fifo() and os.listdir(tmp_path) == [name]


@needs("tables")
def test_names_that_are_none(small, small_reduction, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    os.symlink("loop", "loop")
    names = {"a\0b.npz": "zero byte", "loop": "Too many levels of symbolic links"}
    for path, why in (
        names | dict.fromkeys(("", ".", "/"), "names a folder: add the name of a file")
    ).items():
        with pytest.raises(FileError, match=why):
            hhr.save_model(path, small_reduction)
    with pytest.raises(FileError, match="zero byte"):
        hhr.SnapshotStore("a\0b", BareFull())
    with pytest.raises(ParameterError, match="cannot be read"):
        hhr.read_points("a\0b.csv", small.parameters)


@needs("studies", "tables")
def test_brackets_in_names_are_printed(small_reduction, tmp_path, capsys):
    """To rich ``[bold]`` is a colour, and ``[/x]`` the end of one that never began."""
    from parts.cli import print_rows

    from hhr_dolfinx.plugins.studies.report import print_report

    folder = tmp_path / "run [bold] a[" / "x]"
    hhr.answer_table(small_reduction, [], folder / "answers.csv", make_console())
    assert f"{folder}/answers.csv" in capsys.readouterr().out
    sizes = dict.fromkeys(
        ("N", "N_lambda", "ell_bar", "N_lambda_C", "rid_cells", "cells", "snapshots"), 1
    )
    report = {"scene": "a[/x]", "sizes": sizes, "stability": {}, "errors": {}, "skipped": []}
    report |= {
        "times": {"online": {"median": 1.0, "p95": 1.0}},
        "refused_before": [{"layers": 1, "why": "[red] [/]"}],
    }
    print_report(report, make_console())
    print_rows("rows", [{"case": "[0, 1] [red]"}], make_console())
    printed = capsys.readouterr().out
    assert all(text in printed for text in ("a[/x]", "[red] [/]", "[0, 1] [red]"))


@needs("tables")
@pytest.mark.parametrize(
    "points",
    ([["a", "b"]], [[1.0, 2.0], [1.0]], [[1j, 2.0]], {"P1": 1.0}, None, [1.0, 2.0]),
    ids=repr,
)
def test_points_that_are_no_table(points, small_reduction):
    with pytest.raises(ParameterError, match=r"one row per point|'h1' is missing"):
        hhr.answer_points(small_reduction, points)
    with pytest.raises(
        ParameterError, match="outside = 'Refuse' is unknown, one of warn, refuse, ignore"
    ):
        hhr.answer_points(small_reduction, [[100.0, 3.0]], outside="Refuse")


# ---------------------------------------------------------------- arrays left on the disk


def test_arrays_on_the_disk_are_those_in_memory(tmp_path, monkeypatch):
    """Both orders in memory, names of all lengths, so that arrays begin at any byte.

    Small ones are read.
    """
    rng = np.random.default_rng(0)
    given = {"x" * k: rng.standard_normal((k, 3)) for k in range(1, 12)}
    given |= {
        "turned": np.asfortranarray(rng.standard_normal((7, 5))),
        "few": np.arange(2),
        "flags": np.ones(9, bool),
    }
    write_arrays(tmp_path / "a.npz", {"format": "a", "version": 1}, given)
    monkeypatch.setattr(files, "MAPPED_BYTES", 150)
    header, found = read_arrays(tmp_path / "a.npz", "a", 1, mapped=True)
    assert header["version"] == 1 and found.keys() == given.keys()
    for name, array in given.items():
        assert (
            np.array_equal(found[name], array)
            and found[name].flags.f_contiguous == array.flags.f_contiguous
        )
    left = {name for name, array in found.items() if on_disk(array)}
    assert {"x" * 11, "turned"} <= left and not {"few", "flags"} & left
    assert not any(on_disk(array) for array in read_arrays(tmp_path / "a.npz", "a", 1)[1].values())


def test_descriptors_are_left_for_others(tmp_path, monkeypatch):
    """One for each file on the disk, up to half of those allowed.

    What comes then is read into memory.
    """
    monkeypatch.setattr(files, "MAPPED_BYTES", 150)
    arrays = {name: np.arange(100.0) for name in "abc"}
    for k in range(80):
        write_arrays(tmp_path / f"{k}.npz", {"format": "a", "version": 1}, arrays)
    limits = resource.getrlimit(resource.RLIMIT_NOFILE)
    used = len(os.listdir("/proc/self/fd"))
    try:
        resource.setrlimit(resource.RLIMIT_NOFILE, (2 * (used + 40), limits[1]))
        kept = [read_arrays(tmp_path / f"{k}.npz", "a", 1, mapped=True)[1] for k in range(80)]
        assert len(os.listdir("/proc/self/fd")) <= used + 42
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, limits)
    on_files = [all(on_disk(array) for array in found.values()) for found in kept]
    assert all(on_files[:30]) and not any(on_files[45:])
    assert all(np.array_equal(found["b"], arrays["b"]) for found in kept)


@pytest.mark.parametrize("place", [0.3, 0.6, 0.9, None])
def test_damage_is_found_in_arrays_on_the_disk(place, tmp_path, monkeypatch):
    path = tmp_path / "a.npz"
    write_arrays(path, {"format": "a", "version": 1}, {"values": np.arange(1000.0)})
    monkeypatch.setattr(files, "MAPPED_BYTES", 150)
    content = bytearray(path.read_bytes())
    if place is None:
        content = content[: len(content) // 2]
    else:
        content[int(place * len(content))] ^= 1
    path.write_bytes(content)
    with pytest.raises(FileContentError):
        read_arrays(path, "a", 1, mapped=True)


DIGESTS = f"""
import sys
sys.path[:0] = {SCENE_FOLDERS!r}
import dataclasses
import contract, scenes
import hhr_dolfinx as hhr

kinds = [name for name in sys.argv[2:] if name in contract.KINDS]
made = {{name: lambda name=name: contract.KINDS[name].full() for name in kinds}}
made["elastic"] = lambda: hhr.FullOrderModel(scenes.pressed_block("plane_strain"))
if "constraints" in sys.argv:
    plain = scenes.pressed_block("plane_strain")
    low, high = hhr.Nodes.near((1.5, 0.0)), hhr.Nodes.near((1.5, 1.0))
    tied = dataclasses.replace(plain, constraints=(hhr.Equation(((low, 0, 1.0), (high, 0, -1.0))),))
    made["constraints"] = lambda: hhr.FullOrderModel(tied)
for name, full in made.items():
    print(name, hhr.SnapshotStore(sys.argv[1], full()).problem_digest)
"""


@needs("nodal_loads")
def test_a_problem_has_one_digest_in_every_process(tmp_path):
    """Else a training that was interrupted finds none of its answers again."""
    plugins = [name for name in ("constraints",) if present(name)]
    kinds = ["full", "full, friction", "full, flowing", "full, friction and flowing", *plugins]
    seen = [
        python("-c", DIGESTS, tmp_path, *kinds, env=os.environ | {"PYTHONHASHSEED": seed})
        for seed in "12"
    ]
    assert seen[0].stdout == seen[1].stdout and len(set(seen[0].stdout.split()[1::2])) > 1


def test_an_object_without_bytes_is_no_part_of_a_digest():
    """An object has an address, which another process has elsewhere."""
    for part in (None, object(), [np.ones(2), None]):
        with pytest.raises(TypeError, match="no bytes that identify it"):
            add_to(hashlib.sha256(), [part])
