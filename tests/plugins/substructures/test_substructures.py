"""Ranks that eliminate what is inside of their rows: covers of couplings, shares of meshes, parts
of the border.
"""

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mpi4py import MPI

from hhr_dolfinx.geometries.partition import shares
from hhr_dolfinx.plugins.substructures import border
from hhr_dolfinx.plugins.substructures.border import DenseFactors, _cover, _owners

EDGES = st.lists(st.tuples(st.integers(0, 5), st.integers(10, 15)), max_size=14)


@settings(deadline=None)
@given(EDGES)
def test_no_fewer_vertices_cover_all_edges(edges):
    one = np.array([edge[0] for edge in edges], dtype=np.int64)
    other = np.array([edge[1] for edge in edges], dtype=np.int64)
    found = set(_cover(one, other).tolist())
    assert all(edge[0] in found or edge[1] in found for edge in edges)
    every = sorted({vertex for edge in edges for vertex in edge})
    for some in combinations(every, max(len(found) - 1, 0)) if found else ():
        assert not all(edge[0] in some or edge[1] in some for edge in edges)


def grid(*cells):
    """Points and cells of a block of cubes."""
    points = np.stack(
        np.meshgrid(*(np.arange(count + 1.0) for count in cells), indexing="ij"), axis=-1
    ).reshape(-1, 3)
    numbers = np.arange(len(points)).reshape([count + 1 for count in cells])
    corners = [
        numbers[x : x + cells[0], y : y + cells[1], z : z + cells[2]]
        for x, y, z in np.ndindex(2, 2, 2)
    ]
    return points, np.stack(corners, axis=-1).reshape(-1, 8)


@pytest.mark.parametrize("count", [1, 2, 3, 4, 7])
def test_each_body_is_shared_out_alike_by_flat_cuts(count):
    """Two bodies of other sizes: all ranks have as much of each, and two halves have one layer of
    points in common.
    """
    bodies = [grid(12, 6, 4), grid(9, 4, 5)]
    points = np.concatenate([bodies[0][0], bodies[1][0] + 10.0])
    cells = np.concatenate([bodies[0][1], bodies[1][1] + len(bodies[0][0])])
    found = shares(points, cells, count)
    first = len(bodies[0][1])
    for body in (found[:first], found[first:]):
        sizes = np.bincount(body, minlength=count)
        assert len(sizes) == count and sizes.max() - sizes.min() <= 2
    if count == 2:
        sides = [cells[:first][found[:first] == side] for side in (0, 1)]
        assert np.intersect1d(*sides).size == 7 * 5


@pytest.mark.parametrize("count", [2, 3, 5])
def test_bodies_of_fewer_cells_than_ranks_go_round(count):
    """All of a body where there is least: no rank is without cells as long as there are bodies
    enough.
    """
    one, cells = grid(1, 1, 1)
    bodies = [(one + 5.0 * number, cells + 8 * number) for number in range(12)]
    found = shares(
        np.concatenate([body[0] for body in bodies]),
        np.concatenate([body[1] for body in bodies]),
        count,
    )
    sizes = np.bincount(found, minlength=count)
    assert sizes.max() - sizes.min() <= 1


def test_work_of_ranks_differs_by_no_more_than_a_part():
    sizes = [500, 400, 390, 380, 100, 90]
    owners = np.array(_owners(sizes, 3))
    work = [
        sum(size**3 for size, owner in zip(sizes, owners, strict=True) if owner == rank)
        for rank in range(3)
    ]
    assert max(work) - min(work) <= max(sizes) ** 3
    assert set(owners) == {0, 1, 2}


def test_triangles_are_added_where_they_belong(monkeypatch):
    """In blocks of rows, at places that are not all neighbours.

    What is below the diagonal does not count.
    """
    monkeypatch.setattr(border, "SENT", 12)
    places = np.array([0, 1, 2, 5, 6, 9])
    left = np.random.default_rng(0).standard_normal((6, 6))
    assert len(border._blocks(6)) == 3
    total = border.gathered(border.BorderPart(slice(0, 10), 0, 0), places, left, MPI.COMM_SELF)
    expected = np.zeros((10, 10))
    expected[np.ix_(places, places)] = np.triu(left)
    np.testing.assert_array_equal(np.triu(total), expected)


def test_the_inverse_is_that_between_the_rows_that_are_asked_for():
    rng = np.random.default_rng(1)
    half = rng.standard_normal((8, 8))
    matrix = half @ half.T + 8 * np.eye(8)
    given_rows = np.triu(matrix) + np.tril(rng.standard_normal((8, 8)), -1)
    found = DenseFactors(given_rows.copy(), 5)
    assert found.definite
    np.testing.assert_allclose(found.inverse(), np.linalg.inv(matrix)[5:, 5:], rtol=1e-12)
    loads = rng.standard_normal((8, 2))
    np.testing.assert_allclose(matrix @ found.solve(loads), loads, atol=1e-12)
    assert not DenseFactors(-given_rows, 5).definite
