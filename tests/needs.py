"""Marks for tests that need plug-ins, which may have been deleted: they are left out where one of these is missing."""

import pytest

from hhr_dolfinx import registry


def needs(*plugins):
    """Mark of a test that needs all of these plug-ins."""
    return pytest.mark.needs(*plugins)


def present(*plugins):
    """True if all of them are installed."""
    return set(plugins) <= registry.installed().keys()
