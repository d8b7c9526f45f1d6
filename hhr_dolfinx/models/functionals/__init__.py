"""Outputs of an answer as numbers, with their derivatives."""
