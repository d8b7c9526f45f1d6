"""Training and condensation of a scene; settings and views that its file may hold."""
