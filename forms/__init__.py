"""The physics in UFL: small strain, loads, areas of contact surfaces, and the return mapping, a
reference in tests.
"""
