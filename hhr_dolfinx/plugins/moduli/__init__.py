"""Elastic bodies whose stiffness depends on parameters: S and K~^-1, interpolated between few of
them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hhr_dolfinx.registry import Bounds, Plugin, Stage, Way

if TYPE_CHECKING:
    from hhr_dolfinx.models.full import FullModel
    from hhr_dolfinx.reduction.recipe import Recipe

_HERE = "hhr_dolfinx.plugins.moduli"


def _wanted(full: FullModel, recipe: Recipe | None = None) -> bool:
    return full.equilibrium is None and full.problem.varies


def _of_one_shape(full: FullModel, recipe: Recipe) -> bool:
    return _wanted(full) and full.problem.reshaped is None


PLUGIN = Plugin(
    name="moduli",
    needs=("exact_errors", "elasticity"),
    optional=("one_call",),
    classes={
        f"{_HERE}.varying_bound": "PartEnergy VaryingBound",
        f"{_HERE}.interpolated": "Compliance Compliances InterpolatedFields PrimalModes",
        f"{_HERE}.interpolation": "Interpolant",
        f"{_HERE}.shaped": "InterpolatedProblem ReshapedElimination",
    },
    reductors={"condensed": Way(f"{_HERE}.condense:Condensation", _wanted, condenses=True)},
    stages=(
        Stage(
            f"{_HERE}.interpolate_reduced:interpolate",
            "hhr_dolfinx.reduction.build:assemble",
            _of_one_shape,
        ),
    ),
    bounds=(Bounds(f"{_HERE}.bounding:bounding", _wanted),),
)
