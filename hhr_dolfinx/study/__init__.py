"""Error against run time: measured, reported and drawn."""
