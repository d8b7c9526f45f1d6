"""The box of the parameters: differences inside of it, and tables of points."""

import time

import numpy as np
import pytest

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import ParameterError

BOX = hhr.ParameterSpace(("a", "b"), (0.0, -2.0), (1.0, 3.0))


def curved(point):
    return np.array([np.exp(2 * point[0]) + point[1], np.sin(point[0]) * point[1]])


def slopes(point):
    return np.array([[2 * np.exp(2 * point[0]), 1.0], [np.cos(point[0]) * point[1], np.sin(point[0])]])


@pytest.mark.parametrize("point", [(0.0, -2.0), (1.0, 3.0), (0.5, 0.0), (0.0, 3.0), (5e-4, 2.999)])
def test_differences_are_of_second_order_up_to_the_ends(point):
    """The error falls with the square of the step, in the middle, at the ends and nearer to them than a step."""
    point = np.array(point)
    inside = []

    def value(moved):
        inside.append(((moved >= BOX.lower) & (moved <= BOX.upper)).all())
        return curved(moved)

    coarse, fine = (np.abs(BOX.differences(value, point, part) - slopes(point)).max() for part in (4e-3, 1e-3))
    assert all(inside)
    # sixteen for the square; 12 leaves room for the next term, 4 is the first order
    assert fine <= coarse / 12 and fine <= 2e-5


def test_a_table_is_checked_as_a_whole():
    """A million rows in a moment; the first wrong row is named, and NaN is wrong."""
    table = BOX.random(1_000_000, 0)
    start = time.perf_counter()
    found = BOX.points(table)
    assert time.perf_counter() - start < 3.0  # row by row it took 13 s
    assert np.array_equal(found, table) and found is not table
    ends = np.array([BOX.lower, BOX.upper]) + 1e-13 * np.array([[-1.0, -1.0], [1.0, 1.0]])
    assert np.array_equal(BOX.points(ends), ends)  # grids that end there, to round-off
    for value, said in ((1.5, r"row 70: a = 1.5 is outside \[0, 1\]"), (np.nan, "row 70: a = nan is not finite")):
        table[[70, 900], 0] = value
        with pytest.raises(ParameterError, match=said):
            BOX.points(table)
