"""Where only moduli of whole bodies vary the full model factors once, and answers as one that factors anew."""

import warnings
from unittest.mock import Mock

import numpy as np
import pytest
from needs import cases_of, needs
from scenes import largest_difference, lying, pressed_pair, slope_errors

import hhr_dolfinx as hhr
from hhr_dolfinx.contact.problem import ScaledBodies
from hhr_dolfinx.errors import SceneWarning
from hhr_dolfinx.linear.factors import Factors
from hhr_dolfinx.linear.sparse import FreeCholesky

YOUNG = ("E1", 0.3), ("E2 * (1 + 0.2 * c**2)", 0.2)
BOX = {"E1": (1.0, 6.0), "E2": (20.0, 900.0), "c": (0.0, 1.0)}
MESHES = {"plane_strain": {"cells": 4}, "axisymmetric": {"cells": 3, "matching": False}, "solid": {"cells": 2}}


@pytest.fixture(scope="module", params=cases_of(MESHES))
def full(request):
    return hhr.FullOrderModel(pressed_pair(request.param, YOUNG, BOX, **MESHES[request.param]))


def plain(full, point):
    """Answer of the scene with these moduli as numbers."""
    *driven, first, second, c = point
    bodies = (first, 0.3), (second * (1 + 0.2 * c**2), 0.2)
    hypothesis = full.scene.hypothesis
    return hhr.FullOrderModel(pressed_pair(hypothesis, bodies, **MESHES[hypothesis])).solve(driven)


@pytest.fixture
def no_factors(monkeypatch):
    """Nothing may be factored, and no columns solved for, from here on."""
    refused = Mock(side_effect=AssertionError("the stiffness of whole bodies is a number times one that was factored"))
    monkeypatch.setattr(Factors, "factor", refused)
    monkeypatch.setattr(FreeCholesky, "solve_columns", refused)


def test_it_answers_as_one_that_factors_anew(full, request):
    """With moduli up to 300 times apart, lifts that move, and loads: 1e-10 is round-off over the condition of K."""
    points = full.parameters.random(6, 0)
    expected = [plain(full, point) for point in points]
    request.getfixturevalue("no_factors")
    for point, other in zip(points, expected, strict=True):
        answer = full.solve(point)
        assert largest_difference(answer.displacement(), other.displacement()) < 1e-10
        assert largest_difference(answer.forces(), other.forces()) < 1e-10
        assert np.array_equal(answer.active, other.active)


def test_gradients_are_those_of_differences(full):
    """As in test_varying: 1e-10 of the differences themselves, and round-off of the forces over 1e-5."""
    assert slope_errors(full, full.problem.middle + 1e-3).max() < 1e-6


@needs("floating")
def test_a_body_that_only_contact_holds():
    """Its rigid motions do not depend on the modulus; the same scene with a number in its place."""
    space = hhr.ParameterSpace(("p", "E"), (1.0, 500.0), (10.0, 2000.0))
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "body 2 .* moves along axis 0", SceneWarning)
        varying = hhr.FullOrderModel(lying(young="E", tilt=0.2, parameters=space))
        plain = hhr.FullOrderModel(lying(young=700.0, tilt=0.2))
    assert varying.system.bodies is not None and varying.problem.held_by_contact
    answer, other = varying.solve([4.0, 700.0]), plain.solve(4.0)
    assert largest_difference(answer.displacement(), other.displacement()) < 1e-10
    assert largest_difference(answer.forces(), other.forces()) < 1e-10


@pytest.mark.parametrize(
    ("bodies", "box"),
    [
        ((("E1", "nu"), ("E2", 0.3)), {"E1": (1.0, 2.0), "E2": (1.0, 2.0), "nu": (0.1, 0.4)}),
        (((3.0, 0.3), (4.0, 0.3)), {}),
    ],
)
def test_what_varies_otherwise_is_not_taken_for_scaled(bodies, box):
    assert hhr.FullOrderModel(pressed_pair("plane_strain", bodies, box, cells=2)).system.bodies is None


def test_parts_of_schur_add_up(full):
    """Each is positive semi-definite on its own conditions, and their sum is S in the middle of the box."""
    assert isinstance(full.system.bodies, ScaledBodies) and len(full.stiffness.parts) == 2
    assert full.stiffness.parts.sum(axis=0) == pytest.approx(full.schur, rel=1e-12, abs=1e-14 * full.schur.max())
    for part in full.stiffness.parts:
        assert np.linalg.eigvalsh((part + part.T) / 2)[0] > -1e-12 * full.schur.max()
