"""Eliminations: from a point to the condensed contact problem there."""
