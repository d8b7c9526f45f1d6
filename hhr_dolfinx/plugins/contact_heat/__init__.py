"""Heat through contacts: conductance of pressure and gap, expansion; exact and condensed."""

from hhr_dolfinx.registry import Plugin

_HERE = "hhr_dolfinx.plugins.contact_heat"

PLUGIN = Plugin(
    name="contact_heat",
    needs=("elasticity",),
    optional=("exporters", "pages"),
    public={
        f"{_HERE}.heat": "Heat FixedTemperature HeatFlux HeatSource Convection SlidingHeat",
        f"{_HERE}.heated": "HeatAnswer",
        f"{_HERE}.model": "HeatModel",
        f"{_HERE}.transient": "TransientHeatModel",
        f"{_HERE}.making": "condense_heat condense_transient_heat",
        f"{_HERE}.files": "save_heat_model load_heat_model",
    },
    formats={"hhr_dolfinx heat model": f"{_HERE}.files:load_heat_model"},
    classes={f"{_HERE}.parts": "Conduction HeatParts SlidingParts TransientParts"},
)
