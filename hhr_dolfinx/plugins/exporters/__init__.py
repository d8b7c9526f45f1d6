"""Models as C headers and FMI units; problems as decks for CalculiX and Abaqus."""

from hhr_dolfinx.registry import Plugin

PLUGIN = Plugin(
    name="exporters",
    needs=("pages",),
    commands={
        "embed": "hhr_dolfinx.plugins.exporters.commands:embed",
        "export": "hhr_dolfinx.plugins.exporters.commands:export",
    },
)
