"""Search for the cheapest model of a scene that has a requested accuracy."""

from hhr_dolfinx.registry import Plugin

PLUGIN = Plugin(
    name="one_call",
    needs=("paths",),
    public={
        "hhr_dolfinx.plugins.one_call.record": "Reduction",
        "hhr_dolfinx.plugins.one_call.search": "reduce",
        "hhr_dolfinx.plugins.one_call.target": "Budget",
    },
    commands={"reduce": "hhr_dolfinx.plugins.one_call.commands:reduce"},
)
