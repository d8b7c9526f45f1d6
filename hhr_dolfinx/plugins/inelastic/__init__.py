"""Inelastic bodies: plasticity, creep and viscoplasticity along histories."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hhr_dolfinx.registry import Plugin, Stage, Way

if TYPE_CHECKING:
    from hhr_dolfinx.models.full import FullModel
    from hhr_dolfinx.reduction.recipe import Recipe

_HERE = "hhr_dolfinx.plugins.inelastic"
_BUILD = "hhr_dolfinx.reduction.build"
_OURS = "inelastic"
_LAWS = (
    "Arrhenius Chaboche ChangingStiffness DruckerPrager Heated Hill Lemaitre Norton Orthotropic "
    "Plasticity PlasticityWithCreep PrimaryCreep TabulatedHardening Voce"
)
_STEPS = "FlowDeim FlowLimits StressDeim Tangents"


def _wanted(full: FullModel, recipe: Recipe | None = None) -> bool:
    return full.equilibrium is not None and full.equilibrium.reader == _OURS


PLUGIN = Plugin(
    name=_OURS,
    needs=("elasticity", "small_strains", "ufl_programs", "paths"),
    optional=("one_call", "studies"),
    public={f"{_HERE}.laws": _LAWS, f"{_HERE}.law": "Law", f"{_HERE}.recipe": _STEPS},
    parts={
        "laws": {name: f"{_HERE}.laws:{name}" for name in _LAWS.split()},
        "checks": {"check_law": f"{_HERE}.testing:check_law"},
    },
    classes={
        f"{_HERE}.completion": "FlowFields GappyField",
        f"{_HERE}.condensed_fields": "CondensedFlowFields LooseBodies PartFactors PlasticFields",
        f"{_HERE}.condensed_flow": "CondensedFlow CondensedFlowModel",
        f"{_HERE}.law": "LawProgram",
        f"{_HERE}.outputs": "FlowEnergy FlowMises",
        f"{_HERE}.reduced_flow": "ReducedFlow",
        f"{_HERE}.strain": "StrainOperator",
        f"{_HERE}.trained": "TrainedPaths",
        f"{_HERE}.update": "Group Material",
    },
    recipes={"flowing": f"{_HERE}.recipe:flowing"},
    reductors={
        "plastic_correction": Way(
            f"{_HERE}.condense_flow:CorrectionSettings", _wanted, condenses=True
        )
    },
    stages=(
        Stage(f"{_HERE}.project:project_points", f"{_BUILD}:project_problem", _wanted),
        Stage(f"{_HERE}.project:complete_flow", f"{_BUILD}:reconstruct", _wanted),
        Stage(f"{_HERE}.project:check_tangents", f"{_BUILD}:assemble", _wanted),
    ),
    materials=("statement",),
    memory=("gauss", "time_errors"),
    answers={"state": f"{_HERE}.state:state", "plastic_strain": f"{_HERE}.state:plastic_strain"},
    facets={
        "scene": f"{_HERE}.constants:SCENES",
        "full_order": f"{_HERE}.full_order:bodies_of",
        "store": f"{_HERE}.store:StoredGauss",
        "reduction": f"{_HERE}.reduction:OfInelasticBodies",
        "file": f"{_HERE}.state:check_answer",
        "study": f"{_HERE}.study:STUDY",
    },
    switches={f"{_HERE}.switches": "voce norton orthotropic"},
)
