"""One call from a scene to a model of a given accuracy."""
