"""What a newcomer meets first: output in a file and on a terminal, folders that cannot be written,
the set-up.
"""

import fcntl
import os
import pty
import re
import struct
import subprocess
import sys
import termios
from pathlib import Path
from unittest.mock import Mock

import pytest
from mpirun import launch
from needs import needs
from processes import WAIT, python

from hhr_dolfinx.solver_first import COPY, install_for_all

ROOT = Path(__file__).parents[2]
LONG = "word " * 60 + "end"
SPEAKS = f"""
import sys
sys.path.append({str(ROOT / "demos")!r})
from parts import cli
options = cli.parse(cli.demo_parser("talk", "A demo that only talks."))
for label in ("snapshots", "held out"):
    assert list(options.progress(label)(range(3))) == [0, 1, 2]
assert list(options.progress("lazy")(iter("ab"))) == ["a", "b"]
options.console.print({LONG!r})
row = {{"case": "a", "why": "long " * 30, "what": "longer " * 20}}
cli.print_rows("cases", [row], options.console)
"""


def wishing(**wishes):
    """What is around a program, with no wishes for its output but these."""
    unasked = "COLUMNS", "LINES", "FORCE_COLOR", "NO_COLOR", "TTY_COMPATIBLE"
    return {key: value for key, value in os.environ.items() if key not in unasked} | wishes


def run_talk(folder, *out, code=0, **how):
    return python(
        "-c",
        SPEAKS,
        *(word for name in out for word in ("--out", name)),
        code=code,
        cwd=folder,
        **how,
    )


@needs("studies")
@pytest.mark.parametrize(
    "wishes", [{}, {"TERM": "dumb"}, {"COLUMNS": "40"}, {"FORCE_COLOR": "1", "TERM": "dumb"}]
)
def test_output_in_a_file_is_whole_lines(tmp_path, wishes):
    """No blank lines, nothing wrapped, nothing that moves a cursor.

    Colours only where they are asked for.
    """
    run = run_talk(tmp_path, env=wishing(**wishes))
    plain = re.sub(r"\x1b\[[\d;]*m", "", run.stdout)
    assert plain == run.stdout or "FORCE_COLOR" in wishes
    assert "\x1b" not in plain and "\r" not in plain
    lines = plain.splitlines()
    assert lines[:4] == ["snapshots: 3 to do", "held out: 3 to do", "lazy", LONG]
    assert lines[4].strip() == "cases"
    # head, one row and three rules: each is one line
    assert len(lines[5:]) == 5 and len({len(line) for line in lines[5:]}) == 1


@needs("studies")
def test_a_terminal_gets_bars_and_its_own_width(tmp_path):
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 30, 60, 0, 0))
    ends = {"stdin": theirs, "stdout": theirs, "stderr": theirs}
    run = subprocess.Popen(
        [sys.executable, "-c", SPEAKS], **ends, cwd=tmp_path, env=wishing(TERM="xterm")
    )
    os.close(theirs)
    text = b""
    try:
        while part := os.read(ours, 4096):
            text += part
    except OSError:  # Linux says so where the other end is closed
        pass
    os.close(ours)
    assert run.wait(60) == 0, text
    shown = text.decode()
    assert "\x1b[2K" in shown and "snapshots" in shown  # a bar, and its line cleared
    assert "3 to do" not in shown
    words = [
        line
        for line in re.sub(r"\x1b\[[?\d;]*[a-zA-Z]", "", shown).splitlines()
        if "word word" in line
    ]
    assert len(words) > 4 and max(map(len, words)) <= 60


@needs("studies")
def test_a_folder_that_cannot_be_made_ends_at_once(tmp_path):
    """And nothing stays of the trial in one that can."""
    (tmp_path / "file").write_text("")
    for out in ("file", "file/results"):
        run = run_talk(tmp_path, out, code=2)
        assert not run.stdout
        said = run.stderr.splitlines()[-1]
        assert f"--out {out}: results cannot be written" in said and "Name another folder" in said
        assert "Traceback" not in run.stderr
    run_talk(tmp_path, "results/deep")
    assert not any((tmp_path / "results/deep").iterdir())


@needs("studies")
def test_a_folder_of_somebody_else_ends_at_once(tmp_path, monkeypatch, capsys):
    """The system's refusal is played, for nothing is refused to root; whose the folder is, is
    true.
    """
    from parts import cli

    out = tmp_path / "mounted" / "out"
    out.mkdir(parents=True)
    refuse = Mock(side_effect=PermissionError(13, "Permission denied"))
    monkeypatch.setattr(cli.tempfile, "NamedTemporaryFile", refuse)
    monkeypatch.setattr(sys, "argv", ["talk", "--out", str(out)])
    with pytest.raises(SystemExit) as end:
        cli.parse(cli.demo_parser("talk", "A demo that only talks."))
    assert end.value.code == 2
    said = capsys.readouterr().err
    assert f"{out} belongs to user {os.getuid()}, this is user {os.geteuid()}" in said
    assert "mkdir -p out" in said and '--user "$(id -u):$(id -g)"' in said


@needs("ranks", "studies")
def test_on_two_ranks_one_speaks_and_both_end(tmp_path):
    """The first rank alone tries the folder.

    The other must not wait, nor go on, nor repeat what was said.
    """
    program = (
        "import contextlib, sys\n"
        f"sys.path.append({str(ROOT / 'demos')!r})\n"
        "from parts import cli\n"
        "with contextlib.redirect_stderr(sys.stdout):\n"
        "    for out in ('good', 'file'):\n"
        "        sys.argv[1:] = ['--out', out]\n"
        "        try:\n"
        "            options = cli.parse(cli.demo_parser('talk', 'A demo that only talks.'))\n"
        "            options.console.print('folder is good')\n"
        "        except SystemExit as end:\n"
        # in one piece, or what the ranks say gets mixed
        "            sys.stdout.write(f'ended with {end.code}\\n')\n"
        "            sys.stdout.flush()\n"
    )
    (tmp_path / "file").write_text("")
    printed = launch(2, ["-c", program], cwd=tmp_path)
    assert printed.count("folder is good") == 1
    assert printed.count("results cannot be written") == 1 and printed.count("ended with 2") == 2


def packages(text):
    """Names of Debian packages behind the first ``apt-get install -y`` or ``packages=`` in a text,
    options left out.
    """
    names = re.search(r'(?:apt-get install -y|packages=")([^"`&$]*)', text.replace("\\\n", " "))[1]
    return {name for name in names.split() if not name.startswith("-")}


def test_one_list_of_system_packages():
    """README and image install what the set-up looks for, and continuous integration what tests ask
    besides.
    """
    script = (ROOT / "scripts/setup.sh").read_text()
    libraries = set(re.findall(r"^ +need_library \S+ (\S+)$", script, re.MULTILINE))
    wanted = libraries | set(re.findall(r'missing="\$missing (\S+)"', script))
    wanted = {name for name in wanted if name != "$2"} | {"make"}
    asked_by_tests = {"nodejs", "node-jsdom", "chromium", "calculix-ccx"}
    assert asked_by_tests < wanted and len(wanted) == 15
    (row,) = [
        line
        for line in (ROOT / "README.md").read_text().splitlines()
        if line.startswith("| Debian 13, Ubuntu")
    ]
    assert packages(row) == wanted - asked_by_tests
    assert (
        packages((ROOT / "Dockerfile").read_text()) - {"ca-certificates", "python3"}
        == wanted - asked_by_tests
    )
    integration = (ROOT / ".ci/run").read_text()
    assert packages(integration) == wanted - asked_by_tests
    assert all(f" {name}" in integration for name in asked_by_tests)


def set_up(folder):
    """``scripts/setup.sh`` of a copy of a project, with the Python that lies in it."""
    environment = os.environ | {"PYTHON": str(folder / "python"), "HOME": str(folder)}
    command = ["sh", folder / "scripts/setup.sh"]
    return subprocess.run(command, capture_output=True, text=True, env=environment, timeout=WAIT)


def fake_set_up(folder, pip: str) -> subprocess.CompletedProcess:
    (folder / "scripts").mkdir()
    (folder / "pyproject.toml").write_text("")
    (folder / "scripts/setup.sh").write_text((ROOT / "scripts/setup.sh").read_text())
    (folder / "python").write_text(
        "#!/bin/sh\n"
        f'case "$*" in *pip*install*) {pip} ;;\n'
        f'*"-m venv"*) for last; do :; done; mkdir -p "$last/bin"; cp "$0" "$last/bin/python" ;;\n'
        f'*sysconfig*) exec "{sys.executable}" "$@" ;;\n'
        "*) exit 0 ;; esac\n"
    )
    (folder / "python").chmod(0o755)
    return set_up(folder)


def test_set_up_says_what_it_does(tmp_path):
    pip = (
        "echo Collecting vtk; echo '  Downloading vtk-9.whl (112.3 MB)'; echo 'Downloading "
        "tiny-1.whl (11 kB)'; echo 'Installing collected packages: tiny, vtk'; exit 0"
    )
    run = fake_set_up(tmp_path, pip)
    assert run.returncode == 0, run.stderr
    lines = run.stderr.splitlines()
    steps = [line for line in lines if line.startswith("Set-up")]
    assert [line[:13] for line in steps] == [f"Set-up {k} of 3" for k in (1, 2, 3)]
    assert "    Downloading vtk-9.whl (112.3 MB)" in lines and not any(
        "tiny-1" in line for line in lines
    )
    assert re.fullmatch(r"Set up in \d+ s: \d+ MB in .venv", lines[-1])
    assert (
        "\r" not in run.stderr and "\x1b" not in run.stderr and all(line.strip() for line in lines)
    )
    assert "Collecting vtk" in (tmp_path / ".venv/pip.log").read_text()
    again = set_up(tmp_path)
    assert again.returncode == 0 and not again.stderr


def test_set_up_that_fails_says_so(tmp_path):
    """pip's exit code passes its filter; a second call begins anew."""
    run = fake_set_up(tmp_path, "echo 'ERROR: No matching distribution found for vtk'; exit 7")
    assert run.returncode == 1
    assert (
        "pip could not install" in run.stderr
        and "No matching distribution found for vtk" in run.stderr
    )
    assert not (tmp_path / ".venv/.ready").exists()


def test_set_up_removes_no_environment_but_its_own(tmp_path):
    """People make a ``.venv`` of their own in a clone.

    One that a set-up has begun has its log from the start.
    """
    (tmp_path / ".venv").mkdir()
    (tmp_path / ".venv/pyvenv.cfg").write_text("mine")
    run = fake_set_up(tmp_path, "exit 0")
    assert run.returncode == 1 and ".venv was not made by this set-up" in run.stderr
    assert (tmp_path / ".venv/pyvenv.cfg").read_text() == "mine"
    (tmp_path / ".venv/pip.log").write_text("")
    again = set_up(tmp_path)
    assert again.returncode == 0, again.stderr
    assert not (tmp_path / ".venv/pyvenv.cfg").exists()


def test_readme_and_image_tell_the_same_commands():
    readme, image = ((ROOT / name).read_text() for name in ("README.md", "Dockerfile"))
    commands = re.findall(r"^#   (.+)$", image, re.MULTILINE)
    assert [command.split()[0] for command in commands] == ["docker", "mkdir", "docker"]
    assert f"| container | `{' && '.join(commands)}` |" in readme


def test_documentation_and_set_up_tell_the_same_sizes():
    readme, more, script = (
        (ROOT / name).read_text() for name in ("README.md", "docs/install.md", "scripts/setup.sh")
    )
    sizes = re.findall(r"([\d.]+ [MG]B) to download, ([\d.]+ [MG]B) on disk", script)
    assert len(sizes) == 2
    assert all(size in readme + more for pair in sizes for size in pair)


@pytest.mark.parametrize(
    ("version", "scalar", "good"),
    [("0.9.0", "float64", True), ("0.10.0.post1", "float64", True), ("0.8.0", "float64", False),
     ("0.9.0", "complex128", False)],
)  # fmt: skip
def test_which_dolfinx_the_set_up_takes(tmp_path, version, scalar, good):
    """One that is too old, or whose PETSc has complex numbers, is passed over before it ends in an
    error.
    """
    script = (ROOT / "scripts/setup.sh").read_text()
    (code,) = re.findall(r"\"\$1\" -c '(import importlib.*?)' >/dev/null", script, re.S)
    for name in ("dolfinx_solver", "mpi4py", "slepc4py"):
        (tmp_path / f"{name}.py").write_text("")
    (tmp_path / "dolfinx.py").write_text(f"__version__ = {version!r}\n")
    (tmp_path / "petsc4py.py").write_text(
        f"import numpy\nclass PETSc:\n    ScalarType = numpy.{scalar}\n"
    )
    run = python("-c", code, code=None, env=os.environ | {"PYTHONPATH": str(tmp_path)})
    assert (run.returncode == 0) == good and not run.stderr


def test_dolfinx_may_be_imported_first(tmp_path):
    """As import sorters have it; with the wheel it ended in "libmpi.so.12: cannot open shared
    object file".
    """
    install_for_all(tmp_path)
    program = (
        "import site, sys\n"
        "sys.meta_path[:] = [finder for finder in sys.meta_path if type(finder).__name__ != "
        f"'SolverFirst']\nsys.modules.pop({COPY!r}, "
        f"None)\nsite.addsitedir({str(tmp_path)!r})\nfrom dolfinx import mesh\nimport hhr_dolfinx "
        "as hhr\nprint(mesh.Mesh.__name__, issubclass(hhr.FullOrderModel, object))\n"
    )
    assert python("-c", program).stdout == "Mesh True\n"
