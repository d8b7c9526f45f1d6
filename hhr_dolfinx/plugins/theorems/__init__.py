"""Theorems of thesis chapter 2: both sides and their constants, to show how sharp they are."""

from hhr_dolfinx.registry import Plugin, Stage

PLUGIN = Plugin(
    name="theorems",
    needs=("exact_errors",),
    stages=(
        Stage(
            "hhr_dolfinx.plugins.theorems.full_constants:measure",
            "hhr_dolfinx.reduction.build:assess_projection",
        ),
    ),
)
