"""Wear by Archard's law: what presses and slides is worn off, and opens gaps."""

from hhr_dolfinx.registry import Plugin

_HERE = "hhr_dolfinx.plugins.wear"

PLUGIN = Plugin(
    name="wear",
    needs=("contact_laws",),
    public={f"{_HERE}.pair_laws": "ArchardWear", f"{_HERE}.outputs": "WornDepth WornVolume"},
    parts={"outputs": {f"{_HERE}.outputs": "WornDepth WornVolume"}},
    classes={f"{_HERE}.laws": "WornConditions", f"{_HERE}.outputs": "Worn"},
    memory=("worn_depth",),
    facets={
        "report": f"{_HERE}.fields:WEAR_FIELDS",
        "range": f"{_HERE}.laws:WearRange",
        "kernel": f"{_HERE}.kernel:WEAR_KERNEL",
    },
    switches={f"{_HERE}.switches": "wear"},
)
