"""Materials as numbers: elastic constants. No UFL."""
