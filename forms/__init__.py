"""UFL forms: the physics, written once. They need nothing of the package but UFL."""
