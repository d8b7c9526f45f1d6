"""Contact on cells of second order: facets with curved sides, multipliers on flat parts.

Folded cells are mended.
"""

from hhr_dolfinx.registry import Plugin

_FACETS = "hhr_dolfinx.plugins.second_order.facets"
_MESH = "hhr_dolfinx.plugins.second_order.untangled"

PLUGIN = Plugin(
    name="second_order",
    public={_MESH: "Untangled"},
    parts={"geometries": {_MESH: "Untangled"}},
    classes={_FACETS: "QuadraticFacets"},
    tools={
        "second_order": f"{_FACETS}:parted",
        "folded": f"{_MESH}:folded_in_words",
        "mending": f"{_MESH}:mending",
    },
    switches={"hhr_dolfinx.plugins.second_order.switches": "second_order"},
)
