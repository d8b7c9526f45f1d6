"""Materials as numbers: elastic constants, laws of plasticity and creep, strain and update at Gauss points. No UFL."""
