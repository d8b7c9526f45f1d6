"""Mortar contact: gaps in the weighted mean, on meshes that do not match."""

from hhr_dolfinx.registry import Plugin

_PAIRING = "hhr_dolfinx.plugins.mortar.pairing"

PLUGIN = Plugin(
    name="mortar",
    needs=("nonmatching",),
    public={_PAIRING: "Mortar"},
    parts={"pairings": {"Mortar": f"{_PAIRING}:Mortar"}},
    classes={_PAIRING: "Mortar"},
)
