"""The slow suite: a slice of it for each commit, and its record in ``tests/slow_report.json``."""

import hashlib
import json
import subprocess
import time
from collections import Counter
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
RECORD = Path(__file__).parent / "slow_report.json"


ONE_BY_ONE = "test_scripts.py", "test_compose.py", "test_contract.py"
"""Files that take minutes, and whose tests share no fixture that takes long."""


def slice_of(text):
    """Index and count of a slice such as ``2/6``: tests of index 2 of 6.

    Raises:
        pytest.UsageError: for a text that is no slice.
    """
    index, _, count = text.partition("/")
    if not (index.isdigit() and count.isdigit() and int(index) < int(count)):
        raise pytest.UsageError(f"--slice {text}: write INDEX/COUNT, the first index is 0")
    return int(index), int(count)


def unit(nodeid):
    """Tests that a slice has or has not: a file, whose tests share fixtures.

    Files whose tests share none that takes long, one by one.
    """
    file = nodeid.partition("::")[0]
    return nodeid if file.endswith(ONE_BY_ONE) else file


def planned(seconds, count):
    """Slices of units, so that all take about as long: the dearest first, each into the slice that
    has least.
    """
    slices, totals = {}, [0.0] * count
    for name in sorted(seconds, key=lambda name: (-seconds[name], name)):
        slices[name] = totals.index(min(totals))
        totals[slices[name]] += seconds[name]
    return slices


def slice_by_hash(name, count):
    """Slice of a unit that no record has."""
    return int(hashlib.sha256(name.encode()).hexdigest(), 16) % count


class Record:
    """Outcomes and seconds of tests by file, of scripts one by one, written when a session ends."""

    def __init__(self, path):
        self.path = Path(path)
        self.began = time.perf_counter()
        self.files = {}

    def pytest_runtest_logreport(self, report):
        """Count a test once: by its call, or by a set-up or an end that did not pass."""
        row = self.files.setdefault(unit(report.nodeid), Counter())
        row["seconds"] += report.duration
        if report.when == "call" or not report.passed:
            row[report.outcome] += 1

    def pytest_sessionfinish(self, session):
        """Write the record, on the process that hands out tests."""
        total = sum(self.files.values(), Counter())
        written = {
            "commit": commit(),
            **{outcome: total[outcome] for outcome in ("passed", "failed", "skipped")},
            "minutes": round((time.perf_counter() - self.began) / 60, 1),
            "files": {file: row_of(self.files[file]) for file in sorted(self.files)},
        }
        self.path.write_text(json.dumps(written, indent=1) + "\n")


def row_of(counts):
    """Outcomes of a file that occurred, and its seconds, which need no more than a digit."""
    kept = {name: count for name, count in sorted(counts.items()) if name != "seconds" and count}
    return kept | {"seconds": round(counts["seconds"], 1)}


def commit():
    """Hash of the commit that is checked out, with ``+`` if files of it are changed.

    Empty outside of git.
    """
    hashed = subprocess.run(["git", "rev-parse", "HEAD"], cwd=ROOT, capture_output=True, text=True)
    changed = subprocess.run(["git", "diff", "--quiet", "HEAD"], cwd=ROOT, capture_output=True)
    return hashed.stdout.strip() + ("+" if changed.returncode == 1 else "")


def pytest_addoption(parser):
    """Options of the slow suite."""
    group = parser.getgroup("slow suite")
    group.addoption("--slice", help="INDEX/COUNT: run one of so many parts of the tests")
    group.addoption("--record", help="file for outcomes and seconds by file")


def pytest_configure(config):
    """Record a session if asked, in the process that collects the reports of all workers."""
    if config.getoption("--record") and not hasattr(config, "workerinput"):
        config.pluginmanager.register(Record(config.getoption("--record")))


def recorded(path=RECORD):
    """Seconds of each unit in the last record of all slow tests; empty without one."""
    files = json.loads(path.read_text())["files"] if path.exists() else {}
    return {
        name: row["seconds"]
        for name, row in files.items()
        if "::" in name or not name.endswith(ONE_BY_ONE)
    }


def pytest_ignore_collect(collection_path, config):
    """Leave out files of other slices before they are imported, which takes longest."""
    text = config.getoption("--slice")
    name = collection_path.relative_to(config.rootpath).as_posix()
    if not text or not name.endswith(".py") or name.endswith(ONE_BY_ONE):
        return None
    return True if _slice_of_unit(name, *slice_of(text)[1:]) != slice_of(text)[0] else None


@cache
def _slice_of_unit(name, count):
    """Slice of a unit, by the last record or else by its name."""
    return _plan(count).get(name, slice_by_hash(name, count))


@cache
def _plan(count):
    return planned(recorded(), count)


def keep_slice(config, items):
    """Leave out tests of other slices."""
    if not (text := config.getoption("--slice")):
        return
    index, count = slice_of(text)
    others = [item for item in items if _slice_of_unit(unit(item.nodeid), count) != index]
    config.hook.pytest_deselected(items=others)
    items[:] = [item for item in items if item not in set(others)]
