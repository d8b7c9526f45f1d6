"""Functions that numba compiles, and what its cache keeps of them."""

import os

import pytest
from bare import python

pytest.importorskip("numba")

CALLED = (
    "from hhr_dolfinx.compat import compiled\n\n"
    "@compiled(inner=True)\ndef inner(x):\n    return {}\n"
)
BETWEEN = (
    "from called import inner\nfrom hhr_dolfinx.compat import compiled\n\n"
    "@compiled(inner=True)\ndef between(x):\n    return inner(x)\n"
)
CALLS = (
    "from between import between\nfrom hhr_dolfinx.compat import compiled\n\n"
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
