"""Studies of error against run time: measured, reported and drawn."""
