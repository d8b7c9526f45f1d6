"""Marks for tests that need plug-ins, which may have been deleted: they are left out where one of these is missing."""

import re
from pathlib import Path

import pytest

import hhr_dolfinx as hhr
from hhr_dolfinx import registry

OURS = tuple(
    re.findall(r"^\| `(\w+)` \|", (Path(__file__).parents[1] / "docs/plug_ins.md").read_text("utf-8"), re.MULTILINE)
)
"""Our plug-ins, by the list of the page, which has those that were deleted too."""


def needs(*plugins):
    """Mark of a test that needs all of these plug-ins."""
    return pytest.mark.needs(*plugins)


def present(*plugins):
    """True if all of them are installed."""
    return set(plugins) <= registry.installed().keys()


def mortar(*surfaces, **options):
    """A mortar pair, of a plug-in, which is asked for when a scene is made."""
    return hhr.Mortar(*surfaces, **options)


MORTAR = pytest.param(mortar, id="Mortar", marks=needs("mortar"))
"""It as a case of a test."""
