"""Nodes chosen by their places, forces at nodes, and springs."""

from hhr_dolfinx.registry import Plugin

_PLACES = "hhr_dolfinx.plugins.places.places"

PLUGIN = Plugin(
    name="places",
    public={_PLACES: "NodalForce Nodes Springs"},
    parts={"loads": {_PLACES: "NodalForce Springs"}},
    switches={"hhr_dolfinx.plugins.places.switches": "bedding springs nodal_force"},
)
