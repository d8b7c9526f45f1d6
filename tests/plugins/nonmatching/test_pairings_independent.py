"""Independent checks of the pairings and of the RID closure: nothing here trusts the package's own
geometry.

Surfaces are built from raw arrays. Tolerances: lengths are of order 1, so 1e-12 is some thousand
units of round-off; where a sampling minimises a distance, the distance (second order in the
position) is good to 1e-9.
"""

import dataclasses

import numpy as np
import pytest
from needs import needs
from scenes import check_closed, pair_scene
from surfaces import UP2, UP3, chain, grid, lines, make, rows_of, sheets, turned

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import PairingWarning, ReductionError
from hhr_dolfinx.geometries.two_blocks import side
from hhr_dolfinx.plugins.nonmatching.projection import closest_points
from hhr_dolfinx.reduction.projection import project, reduced_domain
from hhr_dolfinx.warn import ignored


def nearest_on_segment(x, a, b):
    t = np.clip((x - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
    return a + t * (b - a)


def nearest(x, corners):
    """Distance to all facets: exact for segments and triangles, nested refinement of a sampling for
    quadrilaterals.
    """
    best = np.inf
    for c in corners:
        if len(c) == 2:
            foot = nearest_on_segment(x, *c)
            best = min(best, np.linalg.norm(x - foot))
        elif len(c) == 3:
            g = np.array([c[1] - c[0], c[2] - c[0]]).T
            u = np.linalg.lstsq(g, x - c[0], rcond=None)[0]
            feet = [nearest_on_segment(x, c[i], c[j]) for i, j in ((0, 1), (1, 2), (2, 0))]
            if (u >= 0).all() and u.sum() <= 1:
                feet.append(c[0] + g @ u)
            best = min(best, *(np.linalg.norm(x - foot) for foot in feet))
        elif np.linalg.norm(c - x, axis=1).min() < best + np.ptp(c, axis=0).max() * 2:
            middle, half = np.array([0.5, 0.5]), 0.5
            for _ in range(
                22
            ):  # each pass keeps the best of 9 x 9 samples and a quarter of the window and more
                s = [np.clip(middle[i] + half * np.linspace(-1, 1, 9), 0, 1) for i in (0, 1)]
                u, v = (item.ravel() for item in np.meshgrid(*s, indexing="ij"))
                n = np.stack([(1 - u) * (1 - v), u * (1 - v), (1 - u) * v, u * v])
                d = np.linalg.norm(n.T @ c - x, axis=1)
                middle, half = np.array([u[d.argmin()], v[d.argmin()]]), half * 0.4
            best = min(best, d.min())
    return best


ARC = np.column_stack([np.cos(np.linspace(0, np.pi, 15)), np.sin(np.linspace(0, np.pi, 15))])


@pytest.mark.parametrize("scale", [1.0, 1e6, 1e-5, 1e-9])
def test_closest_points_of_an_arc_in_any_unit(scale):
    rng = np.random.default_rng(0)
    x, corners = rng.uniform(-1.2, 1.2, (80, 2)), np.stack([ARC[:-1], ARC[1:]], axis=1)
    feet = closest_points(x * scale, corners * scale)
    found = np.linalg.norm(feet.offsets, axis=1) / scale
    np.testing.assert_allclose(found, [nearest(p, corners) for p in x], atol=1e-12)


def cap(x, y):
    """Near the top of a sphere."""
    return 1 - np.sqrt(1 - (x**2 + y**2) / 3)


def wave(x, y):
    """A surface whose quadrilaterals are warped."""
    return 0.1 * np.sin(7 * x) * np.cos(5 * y)


@pytest.mark.parametrize(
    ("height", "cells", "triangles", "jitter", "away"),
    [(cap, 5, True, 0.2, 0.5), (cap, 5, False, 0.2, 0.5), (wave, 7, False, 0.0, 0.3)],
)
def test_closest_points_in_space(height, cells, triangles, jitter, away):
    """A jittered sphere is only slightly warped: the convex hulls that GJK takes are the facets
    within 1e-9.
    """
    rng = np.random.default_rng(1)
    points, facets = grid(cells, cells, height, triangles=triangles, jitter=jitter, rng=rng)
    x = rng.uniform(-0.1 if jitter else 0.0, 1.1 if jitter else 1.0, (60, 2))
    x = np.column_stack([x, height(*x.T) + rng.uniform(-away, away, 60)])
    found = np.linalg.norm(closest_points(x, points[facets]).offsets, axis=1)
    np.testing.assert_allclose(found, [nearest(p, points[facets]) for p in x], atol=1e-9)


@pytest.mark.parametrize("triangles", [True, False])
def test_rays_and_rigid_motion(triangles):
    """Against a plane hit by rays; B of a translation is 0.

    Moving the slave by t changes the gap by -B t.
    """
    rng = np.random.default_rng(3)
    for _ in range(3):
        turn = turned(rng)
        tilt = lambda x, y: 0.3 + 0.1 * x - 0.2 * y  # noqa: E731
        a = grid(4, 4, lambda x, y: 0.05 * np.sin(3 * x), triangles=triangles, jitter=0.3, rng=rng)
        b = grid(3, 5, tilt, (-0.5, -0.5), (1.5, 1.5), not triangles, 0.3, rng)
        for normal in (None, tuple(turn @ np.array(UP3))):
            slave, master, points = sheets(a, b, turn)
            rows = rows_of(hhr.NodeToSurface(1, 2, normal), slave, master, points)
            assert rows.gap.size == len(a[0])
            local = rows.points @ turn
            exact = tilt(*local[:, :2].T) - local[:, 2]
            if normal is None:
                exact /= np.sqrt(1 + 0.1**2 + 0.2**2)
            np.testing.assert_allclose(rows.gap, exact, atol=1e-12)
            t = rng.uniform(-0.1, 0.1, 3) if normal is None else 0.1 * np.array(normal)
            moved = rows_of(
                hhr.NodeToSurface(1, 2, normal), *sheets((a[0] + turn.T @ t, a[1]), b, turn)
            )
            motion = np.zeros_like(points)
            motion[: len(a[0])] = t
            np.testing.assert_allclose(
                moved.gap, rows.gap - rows.matrix @ motion.ravel(), atol=1e-12
            )
            np.testing.assert_allclose(rows.matrix @ np.tile(t, len(points)), 0, atol=1e-12)


def test_symmetry_planes_keep_their_conditions():
    x = np.linspace(0, 1, 9)
    in_plane = lines(np.column_stack([x, 0 * x]), np.column_stack([x, 0.1 + x**2 / 2]))
    in_space = sheets(grid(6, 2, 0.0), grid(8, 3, lambda x, y: 0.1 + (x**2 + y**2) / 2))
    for surfaces in (in_plane, in_space):
        rows = rows_of(hhr.NodeToSurface(1, 2), *surfaces)
        assert np.linalg.norm(rows.points, axis=1).min() < 1e-12


def test_nearest_layer_is_hit():
    x = np.linspace(0, 1, 6)
    points = np.vstack([np.column_stack([x, 0 * x + y]) for y in (0.0, 0.1, 0.5)])
    slave = make(1, points, chain(6), np.array([0.5, -1]))
    facets = np.vstack([chain(6, 6), chain(6, 12)])
    master = make(2, points, facets, points[facets].mean(axis=1) + np.array([0, 0.05]))
    rows = rows_of(hhr.NodeToSurface(1, 2, UP2), slave, master, points)
    np.testing.assert_allclose(rows.gap, 0.1, atol=1e-12)


def l_shaped_slave():
    line = np.array(
        [[0, 0], [0.25, 0], [0.5, 0], [0.75, 0], [1, 0], [1, -0.25], [1, -0.5], [1, -0.75], [1, -1]]
    )
    points = np.vstack([line, np.column_stack([np.linspace(-0.5, 1.5, 9), np.full(9, 0.1)])])
    return (
        make(1, points, chain(9), np.array([0.5, -0.5])),
        make(2, points, chain(9, 9), np.array([0.5, 1])),
        points,
    )


@pytest.mark.parametrize("name", ["NodeToSurface", pytest.param("Mortar", marks=needs("mortar"))])
def test_sides_of_the_slave_do_not_face_the_master(name):
    """A mortar takes its normal at the corner from the side that does."""
    pairing = hhr.Mortar(1, 2) if name == "Mortar" else hhr.NodeToSurface(1, 2, UP2)
    rows = rows_of(pairing, *l_shaped_slave())
    assert rows.points[:, 1].min() == 0  # those on the side have y < 0
    np.testing.assert_allclose(rows.gap, 0.1, atol=1e-12)


@pytest.mark.parametrize("mirrored", [False, True])
def test_crease_of_the_master_is_an_edge(mirrored):
    """Two sides of a block are master.

    Slave nodes past the corner face nothing, however the axes are named.
    """
    line = np.vstack([np.column_stack([np.linspace(-1, 0, 5), np.zeros(5)]),
                      np.column_stack([np.zeros(4), -np.arange(1, 5) / 4])])  # fmt: skip
    upper = np.column_stack([np.linspace(-0.9, 0.6, 7), np.full(7, 0.1)])
    points = np.vstack([upper, line])
    inner, above = np.array([-0.5, -0.5]), np.array([0.0, 2.0])
    if mirrored:
        points, inner, above = points[:, ::-1].copy(), inner[::-1], above[::-1]
    slave, master = make(1, points, chain(7), above), make(2, points, chain(9, 7), inner)
    with pytest.warns(PairingWarning, match="3 of 7"):
        rows = hhr.NodeToSurface(1, 2).rows((slave, master), points.size)
    assert rows.points[:, 1 if mirrored else 0].max() < 0


@pytest.mark.parametrize("normal", [None, UP3])
def test_collapsed_quadrilateral(normal):
    points = np.array(
        [
            [0, 0, 0],
            [1, 0, 0],
            [0, 1, 0],
            [0, 1, 0],
            [0.05, 0.9, -0.1],
            [0.1, 0.9, -0.1],
            [0.05, 0.92, -0.1],
            [0, 1, -0.1],
        ],
        dtype=float,
    )
    slave = make(1, points, np.array([[4, 5, 6, 7]]), np.array([0.3, 0.3, -1]))
    master = make(2, points, np.array([[0, 1, 2, 3]]), np.array([0.3, 0.3, 1]))
    rows = rows_of(hhr.NodeToSurface(1, 2, normal), slave, master, points)
    np.testing.assert_allclose(rows.gap, 0.1, atol=1e-12)


def test_double_pass_with_one_empty_pass():
    small, large = grid(2, 2, 0.0), grid(1, 1, 0.1, (-1, -1), (2, 2))
    rows = rows_of(hhr.DoublePass(1, 2), *sheets(small, large))
    assert rows.gap.size == 9


def test_double_pass_has_full_rank():
    rng = np.random.default_rng(8)
    for _ in range(5):
        a, b = grid(4, 4, 0.0, jitter=0.2, rng=rng), grid(3, 5, 0.1, jitter=0.2, rng=rng)
        slave, master, points = sheets(a, b, turned(rng))
        matrix = rows_of(hhr.DoublePass(1, 2), slave, master, points).matrix.toarray()
        one = rows_of(hhr.NodeToSurface(1, 2), slave, master, points).matrix.toarray()
        two = rows_of(hhr.NodeToSurface(2, 1), master, slave, points).matrix.toarray()
        # rows have norms of 1 to 1.5; singular values of dependent rows are round-off
        values = np.linalg.svd(np.vstack([one, two]), compute_uv=False)
        assert len(matrix) == (values > 1e-9).sum() == np.linalg.matrix_rank(matrix, tol=1e-9)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize(
    "kind",
    [
        "slave 1",
        "slave 2",
        *(pytest.param(k, marks=needs("mortar")) for k in ("dual", "standard")),
        "double",
    ],
)
def test_reduced_domains_are_closed(dim, kind):
    rng = np.random.default_rng(6)
    one, two = side(1, dim - 1, True), side(2, dim - 1, False)
    pairing = {
        "slave 1": lambda: hhr.NodeToSurface(one, two),
        "slave 2": lambda: hhr.NodeToSurface(two, one),
        "dual": lambda: hhr.Mortar(one, two),
        "standard": lambda: hhr.Mortar(one, two, None, "standard"),
        "double": lambda: hhr.DoublePass(one, two),
    }[kind]()
    first, second = ((14, 8), (9, 6)) if dim == 2 else ((5, 5, 3), (4, 4, 3))
    base, top = (-0.1,) * (dim - 1) + (1.1,), (1.1,) * (dim - 1) + (2.1,)
    ends = [(side(1, dim - 1, False), i) for i in range(dim)] + [
        (side(2, dim - 1, True), i) for i in range(dim)
    ]
    scene = pair_scene(
        "closed",
        {"p": (0.0, 1.0)},
        ((0.0,) * dim, (1.0,) * dim, first),
        (base, top, second),
        ((1.0, 0.3),) * 2,
        simplices=dim == 2,
        hypothesis="plane_strain" if dim == 2 else "solid",
        contacts=(pairing,),
        displacements=tuple(hhr.Displacement(*end) for end in (*ends, (side(1, 0, False), 0))),
    )
    with ignored(Warning):
        problem = hhr.FullOrderModel(scene).problem
    at_contact = np.unique(problem.contact.nonzero()[1] // dim)
    basis = rng.normal(size=(problem.free.size, 3)) * problem.free[:, None]
    for layers in (0, 1, 2):
        for _ in range(3):
            nodes = np.concatenate(
                [rng.choice(at_contact, 2), rng.integers(len(problem.points), size=2)]
            )
            sets = reduced_domain(problem, nodes, layers)
            check_closed(problem, nodes, sets)
            project(problem, basis, sets)
            row = sets.A_lambda[0]
            if np.intersect1d(problem.contact[row].nonzero()[1], sets.A).size:
                with pytest.raises(ReductionError, match="not closed"):
                    project(problem, basis, dataclasses.replace(sets, A_lambda=sets.A_lambda[1:]))
