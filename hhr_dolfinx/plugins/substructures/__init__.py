"""Substructures: several ranks share K^-1 between the dofs of contact, each eliminates its interior
rows.
"""

from hhr_dolfinx.registry import Plugin

PLUGIN = Plugin(
    name="substructures",
    tools={"substructures": "hhr_dolfinx.plugins.substructures.factors:Substructures"},
)
