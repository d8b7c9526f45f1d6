"""Errors of time steps: their estimate compared with true ones, and steps cut by it."""

import warnings
from dataclasses import replace

import condensing
import flowing
import numpy as np
import pellet_cladding_plastic as demo
import pytest
import time_errors as scripts
from condensing import walled_tube
from needs import needs
from toy_law import Bingham
from tubes import tube

import hhr_dolfinx as hhr
from hhr_dolfinx.contact.active_set import Status
from hhr_dolfinx.errors import ParameterError, TimeStepWarning
from hhr_dolfinx.geometries import block
from hhr_dolfinx.materials.elasticity import lame_parameters
from hhr_dolfinx.memory import Memory
from hhr_dolfinx.models.answer import Answer
from hhr_dolfinx.plugins.inelastic.equilibrium import Goal, Stepper
from hhr_dolfinx.plugins.inelastic.law import program_of
from hhr_dolfinx.plugins.inelastic.points import ALL_HERE
from hhr_dolfinx.plugins.inelastic.state import GaussState
from hhr_dolfinx.plugins.inelastic.time_error import SecondSolution
from hhr_dolfinx.plugins.inelastic.update import Group, Material

pytestmark = pytest.mark.filterwarnings("ignore::hhr_dolfinx.errors.TimeStepWarning")
QUIET = hhr.MarchSettings(search="elastic", iterations=200, outside="ignore")
ASKED = replace(QUIET, time_error=True)
CONTROLLED = replace(QUIET, time_tolerance=0.01)
NEAR = 3.0
"""Factor within which an estimate is to be of the largest error of a history."""


def held(steps, up=8, high=2, top=1.0):
    """Times and shares of a load that is put on within a second and held for four decades of time,
    from .01 s on.
    """
    times = np.concatenate([np.arange(up + 1) / up, 1 + np.logspace(high - 4, high, steps + 1)])
    return times, top * np.minimum(times, 1.0)


def errors(exact, history):
    """Largest errors of stress, forces, displacement and cumulated strain over their largest sizes
    in a history.
    """
    times = np.array([answer.time for answer in exact.answers])
    near = [exact.answers[int(np.abs(times - answer.time).argmin())] for answer in history.answers]
    assert [answer.time for answer in near] == pytest.approx(
        [answer.time for answer in history.answers]
    )
    names = "stress", "forces", "displacement", "plastic_strain"
    return np.array(condensing.apart(history, replace(exact, answers=near), names))


def errors_so_far(exact, history):
    """Largest error of stress or displacement over the largest size so far, of which ``time_error``
    is the estimate.
    """
    times = np.array([answer.time for answer in exact.answers])
    near = [exact.answers[int(np.abs(times - answer.time).argmin())] for answer in history.answers]
    found = []
    for name in ("stress", "displacement"):
        pairs = [
            (getattr(one, name)(), getattr(two, name)())
            for one, two in zip(history.answers, near, strict=True)
        ]
        sizes = np.maximum.accumulate([np.linalg.norm(known) for _, known in pairs])
        found += [
            np.linalg.norm(one - known) / size
            for (one, known), size in zip(pairs, sizes, strict=True)
        ]
    return max(found)


class HeldPoint(Stepper):
    """A point that relaxes at a constant strain, as a model and its stepper."""

    def __init__(self, law):
        super().__init__(self, hhr.MarchSettings(time_error=True))
        self.material = Material([Group(np.arange(1), 1.0, 0.3, program_of(law, 4))], 4)
        self.shear = lame_parameters(1.0, 0.3)[1]
        self.together = ALL_HERE
        self.strain = np.array([[0.0, 0.0, 0.0, np.sqrt(2 / 3) / (2 * self.shear)]])
        self.start = self.answer(0.0, 2 * self.shear * self.strain, self.material.at_rest())

    def alongside(self):
        return self

    def stepper(self, settings):
        return self

    def learn(self, answer):
        raise NotImplementedError

    @staticmethod
    def displacement(answer):
        return np.zeros(1)

    def answer(self, time, stress, state):
        nothing = np.zeros(0)
        how = nothing, nothing, nothing, 1, Status.CONVERGED, False, self, time
        return Answer(nothing, *how, memory=Memory(gauss=GaussState(stress, state)))

    def step(self, trail, goal):
        state = trail[-1].memory["gauss"].state
        update = self.material.update(self.strain, state, goal.time - trail[-1].time, tangent=False)
        return self.answer(goal.time, update.stress, update.state)


@pytest.mark.parametrize(
    "law", [hhr.Norton(1.0, 4.0), hhr.Norton(1.0, 1.0), Bingham(0.2, 1.0)], ids=repr
)
@pytest.mark.parametrize("steps", [4, 8, 16, 32, 64])
def test_estimate_at_a_point_held_at_a_strain(law, steps):
    """Relaxation of σ_eq from 1 over four decades, of which laws have closed forms."""
    point = HeldPoint(law)

    def exact(time):
        rate = 3 * point.shear * time
        if isinstance(law, Bingham):
            return 0.2 + 0.8 * np.exp(-rate)
        return np.exp(-rate) if law.exponent == 1 else (1 + 3 * rate) ** (-1 / 3)

    here, second = point.start, SecondSolution(point, point.settings, point.start)
    wrong, told = [], []
    for time in np.logspace(-2, 2, steps + 1):
        there = point.step((here,), Goal(float(time), here.parameter))
        second.follow(here, there, False)
        size = float(there.memory["gauss"].stress[0, 3]) * np.sqrt(1.5)
        wrong.append(abs(size - exact(time)))
        told.append(second.errors().stress * float(second.largest[0]))
        here = there
    assert 0.8 < max(told) / max(wrong) < NEAR


@pytest.fixture(scope="module")
def pressed():
    """Creeping tubes pressed against a wall and held, bulging freely, swelling or softened by heat.

    Exact histories.
    """
    law, found = hhr.Norton(2.0, 4.0), []
    hot, soft = hhr.Heated(law, 5e-3, "p"), hhr.ChangingStiffness(law, "200 * (1 - 0.5 * p)")
    walled = [
        (walled_tube(of, wall=wall), 0.9, 2)
        for of, wall in ((law, 2.003), (hot, 2.01), (soft, 2.003))
    ]
    for scene, top, high in (walled[0], (tube(law, 0.6, cells=8), 0.6, 0), *walled[1:]):
        full = hhr.FullOrderModel(scene)

        def path(steps, up=8, top=top, high=high):
            return [
                (float(time), np.array([share]))
                for time, share in zip(*held(steps, up, high, top), strict=True)
            ]

        found.append((full, path, full.march(path(256, 128), hhr.MarchSettings("tangent"))))
    return found


@pytest.mark.parametrize(
    "scene", range(4), ids=["pressed against a wall", "bulging", "heated", "softened"]
)
@pytest.mark.parametrize("steps", [4, 16, 64])
def test_estimate_of_creeping_tubes(pressed, scene, steps):
    full, path, exact = pressed[scene]
    history = full.march(path(steps), hhr.MarchSettings("tangent", time_error=True))
    assert 0.8 < history.time_error.max() / errors_so_far(exact, history) < NEAR
    # steps of a tolerance, from whatever path
    cut = full.march(path(steps), hhr.MarchSettings("tangent", time_tolerance=0.01))
    assert cut.time_error.max() < 0.012 and errors(exact, cut).max() < 0.03
    assert [answer.time for answer in cut.answers] == [time for time, _ in path(steps)[1:]]


@pytest.fixture(scope="module")
def pellet():
    """The flowing pellet with its small models, whose own errors do not count, and a path."""
    full = flowing.flowing_full()

    def path(steps, gap=8.0, up=8):
        return demo.history(*held(steps, up), gap)

    trained = [full.march(path(16, gap), QUIET) for gap in flowing.TRAINING]
    reduced = hhr.build(
        full, hhr.SnapshotSet.of_histories(trained), hhr.Recipe.flowing().as_it_is()
    )
    return {
        "full": full,
        "HHR": reduced,
        "condensed": condensing.condensed(full, trained, attempts=1, trust=None),
    }, path


@needs("nonmatching")
@pytest.mark.parametrize("name", ["full", "HHR", "condensed"])
def test_all_models_estimate_and_cut_alike(pellet, name):
    """Few steps are 10 % off, and their estimate says so.

    A tolerance of a hundredth is kept by each model itself.
    """
    models, path = pellet
    exact = models[name].march(path(128, up=128), QUIET)
    plain, cut = (models[name].march(path(4), settings) for settings in (ASKED, CONTROLLED))
    wrong = errors(exact, plain)
    assert wrong[0] > 0.08 and 0.8 < plain.time_error.max() / errors_so_far(exact, plain) < NEAR
    assert sum(plain.parts) <= 14 and (name == "HHR" or plain.cuts == 0)
    assert errors(exact, cut)[:2].max() < 0.02 and cut.time_error.max() < 0.012
    assert cut.cuts == sum(part > 1 for part in cut.parts) > 5
    assert 40 < sum(cut.parts) / 2 < 200  # each part is answered in halves
    assert np.array_equal(
        [answer.time for answer in cut.answers], [time for time, _ in path(4)[1:]]
    )


@needs("nonmatching")
def test_finer_tolerances_take_more_parts(pellet):
    models, path = pellet
    exact = models["condensed"].march(path(128, up=128), QUIET)
    found = [
        models["condensed"].march(path(4), replace(CONTROLLED, time_tolerance=t))
        for t in (0.1, 0.03, 0.01)
    ]
    parts = [sum(history.parts) / 2 for history in found]  # each is answered in halves
    assert parts == sorted(set(parts)) and parts[0] < 30
    wrong = [errors(exact, history)[0] for history in found]
    assert wrong == sorted(wrong, reverse=True)


@pytest.mark.parametrize("modulus", [50.0, 260.0])
def test_a_law_with_an_own_modulus_has_the_error_of_a_body_with_it(modulus):
    """The modulus of the body, which the law replaces, does not matter."""
    law, (times, loads) = hhr.Norton(6.0, 4.0), held(6, 4, 1, 0.9)
    path = [(float(time), np.array([load])) for time, load in zip(times, loads, strict=True)]
    found = []
    settings = hhr.MarchSettings("tangent", 1e-9, 1e-7, 1e-9, time_tolerance=0.01)
    for own, young in ((hhr.ChangingStiffness(law, modulus), 200.0), (law, modulus)):
        body = (hhr.Body(block.SOLID, young, 0.3, own),)
        found.append(hhr.FullOrderModel(tube(own, 0.9, cells=3, bodies=body)).march(path, settings))
    assert found[0].time_error == pytest.approx(found[1].time_error, rel=1e-4)
    assert found[0].parts == found[1].parts


def test_linear_creep_from_rest_keeps_a_tolerance():
    """Its error falls with the stress of a short part, which is small beside that of the step."""
    full = hhr.FullOrderModel(tube(hhr.Norton(100.0, 1.0), 0.9, cells=3))
    found = full.march(
        [(time, np.array([min(time, 0.9)])) for time in (0.0, 0.45, 0.9, 2.0)], CONTROLLED
    )
    assert found.time_error.max() < 0.012 and 5 < sum(found.parts) < 400


@pytest.mark.parametrize("up", [0.1, 1e-4])
def test_yield_in_a_quick_step_is_no_rate_of_the_hold(up):
    """Plastic flow of the load divided by its time would count as creep at the start of the
    hold.
    """
    full = hhr.FullOrderModel(tube(hhr.PlasticityWithCreep(1.2, 5.0, 6.0, 4.0), 0.9, cells=3))
    found = full.march([(0.0, [0.0]), (up, [0.9]), (up + 0.1, [0.9]), (up + 1.0, [0.9])], ASKED)
    assert 1e-4 < found.time_error.max() < 0.05


def _named(value):
    return value if isinstance(value, str) else value.name


SCENES = {
    "Norton": scripts.CASES,
    "Perzyna of a user": scripts.CASES,
    "PlasticityWithCreep": scripts.CASES[2:5:2],
}


@pytest.mark.parametrize(
    ("name", "case"), [(name, case) for name, cases in SCENES.items() for case in cases], ids=_named
)
def test_estimates_of_stress_displacement_and_forces(name, case):
    """Compared with the same path in eight times as many steps, whose own error is an eighth."""
    full = hhr.FullOrderModel(case.scene(scripts.LAWS[name]))
    estimates, wrong = scripts.compared(full, case.path, 8)
    for field, error in wrong.items():
        assert error == 0 or 0.8 < estimates[field] / error < NEAR, field
    assert wrong["displacement"] > 0.003


@pytest.mark.parametrize("scene", ["tube", "bending"])
def test_primary_creep_after_a_quick_load(scene):
    """Its rate is infinite at first; an estimate from rates was 100 to a million times too
    large.
    """
    full = hhr.FullOrderModel(getattr(scripts, scene)(hhr.PrimaryCreep(20.0, 3.0, 0.4)))
    estimates, wrong = scripts.compared(full, scripts.held(6), 8)
    assert all(error == 0 or 0.5 < estimates[field] / error < 5 for field, error in wrong.items())
    cut = full.march(scripts.held(6), hhr.MarchSettings("tangent", time_tolerance=0.01))
    assert cut.time_error.max() < 0.01


def test_perfectly_plastic_indentation_has_a_time_error():
    """A law without rates: its steps are exact on straight paths of strain alone, and contact bends
    these.
    """
    full = hhr.FullOrderModel(scripts.indentation(scripts.PERFECT))
    estimates, wrong = scripts.compared(full, scripts.ramp(6), 6)
    assert min(wrong.values()) > 1e-3
    assert all(0.5 < estimates[field] / wrong[field] < 4 for field in wrong)


def test_a_tolerance_cuts_steps_of_laws_without_rates():
    full = hhr.FullOrderModel(scripts.indentation(scripts.PERFECT))
    path = scripts.ramp(3)
    exact = full.march(scripts.finer(path, 16), scripts.PLAIN)
    found = full.march(path, hhr.MarchSettings("tangent", time_tolerance=0.02))
    plain = full.march(path, scripts.PLAIN)
    assert np.isnan(plain.time_error).all() and plain.answers[-1].time_errors is None
    assert sum(found.parts) > 6 and found.time_error.max() < 0.02
    wrong = [scripts.true_errors(history, exact, 16)["stress"] for history in (plain, found)]
    assert wrong[1] < 0.02 < wrong[0]


def test_a_tolerance_bounds_the_displacement_under_a_load():
    """A body that creeps under a constant load does not relax: errors of displacement add up."""
    full = hhr.FullOrderModel(scripts.load_control(scripts.LAWS["Norton"]))
    path = scripts.ramp(4)
    found = full.march(path, hhr.MarchSettings("tangent", time_tolerance=0.02))
    exact = full.march(scripts.finer(found.solved_path, 8), scripts.PLAIN)
    ends = [exact.answers[8 * int(k) - 1] for k in np.cumsum(found.parts)]
    wrong = scripts.true_errors(found, replace(exact, answers=ends), 1)
    assert 0.001 < wrong["displacement"] < found.time_error.max() < 0.02


def test_estimates_leave_the_answers_as_they_are():
    """And are those of the second solution along the path in halves."""
    full = hhr.FullOrderModel(scripts.bending(scripts.LAWS["Norton"]))
    plain, asked = (
        full.march(scripts.ramp(4), settings) for settings in (scripts.PLAIN, scripts.ESTIMATED)
    )
    halves = full.march(scripts.finer(scripts.ramp(4), 2), scripts.PLAIN)
    for one, two, half in zip(plain.answers, asked.answers, halves.answers[1::2], strict=True):
        assert np.array_equal(one.unknown, two.unknown) and np.array_equal(
            one.stress(), two.stress()
        )
        difference = np.linalg.norm(one.displacement() - half.displacement())
        size = max(
            np.linalg.norm(answer.displacement())
            for answer in plain.answers[: plain.answers.index(one) + 1]
        )
        assert two.time_errors.displacement == pytest.approx(2.5 * difference / size, rel=1e-3)


@needs("nonmatching")
def test_stored_histories_go_on_with_their_parts(pellet, tmp_path):
    """Answers of another tolerance are others; a history that ended goes on as it would have."""
    models, path = pellet
    full, asked = models["full"], [path(4)]
    whole = full.march(asked[0], CONTROLLED)

    def stored(path, settings):
        store = hhr.SnapshotStore(tmp_path, full)
        return hhr.compute_snapshots(full, [path], store=store, settings=settings).histories[
            0
        ], store.found

    assert stored(asked[0][:6], CONTROLLED)[1] == 0
    history, found = stored(asked[0], CONTROLLED)
    # whether the last step takes two parts or four is round-off: both were seen, by sums of K in
    # another order
    assert found == 5 and history.parts[:-1] == whole.parts[:-1] and history.time_tolerance == 0.01
    assert history.time_error[:5] == pytest.approx(whole.time_error[:5])
    # the rate at the start of a step comes of its law, not of the part before: equal but for
    # round-off
    one, other = (item.answers[-2].stress() for item in (history, whole))
    assert np.abs(one - other).max() < 1e-4 * np.abs(one).max()
    again, found = stored(asked[0], CONTROLLED)
    assert (
        found == 13
        and again.parts == history.parts
        and np.array_equal(again.time_error, history.time_error)
    )
    assert stored(asked[0], replace(CONTROLLED, time_tolerance=0.02))[1] == 0
    assert stored(asked[0], QUIET)[1] == 0


@needs("nonmatching")
def test_another_model_takes_the_same_parts(pellet):
    """The check of a model compares it in the parts of the full order: time steps are no error of
    the model.
    """
    models, path = pellet
    exact = models["full"].march(path(4), CONTROLLED)
    assert len(exact.solved_path) == 1 + sum(exact.parts)
    # what the default tolerances leave in each of these short steps would count as time error
    tight = replace(ASKED, relative_stress=1e-6, floor_stress=1e-6, relative_force=1e-7)
    times = [answer.time for answer in exact.answers]
    found, same = (
        models[name].march(exact.solved_path, tight).thinned(times) for name in ("HHR", "full")
    )
    assert np.array_equal([answer.time for answer in found.answers], times)
    assert found.time_error.max() == pytest.approx(same.time_error.max(), rel=0.05)


@needs("nonmatching")
@pytest.mark.filterwarnings("always::hhr_dolfinx.errors.TimeStepWarning")
def test_long_steps_are_warned_of_once(pellet):
    models, path = pellet
    full, paths = models["full"], [path(4), path(4, 12.0), path(64, up=32)]
    with pytest.warns(
        TimeStepWarning, match=r"steps of this history make errors of 1\d % .*time_tolerance=0.01"
    ):
        full.march(paths[0], ASKED)
    with warnings.catch_warnings(record=True, action="always") as caught:
        snapshots = hhr.compute_snapshots(full, paths, settings=ASKED)
    (told,) = [str(item.message) for item in caught if item.category is TimeStepWarning]
    assert "2 of 3 histories make errors of 1" in told
    with warnings.catch_warnings(record=True, action="always") as caught:
        # neither where it was said before, nor where it was asked for
        condensing.condensed(full, snapshots.histories)
        full.march(paths[0], replace(CONTROLLED, time_tolerance=0.1))
    assert not [item for item in caught if item.category is TimeStepWarning]


def test_steps_cut_by_a_tolerance_have_no_gradient():
    with pytest.raises(
        ParameterError, match="have no gradient: march along the path in more steps"
    ):
        hhr.MarchSettings(time_tolerance=0.01, gradient=True)
