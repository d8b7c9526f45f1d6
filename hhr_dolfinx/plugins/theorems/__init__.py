"""Theorems of thesis chapter 2: both sides and their constants, to show how sharp they are."""

from hhr_dolfinx.registry import Plugin

PLUGIN = Plugin(
    name="theorems",
    needs=("differences",),
)
