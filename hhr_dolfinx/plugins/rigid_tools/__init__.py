"""Rigid tools that forces drive, that drag by friction, and that turn."""

from hhr_dolfinx.registry import Plugin

_HERE = "hhr_dolfinx.plugins.rigid_tools"
_OUTPUTS = {f"{_HERE}.outputs": "ToolMotion"}

PLUGIN = Plugin(
    name="rigid_tools",
    needs=("constraints",),
    public={f"{_HERE}.drive": "drive", **_OUTPUTS},
    parts={"outputs": _OUTPUTS},
    switches={f"{_HERE}.switches": "driven_tool"},
)
