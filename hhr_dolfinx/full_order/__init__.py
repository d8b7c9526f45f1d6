"""From a scene to matrices, and the full-order models. The only room that assembles."""
