"""Materials as numbers: elastic constants, laws of flow, the update of all Gauss points, strain there. No UFL."""
