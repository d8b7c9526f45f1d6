"""Surfaces that slide by any length: contact rows are paired again in each increment."""

from hhr_dolfinx.registry import Plugin

PLUGIN = Plugin(
    name="sliding",
    needs=("contact_laws", "friction", "mortar", "nonmatching"),
    public={"hhr_dolfinx.plugins.sliding.slide": "slide"},
    classes={
        "hhr_dolfinx.plugins.sliding.beside": "BesideTools",
        "hhr_dolfinx.plugins.sliding.law": "SlidingLaw",
        "hhr_dolfinx.plugins.sliding.model": "SlidingModel",
        "hhr_dolfinx.plugins.sliding.outputs": "LargestOfSlaves LoadedOfSlaves",
        "hhr_dolfinx.plugins.sliding.pressures": "FrictionBesideLaws SlidingFriction",
        "hhr_dolfinx.plugins.sliding.repairing": "SlidingPair",
    },
    facets={
        "steps": "hhr_dolfinx.plugins.sliding.law:SLIDING_STEPS",
        "flow_slopes": "hhr_dolfinx.plugins.sliding.law:no_slopes",
    },
    switches={"hhr_dolfinx.plugins.sliding.switches": "sliding"},
)
