"""Contact of nodes with facets, on meshes that do not match, in one pass or two."""

from hhr_dolfinx.registry import Plugin

_PAIRINGS = {
    "hhr_dolfinx.plugins.nonmatching.node_to_surface": "NodeToSurface",
    "hhr_dolfinx.plugins.nonmatching.double_pass": "DoublePass",
}

PLUGIN = Plugin(
    name="nonmatching",
    public=_PAIRINGS,
    parts={"pairings": _PAIRINGS},
    classes=_PAIRINGS,
    switches={"hhr_dolfinx.plugins.nonmatching.switches": "node_to_surface double_pass"},
)
