"""What answers: models of arrays with `solve` and `march`, and the answers they give. Needs no DOLFINx."""
