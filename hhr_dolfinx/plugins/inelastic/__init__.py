"""Inelastic bodies: plasticity, creep and viscoplasticity along histories."""

from hhr_dolfinx.registry import Plugin

_HERE = "hhr_dolfinx.plugins.inelastic"

PLUGIN = Plugin(
    name="inelastic",
    public={f"{_HERE}.laws": "Norton Plasticity", f"{_HERE}.recipe": "FlowDeim StressDeim"},
    parts={
        "laws": {"Plasticity": f"{_HERE}.laws:Plasticity", "Norton": f"{_HERE}.laws:Norton"},
        "recipes": {"flowing": f"{_HERE}.recipe:flowing"},
        "checks": {"check_law": f"{_HERE}.testing:check_law"},
    },
    classes={
        f"{_HERE}.completion": "FlowFields GappyField",
        f"{_HERE}.condensed_fields": "CondensedFlowFields PartFactors PlasticFields",
        f"{_HERE}.condensed_flow": "CondensedFlow CondensedFlowModel",
        f"{_HERE}.laws": "Norton Plasticity",
        f"{_HERE}.outputs": "FlowMises",
        f"{_HERE}.reduced_flow": "ReducedFlow",
        f"{_HERE}.trained": "TrainedPaths",
        f"{_HERE}.update": "Group Material",
    },
    methods={"force_correction": f"{_HERE}.project:of_training"},
    materials=("flow",),
    memory=("gauss",),
    answers={"state": f"{_HERE}.state:state", "plastic_strain": f"{_HERE}.state:plastic_strain"},
    facets={
        "scene": f"{_HERE}.scenes:SCENES",
        "full_order": f"{_HERE}.full_order:bodies_of",
        "store": f"{_HERE}.store:StoredGauss",
        "comparison": f"{_HERE}.comparison:COMPARISON",
        "stages": f"{_HERE}.stages:STAGES",
        "condense": f"{_HERE}.condense_flow:condense_flow",
        "file": f"{_HERE}.state:check_answer",
        "study": f"{_HERE}.study:STUDY",
    },
)
