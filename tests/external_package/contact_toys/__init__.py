"""A package of a user's own, which hhr_dolfinx knows by its entry points alone."""
