"""Contact of nodes with facets, on meshes that do not match, in one pass or two."""

from hhr_dolfinx.registry import Plugin

_ONE = "hhr_dolfinx.plugins.nonmatching.node_to_surface"
_TWO = "hhr_dolfinx.plugins.nonmatching.double_pass"

PLUGIN = Plugin(
    name="nonmatching",
    public={_ONE: "NodeToSurface", _TWO: "DoublePass"},
    parts={"pairings": {"NodeToSurface": f"{_ONE}:NodeToSurface", "DoublePass": f"{_TWO}:DoublePass"}},
    classes={_ONE: "NodeToSurface", _TWO: "DoublePass"},
)
