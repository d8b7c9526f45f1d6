"""The command ``hhr``, as people use it: words, files, pipes, ranks, mistakes, and Ctrl-C."""

import ast
import csv
import re
import signal
import subprocess
import sys
import time
import tomllib
from pathlib import Path
from unittest.mock import Mock

import contract
import numpy as np
import pytest
from mpirun import run_program
from needs import needs, present
from processes import WAIT, python
from shell import AT, DEMO, ENVIRONMENT, POINT, PROGRAM, SPRING, TRAIN, invoke, run

import hhr_dolfinx as hhr
from hhr_dolfinx import registry

pytest.importorskip("click")
from click.testing import CliRunner

from hhr_dolfinx.command.main import hhr as command


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    folder = tmp_path_factory.mktemp("trained") / "of this scene"
    found = run(*TRAIN, "--out", folder)
    assert found.returncode == 0, found.stderr
    return folder, found


@pytest.fixture(scope="module")
def file(trained):
    return trained[0] / "hhr.npz"


@pytest.fixture(scope="module")
def model(file):
    return hhr.load_model(file)


@pytest.fixture(scope="module")
def full():
    import your_scene

    return hhr.FullOrderModel(your_scene.scene())


PIPES = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True, "env": ENVIRONMENT}


def told(output):
    return {
        name: float(value) for name, value in (line.rsplit(": ", 1) for line in output.splitlines())
    }


COMMANDS = command.list_commands(None)


def test_every_command_helps_with_examples():
    code, output = invoke("--help")
    of_plugins = {
        name
        for one in registry.installed().values()
        for name, _ in registry.places_in(one.commands)
    }
    assert code == 0 and set(COMMANDS) == {"train", "solve", "list"} | of_plugins
    for name in COMMANDS:
        for word in ("--help", "-h"):
            code, said = invoke(name, word)
            assert (
                code == 0 and "Examples:\n" in said and f"hhr {name}" in said.split("Examples:")[1]
            )
        assert f"  {name} " in output
    assert invoke("--version")[0] == 0


@needs("exact_errors")
def test_training_says_each_thing_once(trained):
    folder, found = trained
    lines = found.stdout.splitlines()
    assert lines[:2] == ["snapshots: 12 to do", "held out: 100 to do"]
    assert "3128 dofs and 86 contacts -> " in lines[2] and lines[4:] == [
        f"model: {folder / 'hhr.npz'}"
    ]
    assert lines[3].startswith(
        "errors of its answers: bound, proved: the displacement in energy; nodal contact forces"
    )
    # twelve points are few, which is said
    warned = [line for line in found.stderr.splitlines() if line]
    assert (
        warned
        and all(line.startswith("warning: ") for line in warned)
        and len(set(warned)) == len(warned)
    )


def test_an_interrupted_training_keeps_its_answers(tmp_path):
    words = [sys.executable, *PROGRAM, "train", SPRING, "--sobol", "128", "--out", str(tmp_path)]
    # what runs these tests in the background may ignore Ctrl-C, and those it starts would, too
    started = subprocess.Popen(
        words, **PIPES, preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL)
    )
    end = time.monotonic() + WAIT
    while (
        len(list(tmp_path.glob("snapshots/*.npz"))) < 5
        and started.poll() is None
        and time.monotonic() < end
    ):
        time.sleep(0.005)
    started.send_signal(signal.SIGINT)
    stdout, stderr = started.communicate(timeout=WAIT)
    assert started.returncode == 130, stdout + stderr
    assert (
        stderr
        == "interrupted: answers that were done are kept, and the same command goes on from there\n"
    )
    kept = len(list(tmp_path.glob("snapshots/*.npz")))
    assert (
        5 <= kept < 128
        and not list(tmp_path.glob("snapshots/*.part"))
        and not (tmp_path / "hhr.npz").exists()
    )
    again = run(*words[3:])
    assert again.returncode == 0 and f"{kept} of 228 answers were read" in again.stdout, (
        again.stdout + again.stderr
    )


@needs("exact_errors")
def test_scene_and_model_answer_alike(file, full):
    code, output = invoke("solve", DEMO, *AT)
    exact, answer = told(output), full.solve(POINT)
    assert code == 0
    pairs, forces = full.problem.contact_pairs, answer.forces()
    places = "0 of roller_round, spring_top", "1 of stop_round, spring_bottom"
    sums = [exact.pop(f"sum of the forces of contact {place} [N/mm]") for place in places]
    assert sums == pytest.approx([forces[pairs == number].sum() for number in (0, 1)], rel=1e-5)
    largest = np.linalg.norm(answer.displacement().reshape(-1, 2), axis=1).max()
    assert exact["largest displacement [mm]"] == pytest.approx(largest, rel=1e-5)
    assert exact["active contacts"] == (forces > 0).sum()
    force = answer.outputs().values["force on the roller"]
    assert exact["force on the roller [N/mm]"] == pytest.approx(force, rel=1e-5)
    code, output = invoke("solve", file, "--at", "lowered = 0.1", "--at", "travel=5e-1,")
    found = told(output)
    bounds = [
        f"bound of {name}" for name in ("displacement", "forces", "pressure", "forces in energy")
    ]
    assert code == 0 and max(found.pop(name) for name in bounds) < 0.05
    # a file says neither units nor which force belongs to which contact
    exact["largest displacement"] = exact.pop("largest displacement [mm]")
    exact["sum of the forces of all contacts"] = sum(sums)
    assert found == pytest.approx(exact, rel=1e-4)


@needs("plots")
@pytest.mark.parametrize("ending", [".vtu", ".vtkhdf"])
def test_fields_are_those_of_the_answer(ending, tmp_path, full):
    pyvista = pytest.importorskip("pyvista")
    path = tmp_path / "a folder" / f"fields of it{ending}"
    code, output = invoke("solve", DEMO, *AT, "--out", path)
    assert code == 0 and [item.name for item in path.parent.iterdir()] == [path.name], output
    found = pyvista.read(path).point_data["displacement"][:, :2]
    np.testing.assert_allclose(
        found, full.solve(POINT).displacement().reshape(-1, 2), rtol=1e-10, atol=1e-14
    )


def questions(path, header, rows):
    with open(path, "w", newline="", encoding="utf-8-sig") as file:
        csv.writer(file).writerows([header, *rows])
    return path


def columns_of(path):
    if path.suffix == ".parquet":
        from pyarrow import parquet

        return parquet.read_table(path).to_pydict()
    with open(path, newline="", encoding="utf-8") as file:
        head, *rows = csv.reader(file)
    return {name: [row[k] for row in rows] for k, name in enumerate(head)}


def questions_in_parquet(path, **columns):
    pyarrow = pytest.importorskip("pyarrow")
    pytest.importorskip("pyarrow.parquet").write_table(pyarrow.table(columns), path)
    return path


@needs("tables")
def test_tables_of_text_and_parquet_have_the_numbers_of_the_model(file, model, tmp_path):
    points = model.parameters.random(7, seed=3)
    # columns in another order, one more, a byte order mark, and a space in the name
    text = questions(
        tmp_path / "my questions.csv",
        ["lowered", "note", "travel"],
        [[b, "ä", a] for a, b in points],
    )
    held = questions_in_parquet(
        tmp_path / "q.parquet", note=["x"] * 7, lowered=points[:, 1], travel=points[:, 0]
    )
    for given, out in ((text, tmp_path / "a.csv"), (held, tmp_path / "b" / "a.parquet")):
        code, output = invoke("answer", file, given, "--out", out)
        assert code == 0 and "7 answers and 0 bad rows" in output, output
    found, other = columns_of(tmp_path / "a.csv"), columns_of(tmp_path / "b" / "a.parquet")
    assert list(found) == list(other) and found["status"] == other["status"] == ["ok"] * 7
    assert other["travel"] == points[:, 0].tolist()
    for k, point in enumerate(points):
        answer = model.solve(point)
        forces = [other[f"force_{place}"][k] for place in range(86)]
        np.testing.assert_allclose(forces, answer.forces(), rtol=1e-9, atol=1e-9)
        assert float(found["lowered"][k]) == point[1]
        assert other["force on the roller [N/mm]"][k] == pytest.approx(
            answer.outputs().values["force on the roller"]
        )
    for name in set(found) - {"status"}:
        np.testing.assert_allclose(
            np.array(found[name], dtype=float), other[name], rtol=1e-11, atol=1e-12
        )


@needs("tables")
def test_rows_that_have_no_answer_do_not_stop_the_others(file, tmp_path):
    """In Parquet; tests/core/test_files.py has them in text."""
    travel = [0.5, None, 9.0, float("nan"), 0.6]
    given = questions_in_parquet(tmp_path / "q.parquet", travel=travel, lowered=[0.1] * 5)
    code, output = invoke("answer", file, given, "--out", tmp_path / "a.parquet")
    found = columns_of(tmp_path / "a.parquet")
    assert code == 1 and "2 answers and 3 bad rows" in output and "travel = 9 is outside" in output
    assert [status == "ok" for status in found["status"]] == [1, 0, 0, 0, 1]
    assert found["total_force"][1] is None and found["total_force"][0] > 0
    given = questions_in_parquet(tmp_path / "t.parquet", travel=["0.5", "it's"], lowered=[0, 0])
    code, output = invoke("answer", file, given, "--out", tmp_path / "t.csv")
    assert code == 1 and columns_of(tmp_path / "t.csv")["travel"] == ["0.5", "it's"]


@needs("tables")
def test_tables_without_rows_have_a_header_of_answers(file, tmp_path):
    given = questions(tmp_path / "none.csv", ["travel", "lowered"], [])
    for ending in (".csv", ".parquet"):
        code, output = invoke("answer", file, given, "--out", tmp_path / f"a{ending}")
        assert code == 0 and "0 answers and 0 bad rows" in output
    assert columns_of(tmp_path / "a.csv")["total_force"] == []
    assert invoke("answer", file, tmp_path / "a.parquet", "--out", tmp_path / "b.csv")[0] == 0
    assert (tmp_path / "b.csv").read_text() == (tmp_path / "a.csv").read_text()


@needs("ranks", "studies", "tables")
def test_two_ranks_answer_as_one(trained, file, tmp_path):
    found = run_program(2, [*PROGRAM, "train", DEMO, *TRAIN[2:], "--out", str(tmp_path / "of two")])
    assert found.returncode == 0, found.stdout + found.stderr
    assert found.stdout.count("snapshots: ") == 1 and found.stdout.count("model: ") == 1
    assert found.stderr.count("warning: ") == trained[1].stderr.count("warning: ")
    points = [[0.2, 0.0], [0.5, 0.1], [0.9, 0.1], [7, 0.1], [0.33, 0.29]]
    given = questions(tmp_path / "q.csv", ["travel", "lowered"], points)
    code, _ = invoke("answer", file, given, "--out", tmp_path / "one.csv")
    words = [
        "answer",
        str(tmp_path / "of two" / "hhr.npz"),
        str(given),
        "--out",
        str(tmp_path / "two.csv"),
    ]
    found = run_program(2, [*PROGRAM, *words])
    assert (
        code == found.returncode == 1 and "4 answers and 1 bad rows on 2 ranks" in found.stdout
    ), found.stderr
    one, two = (columns_of(tmp_path / name) for name in ("one.csv", "two.csv"))
    assert one.keys() == two.keys() and one["status"] == two["status"]
    for name in set(one) - {"status"}:
        if not name.startswith(("bound", "indicator")):
            values = [
                np.array([cell or "nan" for cell in found[name]], dtype=float)
                for found in (one, two)
            ]
            np.testing.assert_allclose(*values, rtol=1e-7, atol=1e-7, err_msg=name)


@needs("ranks")
def test_ranks_refuse_as_one(tmp_path):
    found = run_program(2, [*PROGRAM, "train", str(tmp_path / "no.py")])
    assert found.returncode == 3 and found.stderr.count("error: there is no file") == 1


@needs("studies")
def test_a_study_has_a_page(tmp_path):
    found = run("study", DEMO, "--sobol", "12", "--tests", "6", "--queries", "6", "--out", tmp_path)
    assert found.returncode == 0, found.stderr
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert (
        page.count("<img ") == len(list(tmp_path.glob("*.png"))) == 3
        and (tmp_path / "study.npz").exists()
    )
    (tmp_path / "report.html").unlink()
    code, output = invoke("report", tmp_path)
    assert code == 0 and output == f"{tmp_path / 'report.html'}\n"
    assert (tmp_path / "report.html").read_text(encoding="utf-8") == page


@needs("plots")
def test_a_check_draws_and_finds(tmp_path):
    code, output = invoke("check", DEMO, "--at", "travel=1", "--picture", tmp_path / "it.png")
    assert (
        code == 0
        and "body 'spring': 1520 cells" in output
        and "displacements hold every body" in output
    )
    assert (tmp_path / "it.png").read_bytes().startswith(b"\x89PNG")
    (tmp_path / "wrong.py").write_text(
        "from dataclasses import replace\nimport hhr_dolfinx as hhr\nimport your_scene\n"
        "pair = hhr.NodeToSurface('roller_rund', 'spring_top')\n"
        "scene = replace(your_scene.scene(), openings=(), outputs=(), contacts=(pair,))\n"
    )
    code, output = invoke("check", tmp_path / "wrong.py", "--picture", tmp_path / "wrong.png")
    assert code == 1 and "mistake" in output and "roller_r" in output
    (tmp_path / "refused.py").write_text(
        (tmp_path / "wrong.py").read_text().replace("openings=(), ", "")
    )
    code, output = invoke("check", tmp_path / "refused.py")
    assert code == 3 and "error: refused.py, line 5: an opening names contact 1" in output


def test_lists():
    code, output = invoke("list")
    assert (
        code == 0 and "  NodeToNode (hhr_dolfinx)\n" in output and "  steel: E = 210 GPa" in output
    )
    for kind, name in (("loads", "Pressure"), ("outputs", "ContactForce"), ("samplings", "Sobol")):
        assert f"{kind}:\n" in output and f"  {name} (hhr_dolfinx)\n" in invoke("list", kind)[1]
    if present("inelastic"):
        assert (
            "laws:\n  Arrhenius (inelastic)\n  Chaboche (inelastic)\n" in invoke("list", "laws")[1]
        )


FILES = {
    "late.py": "def scene():\n    return 1 / 0\n",
    "three.py": "scene = 3\n",
    "needs.py": "def scene(mesh, *, size=1):\n    pass\n",
    "settings.py": "from your_scene import scene\nSETTINGS = {'training': 3}\n",
    "view.py": "from your_scene import scene\nVIEW = 'nice'\n",
    "views.py": "from your_scene import scene\ndef VIEW(size): pass\n",
    "geometry.py": "from dataclasses import replace\nimport your_scene\ndef mine(comm):\n"
    "    raise ValueError('none')\n"
    "scene = replace(your_scene.scene(), geometry=mine)\n",
    "stops.py": "from dataclasses import replace\nimport your_scene\ndef mine(comm):\n"
    "    raise KeyboardInterrupt\n"
    "scene = replace(your_scene.scene(), geometry=mine)\n",
    "file": "",
    "broken.npz": "abc",
    "half.csv": "travel;low\n0,5;0,1\n",
    "book.ods": "PK",
    "one.csv": "load\n1\n",
    "good.csv": "travel,lowered\n0.5,0.1\n",
    "latin.csv": b"travel,lowered\n\xe4,1\n",
    "bad.parquet": "abc",
}
WRONG_SETTINGS = (
    "must be hhr.StudySettings, and is dict"
    if present("studies")
    else "needs the plug-in 'studies'"
)
MISTAKES = [
    (2, "Usage: hhr", []),
    (2, "No such command 'solv'", ["solv"]),
    (2, "Missing argument 'SCENE'", ["check"]),
    (3, "there is no file", ["check", "no.py"]),
    (3, "folder is a folder, and a mesh is a file", ["check", "folder"]),
    (3, "late.py, line 2: ZeroDivisionError", ["check", "late.py"]),
    (3, "three.py is int and no Scene", ["check", "three.py"]),
    (3, "the function needs mesh;", ["solve", "needs.py"]),
    (3, "geometry.py, line 4: ValueError: none", ["solve", "geometry.py", *AT]),
    (3, f"SETTINGS beside settings.py {WRONG_SETTINGS}", ["train", "settings.py"]),
    (3, "VIEW beside view.py must be hhr.View, and is str", ["study", "view.py"]),
    (3, "VIEW beside views.py needs size; give them defaults", ["study", "views.py"]),
    (130, "interrupted\n", ["check", "stops.py"]),
    (130, "interrupted: answers that were done are kept", ["train", "stops.py", "--sobol", "4"]),
    (3, "there is no model file no.npz", ["solve", "no.npz", *AT]),
    (3, "broken.npz is damaged", ["solve", "broken.npz", *AT]),
    (3, "no value is given for lowered in [0, 0.3]", ["solve", "MODEL", "--at", "travel=0.5"]),
    (3, "no value is given for travel in [0.05, 1], lowered", ["solve", "MODEL"]),
    (3, "'travel' is there twice", ["solve", "MODEL", *AT, "--at", "travel=0.5"]),
    (3, "'load' is no parameter", ["solve", "MODEL", "--at", "load=1"]),
    (3, "'travel' gives no parameter a number", ["solve", "MODEL", "--at", "travel"]),
    (3, "'travel=a' gives", ["solve", "MODEL", "--at", "travel=a"]),
    (
        3,
        "'5' gives no parameter a number: write --at travel=0.5, with a dec",
        ["solve", "MODEL", "--at", "travel=0,5"],
    ),
    (
        3,
        "travel = nan is not finite: give a number",
        ["solve", "MODEL", "--at", "travel=nan,lowered=0"],
    ),
    (3, "travel = 4 is outside", ["solve", "MODEL", "--at", "travel=4,lowered=0"]),
    (2, "--scene has the mesh for the --out", ["solve", "MODEL", *AT, "--scene", SPRING]),
    (
        2,
        "--scene has the mesh for the --out",
        ["solve", DEMO, *AT, "--scene", SPRING, "--out", "a.vtu"],
    ),
    (2, "all bodies are elastic", ["solve", "MODEL", *AT, "--duration", "2"]),
    (3, "no parameter", ["check", DEMO, "--at", "travl=0.5"]),
    (3, "must end in .vtkhdf or .vtu", ["solve", DEMO, *AT, "--out", "a.pvd"]),
    (3, "folder.vtu is a folder", ["solve", DEMO, *AT, "--out", "folder.vtu"]),
    (3, "a file stands where a folder is needed", ["solve", DEMO, *AT, "--out", "file/a.vtu"]),
    (3, "file is a file", ["train", SPRING, "--out", "file"]),
    (2, "give one of --grid, --sobol", ["train", SPRING, "--sobol", "4", "--grid", "2,2"]),
    (2, "--budget belongs to --greedy", ["study", DEMO, "--budget", "4"]),
    (2, "--grid 4;4 must be counts", ["train", SPRING, "--grid", "4;4"]),
    (3, "tolerance = nan", ["train", SPRING, "--greedy", "nan"]),
    *(
        (2, "is no part: write 3/8", ["train", SPRING, "--part", part])
        for part in ("0/3", "4/3", "x", "1/2/3", "1")
    ),
    (2, "holds the questions", ["answer", "MODEL", "good.csv", "--out", "good.csv"]),
    (3, "there is no table", ["answer", "MODEL", "no.csv"]),
    (3, "there is no table", ["answer", "MODEL", "no.parquet"]),
    (3, "bad.parquet cannot be read as Parquet", ["answer", "MODEL", "bad.parquet"]),
    (3, "latin.csv cannot be read as a table of UTF-8", ["answer", "MODEL", "latin.csv"]),
    (3, "half.csv has no column ['lowered'] or has it twice", ["answer", "MODEL", "half.csv"]),
    (3, "one.csv has no column", ["answer", "MODEL", "one.csv"]),
    (
        3,
        "book.ods is a workbook of a spreadsheet: save its table as CSV",
        ["answer", "MODEL", "book.ods"],
    ),
    (3, "good.csv is a table and no model: the model comes first", ["answer", "good.csv", "MODEL"]),
    (3, "folder is a folder, and a model is a file\n", ["solve", "folder", *AT]),
    (3, "is a folder, and a model is a file: did you mean ", ["answer", "FOLDER", "good.csv"]),
    (3, "there is no model file ", ["page", "FOLDER/condensed.npz"]),
    (3, "hhr.npz?\n", ["page", "FOLDER/condensed.npz"]),
    (3, "folder cannot be read", ["answer", "MODEL", "folder"]),
    (3, "must end in .csv or .parquet", ["answer", "MODEL", "good.csv", "--out", "a.xlsx"]),
    (3, "folder.csv is a folder", ["answer", "MODEL", "good.csv", "--out", "folder.csv"]),
    (3, "it.txt must end in .png or .pdf or .svg", ["check", DEMO, "--picture", "it.txt"]),
    (3, "/proc/it.png cannot be written", ["check", DEMO, "--picture", "/proc/it.png"]),
    (3, "/proc/it.vtu cannot be written", ["solve", DEMO, *AT, "--out", "/proc/it.vtu"]),
    (3, "/proc/it.inp cannot be written", ["export", DEMO, *AT, "--out", "/proc/it.inp"]),
    (
        3,
        "file cannot be made (File exists): a file stands where",
        ["export", DEMO, *AT, "--out", "file/it.inp"],
    ),
    (3, "must end in .inp", ["export", DEMO, *AT, "--out", "a.txt"]),
    (2, "Missing option '--out'", ["export", DEMO, *AT]),
    (3, "there is no report", ["report", "folder"]),
    (2, "there are no pairing: kinds are", ["list", "pairing"]),
]
ABSENT = set() if present("greedy") else {"--greedy", "--budget"}
MISTAKES = [
    row
    for row in MISTAKES
    if (*row[2], "")[0] in {"", "solv", *COMMANDS} and not ABSENT & {*row[2]}
]


@pytest.mark.parametrize("made", ["{'training': 3}", "lambda: hhr.StudySettings([3])"])
def test_settings_need_the_plug_in_of_studies(made, tmp_path, monkeypatch):
    (tmp_path / "mine.py").write_text(
        f"import hhr_dolfinx as hhr\nfrom your_scene import scene\nSETTINGS = {made}\n"
    )
    monkeypatch.setattr(registry, "offered", lambda word: None)
    code, output = invoke("train", tmp_path / "mine.py")
    assert (
        code == 3
        and "no installed plug-in reads the SETTINGS beside" in output
        and "mine.py" in output
    )


def contents():
    """All that lies in this folder, by its path."""
    paths = [path for path in Path().rglob("*") if "__pycache__" not in str(path)]
    return {path: path.is_file() and path.read_bytes() for path in paths}


@pytest.mark.parametrize(
    ("code", "said", "words"),
    MISTAKES,
    ids=lambda item: " ".join(item)[-60:] if isinstance(item, list) else "",
)
def test_mistakes_end_in_a_sentence(code, said, words, trained, tmp_path, monkeypatch):
    """And leave all files as they were."""
    monkeypatch.chdir(tmp_path)
    for name, text in FILES.items():
        Path(name).write_bytes(text.encode() if isinstance(text, str) else text)
    for name in ("folder", "folder.vtu", "folder.csv"):
        Path(name).mkdir()
    before, folder = contents(), trained[0]
    places = {
        "MODEL": folder / "hhr.npz",
        "FOLDER": folder,
        "FOLDER/condensed.npz": folder / "condensed.npz",
    }
    found, output = invoke(*(places.get(word, word) for word in words))
    assert found == code and said in output, output
    assert code not in (2, 3) or contents() == before


def test_messages_name_options_that_are_there():
    """What an error or a warning advises must exist.

    Options of other programs stand beside their names.
    """
    commands = command, *(command.get_command(None, name) for name in COMMANDS)
    known = {
        word
        for one in commands
        for item in one.params
        for word in (*item.opts, *item.secondary_opts)
    }
    # the last ones are those of demos, and of the programs mfront and clang
    known |= {"--no-entry", "--strip-all"}
    known |= {"--user", "--help", "--quick", "--batch", "--cells", "--order", "--interface"}
    for path in Path(hhr.__file__).parent.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                named = set(re.findall(r"(?<![\w-])--[a-z][a-z-]+", node.value))
                assert named <= known, (path.name, node.lineno, named)


@needs("pages", "exporters", "um_bridge", "inelastic", "tables")
def test_models_with_a_law_of_a_users_own(tmp_path, monkeypatch):
    """A file holds it as a program, without its class, and so does a header of C.

    A page needs the geometry.
    """
    from toy_law import Bingham

    from hhr_dolfinx.plugins.inelastic.condense_flow import CorrectionSettings

    scene = contract.blocks(law=Bingham(0.03, 0.5))
    training = hhr.train(
        scene, [contract.path(top) for top in (0.02, 0.05)], held_out=[contract.path(0.04)]
    )
    # one step from rest is faster than what was trained, and no subject here
    model = training.condense(CorrectionSettings(primal=1.0, dual=1.0)).changed(trained=None)
    monkeypatch.chdir(tmp_path)
    hhr.save_model("model.npz", model)
    Path("q.csv").write_text("push,load\n0.04,0.02\n")
    known = model.solve([0.04, 0.02], duration=1.0, outside="ignore").outputs()["force"]
    ask = {"solve": ["--at", "push=0.04,load=0.02"], "answer": ["q.csv"]}
    ask |= {"page": [], "embed": ["--out", "a.h"], "serve": ["--host", "192.0.2.1"]}
    found = {name: invoke(name, "model.npz", *words) for name, words in ask.items()}
    (value,) = re.findall(
        r"^force: (\S+)$", found["solve"][1], re.MULTILINE
    )  # beside warnings of the large step
    assert found["solve"][0] == 0 and float(value) == pytest.approx(
        known, rel=1e-5
    )  # six digits are printed
    assert found["page"][0] == 3 and "no scenery.npz beside model.npz" in found["page"][1]
    assert found["embed"][0] == 0 and "_solve" in Path("a.h").read_text()
    assert found["serve"][0] == 3 and "cannot be served" in found["serve"][1]
    assert found["answer"][0] == 0
    (row,) = csv.DictReader(Path("answers.csv").read_text().splitlines())
    assert float(row["force"]) == pytest.approx(known, rel=1e-10)


def test_without_click_the_command_says_so_in_one_line():
    program = (
        "import sys; sys.modules['click'] = None; from hhr_dolfinx.command.start import main; "
        "main()"
    )
    found = python("-c", program, code=3)
    why = (
        "the command hhr needs the package click, which is not installed: `pip install "
        "hhr_dolfinx[study]`"
    )
    assert (found.stdout, found.stderr) == ("", f"error: {why}\n")
    scripts = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())["project"][
        "scripts"
    ]
    assert scripts == {"hhr": "hhr_dolfinx.command.start:main"}


@needs("tables")
def test_columns_of_forces_may_stay_out(file, model, tmp_path):
    """Eighty-six of them are no table to read; all other columns are the same."""
    given = questions(tmp_path / "q.csv", ["travel", "lowered"], [[0.5, 0.1], [0.6, 0.1]])
    for name, words in (("all.csv", []), ("few.csv", ["--no-forces"])):
        assert invoke("answer", file, given, "--out", tmp_path / name, *words)[0] == 0
    whole, few = (columns_of(tmp_path / name) for name in ("all.csv", "few.csv"))
    forces = [f"force_{k}" for k in range(model.conditions)]
    assert list(whole) == [*few, *forces] and "total_force" in few and whole.items() >= few.items()


def test_a_fault_of_the_program_keeps_its_traceback(monkeypatch):
    monkeypatch.setattr(
        "hhr_dolfinx.command.loading.scene_of", Mock(side_effect=RuntimeError("a fault"))
    )
    found = CliRunner().invoke(command, ["solve", DEMO, *AT])
    assert isinstance(found.exception, RuntimeError) and found.exit_code == 1


@pytest.mark.parametrize(
    "words",
    [["list"], pytest.param(["check", DEMO, "--picture", "it.png"], marks=needs("plots"))],
    ids=lambda w: w[0],
)
def test_a_reader_that_has_seen_enough_is_no_crash(words, tmp_path):
    with subprocess.Popen([sys.executable, *PROGRAM, *words], cwd=tmp_path, **PIPES) as started:
        started.stdout.close()
        assert started.stderr.read() == "" and started.wait(60) == 1


@needs("tables")
def test_parts_of_a_training_and_of_a_table(tmp_path):
    """Jobs of an array share a folder, and the same command without a part builds.

    Blocks of a table lie apart.
    """
    folder = tmp_path / "out"
    for part, count in (("2", 27), ("1", 27), ("3", 26)):
        code, output = invoke(*TRAIN, "--out", folder, "--part", f"{part}/3")
        said = f"part {part} of 3: 4 training queries and {count} held out"
        assert code == 0 and said in output.replace("\n", " ")
    assert not (folder / "hhr.npz").exists()
    found = run(
        *TRAIN, "--out", folder
    )  # 12 answers are too few for a good model, which it warns of
    assert found.returncode == 0 and "92 of 112 answers were read" in found.stdout.replace(
        "\n", " "
    )
    points = hhr.load_model(folder / "hhr.npz").parameters.random(5, seed=3)
    table = questions(tmp_path / "q.csv", ["travel", "lowered"], points)
    found = []
    for part in (1, 2):
        code, output = invoke(
            "answer", folder / "hhr.npz", table, "--out", tmp_path / "a.csv", "--part", f"{part}/2"
        )
        assert code == 0, output
        found += columns_of(tmp_path / f"a.{part}of2.csv")["travel"]
    assert [float(value) for value in found] == points[:, 0].tolist()
