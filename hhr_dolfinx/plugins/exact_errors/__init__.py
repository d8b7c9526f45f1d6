"""Errors of hyper-reduced answers for a constant stiffness: differences from the exact answer,
which S provides.

S also completes the forces outside the RID, and the displacement of these. Those of contacts with
laws are fitted by modes of training forces, and errors of these are indicated by the part that no
mode explains.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hhr_dolfinx.registry import Bounds, Plugin, Stage

if TYPE_CHECKING:
    from hhr_dolfinx.models.full import FullModel
    from hhr_dolfinx.reduction.recipe import Recipe

_HERE = "hhr_dolfinx.plugins.exact_errors"
_BUILD = "hhr_dolfinx.reduction.build"


def _wanted(full: FullModel) -> bool:
    return (
        full.equilibrium is not None or not full.problem.varies
    )  # laws are refused with their reason


def _has_outputs(full: FullModel, recipe: Recipe) -> bool:
    return _wanted(full) and full.functionals is not None and not full.problem.held_by_contact


def _calibrated(full: FullModel, recipe: Recipe) -> bool:
    return bool(full.law.plugin) and full.equilibrium is None and recipe.trust is not None


PLUGIN = Plugin(
    name="exact_errors",
    optional=("contact_laws", "floating", "paths"),
    classes={
        f"{_HERE}.difference": "ExactDifference",
        f"{_HERE}.field_response": "FieldResponse",
        f"{_HERE}.fitted": "FittedForces",
        f"{_HERE}.outputs": "OutputDifference",
    },
    bounds=(Bounds(f"{_HERE}.offline:bounding", _wanted),),
    stages=(
        Stage(f"{_HERE}.offline:read_outputs", f"{_BUILD}:reconstruct", _has_outputs),
        Stage(f"{_HERE}.calibrate:calibrate", f"{_BUILD}:assemble", _calibrated),
    ),
    tools={"forces_outside": f"{_HERE}.fitted:forces_outside"},
)
