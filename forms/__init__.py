"""The physics, written once: forms in UFL, and laws of flow as closed forms on arrays. Nothing of the package."""
