"""What answers: the reduced model, whole fields from it, its file, tables of parameters. Needs no DOLFINx."""
