"""Reduced models in files, and their answers to tables of parameters. Needs no DOLFINx."""
