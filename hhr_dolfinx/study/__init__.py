"""Training and condensation of a scene."""
