"""Marks for tests that need plug-ins, which may have been deleted: they are left out where one of
these is missing.
"""

import re
from pathlib import Path

import pytest

import hhr_dolfinx as hhr
from hhr_dolfinx import registry

PAGE = (Path(__file__).parents[1] / "docs/plug_ins.md").read_text("utf-8")
OURS = tuple(
    re.findall(
        r"^\| `(\w+)` \|", PAGE.partition("\n## Ours\n")[2].partition("\n## ")[0], re.MULTILINE
    )
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


def node_to_surface(*surfaces, **options):
    """A pair of nodes and facets, likewise."""
    return hhr.NodeToSurface(*surfaces, **options)


def double_pass(*surfaces, **options):
    """Such a pair both ways."""
    return hhr.DoublePass(*surfaces, **options)


def cases_of(meshes):
    """Cases by names of arguments of ``pressed_pair``.

    Those of meshes that do not match need a plug-in.
    """
    return [
        pytest.param(name, marks=() if mesh.get("matching", True) else needs("nonmatching"))
        for name, mesh in sorted(meshes.items())
    ]


MORTAR = pytest.param(mortar, id="Mortar", marks=needs("mortar"))
NODE_TO_SURFACE = pytest.param(node_to_surface, id="NodeToSurface", marks=needs("nonmatching"))
DOUBLE_PASS = pytest.param(double_pass, id="DoublePass", marks=needs("nonmatching"))
"""They as cases of a test."""
