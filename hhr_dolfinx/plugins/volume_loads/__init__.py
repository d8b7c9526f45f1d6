"""Loads on whole bodies: forces per volume, rotation, temperature, swelling."""

from hhr_dolfinx.registry import Plugin

_HERE = "hhr_dolfinx.plugins.volume_loads"

_LOADS = {f"{_HERE}.loads": "BodyForce Centrifugal Eigenstrain ThermalExpansion"}

PLUGIN = Plugin(
    name="volume_loads",
    public=_LOADS,
    parts={"loads": _LOADS},
    switches={f"{_HERE}.switches": "body_force centrifugal swelling thermal"},
)
