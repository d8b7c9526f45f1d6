"""Histories: one loop over time steps, and what each kind of model says of a step."""
