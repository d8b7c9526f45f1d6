"""Rivals: reduced models of other authors and regression, for the table of a study."""

from hhr_dolfinx.registry import Plugin

_HERE = "hhr_dolfinx.plugins.rivals"

PLUGIN = Plugin(
    name="rivals",
    needs=("nonmatching", "studies"),
    public={f"{_HERE}.coarser": "CoarserMesh"},
    parts={
        "rivals": {
            "galerkin": f"{_HERE}.cones:galerkin",
            "nnmf": f"{_HERE}.cones:nnmf",
            "cpg": f"{_HERE}.cones:cone_projected_greedy",
            "inf_sup": f"{_HERE}.cones:inf_sup_greedy",
            "reduced_basis": f"{_HERE}.cones:reduced_basis",
            "dictionary": f"{_HERE}.cones:dictionary",
            "weighted_cells": f"{_HERE}.sampled:weighted_cells",
            "penalty": f"{_HERE}.primal:penalty",
            "nitsche": f"{_HERE}.primal:nitsche",
            "gaussian_process": f"{_HERE}.regression:gaussian_process",
            "radial_functions": f"{_HERE}.regression:radial_functions",
            "polynomials": f"{_HERE}.regression:polynomials",
            "neural_network": f"{_HERE}.regression:neural_network",
            "informed_network": f"{_HERE}.informed:informed_network",
            "thesis": f"{_HERE}.ours:thesis",
            "boxes": f"{_HERE}.boxes:boxes",
            "local": f"{_HERE}.ours:local",
        }
    },
)
