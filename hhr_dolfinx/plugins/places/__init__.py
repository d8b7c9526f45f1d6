"""Nodes chosen by their places, and forces at nodes."""

from hhr_dolfinx.registry import Plugin

_PLACES = "hhr_dolfinx.plugins.places.places"

PLUGIN = Plugin(
    name="places",
    public={_PLACES: "NodalForce Nodes"},
    parts={"loads": {"NodalForce": f"{_PLACES}:NodalForce"}},
)
