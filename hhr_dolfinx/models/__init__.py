"""Models of arrays with `solve` and `march`, and their answers. The folder needs no DOLFINx."""
