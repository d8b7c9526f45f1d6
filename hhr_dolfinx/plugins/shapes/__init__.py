"""Bodies whose shape depends on parameters: a mesh that moves, and outputs on it."""

from hhr_dolfinx.registry import Plugin

_HERE = "hhr_dolfinx.plugins.shapes"

PLUGIN = Plugin(
    name="shapes",
    needs=("moduli", "stress"),
    public={f"{_HERE}.shape": "Shape"},
    classes={
        f"{_HERE}.cells": "Middles MovingCells",
        f"{_HERE}.functionals": "MovingMises ReshapedFunctionals Zone",
        f"{_HERE}.shape": "Shape",
    },
    tools={"shapes": f"{_HERE}.reshaped:Reshaped"},
    switches={f"{_HERE}.switches": "shape"},
)
