"""The checkout without a plug-in: what is deleted, and that the rest passes its tests."""

import runpy
import subprocess
import sys
from pathlib import Path

import pytest
from needs import needs

ROOT = Path(__file__).parents[2]
SCRIPT = ROOT / "scripts" / "without.py"
without = runpy.run_path(str(SCRIPT))


@needs("exporters", "pages")
def test_what_needs_a_deleted_plug_in_goes_with_it():
    """C headers are written from pages; the other way round pages are deleted alone."""
    assert "exporters" in without["deleted"](["pages"])
    assert "pages" not in without["deleted"](["exporters"])
    with pytest.raises(SystemExit, match="there is no plug-in nowhere"):
        without["deleted"](["nowhere"])


@pytest.mark.slow
@needs("pages", "studies", "friction")
@pytest.mark.parametrize("plugin", ["pages", "friction"])
def test_tests_of_the_rest_pass_without_a_plug_in(plugin):
    """Registry and names; `make without` runs all tests of the rest."""
    names = ("registry", "by_name")
    run_rest([plugin], [f"tests/core/test_{name}.py" for name in names])


@pytest.mark.slow
@needs("pages")
def test_the_core_passes_without_plug_ins():
    """The every-day tests of the core that need no plug-in, as `make test-core` selects them."""
    run_rest(["--all"], ["tests/core"])


def run_rest(gone, tests):
    """Run tests in a copy without some plug-ins.

    Raises:
        AssertionError: with the end of what they print, if they fail.
    """
    command = [
        sys.executable,
        str(SCRIPT),
        *gone,
        "--",
        "-q",
        "-m",
        "not slow and not needs",
        *tests,
    ]
    result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert result.returncode == 0, (result.stdout[-4000:], result.stderr[-2000:])
    assert " passed" in result.stdout
