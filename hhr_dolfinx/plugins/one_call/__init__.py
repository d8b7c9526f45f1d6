"""Search for the cheapest model of a scene that has a requested accuracy."""

from hhr_dolfinx.registry import Plugin

PLUGIN = Plugin(
    name="one_call",
    needs=("paths",),
    public={
        "hhr_dolfinx.plugins.one_call.search": "Reduction reduce",
        "hhr_dolfinx.plugins.one_call.target": "Budget",
    },
    commands={"reduce": "hhr_dolfinx.plugins.one_call.commands:reduce"},
)
