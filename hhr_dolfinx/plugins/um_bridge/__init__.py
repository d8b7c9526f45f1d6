"""A server of UM-Bridge; docs/coupling.md has recipes for other programs."""

from hhr_dolfinx.registry import Plugin

PLUGIN = Plugin(
    name="um_bridge",
    commands={"serve": "hhr_dolfinx.plugins.um_bridge.commands:serve"},
)
