"""Mortar contact: gaps in the weighted mean, on meshes that do not match."""

from hhr_dolfinx.registry import Plugin

_PAIRING = {"hhr_dolfinx.plugins.mortar.pairing": "Mortar"}

PLUGIN = Plugin(
    name="mortar",
    needs=("nonmatching",),
    public=_PAIRING,
    parts={"pairings": _PAIRING},
    classes=_PAIRING,
    switches={"hhr_dolfinx.plugins.mortar.switches": "mortar"},
)
