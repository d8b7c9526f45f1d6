"""Reduced models in files. Needs no DOLFINx."""
