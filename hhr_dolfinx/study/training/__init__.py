"""Trainings: what to solve, and what is built of it."""
