"""Friction of contacts: Coulomb's and Tresca's laws, for elastic and for inelastic bodies."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hhr_dolfinx.registry import Plugin, Stage

if TYPE_CHECKING:
    from hhr_dolfinx.models.full import FullModel
    from hhr_dolfinx.reduction.recipe import Recipe

_HERE = "hhr_dolfinx.plugins.friction"
_OUTPUTS = {
    f"{_HERE}.outputs": "DissipatedWork FrictionForce LargestSlip LargestWear SlipArea "
    "StickArea Torque"
}

_BUILD = "hhr_dolfinx.reduction.build"
_OURS = "friction"


def _wanted(full: FullModel, recipe: Recipe) -> bool:
    return _OURS in full.law.plugins


PLUGIN = Plugin(
    name=_OURS,
    needs=("contact_laws", "paths"),
    optional=("floating", "inelastic", "pages"),
    public={f"{_HERE}.pair_laws": "Coulomb Tresca", **_OUTPUTS},
    parts={"outputs": _OUTPUTS},
    classes={
        f"{_HERE}.laws": "Friction FrictionLaw",
        f"{_HERE}.over": "FrictionOver",
        f"{_HERE}.pair_laws": "Coulomb Tresca",
        f"{_HERE}.functionals": "Remembered RememberedShare StatusArea",
    },
    tools={"laws_of_a_pair": f"{_HERE}.rubbing:rubbing"},
    pair_laws={"friction": f"{_HERE}.pair_laws:law_of"},
    memory=("slip",),
    recipes={"with_friction": f"{_HERE}.reduction:with_friction"},
    stages=(Stage(f"{_HERE}.reduction:check_forces", f"{_BUILD}:assess_projection", _wanted),),
    facets={
        "steps": f"{_HERE}.steps:FRICTION_STEPS",
        "range": f"{_HERE}.over:solver_of",
        "report": f"{_HERE}.report:REPORT",
        "page": f"{_HERE}.page:PAGE",
        "flow_slopes": f"{_HERE}.flow_slopes:SlidingSlopes",
        "deck": f"{_HERE}.pair_laws:DECK",
    },
    switches={f"{_HERE}.switches": "friction friction_by_formula tresca"},
)
