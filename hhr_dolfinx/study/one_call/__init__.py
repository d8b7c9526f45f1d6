"""One call from a scene to a model that is as exact as somebody wishes."""
