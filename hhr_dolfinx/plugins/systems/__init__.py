"""User-defined systems, ``Scene(system=...)``: K by any other means, such as another code."""

from hhr_dolfinx.registry import Plugin

PLUGIN = Plugin(
    name="systems",
    needs=("elasticity",),
    tools={"systems": "hhr_dolfinx.plugins.systems.user_system:UserSystem"},
)
