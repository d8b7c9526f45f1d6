"""Elasticity beyond constant moduli: formulas, gradings, nearly incompressible bodies, springs,
strains as loads.
"""

from hhr_dolfinx.registry import Plugin

PLUGIN = Plugin(
    name="elasticity",
    tools={"elasticity": "hhr_dolfinx.plugins.elasticity.varying:VaryingElasticity"},
)
