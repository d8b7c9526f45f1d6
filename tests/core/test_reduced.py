"""RID, projection and the reduced model against their definitions and against the full order."""

from types import SimpleNamespace

import numpy as np
import pytest
from needs import needs
from scenes import check_closed, check_contact_conditions, references_at, whole_domain

import hhr_dolfinx as hhr
from hhr_dolfinx.models.starts import KnownStatuses
from hhr_dolfinx.reduction.completion import ReconstructionData
from hhr_dolfinx.reduction.modes import deim
from hhr_dolfinx.reduction.projection import project, reduced_domain


def test_index_sets_follow_their_definitions(hertz, hertz_reduction):
    """(1.35), (1.36), (1.45), (1.55), (1.58), (1.59), each by brute force.

    The RID holds the nodes that DEIM picks.
    """
    problem, sets = hertz.problem, hertz_reduction.offline.sets
    check_closed(problem, deim(hertz_reduction.offline.basis) // 2, sets)
    nodes_outside = np.unique(np.delete(problem.cell_nodes, sets.cells, axis=0))
    A = [i for i in range(problem.free.size) if i // 2 not in nodes_outside and problem.free[i]]
    assert sets.A.tolist() == A
    coupled = np.flatnonzero(np.abs(problem.stiffness.toarray()[sets.A]).sum(axis=0))
    assert sets.I.tolist() == [j for j in coupled if j not in set(A)]


def test_layers_only_add_cells(hertz):
    node = np.array([hertz.problem.contact[27].indices[0] // 2])
    cells = [set(reduced_domain(hertz.problem, node, layers).cells) for layers in range(3)]
    assert cells[0] < cells[1] < cells[2]


def test_projection_equals_the_unrestricted_formula(hertz, hertz_reduction):
    """(1.61) with restricted rows and columns is (1.57) with V zeroed outside A."""
    problem, basis, sets = (
        hertz.problem,
        hertz_reduction.offline.basis,
        hertz_reduction.offline.sets,
    )
    test_functions = np.zeros_like(basis)
    test_functions[sets.A] = basis[sets.A]
    reduced = project(problem, basis, sets)
    assert reduced.stiffness == pytest.approx(
        test_functions.T @ (problem.stiffness @ basis), abs=1e-12
    )
    assert reduced.contact_trial == pytest.approx(
        (problem.contact @ basis)[sets.A_lambda], abs=1e-14
    )
    assert reduced.contact_test == pytest.approx(
        (problem.contact @ test_functions)[sets.A_lambda], abs=1e-14
    )
    assert np.abs(reduced.stiffness - reduced.stiffness.T).max() > 1e-3, (
        "a Petrov-Galerkin K~ is not symmetric"
    )


def test_full_basis_on_the_whole_domain_is_the_full_order(hertz, hertz_snapshots):
    """Nothing reduced, nothing lost: 1e-10, round-off times cond(K) ~ 1e4.

    Contact conditions hold for both.
    """
    problem = hertz.problem
    basis = np.eye(problem.free.size)[:, problem.free]
    sets = whole_domain(problem)
    fields = ReconstructionData.of(problem, hertz_snapshots).reconstruction(problem, basis, sets)
    known = hertz_snapshots.known_statuses()
    model = hhr.ReducedModel(project(problem, basis, sets), problem.parameters, fields, known=known)
    for mu in (0.15, 0.217, 0.3, 0.45):
        reference, solution = hertz.solve(mu), model.solve(mu)
        field, forces = reference.displacement(), reference.forces()
        displacement = basis @ solution.unknown + problem.lifts @ problem.amplitudes(np.array([mu]))
        assert displacement == pytest.approx(field, abs=1e-10 * np.abs(field).max())
        assert np.array_equal(solution.displacement(), displacement)
        assert solution.multipliers == pytest.approx(forces, abs=1e-10 * forces.max())
        assert np.array_equal(solution.forces(), solution.multipliers)
        for answer in (reference, solution):
            check_contact_conditions(problem, answer.displacement(), answer.forces(), mu)


def test_full_snapshot_basis_reproduces_the_training_points(hertz, hertz_snapshots):
    """With all modes each snapshot lies in the space, and a consistent RID model returns it."""
    reduction = hhr.build(hertz, hertz_snapshots, hhr.Recipe.thesis(1e-25).as_it_is())
    for point, field, forces in zip(
        hertz_snapshots.points,
        hertz_snapshots.displacements.T,
        hertz_snapshots.forces.T,
        strict=True,
    ):
        solution = reduction.solve(point)
        assert reduction.offline.basis @ solution.unknown == pytest.approx(field, abs=1e-9)
        assert solution.multipliers == pytest.approx(
            forces[reduction.offline.sets.A_lambda], abs=1e-9
        )


@pytest.mark.parametrize("start", ["nearest", None])
def test_reduced_contact_conditions(hertz_reduction, start):
    """(1.61) to round-off, from a table of known statuses and from none."""
    reduced, model = hertz_reduction.problem, hertz_reduction
    for mu in np.linspace(0.15, 0.45, 37):
        solution = model.solve(mu, start=start)
        theta = model.fields.amplitudes(np.array([mu]))
        slack = reduced.gaps @ theta - reduced.contact_trial @ solution.unknown
        load = reduced.loads @ theta
        residual = (
            reduced.stiffness @ solution.unknown
            + reduced.contact_test.T @ solution.multipliers
            - load
        )
        assert np.abs(residual).max() < 1e-12 * np.abs(load).max()
        assert (
            solution.multipliers.min() >= -1e-11 * solution.multipliers.max()
            and slack.min() > -1e-11
        )
        assert np.abs(slack * solution.multipliers).max() < 1e-11


def test_nearest_known_statuses():
    known = KnownStatuses(np.array([[0.0, 0.0], [1.0, 1e6], [0.4, 1e6]]), np.eye(3, dtype=bool))
    # the second parameter is a million times larger and must not drown the first
    assert known.nearest(np.array([0.9, 9e5])) == 1
    assert known.nearest(np.array([0.1, 1e5])) == 0


@needs("studies")
def test_errors_of_the_thesis(hertz, hertz_snapshots, hertz_reduction):
    """Section 3.5.1, figure 3.3: the bounds the thesis reports on its 101 points."""
    assert 8 <= hertz_reduction.offline.basis.shape[1] <= 10
    assert 7 <= len(hertz_reduction.offline.sets.A_lambda) <= 9
    assert hertz_reduction.offline.stability.kappa_B <= 5
    points = hertz.problem.parameters.grid([101])
    errors = references_at(points, hertz, hertz_snapshots).errors(hertz_reduction)
    assert errors.values["primal_euclid"].max() <= 5e-4
    assert errors.values["dual_rid"].max() <= 8e-3
    assert errors.values["energy_minimum"].max() <= 1e-4
    assert not any(hertz_reduction.solve(point).cycled for point in points)


@needs("studies")
def test_displacement_converges_with_the_basis(hertz, hertz_snapshots):
    """A smaller POD tolerance gives a smaller error, down to exactness on 14 modes."""
    references = references_at(hertz.parameters.random(20, seed=0), hertz, hertz_snapshots)
    worst = []
    for tolerance in (1e-6, 1e-8, 1e-12):
        reduction = hhr.build(hertz, hertz_snapshots, hhr.Recipe.thesis(tolerance).as_it_is())
        worst.append(references.errors(reduction).values["primal_energy"].max())
    assert worst[0] > 3 * worst[1] > 9 * worst[2]


def test_statuses_are_solved_from_those_of_the_nearest_point_before():
    """The second point has no answer, so nothing starts from it."""
    starts = []

    def solve(point, start):
        starts.append(start)
        active = np.array([point[0] > 0.4, True])
        return SimpleNamespace(converged=point[0] != 0.3, parameter=point, active=active)

    points = np.array([[0.5], [0.3], [0.1], [0.45], [0.2]])
    known = KnownStatuses.solved(solve, points)
    assert known.points.ravel().tolist() == [0.5, 0.1, 0.45, 0.2]
    assert known.active[:, 0].tolist() == [True, False, True, False]
    assert starts[0] is None
    # nearest solved ones: 0.5, 0.5, 0.5, 0.1
    assert [start[0] for start in starts[1:]] == [True, True, True, False]
    assert KnownStatuses.solved(solve, points[1:2]) is None
