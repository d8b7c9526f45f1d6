"""Kernels that were compiled for pages are those of their C sources.

What is compiled where a page is written.
"""

import importlib.util
import itertools

import pytest
from libraries import ZIG

from hhr_dolfinx import registry
from hhr_dolfinx.errors import MissingPackageError
from hhr_dolfinx.plugins.pages.kernel import (
    SOURCES_SECTION,
    compiled,
    digest_of,
    kernel_path,
    page_sources,
)
from hhr_dolfinx.plugins.pages.laws import Laws
from hhr_dolfinx.plugins.pages.layout import layouts

LAWS = [None, *(name for name in ("friction",) if name in registry.installed())]
KERNELS = list(itertools.product(LAWS, ([], ["floating"], ["flow"], ["floating", "flow"])))


def sources(name, part):
    """Sources of a kernel and its file."""
    law = None if name is None else registry.facet(name, "page", "a test")
    parts = [*part, *([] if law is None else [law.key])]
    return page_sources(parts, Laws(law, ())), kernel_path(parts, Laws(law, ()))


@pytest.mark.parametrize(("law", "part"), KERNELS)
def test_a_kernel_is_that_of_its_sources(law, part):
    """By their digest in a section of it; after a change of the sources: python
    scripts/kernels.py.
    """
    texts, path = sources(law, part)
    assert path.read_bytes().endswith(SOURCES_SECTION + digest_of(texts))
    changed = texts | {"kernel.h": texts["kernel.h"] + " "}
    assert digest_of(changed) != digest_of(texts)


@pytest.mark.skipif(not ZIG, reason="ziglang is not there")
@pytest.mark.parametrize(("law", "part"), KERNELS)
def test_a_kernel_is_compiled_to_the_same_bytes(law, part):
    """By the compiler of this version of ziglang, whatever the machine."""
    texts, path = sources(law, part)
    assert compiled(texts) == path.read_bytes()


def test_a_compiler_that_is_missing_is_named(monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(MissingPackageError, match="pip install ziglang"):
        compiled({})


def test_records_are_laid_out_as_c_declares_them():
    found = layouts()
    assert list(found)[:2] == ["sizes", "data"]
    assert found["limit"] == {"value": "i", "low": "d", "high": "d", "count": "i"}
    assert found["part"]["interpolant"] == "r interpolant" and found["body"]["law"] == "R program"
    assert found["data"]["parts"] == "R part" and found["sizes"]["softness"] == "d"
