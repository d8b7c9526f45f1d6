"""The command hhr as tests call it."""

import os
from pathlib import Path

from click.testing import CliRunner
from processes import python

from hhr_dolfinx.command.main import hhr as command

DEMO = str(Path(__file__).parents[2] / "demos" / "your_scene.py")
SPRING = "your_scene:scene"
"""Its scene, without its settings of studies."""
PROGRAM = ["-m", "hhr_dolfinx.command.main"]
POINT = {"travel": 0.5, "lowered": 0.1}
AT = ["--at", "travel=0.5,lowered=0.1"]
TRAIN = ["train", SPRING, "--sobol", "12"]
ENVIRONMENT = {name: value for name, value in os.environ.items() if name != "FORCE_COLOR"} | {
    "OMP_NUM_THREADS": "1",
    "PYTHONPATH": os.pathsep.join(
        filter(None, [str(Path(DEMO).parent), os.environ.get("PYTHONPATH")])
    ),
}


def invoke(*words):
    """A command in this process: its exit code, and all that it said."""
    result = CliRunner().invoke(command, [str(word) for word in words], prog_name="hhr")
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exc_info
    assert "Traceback" not in result.output
    return result.exit_code, result.output


def run(*words, cwd=None):
    """A command in a process of its own, whose output is a pipe."""
    found = python(*PROGRAM, *words, code=None, cwd=cwd, env=ENVIRONMENT)
    for text in (found.stdout, found.stderr):
        assert "\x1b" not in text and "\r" not in text and "Traceback" not in text, text
    return found
