"""What users get is what is checked: forces on the whole surface, the worst point named, nothing
silent.
"""

import dataclasses
import math
import warnings

import hertz_half_discs as hertz_demo
import numpy as np
import pellet_cladding as demo
import pytest
from bare_problem import rewrite_signed
from mpi4py import MPI
from needs import needs, present
from scenes import THESIS, pressed_pair, references_at, space, with_bodies
from scipy.optimize import nnls

import hhr_dolfinx as hhr
from hhr_dolfinx import errors
from hhr_dolfinx.certify.accuracy import contact_residuals, force_floor, round_off_force
from hhr_dolfinx.certify.compare import compare_points
from hhr_dolfinx.certify.trust import TrustLimits, check_comparison, warn_of_gaps_in_training
from hhr_dolfinx.reduction.completion import spanning_rays
from hhr_dolfinx.warn import collected, ignored

COARSE = {"arc_segments": 28, "flat_segments": 7}


@pytest.fixture(scope="module")
def press_fit():
    """The pellet pressed into its cladding: contact never opens in training."""
    mesh = {"radial_cells": 12, "axial_cells": 40, "cladding_radial_cells": 2}
    return hhr.train(
        demo.scene("held", gap=-0.01, **mesh), [12, 10], held_out=30, comm=MPI.COMM_SELF
    )


@needs("studies")
def test_forces_outside_the_rid_where_contact_never_opens(press_fit):
    """Gaps measured by the largest slack, which is round-off there, made closed contact count as
    open: 82 %.
    """
    reduction = press_fit.build(hhr.Recipe(domain=hhr.Rid(0)), checked=False)
    problem, snapshots = press_fit.full_order.problem, press_fit.snapshots
    assert len(reduction.offline.sets.A_lambda) < problem.contact.shape[0], (
        "some forces are completed"
    )
    slack = (
        problem.amplitudes.sum_columns(problem.gaps, snapshots.points)
        - problem.contact @ snapshots.displacements
    )
    assert slack.max() < 1e-12, "contact never opens"
    points = problem.parameters.random(30, 5)
    off = (
        references_at(points, press_fit.full_order, snapshots)
        .errors(reduction)
        .values["dual_full_floored"]
    )
    # measured 4.6 %, and 5.2 % at the worst
    assert np.percentile(off, 95) < 0.1


@needs("shared_nodes")
def test_two_contacts_on_one_node_are_named():
    """A pair and a stop on one surface move each node alike: no advice on modes helps."""
    scene = pressed_pair("plane_strain", ((1.0, 0.3), (5.0, 0.3)), cells=3)
    both = (*scene.contacts, hhr.Obstacle(scene.contacts[0].first, (0.0, 1.0), 1.004))
    training = hhr.train(dataclasses.replace(scene, contacts=both), hhr.Sobol(16), held_out=0)
    with pytest.raises(
        errors.NotSolvableError,
        match=r"contacts 0 and 1 hold the same node .* 4 places in all.*Leave out",
    ):
        training.build(hhr.Recipe(enrichment=None).as_it_is())


def test_snapshots_span_the_cone_of_all():
    """Independent columns are not enough: e1, e2 span the plane of e1 + e2 and e1 - 0.5 e2, not
    their cone.
    """
    rng = np.random.default_rng(3)
    for _ in range(20):
        rays = rng.uniform(size=(6, 4)) * (rng.uniform(size=(6, 4)) < 0.6)
        mixed = rays @ np.maximum(rng.standard_normal((4, 30)), 0.0)
        columns = np.column_stack([mixed, rays, np.zeros(6)]) * 10.0 ** rng.uniform(-3, 3, 35)
        kept = spanning_rays(columns, 1e-6)
        assert kept.shape[1] < 35
        for column in columns.T:
            assert nnls(kept, column)[1] <= 1e-6 * np.linalg.norm(column) + 1e-300
    # independence keeps two of these; their cone holds the third only if it lies between them
    plane = np.array([[1.0, 1.0, 0.5], [0.0, 1.0, 1.0]])
    kept = spanning_rays(plane, 1e-6)
    assert all(nnls(kept, column)[1] < 1e-6 for column in plane.T)
    assert spanning_rays(np.zeros((3, 2)), 1e-6).shape == (3, 0)


def test_forces_of_three_rings_are_reproduced_at_training_points(press_fit):
    """With thinned snapshots a training solution itself could not be completed: now its forces come
    back.
    """
    snapshots = press_fit.snapshots
    reduction = press_fit.build(hhr.Recipe(domain=hhr.Rid(0)), checked=False)
    answer = reduction.solve(snapshots.points[0])
    for k in range(0, len(snapshots.points), 7):
        gamma = reduction.offline.basis.T @ snapshots.displacements[:, k]
        inside = snapshots.forces[reduction.offline.sets.A_lambda, k]
        forces = answer._replace(
            parameter=snapshots.points[k], unknown=gamma, multipliers=inside
        ).forces()
        assert np.linalg.norm(forces - snapshots.forces[:, k]) < 2e-3 * np.linalg.norm(
            snapshots.forces[:, k]
        )


def test_the_whole_surface_is_checked_and_the_worst_point_named(hertz, hertz_snapshots):
    """The thesis' recipe: 0.06 % in the RID, 22 % on the surface, which the trust check sees and
    says.
    """
    held_out = hhr.compute_snapshots(hertz, np.linspace(0.1505, 0.449, 100)[:, None])
    with pytest.warns(
        errors.StabilityWarning, match=r"the worst is at mu = 0\.1\d+, where it is [12]\d%"
    ):
        hhr.build(hertz, hertz_snapshots, THESIS, held_out)


def test_a_point_without_one_answer_is_never_passed_over(hertz, hertz_snapshots, hertz_reduction):
    floor = force_floor(hertz.problem, hertz_snapshots)
    good = compare_points(hertz, hertz_reduction, hertz_snapshots.take(np.arange(10, 31)), floor)
    check_comparison(good, TrustLimits())
    spoiled = dataclasses.replace(good, dual=np.append(good.dual[:-1], np.inf))
    with pytest.warns(errors.StabilityWarning, match="there is no one answer"):
        check_comparison(spoiled, TrustLimits(refuse_dual=np.inf))
    unknown = dataclasses.replace(good, dual=np.append(good.dual[:-1], np.nan))
    with pytest.raises(errors.UnstableModelError, match="there is no one answer"):
        check_comparison(unknown, TrustLimits())


def test_nothing_held_out_is_said(hertz, hertz_snapshots):
    with pytest.warns(errors.UncheckedWarning, match="held_out"):
        made = hhr.build(hertz, hertz_snapshots).offline
    assert any(item["stage"] == "held_out" for item in made.log.skipped)
    assert len(made.comparison.labels) == 31, "training solutions are compared instead"


def test_points_held_out_look_where_contact_grazes():
    """A corner of 1 % of the box, which 100 random points missed for every second seed."""
    scene = demo.scene(**demo.QUICK_MESH)
    training = hhr.train(scene, [20, 16], held_out=50, seed=5, comm=MPI.COMM_SELF)
    points, forces = training.held_out.points, np.linalg.norm(training.held_out.forces, axis=0)
    assert len(points) == 50
    assert np.array_equal(points[:40], scene.parameters.random(50, 2005)[:40]), (
        "four fifths are uniform"
    )
    # uniform points have one chance in thirty each
    assert (forces[40:] < np.linalg.norm(training.snapshots.forces, axis=0).max() * 0.02).sum() >= 4
    assert not {tuple(point) for point in points} & {
        tuple(point) for point in training.snapshots.points
    }


def test_contact_that_is_never_seen_is_said():
    full_order = hhr.FullOrderModel(
        dataclasses.replace(hertz_demo.scene(**COARSE), parameters=space(mu=(0.01, 0.05)))
    )
    snapshots = hhr.compute_snapshots(full_order, full_order.problem.parameters.grid([6]))
    with pytest.warns(errors.StabilityWarning, match="no training solution has contact"):
        hhr.build(full_order, snapshots, held_out=snapshots)


def test_residuals_of_exact_and_of_spoiled_answers(hertz):
    """Equilibrium, penetration and sign are zero for the full order, and what was put in for
    spoiled answers.
    """
    problem, solution = hertz.problem, hertz.solve(0.3)
    displacement, forces = solution.displacement(), solution.forces()
    theta = problem.theta(0.3)
    assert max(dataclasses.astuple(contact_residuals(problem, displacement, forces, theta))) < 1e-10
    pulling = forces.copy()
    pulling[~solution.active] = -0.5 * forces.max()
    assert contact_residuals(problem, displacement, pulling, theta).sign == pytest.approx(0.5)
    # half of the forces taken away: what is left over is as large as what remains
    assert contact_residuals(problem, displacement, forces / 2, theta).equilibrium == pytest.approx(
        1.0
    )
    # twice the motion: too deep by the gap of 0.1 at the apex, beside motions of 1 at the ends of
    # the arcs
    twice = 2 * displacement - problem.lifts @ theta
    assert 0.05 < contact_residuals(problem, twice, forces, theta).penetration < 0.2


def test_what_was_not_trained_is_warned_of_refused_or_ignored(half_discs_coarse):
    """Half-discs trained on a part of their box."""
    full_order, _ = half_discs_coarse
    train, test = np.linspace(0.2, 0.4, 12)[:, None], np.linspace(0.21, 0.39, 9)[:, None]
    snapshots, held_out = (hhr.compute_snapshots(full_order, points) for points in (train, test))
    model = hhr.build(full_order, snapshots, held_out=held_out)
    with warnings.catch_warnings(action="error", category=errors.OutsideTrainingWarning):
        assert model.solve(0.3).converged
        model.solve(0.405)  # a twentieth of the spread is no extrapolation
        model.solve(0.44, outside="ignore")

    def marched(mu, outside="warn"):
        return model.march([(0.0, [0.3]), (1.0, [mu])], hhr.MarchSettings(outside=outside))

    def tabulated(mu, outside="warn"):
        return model.solve_many([[0.3], [mu]], outside=outside)

    for answering in (model.solve, marched, tabulated):
        with pytest.warns(
            errors.OutsideTrainingWarning, match=r"mu = 0\.44 \(trained 0\.19 to 0\.41\)"
        ):
            answering(0.44)
        with pytest.raises(errors.OutsideTrainingError, match="Train there"):
            answering(0.44, outside="refuse")
        with pytest.raises(errors.ParameterError, match="one of warn, refuse, ignore"):
            answering(0.44, outside="perhaps")
    with pytest.raises(errors.ParameterError, match="widen the parameter space"):
        model.solve(0.6)


@pytest.mark.parametrize(
    ("carried", "poisson"),
    [(1e4, None), (1e8, None), pytest.param(0.0, 0.4999999999, marks=needs("elasticity"))],
)
def test_contact_is_no_round_off(carried, poisson):
    """Half-discs carried away: loads K lift grow with it, and contact counted as noise beside
    them.
    """
    scene = hertz_demo.scene(**COARSE)
    moved = tuple(
        dataclasses.replace(item, amplitude=hhr.Amplitude(carried)) if item.component == 0 else item
        for item in scene.displacements
    )
    still = with_bodies(scene, poisson=poisson) if poisson else scene
    with ignored(errors.LockingWarning):
        models = [
            hhr.FullOrderModel(one)
            for one in (dataclasses.replace(still, displacements=moved), still)
        ]
    sets = [hhr.compute_snapshots(model, model.problem.parameters.grid([5])) for model in models]
    largest = np.linalg.norm(sets[1].forces, axis=0).max()
    assert np.linalg.norm(sets[0].forces, axis=0).max() == pytest.approx(
        largest, rel=1e-14 * carried + 1e-9
    )
    assert 0 < round_off_force(models[0].problem, sets[0]) < (1e-2 if poisson else 0.02) * largest


@pytest.mark.parametrize(
    "points, empty",
    [
        (np.stack([np.linspace(0, 1, 12)] * 2, axis=1), True),
        (
            np.array(
                [[t, 0.0] for t in np.linspace(0, 1, 8)] + [[0.0, t] for t in np.linspace(0, 1, 8)]
            ),
            True,
        ),
        (space(a=(0.0, 1.0), b=(0.0, 9.0)).grid([2, 20]), False),
        (space(a=(0.0, 1.0), b=(0.0, 9.0)).grid([25, 20]), False),
        (space(a=(0.0, 1.0), b=(0.0, 1.0), c=(0.0, 1.0)).random(60, 1), False),
        (np.linspace(0, 1, 9)[:, None], False),
    ],
)
def test_training_points_that_leave_their_box_empty(points, empty):
    """On a diagonal, or one parameter at a time, the box of the training says nothing: 28 % were
    wrong inside.
    """
    with collected() as caught:
        warn_of_gaps_in_training(points)
    assert bool(caught) is empty
    assert not caught or "of their box empty" in str(caught[0].message)


@pytest.fixture(scope="module")
def half_discs_coarse():
    full_order = hhr.FullOrderModel(hertz_demo.scene(**COARSE))
    return full_order, hhr.compute_snapshots(full_order, full_order.problem.parameters.grid([15]))


@pytest.mark.parametrize(
    "spoil, words",
    [
        (
            lambda s: dataclasses.replace(s, forces=s.forces[:-1]),
            "forces of snapshots have the shape",
        ),
        (
            lambda s: dataclasses.replace(s, displacements=s.displacements.T),
            "displacements of snapshots",
        ),
        (lambda s: dataclasses.replace(s, points=s.points.ravel()), "points of snapshots"),
        (lambda s: s.take([]), "points of snapshots"),
        (lambda s: dataclasses.replace(s, forces=s.forces + 1j), "finite real numbers"),
        (
            lambda s: dataclasses.replace(s, points=s.points * np.nan),
            "points of snapshots are not finite",
        ),
        (
            lambda s: dataclasses.replace(s, active=s.active.astype(float)),
            "active of snapshots holds float64",
        ),
        (lambda s: None, "must be a SnapshotSet"),
    ],
)
def test_snapshots_of_something_else(half_discs_coarse, spoil, words):
    full_order, snapshots = half_discs_coarse
    with pytest.raises(errors.ReductionError, match=words):
        hhr.build(full_order, spoil(snapshots))


@pytest.mark.parametrize("name", ["unknown", "multipliers"])
def test_a_signed_snapshot_that_solves_nothing_is_solved_anew(half_discs_coarse, tmp_path, name):
    """Its checksum is right, its numbers are not: the equations tell."""
    full_order, _ = half_discs_coarse
    store, point = hhr.SnapshotStore(tmp_path, full_order), np.array([0.3])
    store.save(full_order.solve(point))
    assert store.load(point) is not None
    (path,) = tmp_path.glob("*.npz")
    rewrite_signed(path, lambda header, arrays: arrays.update({name: 1.1 * arrays[name]}))
    with pytest.warns(errors.SnapshotFileWarning, match="holds no solution"):
        assert store.load(point) is None


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"refuse_primal": -1}, "refuse_primal = -1 of TrustLimits must be a number, not negative"),
        ({"refuse_dual": "x"}, "refuse_dual = 'x' of TrustLimits"),
        ({"warn_worst": math.nan}, "warn_worst = nan"),
        ({"warn_kappa_B": True}, "warn_kappa_B = True"),
        ({"refuse_primal": 0.01}, "warn_primal = 0.02 .* beyond refuse_primal = 0.01: .* smaller"),
        ({"warn_cond_K": 1e8}, "warn_cond_K = 1e[+]08 .* refuse_cond_K = 1e[+]07"),
    ],
)
def test_limits_that_mean_nothing(given, said):
    """Negative limits once made any error pass as small enough."""
    with pytest.raises(errors.ReductionError, match=said):
        TrustLimits(**given)


def test_limits_that_are_never_reached_are_infinite():
    with pytest.raises(errors.ReductionError, match=r"warn_dual = 2 .* refuse_dual = 0\.6"):
        TrustLimits.of_histories(warn_dual=2.0)
    assert TrustLimits(warn_primal=math.inf, refuse_primal=0.1).warn_primal == math.inf
    assert TrustLimits(warn_definite=-math.inf).warn_definite == -math.inf
    if present("inelastic"):
        from hhr_dolfinx.plugins.inelastic.condense_flow import CorrectionSettings

        assert CorrectionSettings(stress=math.inf, plastic=math.inf).stress == math.inf
