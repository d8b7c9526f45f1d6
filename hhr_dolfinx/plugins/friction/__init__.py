"""Friction of contacts: Coulomb's and Tresca's laws, for elastic and for inelastic bodies."""

from hhr_dolfinx.registry import Plugin

PLUGIN = Plugin(name="friction", memory=("slip",))
