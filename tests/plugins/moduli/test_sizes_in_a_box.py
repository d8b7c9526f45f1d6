"""Sizes of arrays that are interpolated together: of the whole box, not of a point where one may
vanish.
"""

import numpy as np
import pytest
from scenes import space

from hhr_dolfinx.plugins.moduli.interpolate import GridSettings, grown

TOLERANCE = 1e-6


def gaps(point):
    """Gaps about a fit, with the round-off of coordinates."""
    a, b = point
    return {
        "misfit": np.array([a, -2 * a]) + 1e-17,
        "product": np.array([a * b * np.exp(a)]) + 1e-17,
        "closed": np.random.default_rng(int(1e6 * (2 + a + b))).normal(size=3) * 1e-17,
        "stiffness": np.array([3.0 / (2 + b), 1.0]),
    }


@pytest.mark.parametrize("size", [1.0, 1e-3])
def test_arrays_that_vanish_in_the_middle(size):
    """Each is as exact as the tolerance relative to its own size, and the budget is not spent on
    round-off.
    """
    box = space(a=(-size, size), b=(-size, size))
    settings = GridSettings(TOLERANCE, 200)
    grid, modes = grown(gaps, box, (0, 1), settings, round_off={"closed": 1e-8})
    assert grid.surplus <= TOLERANCE and grid.evaluations < settings.budget
    largest = gaps(np.array([size, size]))
    for point in box.random(20, seed=3):
        along = grid.interpolant.along_modes(point)
        for name, value in gaps(point).items():
            off = np.abs(modes[name] @ along - value).max()
            assert off <= (
                1e-14 if name == "closed" else 100 * TOLERANCE * np.abs(largest[name]).max()
            ), name


def test_each_point_is_solved_once():
    """The growth takes over the points from which sizes are known."""
    points = []

    def solved(point):
        points.append(tuple(point))
        return gaps(point)

    grid, _ = grown(
        solved,
        space(a=(-1, 1), b=(-1, 1)),
        (0, 1),
        GridSettings(TOLERANCE, 200),
        round_off={"closed": 1e-8},
    )
    assert len(points) == len(set(points)) == grid.evaluations
    points.clear()
    grid, _ = grown(
        solved,
        space(a=(-1, 1), b=(-1, 1)),
        (0, 1),
        GridSettings(TOLERANCE, 5),
        round_off={"closed": 1e-8},
    )
    assert len(points) == len(set(points)) == grid.evaluations
