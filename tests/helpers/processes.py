"""Other processes of tests: folders in which they find scenes, and how they are run."""

import os
import subprocess
import sys
from pathlib import Path

WAIT = 1800
"""Seconds after which another process is held to hang.

Those of the tests take half a minute on an idle machine.
"""
_ROOT = Path(__file__).parents[2]
_SCRIPTS = "demos", "benchmarks", "benchmarks/thesis"
SCRIPT_FOLDERS = [str(_ROOT / name) for name in _SCRIPTS]
SCENE_FOLDERS = [str(_ROOT / name) for name in ("tests", "tests/helpers", *_SCRIPTS)]
"""Folders in which other processes find helpers of tests and scenes, as `pythonpath` of
`pyproject.toml` names them for pytest.
"""


def folders_of(file):
    """These folders, and that of a test whose process imports it, or a module beside it."""
    return [*SCENE_FOLDERS, str(Path(file).parent)]


def forget_own_folders():
    """Take folders of this checkout out of the shell's path of modules.

    They would hide that another process of a test does not find what it imports.
    """
    given = os.environ.pop("PYTHONPATH", "").split(os.pathsep)
    if kept := [name for name in given if name and _ROOT not in Path(name).resolve().parents]:
        os.environ["PYTHONPATH"] = os.pathsep.join(kept)


def python(*words, code=0, **how):
    """A Python in another process, which must end with ``code``; None for any."""
    command = [sys.executable, *map(str, words)]
    run = subprocess.run(command, capture_output=True, text=True, timeout=WAIT, **how)
    assert code in (None, run.returncode), run.stdout[-2000:] + run.stderr[-3000:]
    return run
