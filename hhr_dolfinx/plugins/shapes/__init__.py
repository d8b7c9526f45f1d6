"""Bodies whose shape depends on parameters: a mesh that moves, and outputs on it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hhr_dolfinx.registry import Plugin, Stage

if TYPE_CHECKING:
    from hhr_dolfinx.models.full import FullModel
    from hhr_dolfinx.reduction.recipe import Recipe

_HERE = "hhr_dolfinx.plugins.shapes"


def _reshaped(full: FullModel, recipe: Recipe) -> bool:
    return full.problem.reshaped is not None


PLUGIN = Plugin(
    name="shapes",
    needs=("elasticity", "moduli", "stress"),
    public={f"{_HERE}.shape": "Shape"},
    classes={
        f"{_HERE}.cells": "Middles MovingCells",
        f"{_HERE}.functionals": "MovingMises ReshapedFunctionals Zone",
        f"{_HERE}.reduced": "ReshapedReconstruction",
        f"{_HERE}.shape": "Shape",
    },
    stages=(
        Stage(
            f"{_HERE}.reduction:interpolate", "hhr_dolfinx.reduction.build:reconstruct", _reshaped
        ),
    ),
    tools={"shapes": f"{_HERE}.reshaped:Reshaped"},
    switches={f"{_HERE}.switches": "shape"},
)
