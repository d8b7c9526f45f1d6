"""Soft contact: a pressure that grows with the overclosure of two surfaces, by a curve."""

from hhr_dolfinx.registry import Plugin

_HERE = "hhr_dolfinx.plugins.soft_contact"

PLUGIN = Plugin(
    name="soft_contact",
    needs=("contact_laws",),
    public={f"{_HERE}.pair_laws": "SoftContact"},
    classes={
        f"{_HERE}.laws": "SoftContacts",
        f"{_HERE}.curves": "LinearCurve ExponentialCurve TabularCurve",
    },
    memory=("overclosure",),
    facets={
        "report": f"{_HERE}.fields:SOFT_FIELDS",
        "range": f"{_HERE}.laws:SoftRange",
        "kernel": f"{_HERE}.kernel:KERNEL",
    },
    switches={f"{_HERE}.switches": "soft_contact"},
)
