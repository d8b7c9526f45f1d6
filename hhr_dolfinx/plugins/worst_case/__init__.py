"""The worst case of an output over the whole box of the parameters, with a proof."""

from hhr_dolfinx.registry import Plugin

_HERE = "hhr_dolfinx.plugins.worst_case"

PLUGIN = Plugin(
    name="worst_case",
    public={f"{_HERE}.search": "worst WorstCase", f"{_HERE}.check": "check_certificate"},
    commands={
        "worst": f"{_HERE}.commands:worst",
        "certificate": f"{_HERE}.commands:certificate",
    },
)
