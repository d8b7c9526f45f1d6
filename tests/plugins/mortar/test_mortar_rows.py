"""Rows of mortar pairs on surfaces of raw arrays, beside integrals without the package's geometry.

Lengths are of order 1: 1e-12 is some thousand units of round-off.
"""

import itertools
import warnings

import numpy as np
import pytest
from scipy.integrate import quad
from surfaces import UP2, chain, grid, lines, make, rows_of, sheets, turned

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import PairingWarning, SceneError


@pytest.mark.parametrize("multipliers", ["dual", "standard"])
@pytest.mark.parametrize("axisymmetric", [False, True])
def test_mortar_in_the_plane_against_adaptive_integration(multipliers, axisymmetric):
    rng = np.random.default_rng(4)
    for _ in range(4):
        angle, shift = (0.0, 0.7) if axisymmetric else (rng.uniform(0, 6), 0.0)
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        xs = np.sort(np.append(rng.uniform(0.05, 0.95, rng.integers(1, 5)), [0, 1])) + shift
        inner = rng.uniform(0.3, 0.7, rng.integers(1, 20))
        xm = np.sort(np.append(inner, rng.uniform([-0.3, 0.75], [0.25, 1.3]))) + shift
        ys, ym = 0.1 * np.sin(3 * xs), 0.3 + 0.05 * np.cos(5 * xm)
        weight = (lambda p: 2 * np.pi * p[:, 0]) if axisymmetric else None
        slave, master, points = lines(
            np.column_stack([xs, ys]) @ turn.T,
            np.column_stack([xm, ym]) @ turn.T,
            turn @ np.array(UP2),
            weight,
        )
        rows = rows_of(
            hhr.Mortar(1, 2, tuple(turn @ np.array(UP2)), multipliers), slave, master, points
        )
        low, high = max(xs[0], xm[0]), min(xs[-1], xm[-1])
        breaks = np.unique(np.clip(np.concatenate([xs, xm]), low, high))
        slope = np.hypot(np.diff(xs), np.diff(ys)) / np.diff(xs)

        def cell(x, xs=xs):
            return int(np.clip(np.searchsorted(xs, x, side="right") - 1, 0, len(xs) - 2))

        measure = lambda x: slope[cell(x)] * (2 * np.pi * x if axisymmetric else 1.0)  # noqa: E731
        hat = lambda nodes, k, x: np.interp(x, nodes, np.eye(len(nodes))[k])  # noqa: E731

        def integral(f, breaks=breaks):
            return sum(quad(f, p, q, epsabs=1e-13)[0] for p, q in itertools.pairwise(breaks))

        dual = {}
        for e in range(len(xs) - 1):
            p, q = max(low, xs[e]), min(high, xs[e + 1])
            if q > p:
                mass = np.array(
                    [
                        [
                            quad(lambda x: hat(xs, i, x) * hat(xs, j, x) * measure(x), p, q)[0]
                            for j in (e, e + 1)
                        ]
                        for i in (e, e + 1)
                    ]
                )
                dual[e] = np.diag(mass.sum(axis=1)) @ np.linalg.inv(mass)

        def psi(j, x):
            if multipliers == "standard":
                return hat(xs, j, x)
            e = cell(x)
            if e not in dual or j not in (e, e + 1):
                return 0.0
            return dual[e][j - e] @ [hat(xs, e, x), hat(xs, e + 1, x)]

        along = rows.matrix.toarray().reshape(rows.gap.size, -1, 2) @ (turn @ np.array(UP2))
        for i, j in enumerate(rows.slaves):
            area = integral(lambda x: psi(j, x) * measure(x))
            gap = integral(
                lambda x: psi(j, x) * (np.interp(x, xm, ym) - np.interp(x, xs, ys)) * measure(x)
            )
            k = int(rng.integers(len(xm)))
            pull = integral(lambda x: psi(j, x) * hat(xm, k, x) * measure(x))
            # unscaled by the area, which may be small at a hardly covered node
            np.testing.assert_allclose(
                [rows.areas[i], rows.gap[i] * area, -along[i, len(xs) + k] * area],
                [area, gap, pull],
                atol=1e-11,
            )
            if multipliers == "dual":
                assert np.flatnonzero(along[i, : len(xs)]).tolist() == [j]
        np.testing.assert_allclose(rows.areas.sum(), integral(measure), rtol=1e-12)


def facet_loads(points, facets):
    """Nodal forces of a unit pressure on flat facets, with more points than any polynomial here
    needs.
    """
    out, c = np.zeros(len(points)), points[facets]
    if facets.shape[1] == 3:
        sizes = np.linalg.norm(np.cross(c[:, 1] - c[:, 0], c[:, 2] - c[:, 0]), axis=1) / 2
        np.add.at(out, facets, sizes[:, None] / 3)
        return out
    nodes, weights = np.polynomial.legendre.leggauss(4)
    for u, a in zip((nodes + 1) / 2, weights / 2, strict=True):
        for v, b in zip((nodes + 1) / 2, weights / 2, strict=True):
            along = (1 - v) * (c[:, 1] - c[:, 0]) + v * (c[:, 3] - c[:, 2])
            across = (1 - u) * (c[:, 2] - c[:, 0]) + u * (c[:, 3] - c[:, 1])
            size = np.linalg.norm(np.cross(along, across), axis=1)
            np.add.at(
                out,
                facets,
                size[:, None]
                * a
                * b
                * np.array([(1 - u) * (1 - v), u * (1 - v), (1 - u) * v, u * v]),
            )
    return out


def check_one_slave(rows, slaves):
    """Each row touches one of the slave nodes, which are the first ones."""
    touched = (
        np.abs(rows.matrix.toarray()).reshape(rows.gap.size, -1, 3).sum(axis=2)[:, :slaves] > 0
    )
    assert (touched.sum(axis=1) == 1).all()


@pytest.mark.parametrize("multipliers", ["dual", "standard"])
@pytest.mark.parametrize(
    "triangles, jitter", [(True, 0.0), (True, 0.3), (False, 0.0), (False, 0.25)]
)
def test_patch_of_constant_pressure_in_space(multipliers, triangles, jitter):
    """Forces areas * p must be the consistent loads of p on both sides; 1e-10 as a patch test
    asks.
    """
    rng = np.random.default_rng(5)
    for cells in ((4, 5), (1, 12), (12, 1)):
        turn = turned(rng)
        a = grid(cells[0], cells[0], 0.0, triangles=triangles, jitter=jitter, rng=rng)
        b = grid(cells[1], cells[1], 0.1, triangles=triangles, jitter=jitter, rng=rng)
        slave, master, points = sheets(a, b, turn)
        rows = rows_of(hhr.Mortar(1, 2, None, multipliers), slave, master, points)
        assert rows.gap.size == len(a[0]) and abs(rows.areas.sum() - 1) < 1e-12
        np.testing.assert_allclose(rows.gap, 0.1, atol=1e-12)
        force = (rows.matrix.T @ rows.areas).reshape(-1, 3) @ turn
        exact = np.concatenate([facet_loads(*a), -facet_loads(*b)])
        np.testing.assert_allclose(force[:, 2], exact, atol=1e-10 * np.abs(exact).max())
        np.testing.assert_allclose(force[:, :2], 0, atol=1e-12)
        np.testing.assert_allclose(
            rows.matrix @ np.tile(rng.normal(size=3), len(points)), 0, atol=1e-11
        )
        if multipliers == "dual":
            check_one_slave(rows, len(a[0]))


@pytest.mark.parametrize("part", [0.5, 0.01])
def test_dual_rows_touch_one_slave_on_hardly_covered_facets(part):
    a, b = grid(3, 3, 0.0), grid(4, 4, 0.1, (0, 0), (2 / 3 + part / 3,) * 2)
    check_one_slave(rows_of(hhr.Mortar(1, 2), *sheets(a, b)), 16)


def stack_of_thin_plates():
    """Two interfaces under one pair of tags, and the surfaces and points of both."""
    x, thick = np.linspace(0, 1, 5), 0.2
    points = np.vstack(
        [np.column_stack([x, 0 * x + y]) for y in (0, 0.01 + thick, 0.01, 0.02 + thick)]
    )
    a, b = np.vstack([chain(5), chain(5, 5)]), np.vstack([chain(5, 10), chain(5, 15)])
    slave = make(1, points, a, points[a].mean(axis=1) - [0, thick / 2])
    master = make(2, points, b, points[b].mean(axis=1) + np.array([0, thick / 2]))
    return slave, master, points


def test_mortar_takes_the_near_layer_of_a_stack_or_refuses():
    rows = rows_of(hhr.Mortar(1, 2), *stack_of_thin_plates())
    np.testing.assert_allclose(rows.areas.sum(), 2, rtol=1e-12)
    np.testing.assert_allclose(rows.gap, 0.01, atol=1e-12)
    with pytest.raises(
        SceneError, match=r"several layers of master surface 2 face slave surface 1 at \["
    ):
        rows_of(hhr.Mortar(1, 2, UP2), *stack_of_thin_plates())


def test_a_way_through_the_own_body_is_none():
    """The slave's upper plate stands between its lower one and the master."""
    x = np.linspace(0, 1, 5)
    heights = {"lower": (0.0, 0.2), "upper": (0.3, 0.5), "master": (0.51,)}
    points = np.vstack([np.column_stack([x, 0 * x + y]) for row in heights.values() for y in row])
    sides = [chain(5, 5 * k) for k in range(5)]
    slave = np.vstack(sides[:4])
    inner = points[slave].mean(axis=1) + np.repeat([[0, 0.1], [0, -0.1]] * 2, 4, axis=0)
    with warnings.catch_warnings(
        action="error", category=PairingWarning
    ):  # nothing lies beyond an edge
        master = make(2, points, sides[4], points[sides[4]].mean(axis=1) + np.array([0, 0.1]))
        found = hhr.Mortar(2, 1).rows((make(1, points, slave, inner), master), points.size)
    assert found.gap == pytest.approx(0.01, abs=1e-12) and found.gap.size == 5
