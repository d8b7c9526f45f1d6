"""Sparse grids that grow: exact for polynomials, exponential for smooth functions, nodes where they
are needed.
"""

import numpy as np
import pytest

from hhr_dolfinx.plugins.moduli.interpolation import MOST_LEVELS, grow, leja_points


def box(*ends):
    """Places and bounds of the axes, as they are of a larger point: every second parameter."""
    return np.arange(len(ends)) * 2, *np.array(ends, dtype=float).reshape(-1, 2).T


def whole(values):
    """A point of all parameters, of which every second one is an axis."""
    point = np.full(max(1, 2 * len(values)), np.nan)
    point[: 2 * len(values) : 2] = values
    return point


def grown(function, area, tolerance=1e-12, budget=400):
    """The grid of a function of its own axes, sizes relative to that in the middle."""
    middle = float(np.linalg.norm(function((area[1] + area[2]) / 2))) or 1.0
    return grow(
        function, lambda surplus: float(np.linalg.norm(surplus)) / middle, area, tolerance, budget
    )


def worst(grid, function, area, count=200):
    """Largest error on random points, relative to the largest value."""
    points = np.random.default_rng(3).uniform(area[1], area[2], (count, len(area[1])))
    values = np.array([function(point) for point in points])
    found = np.array([grid.interpolant.value(whole(point)) for point in points])
    return np.abs(found - values).max() / np.abs(values).max()


def test_leja_points_are_distinct_and_spread():
    points = np.array(leja_points())
    assert len(points) == MOST_LEVELS and points[:3].tolist() == [0.0, 1.0, -1.0]
    assert np.diff(np.sort(points)).min() > 1e-3 and np.abs(points).max() == 1.0
    # the Lebesgue constant of those chosen so grows slowly
    nodes, x = points[:20], np.linspace(-1, 1, 1001)
    lagrange = [np.prod([(x - b) / (a - b) for b in nodes if b != a], axis=0) for a in nodes]
    assert np.abs(lagrange).sum(axis=0).max() < 20


AREA = box((-1.0, 3.0), (10.0, 11.0), (0.0, 1e-3))


def polynomial(x):
    a, b, c = x[0], x[1] - 10.0, 1e3 * x[2]
    return np.array([1 + a**4 - 3 * a * b + c**3, b**2 * c - a * b * c, a**2 * b**2 * c**2, 7.0])


def test_polynomials_and_their_derivatives_are_reproduced_exactly():
    grid = grown(polynomial, AREA)
    assert worst(grid, polynomial, AREA) < 1e-12
    assert grid.surplus <= 1e-12
    # 27 products of degrees up to 2, the powers beyond, and the shell of those that were tried in
    # vain
    assert 27 < grid.evaluations < 90
    scale = np.array([1.0, 1.0, 1e3])
    for point in np.random.default_rng(1).uniform(AREA[1], AREA[2], (10, 3)):
        a, b, c = point[0], point[1] - 10.0, 1e3 * point[2]
        exact = [
            [4 * a**3 - 3 * b, -3 * a, 3 * c**2],
            [-b * c, 2 * b * c - a * c, b**2 - a * b],
            [2 * a * b**2 * c**2, 2 * a**2 * b * c**2, 2 * a**2 * b**2 * c],
            [0, 0, 0],
        ]
        found = grid.interpolant.modes @ grid.interpolant.slopes_along_modes(whole(point))
        assert found == pytest.approx(np.array(exact) * scale, rel=1e-9, abs=1e-9 * scale.max())


def test_nodes_go_where_they_are_needed():
    """A function that hardly depends on one of three axes, and not at all on another."""
    area = box((-1.0, 1.0), (-1.0, 1.0), (-1.0, 1.0))
    grid = grown(lambda x: np.array([1 / (1.3 + x[0]) + 0.01 * x[1]]), area, 1e-8)
    highest = grid.interpolant.levels.max(axis=0)
    assert highest[0] > 12 and highest[1] == 2 and highest[2] == 2
    assert (
        grid.evaluations < 3 * highest[0] + 10
    )  # each level tries the products with the other two


@pytest.mark.parametrize(
    ("function", "accuracy"),
    [
        # odd about the middle: x^2 has no surplus on a node where it is as in the middle, and even
        # functions at first
        (lambda x: 1 + x[0] * (x[0] - 1), 1e-12),
        (lambda x: 2 + x[1] * (1 - x[1]) * x[0] + x[0] + x[1] ** 2, 1e-12),
        (lambda x: 3 + x[0] * (1 - x[0]) * x[1] * (1 - x[1]), 1e-10),
        # constant along both axes through the middle, or zero in the middle and at both ends
        (lambda x: 2 + x[0] * x[1], 1e-7),
        (lambda x: 2 + np.sin(np.pi * x[0]), 1e-7),
        (lambda x: 2 + x[0] * x[1] ** 3, 1e-7),
    ],
)
def test_what_vanishes_at_first_nodes_by_chance_is_found_elsewhere(function, accuracy):
    area = box((-1.0, 1.0), (-1.0, 1.0))
    assert (
        worst(grown(lambda x: np.array([function(x)]), area), lambda x: [function(x)], area)
        < accuracy
    )


@pytest.mark.parametrize("budget", [1, 2, 5, 17])
def test_the_budget_is_kept(budget):
    calls = []
    area = box((-1.0, 1.0), (0.0, 1.0))

    def function(x):
        calls.append(tuple(x))
        return np.array([np.exp(x[0]) / (1.1 + x[1])])

    grid = grown(function, area, 1e-14, budget)
    del calls[0]  # of the size in the middle
    assert len(calls) == len(set(calls)) == grid.evaluations == budget
    assert grid.interpolant.levels.shape == (budget, 2)
    for point in calls:  # what was evaluated is interpolated
        assert grid.interpolant.value(whole(point)) == pytest.approx(
            [np.exp(point[0]) / (1.1 + point[1])], rel=1e-12
        )


def compliance(x):
    return np.array([1 / (x[0] + 2.0), x[0] / (1 - 2 * x[1]), np.sqrt(x[0] * x[1])])


SMOOTH = {
    "two moduli": (compliance, box((1.0, 3.0), (0.2, 0.4)), 10, 150, (1e-2, 1e-4, 1e-6, 1e-8)),
    "exponential": (
        lambda x: np.exp(x[:1] + 2 * x[1]),
        box((0.0, 1.0), (0.0, 1.0)),
        20,
        60,
        (1e-1, 1e-3, 1e-6),
    ),
}


@pytest.mark.parametrize("name", SMOOTH)
def test_the_tolerance_ends_it(name):
    """The error, in tolerances, and few solutions: it converges exponentially."""
    function, area, most, budget, tolerances = SMOOTH[name]
    for tolerance in tolerances:
        grid = grown(function, area, tolerance)
        assert grid.surplus <= tolerance and grid.evaluations < budget
        assert worst(grid, function, area) < most * tolerance


def test_without_axes_it_is_a_constant():
    grid = grow(lambda x: np.array([3.0, -4.0]), lambda surplus: 1.0, box(), 1e-5, 10)
    assert grid.evaluations == 1 and grid.surplus == 0.0
    assert grid.interpolant.value(np.array([7.0])) == pytest.approx([3.0, -4.0])
    assert grid.interpolant.slopes_along_modes(np.array([7.0])).shape[1] == 0


def test_a_function_that_is_zero_stays_zero():
    area = box((0.0, 1.0))
    grid = grown(lambda x: np.zeros(3), area, 1e-8, 50)
    assert grid.evaluations <= 5 and not grid.interpolant.value(whole([0.3])).any()


def test_long_axes_end():
    """A kink needs more levels than there are: the surplus says what is left."""
    area, function = box((-1.0, 1.0)), lambda x: np.array([abs(x[0] - 0.1)])
    grid = grown(function, area, 1e-10, 1000)
    assert grid.evaluations == MOST_LEVELS
    assert grid.interpolant.levels.max() == MOST_LEVELS - 1 and grid.surplus > 1e-4


def test_many_values_are_kept_by_few_modes():
    """A thousand values of rank three."""
    shapes = np.random.default_rng(0).standard_normal((1000, 3))
    area, function = box((0.0, 1.0)), lambda x: shapes @ np.array([1.0, x[0], np.exp(x[0])])
    grid = grown(function, area, 1e-10)
    assert grid.interpolant.modes.shape == (1000, 3) and grid.interpolant.modes.flags.f_contiguous
    assert worst(grid, function, area) < 1e-8


@pytest.mark.parametrize("budget", range(1, 30))
def test_a_budget_that_ends_it_is_told(budget):
    """What is left is at least a hundredth of the error, whatever term was followed last."""
    area, function = box((-1.0, 1.0), (-1.0, 1.0)), lambda x: np.array([1 / (1.15 + x[1])])
    grid = grown(function, area, 1e-5, budget)
    assert (
        grid.surplus * function([0.0, 0.0])[0]
        > worst(grid, function, area, 50) * function([0.0, -1.0])[0] / 100
    )
