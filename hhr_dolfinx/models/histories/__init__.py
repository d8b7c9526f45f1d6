"""Histories: one loop over time steps for all models, and the steps of each kind of model."""
