"""Local models of histories: reduced models that take turns along a path and hand their state on."""

import pickle
import warnings

import numpy as np
import pellet_cladding_plastic as demo
import pytest
from flowing import SMALL_MESH, STEPS
from marched import bits
from mpi4py import MPI

import hhr_dolfinx as hhr
from hhr_dolfinx.certify.accuracy import relative_error
from hhr_dolfinx.certify.compare import compare_histories
from hhr_dolfinx.errors import OutsideTrainingWarning, ParameterError, ReductionError, StudyError
from hhr_dolfinx.models.local_histories import LocalHistories
from hhr_dolfinx.reduction.flow import training_tangents
from hhr_dolfinx.study.training.local_histories import local_histories

QUIET = hhr.MarchSettings(outside="ignore")
TIGHT = hhr.MarchSettings("tangent", 1e-9, 1e-9, 1e-9, outside="ignore")
RECIPE = hhr.Recipe.flowing(basis=hhr.Pod(1e-9))
PHASES = np.repeat([0, 1], STEPS)


def there_and_back(gap, back=1.0):
    """Loaded within a second, and unloaded by a part of it in as many steps."""
    shares = np.arange(STEPS + 1) / STEPS
    return demo.history(np.arange(2 * STEPS + 1) / STEPS, np.concatenate([shares, 1 - back * shares[1:]]), gap)


@pytest.fixture(scope="module")
def trained():
    paths = [there_and_back(5.0), there_and_back(12.0)]
    return hhr.train(demo.scene(**SMALL_MESH), paths, held_out=[there_and_back(9.0)], comm=MPI.COMM_SELF)


@pytest.fixture(scope="module")
def single(trained):
    return trained.build(RECIPE, checked=False)


@pytest.fixture(scope="module")
def phased(trained):
    """Two models: of loading and of unloading."""
    return trained.local([PHASES] * 2, recipe=RECIPE, checked=False)


def one_label(trained):
    return local_histories(trained, [0 * PHASES] * 2, RECIPE, checked=False)


def test_with_one_label_it_is_the_single_model_to_the_last_bit(trained, single):
    local = one_label(trained)
    path = there_and_back(8.0)
    assert bits(local.march(path, QUIET)) == bits(single.march(path, QUIET))
    assert local.trained.imbalance == pytest.approx(single.trained.imbalance, rel=1e-12)
    assert len(local) == 1 and local.dimension == single.dimension


def test_loading_and_unloading_take_turns_and_fewer_modes(phased, single):
    history = phased.march(there_and_back(8.0), QUIET)
    numbers = phased.models_of(history)
    turn = int(np.flatnonzero(np.diff(numbers))[0]) + 1
    assert numbers[0] == 0 and numbers[-1] == 1 and (np.diff(numbers) >= 0).all()
    assert STEPS <= turn <= STEPS + 4
    assert phased.models[1].fields.basis.shape[1] < single.fields.basis.shape[1]
    assert len(history.signs) == len(history.answers) == 2 * STEPS and history.cuts == 0


def test_what_they_answer_is_what_one_model_answers_within_the_error_of_training(trained, phased, single):
    exact = trained.full_order.march(there_and_back(8.0))
    wrong = [compare_histories(trained.full_order, model, {"": exact}, 0.0)[0] for model in (phased, single)]
    assert wrong[0].primal[0] <= max(2 * wrong[1].primal[0], 1e-3)
    assert wrong[0].dual[0] <= max(2 * wrong[1].dual[0], 0.02)


def test_a_change_of_model_hands_its_state_on_as_it_is(phased):
    history = phased.march(there_and_back(8.0), QUIET)
    numbers = phased.models_of(history)
    turn = int(np.flatnonzero(np.diff(numbers))[0])
    last = history.answers[turn]
    carried = phased.equilibrium.carried(last, 1)
    assert carried.gauss is last.gauss and carried.fields is phased.models[1].fields
    flowed = np.array([answer.state().state.cumulated for answer in history.answers])
    assert np.diff(flowed, axis=0).min() >= 0
    # both know the states at which they take turns: their displacements are nearly the same
    assert relative_error(carried.displacement(), last.displacement()) < 0.05


def test_each_answer_is_in_balance_in_its_own_model(phased):
    for answer in phased.march(there_and_back(8.0), TIGHT).answers:
        own = phased.equilibrium.answering(answer)
        left, size = own.residual(answer.unknown, answer.state(), own.amplitudes(answer.parameter))
        left = left - own.contact_load(answer.multipliers)
        assert np.linalg.norm(left) <= 1e-8 * size[0] + 1e-9
        slack = own.gaps(own.amplitudes(answer.parameter)) - own.problem.contact_trial @ answer.unknown
        assert slack.min() > -1e-9 and abs(slack @ answer.multipliers) < 1e-9 * np.abs(answer.multipliers).max(
            initial=1
        )


def test_a_path_that_stays_in_one_phase_changes_no_model(phased):
    path = demo.path(8.0, STEPS)
    history = phased.march(path, QUIET)
    assert not phased.models_of(history).any()
    assert bits(history) == bits(phased.models[0].march(path, QUIET))


def test_models_that_are_no_longer_known_are_asked_again_and_again_at_growing_misfits_only(phased):
    asked = []
    original = phased.equilibrium.stepper(QUIET).__class__._fresh

    def counted(self, number):
        asked.append(number)
        return original(self, number)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("hhr_dolfinx.models.local_histories.LocalStepper._fresh", counted)
        history = phased.march(there_and_back(8.0), QUIET)
    assert len(asked) <= 2 + 4 < len(history.answers)


def test_the_door_warns_of_them_together_as_of_one(phased):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        phased.march(there_and_back(15.5)[:3])
    assert any(item.category is OutsideTrainingWarning and "gap = 0.0155" in str(item.message) for item in caught)


def test_derivatives_go_through_a_change_of_model(phased):
    def history(gap, **how):
        found = phased.march(there_and_back(gap), hhr.MarchSettings(**({"search": "tangent", "relative_stress": 1e-11,
            "floor_stress": 1e-11, "relative_force": 1e-11, "outside": "ignore"} | how)))  # fmt: skip
        return found, phased.models_of(found)

    with_slopes, numbers = history(8.0, gradient=True)
    (low, lower), (high, higher) = history(8.0 - 1e-3), history(8.0 + 1e-3)
    assert (lower == numbers).all() and (higher == numbers).all() and numbers[-1] == 1
    expected = (high.answers[-1].unknown - low.answers[-1].unknown) / 2e-6
    assert relative_error(with_slopes.answers[-1].gradient.unknown[:, 2], expected) < 1e-3


def test_a_copy_answers_the_same_and_one_step_is_that_of_a_path(phased):
    path = there_and_back(8.0)
    copied = pickle.loads(pickle.dumps(phased))
    assert copied.offline is None and bits(copied.march(path, QUIET)) == bits(phased.march(path, QUIET))
    step = phased.solve([200.0, 0.9, 8e-3], outside="ignore")
    assert step.converged and phased.model_of(step) == 0


@pytest.mark.parametrize("labels, said", [
    ([PHASES], "one array for each training history"),
    ([PHASES, PHASES[:-1]], "as many numbers as it has steps"),
    (PHASES, "one array for each training history"),
    (None, "one array for each training history"),
    ([PHASES - 1, PHASES], "whole numbers from 0"),
    ([1.0 * PHASES, PHASES], "whole numbers from 0"),
    ([2 * PHASES, PHASES * 0], "label 1 has 0 steps"),
])  # fmt: skip
def test_labels_that_are_none_of_the_steps_are_refused(trained, labels, said):
    with pytest.raises(ReductionError, match=said):
        local_histories(trained, labels, RECIPE)


def test_models_of_other_scenes_and_other_answers_are_refused(trained, phased, single, hertz_reduction):
    with pytest.raises(ReductionError, match="nothing flows"):
        LocalHistories([hertz_reduction])
    with pytest.raises(ReductionError, match="at least one"):
        LocalHistories([])
    with pytest.raises(ReductionError, match="not of these local models"):
        phased.model_of(single.march(demo.path(8.0, STEPS)[:2], QUIET).answers[-1])
    with pytest.raises(ReductionError, match="overlap = -1"):
        local_histories(trained, [PHASES] * 2, RECIPE, overlap=-1)


def test_parts_of_histories_are_those_steps(trained):
    snapshots, columns = trained.snapshots, np.array([0, 1, 2, 2 * STEPS, 2 * STEPS + 3])
    part = snapshots.part(columns)
    assert [list(steps) for steps in part.steps_of_histories] == [[0, 1, 2], [0, 3]]
    assert np.array_equal(part.displacements, snapshots.displacements[:, columns])
    assert len(part.states) == 5 and part.histories == snapshots.histories
    for forbidden in (lambda: part.part(columns), lambda: part.joined(snapshots), lambda: snapshots.joined(part)):
        with pytest.raises(ReductionError, match="whole"):
            forbidden()
    full = trained.full_order.equilibrium
    every, few = (training_tangents(full, item, 2) for item in (snapshots, part))
    assert len(every) == 4 and len(few) == 4
    assert np.array_equal(few[1][0], training_tangents(full, snapshots, 2 * STEPS)[2][0])


def test_the_check_of_all_models_together_passes_and_is_kept(trained):
    local = local_histories(trained, [PHASES] * 2, hhr.Recipe.flowing(domain=hhr.Rid(3, 4)))
    record = local.offline
    assert record.comparison.labels == ["trained history 0", "trained history 1", "held-out history 0"]
    assert record.layers >= 3 and record.overlap == 2 and set(record.log.times) >= {"nodes", "models", "validation"}


def test_models_with_points_of_their_own_complete_the_state_they_hand_on(trained):
    # as exact as both models must be to take turns: where a thousandth of the forces is left, that of unloading has 23
    # points for 15 modes, and the processor's kernels decide whether it converges
    recipe = hhr.Recipe.flowing(basis=hhr.Pod(1e-7), domain=hhr.Rid(20, 20), cubature=hhr.CubatureStep(1e-6))
    local = local_histories(trained, [PHASES] * 2, recipe, checked=False)
    assert not local.equilibrium.shares_points
    exact = trained.full_order.march(there_and_back(8.0))
    history = local.march(exact.path, QUIET)
    assert local.models_of(history)[-1] == 1
    assert relative_error(history.answers[-1].plastic_strain(), exact.answers[-1].plastic_strain()) < 0.05
    with pytest.raises(ParameterError, match="has no derivative"):
        local.march(exact.path, hhr.MarchSettings(gradient=True))


def test_models_with_domains_of_their_own_answer_as_well(trained):
    recipe = hhr.Recipe.flowing(basis=hhr.Pod(1e-9), nodes=(hhr.Deim(), hhr.LoadNodes()), domain=hhr.Rid(1, 1))
    local = local_histories(trained, [PHASES] * 2, recipe, common=False, checked=False)
    exact = trained.full_order.march(there_and_back(8.0))
    history = local.march(exact.path, QUIET)
    assert not local.equilibrium.shares_points and local.models_of(history)[-1] == 1
    assert relative_error(history.answers[-1].plastic_strain(), exact.answers[-1].plastic_strain()) < 0.05


@pytest.mark.parametrize("how", [None, hhr.Clusters(2)])
def test_histories_need_labels(trained, how):
    with pytest.raises(StudyError, match="each step"):
        trained.local(how)
