"""Contact on cells of second order: facets with curved sides, and multipliers that are linear on their flat parts."""

from hhr_dolfinx.registry import Plugin

_FACETS = "hhr_dolfinx.plugins.second_order.facets"

PLUGIN = Plugin(name="second_order", classes={_FACETS: "QuadraticFacets"}, tools={"second_order": f"{_FACETS}:parted"})
