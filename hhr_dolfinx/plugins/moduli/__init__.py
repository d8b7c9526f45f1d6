"""Elastic bodies whose stiffness or shape depends on parameters: S and K~^-1, interpolated between few of them."""

from hhr_dolfinx.registry import Plugin

_HERE = "hhr_dolfinx.plugins.moduli"

PLUGIN = Plugin(
    name="moduli",
    classes={
        f"{_HERE}.varying_bound": "PartEnergy VaryingBound",
        f"{_HERE}.interpolated": "Compliance Compliances InterpolatedFields PrimalModes",
        f"{_HERE}.interpolation": "Interpolant",
        f"{_HERE}.shaped": "InterpolatedProblem ReshapedElimination",
        f"{_HERE}.shaped_functionals": "ReshapedFunctionals Zone",
    },
)
