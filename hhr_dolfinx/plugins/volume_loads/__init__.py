"""Loads on whole bodies: forces per volume, rotation, temperature, swelling."""

from hhr_dolfinx.registry import Plugin

_LOADS = {"hhr_dolfinx.plugins.volume_loads.loads": "BodyForce Centrifugal Eigenstrain ThermalExpansion"}

PLUGIN = Plugin(name="volume_loads", public=_LOADS, parts={"loads": _LOADS})
