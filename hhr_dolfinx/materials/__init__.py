"""Materials as numbers: elastic constants, and strain at Gauss points. No UFL."""
