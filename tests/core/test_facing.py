"""What faces what: each pairing in each dimension, of surfaces that are one side or the whole
outside of a body.
"""

import itertools
import warnings

import numpy as np
import pytest
from needs import present
from surfaces import chain, make

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import PairingWarning, SceneError
from hhr_dolfinx.pairings.surface import area_vectors

BULGE = 0.05
"""Depth of a convex side: its normals turn by 11 degrees at most, so that lengths along them differ
by 2 %.
"""


def box(dim, count, low, *, bulge=0.0, wide=False, triangles=False):
    """Nodes of a box, one unit or three wide, facets of its sides, and by how much the lower one
    hangs through.
    """
    long = np.linspace(-1.0, 2.0, 3 * count + 1) if wide else np.linspace(0.0, 1.0, count + 1)
    axes = [long] * (dim - 1) + [np.linspace(0.0, 1.0, count + 1)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, dim)
    numbers = np.arange(len(points)).reshape([len(axis) for axis in axes])
    sides = {}
    for axis in range(dim):
        for place in (0, -1):
            face = np.moveaxis(numbers, axis, 0)[place]
            if dim == 2:
                facets = np.column_stack([face[:-1], face[1:]])
            else:
                corners = [face[:-1, :-1], face[1:, :-1], face[:-1, 1:], face[1:, 1:]]
                facets = np.stack(corners, -1).reshape(-1, 4)
                facets = (
                    np.vstack([facets[:, [0, 1, 3]], facets[:, [0, 3, 2]]]) if triangles else facets
                )
            sides[axis, place] = facets
    depth = bulge * np.prod(4 * points[:, :-1] * (1 - points[:, :-1]), axis=1)
    # upper nodes stay where they are
    points = points + np.outer(low - depth * (1 - points[:, -1]), np.eye(dim)[-1])
    every = np.vstack([sides[key] for key in sorted(sides)])
    return points, {"lower": sides[dim - 1, 0], "upper": sides[dim - 1, -1], "whole": every}, depth


def pair(dim, count, gap, *, whole, triangles=False, bulge=0.0, wide=False):
    """A box above another one: surfaces of the upper and of the lower one, all nodes, and gaps of
    the upper side.
    """
    lower, lower_sides, _ = box(dim, count, 0.0, triangles=triangles, wide=wide)
    upper, upper_sides, depth = box(dim, count, 1.0 + gap + bulge, bulge=bulge, triangles=triangles)
    points = np.vstack([upper, lower])
    names = ("whole", "whole") if whole else ("lower", "upper")
    surfaces = []
    bodies = (upper_sides[names[0]], upper), (lower_sides[names[1]] + len(upper), lower)
    for tag, (facets, own) in enumerate(bodies, 1):
        # what lies behind the middle of each facet, by a cell; boxes are convex seen from their own
        # middle
        vectors = area_vectors(points[facets])
        normals = vectors / np.linalg.norm(vectors, axis=1)[:, None]
        middles = points[facets].mean(axis=1)
        side = np.sign(np.einsum("fd,fd->f", normals, middles - own.mean(axis=0)))
        surfaces.append(make(tag, points, facets, middles - side[:, None] * normals / count))
    below = (count + 1) * np.arange((count + 1) ** (dim - 1))
    return surfaces, points, np.sort(gap + bulge - depth[below])


def kinds(dim):
    down = -np.eye(dim)[-1]
    found = {
        "node to node": hhr.NodeToNode(1, 2, tuple(down)),
        "obstacle": hhr.Obstacle(1, tuple(down), -1.0),
    }
    for name, normal in (("", None), (" along n", tuple(down))):
        if present("nonmatching"):
            found["node to surface" + name] = hhr.NodeToSurface(1, 2, normal)
            found["double pass" + name] = hhr.DoublePass(1, 2, normal)
        if present("mortar"):
            found["mortar" + name] = hhr.Mortar(1, 2, normal)
            found["standard mortar" + name] = hhr.Mortar(1, 2, normal, multipliers="standard")
    return found


def rows_of(pairing, surfaces, points, matching):
    with warnings.catch_warnings():
        warnings.filterwarnings(
            "error" if matching else "ignore", ".*beyond the edge", PairingWarning
        )
        warnings.filterwarnings(
            "ignore", ".*(curved surfaces they stand for|inf-sup)", PairingWarning
        )
        return pairing.rows(surfaces[: len(pairing.tags)], points.size)


CELLS = [(2, False), (3, False), (3, True)]
GAPS = 1.5, 0.0, -0.05


def closes(rows, points, count, within):
    """Moving the upper box, the first ``count`` nodes, down by one closes each gap by one."""
    down = np.zeros_like(points)
    down[:count, -1] = -1.0
    np.testing.assert_allclose(rows.matrix @ down.ravel(), 1.0, atol=within)


@pytest.mark.parametrize("name", kinds(2))
@pytest.mark.parametrize(("dim", "triangles"), CELLS)
@pytest.mark.parametrize("whole", [False, True])
def test_each_pairing_finds_the_side_that_faces(name, dim, triangles, whole):
    """A flat side to round-off; one that hangs through to the 2 % by which lengths along its
    normals differ.
    """
    pairing, body = kinds(dim)[name], {"whole": whole, "triangles": triangles}
    for count, gap in itertools.product((1, 3), GAPS):
        surfaces, points, gaps = pair(dim, count, gap, **body)
        rows = rows_of(pairing, surfaces, points, matching=True)
        np.testing.assert_allclose(
            np.sort(rows.gap), gaps, atol=1e-12, err_msg=f"{count} cells, gap {gap}"
        )
        assert rows.areas.sum() == pytest.approx(1.0, abs=1e-12)
        closes(rows, points, (count + 1) ** dim, 1e-12)
    for gap in GAPS:
        surfaces, points, gaps = pair(dim, 4, gap, bulge=BULGE, wide=name != "node to node", **body)
        rows = rows_of(pairing, surfaces, points, matching=False)
        rows = rows.take(np.flatnonzero(rows.slaves < 5**dim))
        assert rows.gap.size == gaps.size, f"gap {gap}"
        if "mortar" in name:
            longer = 0.02 * (abs(gap) + BULGE)
            assert gaps.min() - 1e-12 < rows.gap.min() and rows.gap.max() < gaps.max() + longer
        else:
            np.testing.assert_allclose(np.sort(rows.gap), gaps, atol=1e-12)
        closes(rows, points, 5**dim, 0.02)


def circle(count):
    """The whole outside of a disc of radius 1 above a line at -1.3, of ``count`` facets, and all
    nodes.
    """
    angles = 2 * np.pi * (np.arange(count) + 0.5) / count
    line = np.column_stack([np.linspace(-2, 2, count + 1), np.full(count + 1, -1.3)])
    points = np.vstack([np.column_stack([np.cos(angles), np.sin(angles)]), line])
    ring = np.column_stack([np.arange(count), np.roll(np.arange(count), -1)])
    flat = np.column_stack([np.arange(count), np.arange(1, count + 1)]) + count
    return (
        make(1, points, ring, points[ring].mean(axis=1) / 2),
        make(2, points, flat, np.array([0.0, -2.0])),
    ), points


@pytest.mark.parametrize(
    "name", [name for name in kinds(2) if name not in ("node to node", "double pass along n")]
)
def test_a_whole_round_has_conditions_where_it_looks_at_the_other_body(name):
    """Its lower half, all but 6 degrees.

    A mortar along its own normals meets the line within 57 degrees of upright.
    """
    pairing = kinds(2)[name]
    if name == "obstacle":
        pairing = hhr.Obstacle(1, (0.0, -1.0), 1.3)
    surfaces, points = circle(48)
    rows = rows_of(pairing, surfaces, points, matching="double" not in name)
    rows = rows.take(np.flatnonzero(rows.slaves < 48))
    upright = np.rad2deg(np.arctan2(np.abs(points[:48, 0]), -points[:48, 1]))
    least = 90 if name == "obstacle" or "along n" in name else 57 if "mortar" in name else 84
    np.testing.assert_array_equal(np.sort(rows.slaves), np.flatnonzero(upright < least))
    if "mortar" not in name:
        np.testing.assert_allclose(rows.gap, rows.points[:, 1] + 1.3, atol=1e-12)
    # each node has a chord, but for the ends of what is covered, which may have half of one
    chord = 2 * np.sin(np.pi / 48)
    assert (rows.gap.size - 1.01) * chord < rows.areas.sum() < (rows.gap.size + 0.01) * chord


def test_a_surface_that_looks_away_is_refused():
    surfaces, points = circle(48)
    half = surfaces[0].facets[surfaces[0].outward[:, 1] > 0.01]  # all of the upper half
    away = make(1, points, half, points[half].mean(axis=1) / 2)
    with pytest.raises(SceneError, match="none of its 23 facets does"):
        hhr.Obstacle(1, (0.0, -1.0), 1.3).rows([away], points.size)


@pytest.mark.parametrize("length", [0.5, 1.0, 2.0, 1e-3])
def test_an_obstacle_is_the_plane_of_its_equation(length):
    """The points x of normal·x = offset do not change if both sides are scaled: -2 y = 2e-4 is the
    floor y = -1e-4.
    """
    points = np.array([[0.0, 0.0], [1.0, 0.2], [2.0, 0.1]])
    surface = make(1, points, chain(3), np.array([1.0, 1.0]))
    down = np.array([0.3, -1.0])
    scaled = hhr.Obstacle(1, tuple(length * down), length * 0.4).rows([surface], points.size)
    distances = (0.4 - points @ down) / np.linalg.norm(down)
    assert scaled.gap == pytest.approx(
        distances[np.searchsorted(surface.nodes, scaled.slaves)], rel=1e-14
    )
    one = np.asarray(scaled.matrix.multiply(scaled.matrix).sum(axis=1)).ravel()
    assert one == pytest.approx(np.ones(3))
