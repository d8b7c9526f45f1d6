"""Functions that numba compiles, and what its cache keeps of them."""

import importlib
import logging
import os
import sys
import tempfile

import pytest
from numba.core import caching, config
from processes import python

from hhr_dolfinx.plugins.ufl_programs.compiled import compiled

CALLED = (
    "from hhr_dolfinx.plugins.ufl_programs.compiled import compiled\n\n"
    "@compiled(inner=True)\ndef inner(x):\n    return {}\n"
)
BETWEEN = (
    "from called import inner\nfrom hhr_dolfinx.plugins.ufl_programs.compiled import compiled\n\n"
    "@compiled(inner=True)\ndef between(x):\n    return inner(x)\n"
)
CALLS = (
    "from between import between\n"
    "from hhr_dolfinx.plugins.ufl_programs.compiled import compiled\n\n"
    "@compiled()\ndef outer(x):\n    return between(x)\n\nprint(outer(2.0), "
    "sum(outer.stats.cache_hits.values()))\n"
)


def test_a_change_of_what_is_called_is_compiled_anew(tmp_path):
    """Also through a function in between whose file stays as it is; the cache is used otherwise."""
    (tmp_path / "between.py").write_text(BETWEEN)
    (tmp_path / "calls.py").write_text(CALLS)
    path = os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")])

    def said(returned):
        (tmp_path / "called.py").write_text(CALLED.format(returned))
        done = python(str(tmp_path / "calls.py"), env=os.environ | {"PYTHONPATH": path})
        return done.stdout.split()

    assert said("x + 1.0") == ["3.0", "0"]
    assert said("x + 10.0") == ["12.0", "0"]
    again = python(str(tmp_path / "calls.py"), env=os.environ | {"PYTHONPATH": path})
    assert again.stdout.split() == ["12.0", "1"]


@pytest.fixture
def twice(tmp_path, monkeypatch):
    """A function of a file of its own, as numba's cache asks for.

    Whoever reads the cache imports it by its name.
    """
    (tmp_path / "twice_of_a_test.py").write_text("def twice(x):\n    return 2 * x\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "twice_of_a_test", raising=False)
    return importlib.import_module("twice_of_a_test").twice


@pytest.fixture
def nowhere(tmp_path, monkeypatch):
    """Neither the package nor the user's own cache can be written; where temporary files are."""
    monkeypatch.setattr(caching.CacheImpl, "_locator_classes", [caching.UserProvidedCacheLocator])
    monkeypatch.setattr(config, "CACHE_DIR", "")
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return tmp_path / f"hhr_dolfinx-{os.getuid()}"


def test_a_read_only_installation_compiles_once(twice, nowhere):
    for hits in (0, 1):
        function = compiled()(twice)
        assert function(2.0) == 4.0 and sum(function.stats.cache_hits.values()) == hits
    assert (
        list(nowhere.rglob("*.nbc"))
        and nowhere.stat().st_mode & 0o077 == 0
        and config.CACHE_DIR == ""
    )


def test_a_folder_that_others_write_to_is_no_cache(twice, nowhere):
    nowhere.mkdir()
    nowhere.chmod(0o777)
    assert compiled()(twice)(2.0) == 4.0 and not list(nowhere.iterdir())


def test_whoever_waits_for_a_compiler_is_told(twice, nowhere, caplog):
    for said in (1, 0):
        caplog.clear()
        function = compiled(dear="multiples of two")(twice)
        with caplog.at_level(logging.WARNING):
            assert function(2.0) == 4.0 and function(3) == 6
        told = [
            record.message
            for record in caplog.records
            if "compiling multiples of two, once" in record.message
        ]
        assert len(told) == said
