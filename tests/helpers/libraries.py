"""What the libraries at hand can do, asked of themselves: tests of what they lack are skipped by
that reason.
"""

import importlib.util

import pytest

from hhr_dolfinx.geometries.gmsh_model import knows_med

MED = knows_med()
needs_med = pytest.mark.skipif(not MED, reason="this gmsh was built without MED")
ZIG = importlib.util.find_spec("ziglang") is not None
"""Whether there is a compiler for WebAssembly."""
