"""Two stacked blocks with a floor and a wall, three pairs that may have three laws.

And plug-ins of the templates.
"""

from functools import cache

import my_contact_law
import my_gasket

import hhr_dolfinx as hhr
from hhr_dolfinx import registry
from hhr_dolfinx.geometries import two_blocks

PARAMETERS = hhr.ParameterSpace(("push", "slide"), (0.0, -0.2), (0.3, 0.2))
PATH = [
    (0.0, (0.0, 0.0)),
    (1.0, (0.02, 0.0)),
    (2.0, (0.02, 0.03)),
    (3.5, (0.01, -0.02)),
    (4.0, (0.04, 0.01)),
]


def stacked(between=None, floor=None, wall=None, cells=4, gap=0.0, **changes):
    """The upper block is pushed down and aside; the lower one is clamped on its left.

    Laws are those of three pairs.
    """
    first, second = (((1.0, low), (2.0, low + 1.0), (cells, cells)) for low in (0.0, 1.0))
    top = two_blocks.side(2, 1, True)
    imposed = [
        hhr.Displacement(top, k, hhr.Amplitude(slopes=slopes))
        for k, slopes in enumerate(({"slide": 1.0}, {"push": -1.0}))
    ]
    given = {
        "name": "stacked",
        "geometry": lambda comm: two_blocks.two_blocks(comm, first=first, second=second),
        "hypothesis": "plane_strain",
        "bodies": (hhr.Body(1, 2.0, 0.3), hhr.Body(2, 5.0, 0.3)),
        "contacts": (
            hhr.NodeToNode(
                two_blocks.side(1, 1, True), two_blocks.side(2, 1, False), (0.0, 1.0), law=between
            ),
            hhr.Obstacle(two_blocks.side(1, 1, False), (0.0, -1.0), gap, law=floor),
            hhr.Obstacle(two_blocks.side(1, 0, True), (1.0, 0.0), 2.0, law=wall),
        ),
        "displacements": (*hhr.Displacement.clamp(two_blocks.side(1, 0, False), 2), *imposed),
        "parameters": PARAMETERS,
    }
    return hhr.Scene(**given | changes)


def with_plugins(monkeypatch, *more):
    """Install the plug-ins of the templates, and more, for one test."""
    added = {plugin.name: plugin for plugin in (my_contact_law.PLUGIN, my_gasket.PLUGIN, *more)}
    every = {**registry.installed(), **added}
    monkeypatch.setattr(registry, "installed", lambda: every)
    for name in ("facet", "memories"):
        monkeypatch.setattr(registry, name, cache(getattr(registry, name).__wrapped__))
