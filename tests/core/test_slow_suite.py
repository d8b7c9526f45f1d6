"""Slices of the slow suite, and its record."""

import json
import os
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest
import slow_suite

TESTS = """
import pytest

@pytest.mark.parametrize("number", range({count}))
def test_passes(number): pass
def test_fails(): assert False
def test_skips(): pytest.skip("of no use here")
@pytest.fixture
def broken(): raise ValueError
def test_with_a_broken_fixture(broken): pass
"""


def run(folder, *options):
    """Run pytest on files of three tests or more, with the hooks of the slow suite alone."""
    (folder / "conftest.py").write_text(
        "from slow_suite import keep_slice, pytest_addoption, pytest_configure\n"
        "from slow_suite import pytest_ignore_collect\n"
        "def pytest_collection_modifyitems(config, items): keep_slice(config, items)\n"
    )
    for name in ("one", "two"):
        (folder / f"test_{name}.py").write_text(TESTS.format(count=3))
    # a session within this one: it is no run of continuous integration, whose skipped tests fail
    environment = {name: value for name, value in os.environ.items() if name != "HHR_CI"}
    environment["PYTHONPATH"] = str(Path(slow_suite.__file__).parent)
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-q",
        "-p",
        "no:cacheprovider",
        *options,
        str(folder),
    ]
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)


@pytest.mark.parametrize("workers", ["0", "2"])
def test_a_record_counts_each_test_once_by_file(workers, tmp_path):
    run(tmp_path, "-n", workers, "--record", str(tmp_path / "record.json"))
    record = json.loads((tmp_path / "record.json").read_text())
    assert (record["passed"], record["failed"], record["skipped"]) == (6, 4, 2)
    assert record["minutes"] < 2 and len(record["commit"].rstrip("+")) in (0, 40)
    row = record["files"]["test_one.py"]
    assert {name: row[name] for name in ("passed", "failed", "skipped")} == {
        "passed": 3,
        "failed": 2,
        "skipped": 1,
    }
    assert row["seconds"] < 60


def test_slices_have_all_tests_once(tmp_path):
    """Tests of one file stay together: they share fixtures."""
    collected = [
        run(tmp_path, "--slice", f"{index}/2", "--collect-only").stdout for index in range(2)
    ]
    listed = [{line for line in text.splitlines() if "::" in line} for text in collected]
    assert sum(map(len, listed)) == len(set.union(*listed)) == 12
    for tests in listed:
        assert sum("test_one.py" in name for name in tests) in (0, 6)


@pytest.mark.parametrize("text", ["3/3", "1", "a/b", "-1/3", ""])
def test_a_text_that_is_no_slice_is_refused(text):
    with pytest.raises(pytest.UsageError, match="INDEX/COUNT"):
        slow_suite.slice_of(text)


def test_slices_take_about_as_long():
    """What the dearest first leaves uneven is less than the dearest of all.

    A plan does not change with the order.
    """
    seconds = {f"tests/core/test_{number}.py": float(number % 40) ** 1.5 for number in range(120)}
    slices = slow_suite.planned(seconds, 10)
    totals = [
        sum(seconds[name] for name, index in slices.items() if index == one) for one in range(10)
    ]
    assert slices.keys() == seconds.keys() and max(totals) - min(totals) < 0.05 * max(totals)
    assert slow_suite.planned(dict(reversed(seconds.items())), 10) == slices


def test_the_last_record_makes_even_slices():
    """Of twenty none has more than a quarter above its share: continuous integration has minutes
    for one.
    """
    seconds = slow_suite.recorded()
    slices = slow_suite.planned(seconds, 20)
    totals = [
        sum(seconds[name] for name, index in slices.items() if index == one) for one in range(20)
    ]
    assert max(totals) < 1.25 * sum(totals) / 20


def test_files_that_no_record_has_are_in_one_slice_each():
    """Of 600 names none of six slices has less than half or more than one and a half of its share:
    five sigma.
    """
    counts = Counter(
        slow_suite.slice_by_hash(f"tests/core/test_{number}.py", 6) for number in range(600)
    )
    assert (
        50 < min(counts.values()) and max(counts.values()) < 150 and counts.keys() == set(range(6))
    )
