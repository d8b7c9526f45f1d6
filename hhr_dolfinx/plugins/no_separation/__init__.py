"""Contact without separation: surfaces that have pressed on each other do not open any more."""

from hhr_dolfinx.registry import Plugin

_HERE = "hhr_dolfinx.plugins.no_separation"

PLUGIN = Plugin(
    name="no_separation",
    needs=("contact_laws",),
    public={f"{_HERE}.pair_laws": "NoSeparation"},
    classes={f"{_HERE}.laws": "HeldConditions"},
    memory=("held",),
    facets={
        "report": f"{_HERE}.fields:HOLDING_FIELDS",
        "range": f"{_HERE}.laws:HoldingRange",
        "kernel": f"{_HERE}.kernel:HOLDING_KERNEL",
    },
    switches={f"{_HERE}.switches": "no_separation"},
)
