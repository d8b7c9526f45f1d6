"""Condensation by boxes, and scenes of other authors in which each node is a contact."""

import dataclasses

import hertz_half_discs
import numpy as np
import obstacles
import pytest
from contract import blocks
from mpi4py import MPI
from needs import needs
from scenes import check_like, pressed_block
from scipy import linalg, optimize
from scipy.sparse import csc_matrix

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import NotOfferedError
from hhr_dolfinx.plugins.rivals.boxes import BoxwiseModel
from hhr_dolfinx.plugins.studies.study import rivals_of


def quiet(_title):
    return lambda items: items


@pytest.fixture(scope="module")
def rope():
    return obstacles.ObstacleTraining(obstacles.rope(59), [9, 9], quiet)


@pytest.fixture(scope="module")
def boxwise(rope):
    return BoxwiseModel(rope.full_order, 81)


@pytest.mark.parametrize("made", [obstacles.rope, obstacles.membrane, obstacles.torsion])
def test_full_orders_of_obstacles_are_those_of_least_squares(made):
    """min λ·S λ / 2 + s·λ over λ >= 0, by non-negative least squares of the root of S."""
    full = obstacles.ObstacleModel(made(12))
    root = linalg.cholesky(full.schur)
    touched = 0
    for point in full.parameters.random(6, 2):
        theta = full.problem.amplitudes(point)
        slack = full.problem.gaps @ theta - full.stiffness.solve(full.problem.loads @ theta)
        known, _ = optimize.nnls(root, linalg.solve_triangular(root, -slack, trans=1))
        answer = full.solve(point)
        np.testing.assert_allclose(answer.forces(), known, atol=1e-9 * known.max(initial=1.0))
        touched += answer.active.any()
    assert touched > 3


def test_an_elastic_bar_has_the_torsion_constant_of_a_square():
    """J = 0.140577 for side 1 (S. Timoshenko and J. Goodier, Theory of Elasticity); where all of it
    yields u is the hill of sand, whose torque is yield / 3.
    """
    wide = hhr.ParameterSpace(("twist", "yielding"), lower=(0.01, 0.8), upper=(1e6, 1.2))
    full = obstacles.ObstacleModel(obstacles.torsion(71)._replace(parameters=wide))
    elastic = full.solve([0.1, 1.0])
    assert not elastic.active.any()
    torque = 2 * elastic.displacement().sum() / 72**2
    assert torque / 0.1 == pytest.approx(0.140577, rel=1e-3)
    plastic = full.solve([1e5, 1.2])
    assert 2 * plastic.displacement().sum() / 72**2 == pytest.approx(1.2 / 3, rel=2e-3)


def test_boxes_are_exact(rope, boxwise):
    """At random points and corners; the comparison principle makes statuses of the corners those of
    the box here, so that the full model is never before.
    """
    full = rope.full_order
    for point in [*full.parameters.random(50, 3), *full.parameters.grid([9, 9])[::7]]:
        found, exact = boxwise.solve(point), full.solve(point)
        np.testing.assert_allclose(found.displacement(), exact.displacement(), atol=1e-10)
        np.testing.assert_allclose(found.forces(), exact.forces(), atol=1e-9)
    assert boxwise.fallbacks == 0
    assert boxwise.sizes[1] < len(full.problem.gaps) / 2


def test_the_full_model_answers_where_a_box_does_not(rope, boxwise):
    """Open conditions that close, closed ones that pull, and a change beyond what is known."""
    full = rope.full_order
    point = full.parameters.middle
    place = tuple(np.array([4, 4]))
    box = boxwise._boxes[place]
    assert box.closed.size and box.watched.size and np.isfinite(box.reach)
    for change in (
        {"watched": box.watched - 1.0},
        {"held": box.held - 1.0},
        {"reach": 0.0},
    ):
        try:
            boxwise._boxes[place] = dataclasses.replace(box, **change)
            before = boxwise.fallbacks
            check_like(boxwise.solve(point), full.solve(point), displacement=1e-10, forces=1e-9)
            assert boxwise.fallbacks == before + 1
        finally:
            boxwise._boxes[place] = box


def test_slacks_of_a_box_are_above_what_the_corners_say(rope, boxwise):
    """The bound that leaves conditions out: none of them ever closes, by the exact answers."""
    full = rope.full_order
    for point in full.parameters.random(30, 9):
        place = (point - boxwise._low) / boxwise._width
        box = boxwise._boxes[tuple(place.astype(int).tolist())]
        active = np.flatnonzero(full.solve(point).active)
        assert np.isin(active, np.concatenate([box.closed, box.uncertain])).all()
        assert np.isin(box.closed, active).all()


@pytest.mark.parametrize("far", [1.0, 1e5, 1e9])
def test_a_large_gap_elsewhere_hides_no_overlap_and_a_large_force_no_pull(far):
    """A condition that is open, or closed, at both ends of a box and not between."""
    space = hhr.ParameterSpace(("t",), (0.0,), (1.0,))
    for across, gaps, soft, known in (
        (0.9, [[0.2, -1.0], [1.0, -2.0], [far, 0.0]], 1.0, [0.3, 0.0, 0.0]),
        (-0.9, [[-0.2, 1.0], [1.0, -2.0], [-1.0, 0.0]], 1 / far, [0.0, 0.0, far]),
    ):
        schur = np.eye(3)
        schur[0, 1] = schur[1, 0] = across
        schur[2, 2] = soft
        stiffness = csc_matrix(np.linalg.inv(schur))
        nothing = np.zeros((3, 2))
        obstacle = obstacles.Obstacle("o", stiffness, nothing, nothing, np.array(gaps), space)
        model = BoxwiseModel(obstacles.ObstacleModel(obstacle), 2)
        answer = model.solve([0.5])
        np.testing.assert_allclose(answer.forces(), known, rtol=1e-9, atol=1e-12)
        assert model.fallbacks == 1


def test_a_box_of_many_parameters_has_too_many_corners():
    names = tuple(f"p{k}" for k in range(20))
    space = hhr.ParameterSpace(names, (0.0,) * 20, (1.0,) * 20)
    eye, nothing = csc_matrix(np.eye(2)), np.zeros((2, 21))
    full = obstacles.ObstacleModel(obstacles.Obstacle("o", eye, nothing, nothing, nothing, space))
    with pytest.raises(NotOfferedError, match="too many corners"):
        BoxwiseModel(full, 100)


def test_fine_ropes_take_more_steps():
    full = obstacles.ObstacleModel(obstacles.rope(800))
    assert all(full.solve(point).converged for point in full.parameters.random(5, 1))


def test_boxes_of_scenes_with_meshes(hertz):
    training = hhr.train(hertz_half_discs.scene(), [12], held_out=0, comm=MPI.COMM_SELF)
    (rival,) = rivals_of(["boxes"])(training)
    model = rival.made()
    for mu in (0.168, 0.4321):
        check_like(model.solve(mu), hertz.solve(mu), displacement=1e-9, forces=1e-9)
    full = hhr.FullOrderModel(blocks(), MPI.COMM_SELF)
    model = BoxwiseModel(full, 100)
    for point in full.parameters.random(20, 4):
        check_like(model.solve(point), full.solve(point), displacement=1e-9, forces=1e-8)


@needs("moduli")
def test_boxes_have_one_stiffness_and_affine_loads():
    scene = pressed_block("plane_strain", cells=3)
    box = hhr.ParameterSpace(
        (*scene.parameters.names, "E"),
        (*scene.parameters.lower, 1.0),
        (*scene.parameters.upper, 9.0),
    )
    bodies = tuple(dataclasses.replace(body, young="E") for body in scene.bodies)
    varied = dataclasses.replace(scene, parameters=box, bodies=bodies)
    with pytest.raises(NotOfferedError, match="it has one K"):
        BoxwiseModel(hhr.FullOrderModel(varied, MPI.COMM_SELF), 10)


def test_the_bound_of_obstacles_holds_for_any_forces(rope):
    """Of answers of cones, of regressions, and of random forces >= 0; exact forces have none."""
    full = rope.full_order
    models = [rival.made() for rival in rivals_of(["nnmf", "cpg", "radial_functions"])(rope)]
    random = np.random.default_rng(5)
    ratios = []
    for point in full.parameters.random(15, 6):
        exact = full.solve(point)
        error, bound, size = obstacles.bound_of(full, exact)
        assert error <= 1e-10 * size and bound <= 1e-6 * size
        for model in models:
            error, bound, _ = obstacles.bound_of(full, model.solve(point))
            assert bound >= error * (1 - 1e-9)
            ratios.append(bound / error)
        noise = exact._replace(multipliers=random.uniform(0, 2, len(exact.multipliers)))
        error, bound, _ = obstacles.bound_of(full, noise)
        assert bound >= error
    assert np.median(ratios) < 10
