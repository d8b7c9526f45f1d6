"""Marks for tests that need plug-ins, which may have been deleted: they are left out where one of these is missing."""

import pytest

from hhr_dolfinx import registry

IN_TRUNK = ("moduli",)
"""Plug-ins in the making, whose code still lies in the core: a name goes on the day that its folder is there."""


def needs(*plugins):
    """Mark of a test that needs all of these plug-ins."""
    return pytest.mark.needs(*plugins)


def present(*plugins):
    """True if all of them are installed."""
    return set(plugins) <= {*registry.installed(), *IN_TRUNK}
