"""Inelastic bodies: plasticity, creep and viscoplasticity along histories."""

from hhr_dolfinx.registry import Plugin

PLUGIN = Plugin(name="inelastic", memory=("gauss",))
