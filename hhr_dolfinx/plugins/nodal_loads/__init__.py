"""Nodes chosen by their places, forces at nodes, and springs."""

from hhr_dolfinx.registry import Plugin

_LOADS = "hhr_dolfinx.plugins.nodal_loads.loads"

PLUGIN = Plugin(
    name="nodal_loads",
    public={_LOADS: "NodalForce Nodes Springs"},
    parts={"loads": {_LOADS: "NodalForce Springs"}},
    switches={"hhr_dolfinx.plugins.nodal_loads.switches": "bedding springs nodal_force"},
)
