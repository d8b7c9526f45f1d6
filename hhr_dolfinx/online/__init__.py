"""Reduced models in files, and tables of parameters answered by them. Needs no DOLFINx."""
