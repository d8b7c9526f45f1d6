"""A skipped test is one that was not run: where nothing is optional it fails."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

TESTS = """
import pytest

def test_passes():
    pass

def test_of_a_tool():
    pytest.importorskip("no_such_tool")

@pytest.mark.skipif(True, reason="no browser is there")
def test_of_a_browser():
    pass

@pytest.fixture
def tool():
    pytest.skip("no compiler is there")

def test_of_a_fixture(tool):
    pass

@pytest.mark.xfail(reason="is known")
def test_of_what_is_known():
    raise AssertionError
"""
FILE = "import pytest\npytest.importorskip('no_such_package')\n"


@pytest.mark.parametrize("workers", ["0", "1"])
@pytest.mark.parametrize(("nothing_optional", "code"), [("1", 1), ("", 0)])
def test_skips_fail_where_nothing_is_optional(nothing_optional, code, workers, tmp_path):
    (tmp_path / "test_tools.py").write_text(TESTS)
    (tmp_path / "test_file.py").write_text(FILE)
    words = [sys.executable, "-m", "pytest", "-q", "-p", "no_skips", "-p", "no:cacheprovider", "-n", workers]
    words += ["-o", "addopts=", "--continue-on-collection-errors", "--rootdir", str(tmp_path), str(tmp_path)]
    # no other plugins of the tests around, which bring minutes of imports
    env = os.environ | {"HHR_CI": nothing_optional, "PYTHONPATH": str(Path(__file__).parents[1])}
    done = subprocess.run(words, capture_output=True, text=True, env=env, cwd=tmp_path)
    assert done.returncode == code, done.stdout
    assert "1 passed" in done.stdout and "1 xfailed" in done.stdout
    if nothing_optional:
        assert "1 failed" in done.stdout and "3 errors" in done.stdout
        for reason in ("no_such_tool", "no browser is there", "no compiler is there", "no_such_package"):
            assert reason in done.stdout
        assert "install what is missing" in done.stdout
    else:
        assert "4 skipped" in done.stdout and " failed" not in done.stdout
