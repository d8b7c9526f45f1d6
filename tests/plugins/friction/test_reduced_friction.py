"""Hyper-reduced contact with friction: increments on the RID, slip and forces everywhere."""

from __future__ import annotations

import dataclasses
import warnings
from unittest.mock import Mock

import contract
import numpy as np
import pytest
from mpi4py import MPI
from needs import needs, present
from sheared_blocks import FIRST, SECOND, round_block, rubbing
from sheared_paths import BOX, OUTPUTS, paths

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import (
    NotOfferedError,
    NotSolvableError,
    ParameterError,
    ReductionError,
    StudyError,
)
from hhr_dolfinx.memory import NO_MEMORY
from hhr_dolfinx.models.eliminations.block import BlockElimination
from hhr_dolfinx.models.model import AnsweringModel
from hhr_dolfinx.study.training.train import Training
from hhr_dolfinx.timing import StageLog

pytestmark = needs("exact_errors")


@pytest.fixture(scope="module")
def scene():
    return rubbing("f", geometry=round_block, box=BOX, outputs=OUTPUTS)


@pytest.fixture(scope="module")
def training(scene):
    return hhr.train(scene, paths(24, 1, scene.parameters), held_out=paths(4, 2, scene.parameters))


@pytest.fixture(scope="module")
def model(training):
    return training.build()


@pytest.fixture(scope="module")
def unseen(training, model):
    """Histories of paths that were not trained, of the full order and of the model."""
    full = training.full_order
    return [(full.march(path), model.march(path)) for path in paths(6, 3, full.parameters)]


def test_unseen_paths(training, model, unseen):
    """Forces, slip and work on the whole surface, though some contacts lie outside the RID."""
    assert 0 < model.own_conditions < 0.9 * training.full_order.conditions
    values = {
        "forces": lambda answer: answer.forces(), "path": lambda answer: answer.slip.path,
        "work": lambda answer: answer.slip.work,
    }  # fmt: skip
    for (name, value), most in zip(values.items(), (0.025, 0.01, 0.02), strict=True):
        errors = []
        for pair in unseen:
            wanted, ours = (
                np.array([value(answer) for answer in history.answers]) for history in pair
            )
            errors.extend(
                np.linalg.norm(ours - wanted, axis=1) / np.linalg.norm(wanted, axis=1).max()
            )
        assert np.quantile(errors, 0.95) < most, name


def test_outputs_and_what_is_known_of_errors(model, unseen):
    """Outputs are those of the whole surface; the indicator follows errors of forces."""
    said, errors = [], []
    for exact, found in unseen:
        largest = max(np.linalg.norm(answer.forces()) for answer in exact.answers)
        for one, other in zip(exact.answers, found.answers, strict=True):
            size = max(np.linalg.norm(one.forces()), 1e-3 * largest)
            errors.append(np.linalg.norm(other.forces() - one.forces()) / size)
            estimate = other.estimate()
            assert estimate.kind == "indicator of the forces" and np.isinf(estimate.primal_relative)
            said.append(estimate.forces_euclid_relative)
        wanted, ours = (dict(history.answers[-1].outputs().values) for history in (exact, found))
        # 5e-6 of forces, 1e-4 of work and 2e-4 of slip were measured; of areas two contacts of 24,
        # and none
        least = {
            "normal": 1e-4 * abs(wanted["normal"]),
            "work": 1e-3 * wanted["work"],
            "slip": 2e-3 * wanted["slip"],
        }
        least |= {"shear": least["normal"], "sticks": 2 / 24, "slips": 2 / 24}
        for name, value in wanted.items():
            assert ours[name] == pytest.approx(value, abs=least[name]), name
    assert "indicator of the forces" in model.known_error
    # .66 was measured, and 97 % of what is said is more than the error
    assert np.corrcoef(np.log(said), np.log(errors))[0, 1] > 0.5
    assert np.mean(np.array(said) > errors) > 0.9


def test_with_all_modes_on_the_whole_mesh_it_is_the_full_order():
    """On its own training: whatever the modes, they hold these answers, and tests see all of the
    mesh.
    """
    full = hhr.FullOrderModel(rubbing(0.3, geometry=round_block), MPI.COMM_SELF)
    known = [full.march(path) for path in paths(2, 7, full.parameters)]
    everywhere = hhr.Zone(lambda problem: np.arange(len(problem.points)))
    recipe = hhr.Recipe.with_friction(
        basis=hhr.Pod(1e-28), nodes=(everywhere,), enrichment=hhr.Enrich(1.0)
    )
    model = hhr.build(full, hhr.SnapshotSet.of_histories(known), recipe.as_it_is())
    assert model.own_conditions == full.conditions
    for history in known:
        for one, other in zip(history.answers, model.march(history.path).answers, strict=True):
            np.testing.assert_allclose(other.forces(), one.forces(), atol=1e-8)
            np.testing.assert_allclose(other.displacement(), one.displacement(), atol=1e-9)
            for name in one.slip._fields:
                np.testing.assert_allclose(
                    getattr(other.slip, name), getattr(one.slip, name), atol=1e-8
                )


def test_laws_hold_outside_the_domain_too(training, model, unseen):
    friction = training.full_order.law
    inside = np.isin(friction.normal, model.fields.A_lambda)
    assert not inside.all()
    for answer in (answer for _, history in unseen for answer in history.answers):
        forces = answer.forces()
        bound = answer.parameter[2] * forces[friction.normal]
        assert (forces[friction.normal] >= 0).all()
        assert (np.abs(forces[friction.tangential]) <= bound + 1e-10 * forces.max()).all()
        np.testing.assert_array_equal(forces[model.fields.A_lambda], answer.multipliers)
        np.testing.assert_array_equal(answer.slip.statuses > 0, forces[friction.normal] > 0)
        np.testing.assert_allclose(answer.slip.pressure, forces[friction.normal], atol=1e-15)


def test_derivatives_along_a_path_are_those_of_differences(model):
    path = paths(1, 11, model.parameters)[0][:9]
    settings = hhr.MarchSettings(gradient=True, cuts=0)
    answer = model.march(path, settings).answers[-1]
    step = 1e-6 * (np.array(model.parameters.upper) - model.parameters.lower)
    slopes = answer.outputs().gradient
    assert {"normal", "shear"} <= set(slopes)
    for axis in (1, 2):  # pushed from the end of the box, where no difference can be taken
        shift = step * (np.arange(3) == axis)
        plain = dataclasses.replace(settings, gradient=False)
        ends = [[(time, point + sign * shift) for time, point in path] for sign in (-1.0, 1.0)]
        moved = [model.march(end, plain).answers[-1] for end in ends]
        for name in ("normal", "shear"):
            difference = (moved[1].outputs()[name] - moved[0].outputs()[name]) / (2 * step[axis])
            assert slopes[name][axis] == pytest.approx(
                difference, rel=1e-3, abs=1e-5 * np.abs(slopes[name]).max()
            )
        forces = (moved[1].forces() - moved[0].forces()) / (2 * step[axis])
        own = model.fields._all_force_changes(answer, np.zeros((0, 3)))[:, axis]
        np.testing.assert_allclose(own, forces, atol=1e-4 * np.abs(forces).max())


@needs("tables")
def test_a_table_has_its_answers(model):
    point = paths(1, 13, model.parameters)[0][-1][1]
    answers, answer = hhr.answer_points(model, point[None]), model.solve(point)
    assert answers.total_force[0] == pytest.approx(-answer.outputs()["normal"], rel=1e-12)
    np.testing.assert_array_equal(answers.forces[0], answer.forces())


def test_moduli_are_eliminated_once_along_a_path():
    """Where K~ is not smooth enough to be interpolated.

    What points of a path share is what each has for itself.
    """
    bodies = hhr.Body(FIRST, "E", 0.3), hhr.Body(SECOND, 5.0, 0.2)
    scene = rubbing(0.3, geometry=round_block, box={"E": (3.0, 6.0)}, bodies=bodies)
    full = hhr.FullOrderModel(scene, MPI.COMM_SELF)
    known = [full.march(path) for path in paths(6, 1, full.parameters)]
    model = hhr.build(
        full, hhr.SnapshotSet.of_histories(known), hhr.Recipe.with_friction().as_it_is()
    )
    alone = BlockElimination(model.problem, model.fields.amplitudes)
    made = alone.along_path()
    forces = np.ones(model.own_conditions)
    for point in ([0.01, 0.02, 4.0], [0.04, -0.05, 4.0], [0.04, -0.05, 5.0]):
        one, other = alone(np.array(point)), made(np.array(point))
        np.testing.assert_allclose(other.schur, one.schur, rtol=1e-13, atol=1e-15)
        np.testing.assert_allclose(other.free_slack, one.free_slack, atol=1e-14)
        np.testing.assert_allclose(other.unknown(forces), one.unknown(forces), atol=1e-12)
        pair = [item.at_fixed_forces(forces, item.unknown(forces)) for item in (other, one)]
        for ours, theirs in zip(*pair, strict=True):
            np.testing.assert_allclose(ours, theirs, atol=1e-12)
    path = paths(1, 15, full.parameters)[0]
    exact, found = full.march(path).answers[-1], model.march(path).answers[-1]
    # 6e-5 was measured
    assert np.linalg.norm(found.forces() - exact.forces()) < 1e-3 * np.linalg.norm(exact.forces())


@needs("floating")
def test_too_few_modes_for_what_sticks_are_refused(monkeypatch):
    """A body that contact alone holds: modes without its motions must tell the forces of all rows
    apart.

    The usual recipe takes the enrichment that it advises then, and the model answers as the full
    order.
    """
    full, path = contract.rubbing("floating"), [(0.0, [0.01]), (1.0, [0.05])]
    histories = hhr.SnapshotSet.of_histories([full.march(path)] * 2)
    small = hhr.Recipe.with_friction(domain=hhr.Rid(1, 1), enrichment=hhr.Enrich(10.0))
    with pytest.raises(NotSolvableError, match="friction has several answers: enrich the basis"):
        hhr.build(full, histories, small)
    usual = lambda **changes: dataclasses.replace(small, **changes)  # noqa: E731
    monkeypatch.setattr("hhr_dolfinx.plugins.contact_laws.reduction.of_paths", usual)
    model = Training(full, histories, None, StageLog()).build()
    assert (
        model.offline.recipe.enrichment == hhr.Enrich(2.0) and len(model.offline.log.refused) == 1
    )
    exact, found = (item.march(path).answers[-1].forces() for item in (full, model))
    # a path of training, which its modes span
    assert np.linalg.norm(found - exact) < 1e-8 * np.linalg.norm(exact)


@needs("greedy", "studies")
def test_what_is_not_built_in_is_refused_by_name(scene, training):
    with pytest.raises(
        StudyError, match="depend on the path that leads to them: train on a list of paths"
    ):
        hhr.train(scene, hhr.Sobol(8))
    with pytest.raises(
        NotOfferedError, match="a training that chooses such histories itself is not built in"
    ):
        hhr.train(scene, hhr.Greedy(budget=3))
    points = training.snapshots.take(np.arange(4))
    with pytest.raises(ReductionError, match="with friction must be histories"):
        hhr.build(training.full_order, points)
    with pytest.raises(NotOfferedError, match="a study of scene 'rubbing' is not built in"):
        hhr.study_scene(scene, hhr.StudySettings(paths(2, 1, scene.parameters)), "nowhere")
    with pytest.raises(ValueError, match="go together"):
        training.full_order.law.within(training.full_order.law.normal[:2])


def test_nothing_is_known_of_forces_where_bodies_overlap_outside_the_domain(training, model):
    """No force in the RID would be explained by any modes.

    Contact that has left it shows in the displacement.
    """
    fields = model.fields
    frictional, scale = fields.interface, fields.gap_scale
    friction = frictional.whole
    row = friction.normal[~np.isin(friction.normal, frictional.within)][0]
    apart, deep = np.ones(len(scale)) * scale, np.ones(len(scale)) * scale
    deep[row] = -1e-4 * scale[row]
    nothing = np.zeros(model.own_conditions)
    assert frictional.indicated(nothing, apart, scale, NO_MEMORY) == 0.0
    assert np.isinf(frictional.indicated(nothing, deep, scale, NO_MEMORY))
    forces = np.where(np.isin(fields.A_lambda, friction.normal), 1.0, 0.0)
    said = frictional.indicated(forces, deep, scale, NO_MEMORY)
    assert said == frictional.indicated(forces, apart, scale, NO_MEMORY) > 0.0
    deep[row] = -max(1.0, 10 * frictional.depth) * scale[row]
    assert np.isinf(frictional.indicated(forces, deep, scale, NO_MEMORY))


def test_what_grazes_when_held_out_does_not_spoil_the_indicator(training):
    """Relative to its own forces nothing of such a history is right.

    What other histories say counts.
    """
    full = training.full_order
    grazing = [(0.0, np.array([0.0, 0.0, 0.3])), (1.0, np.array([1e-12, 0.0, 0.3]))]
    held_out = [full.march(grazing), *training.held_out.histories]
    shares = []
    for histories in (held_out[1:], held_out, held_out[:1]):
        apart = hhr.SnapshotSet.of_histories(histories)
        with warnings.catch_warnings(action="ignore"):
            model = hhr.build(full, training.snapshots, None, apart)
        shares.append(model.fields.interface.share)
        assert 1.0 <= shares[-1] < 100.0
    assert shares[0] == pytest.approx(shares[1], rel=1e-9)


@pytest.mark.parametrize(("flows", "tolerance"), [(False, None), (False, 5e-3), (True, None)])
def test_a_training_that_was_interrupted_goes_on(flows, tolerance, tmp_path):
    """Steps are read, with what friction remembers; a tolerance may cut them otherwise.

    Other friction asks anew.
    """
    law = hhr.Plasticity(0.06, 0.5) if flows else None
    bodies = hhr.Body(FIRST, 3.0, 0.3), hhr.Body(SECOND, 5.0, 0.2, law)
    scene = rubbing("f", box=BOX, bodies=bodies)
    every = [path[::6] for path in paths(2, 17, scene.parameters)]
    settings = hhr.MarchSettings(time_tolerance=tolerance)
    with warnings.catch_warnings(action="ignore"):
        wanted = hhr.train(scene, every, march=settings).snapshots
        hhr.train(scene, [every[0], every[1][:3]], march=settings, folder=tmp_path)
        again = hhr.train(scene, every, march=settings, folder=tmp_path)
        assert again.read == len(every[0]) - 1 + 2
        other = hhr.train(
            rubbing("0.9 * f", box=BOX, bodies=bodies), every, march=settings, folder=tmp_path
        )
    assert other.read == 0
    off = 1e-9 if tolerance is None else tolerance
    np.testing.assert_allclose(
        again.snapshots.forces, wanted.forces, atol=off * np.abs(wanted.forces).max()
    )
    for one, two in zip(wanted.histories, again.snapshots.histories, strict=True):
        for first, second in zip(one.answers, two.answers, strict=True):
            assert second.time == first.time
            assert second.slip.work.sum() == pytest.approx(
                first.slip.work.sum(), rel=2 * off, abs=1e-12
            )
            if tolerance is None:
                np.testing.assert_allclose(second.slip.work, first.slip.work, atol=1e-12)
                np.testing.assert_array_equal(second.slip.statuses, first.slip.statuses)
                assert second.ends == pytest.approx(first.ends)
                assert second.time_error == pytest.approx(first.time_error, rel=1e-6, nan_ok=True)


@needs("fallback", "tables")
def test_a_path_of_which_too_little_is_known_is_answered_in_full(training, model):
    """By the indicator of any increment: two of eight paths fell back, and the largest error was
    .038.
    """
    full = training.full_order
    safe = training.safe_model(0.05, of="forces")
    fell, off = [], []
    for path in paths(8, 11, full.parameters):
        history, exact = safe.march(path), full.march(path)
        fell.append(safe.fell_back(history.answers[-1]))
        assert all(safe.fell_back(answer) is fell[-1] for answer in history.answers)
        pairs = zip(history.answers, exact.answers, strict=True)
        errors = [
            np.linalg.norm(one.forces() - two.forces()) / np.linalg.norm(two.forces())
            for one, two in pairs
        ]
        if fell[-1]:
            assert max(errors) < 1e-12
        off += errors
    assert 0 < sum(fell) < 8 and (safe.asked, safe.fallen) == (8, sum(fell))
    assert max(off) <= 0.05
    with pytest.raises(ParameterError, match="must be MarchSettings"):
        safe.march(path, "quick")
    assert safe.asked == 8
    outside = dict(zip(full.parameters.names, full.parameters.upper, strict=True))
    answer = safe.solve(outside)
    wanted = full.solve(outside).forces()
    assert np.linalg.norm(answer.forces() - wanted) <= 0.05 * np.linalg.norm(wanted)
    asked = safe.asked
    assert len(safe.solve_many([list(outside.values())] * 2)) == 2
    slopes = safe.solve(outside, gradient=True)
    assert safe.asked == asked + 3 and slopes.gradient is not None
    points = full.parameters.random(12, 4)
    table = hhr.answer_points(safe, points, outside="ignore")
    fell = table.columns["fell_back"] == 1
    assert set(table.estimates) == {"indicator of the forces"} and 0 < fell.sum() < 12
    said = table.estimates["indicator of the forces"]
    assert (said <= 0.05).all() and (said[fell] == 0.0).all()
    assert safe.coupling(outside) == pytest.approx(full.coupling(outside), rel=1e-12)
    assert "indicator of the forces" in safe.known_error


@needs("fallback")
def test_what_is_no_safe_model(training, model):
    full = training.full_order
    with pytest.raises(ParameterError, match="ask for of='forces'"):
        hhr.FallbackModel(model, full)
    with pytest.raises(ParameterError, match="ask for of='forces'"):
        training.safe_model(of="pressure")
    second = hhr.Body(SECOND, 5.0, 0.2)
    others = (
        ("0.5 * f", {}),
        ("f", {"bodies": (hhr.Body(FIRST, 3.01, 0.3), second)}),
        ("f", {"hypothesis": "plane_stress"}),
    )
    if present("inelastic"):
        others += (
            ("f", {"bodies": (hhr.Body(FIRST, 3.0, 0.3, hhr.Plasticity(0.06, 0.5)), second)}),
        )
    for law, how in others:
        other = hhr.FullOrderModel(
            rubbing(law, geometry=round_block, box=BOX, **how), MPI.COMM_SELF
        )
        with pytest.raises(ReductionError, match=r"of another scene|inelastic bodies"):
            hhr.FallbackModel(model, other, of="forces")


@needs("fallback")
def test_what_a_safe_model_cannot_answer_is_of_the_full_one(training, model, monkeypatch):
    full = training.full_order
    safe = hhr.FallbackModel(model, full, of="forces")
    monkeypatch.setattr(
        AnsweringModel, "follow", Mock(side_effect=NotSolvableError("a body is pulled off"))
    )
    answer = safe.solve(full.parameters.middle, raise_on_failure=False)
    assert safe.fell_back(answer) and not answer.converged
    assert (
        answer.displacement().shape == (len(full.problem.free),) and np.isnan(answer.forces()).all()
    )


@needs("fallback")
def test_increments_within_a_step_are_looked_at(training):
    """Steps of a tolerance are cut: a model that knows their ends only must not answer them."""
    safe = training.safe_model(0.08, of="forces")
    settings = hhr.MarchSettings(time_tolerance=1e-2)
    answered = 0
    for path in paths(6, 21, training.full_order.parameters):
        history = safe.march(path[::4], settings)
        if not safe.fell_back(history.answers[-1]):
            answered += 1
            again = safe.reduced.march(history.solved_path)
            assert max(answer.estimate().forces_euclid_relative for answer in again.answers) <= 0.08
    assert 0 < answered < 6
