"""From a scene to matrices, and the full-order models. The only folder that assembles."""
