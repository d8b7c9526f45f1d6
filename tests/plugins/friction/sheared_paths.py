"""Outputs and random paths of blocks that are pressed and sheared, and the resultants of their
forces.
"""

import numpy as np

import hhr_dolfinx as hhr


def resultants(full, answer):
    """Sum of pressures, and of tangential forces on the slave along x."""
    friction = full.problem.law
    tangential = -answer.multipliers[friction.tangential] @ friction.tangents[:, 0]
    return answer.multipliers[friction.normal].sum(), tangential


OUTPUTS = (
    hhr.ContactForce("normal", 0, (0.0, 1.0)),
    hhr.ContactForce("shear", 0, (1.0, 0.0)),
    hhr.LargestSlip("slip", 0),
    hhr.DissipatedWork("work", 0),
    hhr.StickArea("sticks", 0),
    hhr.SlipArea("slips", 0),
)

BOX = {"f": (0.1, 0.6)}


def paths(count: int, seed: int, space: hhr.ParameterSpace) -> list:
    """Through random points of the box of loads, with what else varies the same along each.

    Pushed first.
    """
    rng = np.random.default_rng(seed)
    low, high = np.array(space.lower), np.array(space.upper)
    found = []
    for _ in range(count):
        points = low + rng.random((7, low.size)) * (high - low)
        points[:, 2:] = points[0, 2:]
        points[0, :2] = 0.0
        corners = np.arange(len(points))
        fine = np.linspace(0, len(points) - 1, 25)
        found.append(
            [
                (float(t), np.array([np.interp(t, corners, column) for column in points.T]))
                for t in fine
            ]
        )
    return found
