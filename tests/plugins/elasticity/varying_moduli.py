"""Moduli of two blocks that are formulas of parameters, and meshes of each hypothesis."""

import numpy as np
import scenes

BODIES = ("E1", "nu1"), ("E2 * (1 + 0.2 * c**2)", "0.3 + 0.1 * sin(c)")
MATERIALS = {"E1": (1.0, 6.0), "nu1": (0.1, 0.42), "E2": (2.0, 9.0), "c": (0.0, 1.0)}
MESHES = {
    "plane_strain": {"cells": 3},
    "plane_stress": {"cells": 3, "simplices": True},
    "axisymmetric": {"cells": 3, "matching": False},
    "solid": {"cells": 2},
}


def check_same(answer, other, tolerance=1e-12):
    """Round-off, about 1e-15 times the condition number of K."""
    scenes.check_like(answer, other, displacement=tolerance, forces=tolerance, stress=tolerance)
    assert np.array_equal(answer.active, other.active)
