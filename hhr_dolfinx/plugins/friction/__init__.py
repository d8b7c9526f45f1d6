"""Friction of contacts: Coulomb's and Tresca's laws, for elastic and for inelastic bodies."""

from hhr_dolfinx.registry import Plugin

_HERE = "hhr_dolfinx.plugins.friction"
_OUTPUTS = "DissipatedWork FrictionForce LargestSlip LargestWear SlipArea StickArea Torque"

PLUGIN = Plugin(
    name="friction",
    public={f"{_HERE}.laws": "Coulomb Tresca", f"{_HERE}.outputs": _OUTPUTS},
    parts={"outputs": {name: f"{_HERE}.outputs:{name}" for name in _OUTPUTS.split()}},
    classes={
        f"{_HERE}.laws": "Coulomb Friction FrictionLaw Tresca",
        f"{_HERE}.fields": "FrictionalFields",
        f"{_HERE}.functionals": "Remembered StatusArea",
    },
    pair_laws={"friction": f"{_HERE}.laws:law_of"},
    memory=("slip",),
    facets={
        "steps": f"{_HERE}.steps:STEPS",
        "reduction": f"{_HERE}.reduction:REDUCTION",
        "report": f"{_HERE}.report:REPORT",
        "page": f"{_HERE}.page:PAGE",
        "deck": f"{_HERE}.deck:DECK",
    },
)
