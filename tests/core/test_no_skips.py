"""A skipped test is one that was not run: where nothing is optional it fails."""

import os
from pathlib import Path

import pytest
from processes import python

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
    words = [
        "-m",
        "pytest",
        "-q",
        "-p",
        "no_skips",
        "-p",
        "no:cacheprovider",
        "-n",
        workers,
        "-o",
        "addopts=",
    ]
    words += ["--continue-on-collection-errors", "--rootdir", tmp_path, tmp_path]
    # no other plugins of the tests around, which bring minutes of imports
    env = os.environ | {"HHR_CI": nothing_optional, "PYTHONPATH": str(Path(__file__).parents[1])}
    said = python(*words, code=code, env=env, cwd=tmp_path).stdout
    assert "1 passed" in said and "1 xfailed" in said
    if nothing_optional:
        reasons = "no_such_tool", "no browser is there", "no compiler is there", "no_such_package"
        assert all(
            text in said for text in ("1 failed", "3 errors", *reasons, "install what is missing")
        )
    else:
        assert "4 skipped" in said and " failed" not in said
