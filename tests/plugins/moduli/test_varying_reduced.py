"""Reduced models of scenes whose elasticity depends on parameters: consistency, interpolation,
gradients.
"""

import numpy as np
import pytest
from needs import cases_of
from scenes import check_alike, largest_difference, pressed_pair, slope_errors, whole_domain

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import ReductionError, StabilityWarning
from hhr_dolfinx.plugins.moduli.interpolate import GridSettings
from hhr_dolfinx.plugins.moduli.interpolated import Compliances
from hhr_dolfinx.reduction.completion import ReconstructionData
from hhr_dolfinx.reduction.projection import project

BODIES = ("E1", "nu1"), ("E2", 0.3)
MATERIALS = {"E1": (1.0, 6.0), "nu1": (0.1, 0.42), "E2": (2.0, 9.0)}
POINT = np.array([0.03, 0.01, 0.05, 0.002, 2.3, 0.35, 3.0])
MESHES = {"plane_strain": {"cells": 5}, "axisymmetric": {"cells": 4, "matching": False}}


@pytest.fixture(scope="module", params=cases_of(MESHES))
def training(request):
    """A matching pair, and one whose gaps are interpolated."""
    scene = pressed_pair(request.param, BODIES, MATERIALS, **MESHES[request.param])
    return hhr.train(scene, hhr.Sobol(64), held_out=20)


@pytest.fixture(scope="module")
def reduced(training):
    """An HHR model whose modes move one body each."""
    return training.build(
        hhr.Recipe(basis=hhr.Pod(1e-11, relative=True, by_body=True)), checked=False
    )


@pytest.fixture(scope="module")
def condensed(training):
    return training.condense()


def points_of(training, count=12):
    return training.full_order.parameters.random(count, seed=7)


def galerkin(training, basis, count=5):
    """All cells and all conditions, on a basis."""
    problem = training.full_order.problem
    snapshots, sets = training.snapshots.take(np.arange(count)), whole_domain(problem)
    fields = ReconstructionData.of(problem, snapshots).reconstruction(problem, basis, sets)
    known = snapshots.known_statuses()
    return hhr.ReducedModel(project(problem, basis, sets), problem.parameters, fields, known=known)


def test_a_whole_basis_trained_on_five_points_is_the_full_order_everywhere(training):
    problem = training.full_order.problem
    model = galerkin(training, np.eye(problem.free.size)[:, problem.free])
    check_alike(
        training.full_order, model, points_of(training, 4), displacement=1e-11, forces=1e-11
    )
    exact = training.full_order.solve(POINT, gradient=True).gradient
    slopes = model.solve(POINT, gradient=True).gradient
    assert largest_difference(slopes.multipliers, exact.multipliers) < 1e-9
    assert largest_difference(slopes.unknown, exact.unknown[problem.free]) < 1e-9


def test_a_basis_of_five_answers_gives_them_back(training):
    """Galerkin's method finds what its basis holds, at any stiffness.

    A mode for each condition makes forces unique.
    """
    columns = np.column_stack(
        [training.snapshots.displacements[:, :5], training.full_order.per_force]
    )
    model = galerkin(training, np.linalg.qr(columns)[0])
    check_alike(
        training.full_order, model, training.snapshots.points[:5], displacement=1e-10, forces=1e-9
    )


def test_reduced_and_condensed_models_are_near_the_full_one(training, reduced, condensed):
    for model, most in ((reduced, 2e-3), (condensed, 1e-4)):
        check_alike(
            training.full_order,
            model,
            points_of(training),
            displacement=most,
            forces=most,
            stress=10 * most,
        )


def test_eliminated_between_few_parameters_it_is_what_is_factored_for_each(training, reduced):
    """To 1e-5 of the compliances, as their grid was asked for."""
    assert isinstance(reduced.compliances, Compliances)
    factored = reduced.changed(compliances=None)
    for point in points_of(training):
        one, other = (
            model.solve(point, outside="ignore", gradient=True) for model in (reduced, factored)
        )
        assert np.array_equal(one.active, other.active)
        for name in ("multipliers", "unknown"):
            assert largest_difference(getattr(one, name), getattr(other, name)) < 1e-4
            assert (
                largest_difference(getattr(one.gradient, name), getattr(other.gradient, name))
                < 1e-3
            )


def test_gradients_are_those_of_differences(reduced, condensed):
    for model in (reduced, reduced.changed(compliances=None), condensed):
        assert slope_errors(model, POINT).max() < 1e-6


def test_gradients_are_near_those_of_the_full_model(training, reduced, condensed):
    box = np.subtract(
        *(getattr(training.full_order.parameters, name) for name in ("upper", "lower"))
    )
    exact = training.full_order.solve(POINT, gradient=True).gradient.multipliers * box
    for model, rows, tolerance in (
        (condensed, slice(None), 1e-4),
        (reduced, reduced.offline.sets.A_lambda, 2e-2),
    ):
        found = model.solve(POINT, gradient=True, outside="ignore").gradient.multipliers * box
        assert np.abs(found - exact[rows]).max() < tolerance * np.abs(exact).max()


def test_every_start_ends_at_the_same_answer(training, condensed, reduced):
    for model in (condensed, reduced, training.full_order):
        for point in points_of(training, 4):
            near, cold = (
                model.solve(point, start=start, outside="ignore") for start in ("nearest", None)
            )
            assert np.array_equal(near.active, cold.active)
            assert largest_difference(near.multipliers, cold.multipliers) < 1e-12


def test_a_modulus_that_all_of_a_body_has_costs_one_solution(training, condensed):
    """The upper body has the factor E2, which is exact; the lower one E1, and a grid along nu1."""
    lower, upper = condensed.eliminated.parts
    assert [len(part.interpolant.axes) for part in (lower, upper)] == [1, 0]
    assert [part.factor.text for part in (lower, upper)] == ["E1", "E2"]
    assert condensed.offline.evaluations[1] == 1 and condensed.offline.evaluations[0] < 20
    assert max(condensed.offline.surpluses) <= condensed.offline.settings.tolerance
    assert max(condensed.offline.comparison.dual) < 1e-3


def test_a_grid_that_spends_its_budget_says_so(training):
    with pytest.warns(StabilityWarning) as caught:
        training.condense(GridSettings(1e-8, 2))
    assert any("spent its budget of 2 solutions" in str(item.message) for item in caught)


def test_condensation_converges_with_its_tolerance(training):
    errors = []
    for tolerance in (1e-1, 1e-3, 1e-8):
        pair = training.condense(GridSettings(tolerance, 40)), training.full_order
        forces = (
            [model.solve(point).forces() for model in pair] for point in points_of(training, 5)
        )
        errors.append(max(largest_difference(found, exact) for found, exact in forces))
    assert errors[0] > errors[1] > errors[2] and errors[2] < 1e-6


def condensed_well(hypothesis, bodies, space, *point):
    """A condensed model whose forces and derivatives are right, and its full model."""
    training = hhr.train(
        pressed_pair(hypothesis, bodies, space, cells=4), hhr.Sobol(32), held_out=10
    )
    model = training.condense()
    check_alike(training.full_order, model, points_of(training, 6), forces=1e-4)
    assert slope_errors(model, [*POINT[:4], *point]).max() < 1e-6
    return model, training.full_order


def test_one_parameter_may_enter_everywhere():
    """A modulus, a ratio and the other body's modulus of one parameter, and no factor that all of a
    body has.
    """
    bodies = ("2 + t**2", "0.2 + 0.15 * t"), ("table(t, 0, 3, 1, 5)", 0.3)
    _, full = condensed_well("plane_strain", bodies, {"t": (0.0, 1.0)}, 0.6)
    assert slope_errors(full, [*POINT[:4], 0.6]).max() < 1e-6


def test_one_body_on_an_obstacle_and_one_that_does_not_vary():
    box = {"E2": (1.0, 4.0), "nu2": (0.0, 0.4)}
    model, _ = condensed_well("plane_stress", ((3.0, 0.3), ("E2", "nu2")), box, 2.0, 0.25)
    lower, upper = model.eliminated.parts
    assert lower.factor is None and lower.interpolant.axes.size == 0 and upper.factor.text == "E2"


NO_TARGET = r"must lie in \(0, 1\), and its budget = .* be a positive integer"
NO_GRID = "must be True or False, and least = .* an integer that is not negative"


@pytest.mark.parametrize(
    ("given", "why"),
    [
        *(
            (given, NO_TARGET)
            for given in (
                {"tolerance": 0.0},
                {"tolerance": 1.0},
                {"tolerance": np.nan},
                {"tolerance": "1e-3"},
                {"budget": 0},
                {"budget": 2.5},
            )
        ),
        *((given, NO_GRID) for given in ({"least": "x"}, {"compressed": 3})),
    ],
)
def test_settings_that_are_none(given, why):
    with pytest.raises(ReductionError, match=why):
        GridSettings(**given)
