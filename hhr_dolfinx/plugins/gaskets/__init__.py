"""Gaskets: a pressure by the closure that unloads on another way than it loads."""

from hhr_dolfinx.registry import Plugin

_HERE = "hhr_dolfinx.plugins.gaskets"

PLUGIN = Plugin(
    name="gaskets",
    needs=("contact_laws",),
    public={f"{_HERE}.pair_laws": "GasketLayer", f"{_HERE}.outputs": "LargestClosure"},
    parts={"outputs": {f"{_HERE}.outputs": "LargestClosure"}},
    classes={
        f"{_HERE}.laws": "GasketLayers",
        f"{_HERE}.behaviour": "GasketCurve",
        f"{_HERE}.outputs": "Closed",
    },
    memory=("gasket_closure", "largest_closure"),
    facets={
        "report": f"{_HERE}.fields:GASKET_FIELDS",
        "range": f"{_HERE}.laws:GasketRange",
        "kernel": f"{_HERE}.kernel:GASKET_KERNEL",
    },
    switches={f"{_HERE}.switches": "gasket"},
)
