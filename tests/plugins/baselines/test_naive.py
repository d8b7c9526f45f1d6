"""The naive full order answers as the full order does, by another solver, and refuses what it does not solve."""

import dataclasses

import flowing
import numpy as np
import pytest
from needs import needs
from scenes import largest_difference, pressed_block, pressed_pair
from threads import at_once

import hhr_dolfinx as hhr
from hhr_dolfinx.contact.rows import joined
from hhr_dolfinx.errors import NotSolvableError, SceneError
from hhr_dolfinx.plugins.baselines.naive import NaiveFullOrder

BODIES = ("E1", "nu1"), ("E2 * (1 + 0.2 * c**2)", "0.3 + 0.1 * sin(c)")
MATERIALS = {"E1": (1.0, 6.0), "nu1": (0.1, 0.42), "E2": (2.0, 9.0), "c": (0.0, 1.0)}
MESHES = {
    "plane_strain": {"cells": 3},
    "plane_stress": {"cells": 3, "simplices": True},
    "axisymmetric": {"cells": 3, "matching": False},
    "solid": {"cells": 2},
}


def check_like(full, point, tolerance):
    """Round-off, about 1e-15 times the condition number of K."""
    answer, other = NaiveFullOrder(full).solve(point), full.solve(point)
    assert other.forces().max() > 0
    for name in ("displacement", "forces", "stress"):
        assert largest_difference(getattr(answer, name)(), getattr(other, name)()) < tolerance, name
    assert np.array_equal(answer.active, other.active)


@pytest.mark.parametrize("mu", [0.15, 0.2345, 0.45])
def test_half_discs(hertz, mu):
    check_like(hertz, [mu], 1e-11)


@pytest.mark.parametrize("hypothesis", sorted(MESHES))
def test_elasticity_that_depends_on_parameters(hypothesis):
    full = hhr.FullOrderModel(pressed_pair(hypothesis, BODIES, MATERIALS, **MESHES[hypothesis]))
    for point in full.parameters.random(2, 0):
        check_like(full, point, 1e-11)


@needs("shapes")
def test_shapes_that_depend_on_parameters():
    space = {"E1": (1.0, 6.0), "crown": (0.0, 0.03), "tall": (0.8, 1.2)}
    crowned = hhr.Shape(1, ("x", "1 + (y - 1) * tall - crown * y * (x - 1.5)**2"))
    scene = pressed_pair("plane_strain", (("E1", 0.3), (4.0, 0.25)), space, shapes=(crowned,), cells=4)
    check_like(hhr.FullOrderModel(scene), [0.03, 0.01, 0.05, 0.002, 2.0, 0.025, 0.9], 1e-11)


def test_threads_share_it(hertz):
    model = NaiveFullOrder(hertz)
    points = [[0.2], [0.31], [0.44]]
    expected = [model.solve(point).forces().tobytes() for point in points]
    jobs = [lambda k=k: [model.solve(point).forces().tobytes() for point in points[k:] + points[:k]] for k in range(3)]
    assert at_once(jobs) == [expected[k:] + expected[:k] for k in range(3)]


class Twice:
    """A contact pair listed twice: constraints are dependent where it is active."""

    def __init__(self, once):
        self.once = once

    @property
    def tags(self):
        return self.once.tags

    def rows(self, surfaces, dofs):
        return joined([self.once.rows(surfaces, dofs)] * 2)


def test_a_pair_listed_twice_is_named():
    scene = pressed_block("plane_strain")
    full = hhr.FullOrderModel(dataclasses.replace(scene, contacts=(Twice(scene.contacts[0]),)))
    with pytest.raises(NotSolvableError, match="list each contact pair once"):
        NaiveFullOrder(full).solve(0.05)


@needs("inelastic")
def test_inelastic_bodies_are_refused():
    with pytest.raises(SceneError, match="flow"):
        NaiveFullOrder(flowing.flowing_full())
