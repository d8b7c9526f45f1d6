"""Files of tests import plug-ins that may be deleted only if they are left out without these."""

import ast
import functools
from pathlib import Path

import conftest
from needs import OURS

from hhr_dolfinx import registry

TESTS = Path(__file__).parents[1]
ROOT = TESTS.parent
FOLDERS = (
    TESTS,
    TESTS / "helpers",
    ROOT / "benchmarks",
    ROOT / "benchmarks/thesis",
    ROOT / "demos",
)
HELPERS = {path.stem: path for folder in FOLDERS for path in sorted(folder.glob("*.py"))}
HELPERS |= {
    path.stem: path
    for path in sorted(TESTS.glob("plugins/*/*.py"))
    if not path.stem.startswith("test_")
}
FILES = sorted(TESTS.glob("*/test_*.py")) + sorted(TESTS.glob("plugins/*/test_*.py"))
del HELPERS["conftest"]  # which tests have without an import


@functools.cache
def imported(path):
    """Modules that a file imports at once, those of a condition or of a function left out."""
    found = []
    for node in ast.parse(path.read_text()).body:
        if isinstance(node, ast.ImportFrom) and node.module:
            found.append(node.module)
        elif isinstance(node, ast.Import):
            found += [name.name for name in node.names]
    return found


def used(path, seen=()):
    """Plug-ins that a file imports, and those of the helpers that it imports."""
    found = set()
    for module in imported(path):
        if module.startswith("hhr_dolfinx.plugins."):
            found.add(module.split(".")[2])
        elif module in HELPERS and HELPERS[module] not in (path, *seen):
            found |= used(HELPERS[module], (*seen, path))
    return found


def with_needs(names):
    """These plug-ins and all that they need."""
    plugins = registry.installed()
    found = set(names)
    while more := {need for name in found for need in plugins[name].needs} - found:
        found |= more
    return found


def test_files_name_the_plug_ins_that_they_import():
    """Their folder's own, and those that conftest lists; else `make without` ends at collection."""
    missing = {}
    for path in FILES:
        key = path.relative_to(TESTS).as_posix()
        own = {path.parent.name} if path.parent.parent.name == "plugins" else set()
        known = (own | set(conftest.NEEDING.get(key, ()))) & registry.installed().keys()
        lacking = (
            (used(path) & set(OURS)) - with_needs(known) - own - set(conftest.NEEDING.get(key, ()))
        )
        if lacking:
            missing[key] = sorted(lacking)
    assert missing == {}


def test_imports_of_helpers_count():
    """The file of capabilities in Chromium imports the studies by the benchmarks alone."""
    path = TESTS / "plugins/pages/test_pages_in_chromium.py"
    if path.exists():
        assert "studies" in used(path)
