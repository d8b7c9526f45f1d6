"""The indicator of histories: what it measures, that it ranks, what it costs, and that it survives
a file.
"""

import dataclasses
import time
import warnings

import condensing
import flowing
import numpy as np
import pellet_cladding_plastic as demo
import pytest
from scipy.stats import spearmanr

import hhr_dolfinx as hhr
from hhr_dolfinx.certify.accuracy import relative_error
from hhr_dolfinx.contact.active_set import Status
from hhr_dolfinx.errors import OutsideTrainingError, OutsideTrainingWarning, StabilityWarning
from hhr_dolfinx.models.estimates import STRESS_INDICATOR, Estimate
from hhr_dolfinx.plugins.inelastic.completion import FlowFields, GappyField
from hhr_dolfinx.plugins.inelastic.condense_flow import CorrectionSettings
from hhr_dolfinx.plugins.inelastic.reduction import check_door
from hhr_dolfinx.plugins.inelastic.trained import Known, Signs, TrainedPaths, Watch
from hhr_dolfinx.study.training.train import Training

STEPS = 12
SHARES = np.arange(STEPS + 1) / STEPS
MESH = {
    "radial_cells": 8,
    "axial_cells": 12,
    "cladding_radial_cells": 3,
    "cladding_axial_cells": 10,
}


def there_and_back(gap, steps=STEPS):
    """Rates of this path hold those of a hold and of any slower path: ranges and rates cannot
    tell.
    """
    shares = np.arange(steps + 1) / steps
    return demo.history(np.arange(2 * steps + 1) / steps, np.append(shares, shares[-2::-1]), gap)


def paths():
    """By name: inside, and what was never trained."""
    yield "inside", there_and_back(9.0)
    yield "up", demo.history(SHARES, SHARES, 12.0)
    again = np.concatenate([SHARES, SHARES[-2:5:-1], SHARES[6:]])
    yield "loaded again", demo.history(np.arange(again.size) / STEPS, again, 10.0)
    held = np.append(SHARES, np.ones(6))
    for seconds in (1.0, 10.0):
        yield (
            f"held for {seconds:g} s",
            demo.history(np.append(SHARES, 1 + seconds * np.arange(1, 7) / 6), held, 10.0),
        )
    for factor in (10.0, 0.1):
        yield f"{factor:g} times slower", demo.history(factor * SHARES, SHARES, 10.0)
    for height in (0.6, 1.3):
        yield f"height {height}", demo.history(SHARES, SHARES, 10.0, height)


@pytest.fixture(scope="module")
def trained():
    """The pellet, loaded and unloaded at two gaps."""
    full = hhr.FullOrderModel(demo.scene(**MESH))
    known = [full.march(there_and_back(gap)) for gap in (5.0, 15.0)]
    held_out = [full.march(there_and_back(8.0))]
    return Training(full, *(hhr.SnapshotSet.of_histories(item) for item in (known, held_out)), None)


@pytest.fixture(scope="module", params=["HHR", "condensed flow"])
def model(request, trained):
    if request.param == "condensed flow":
        return trained.condense(
            CorrectionSettings(modes=1e-3, cubature=5e-4, attempts=1, trust=None)
        )
    return trained.build(demo.recipe(3e-9), checked=False)


@pytest.fixture(scope="module")
def exact(trained):
    """Full histories of the paths, by name, trained ones among them."""
    full, known = trained.full_order, trained.snapshots.histories
    solved = {name: full.march(path) for name, path in paths()}
    return {f"trained {k}": history for k, history in enumerate(known)} | solved


@pytest.fixture(scope="module")
def small():
    """A reduced model in a second or two, with an answer."""
    model = flowing.flowing_reduction(flowing.flowing_full())
    return model, model.march(demo.path(9.0, flowing.STEPS)).answers[-1]


def test_it_ranks_the_steps_of_histories(trained, model, exact):
    estimates, errors = [], []
    for history in exact.values():
        found = model.march(history.path, hhr.MarchSettings(outside="ignore"))
        estimates += [answer.estimate().primal_relative for answer in found.answers]
        errors += [
            [
                relative_error(
                    here.displacement(), there.displacement(), trained.full_order.problem.mass
                ),
                relative_error(here.stress().ravel(), there.stress().ravel()),
            ]
            for here, there in zip(found.answers, history.answers, strict=True)
        ]
    displacement, stress = np.transpose(errors)
    assert spearmanr(estimates, stress).statistic >= 0.95
    # displacements are mostly elastic, and those of condensed flow are right to a thousandth
    assert spearmanr(estimates, displacement).statistic >= 0.7


def by_least_squares(field, inside):
    """|σ - Φ c| / |σ| with the best c."""
    modes = field.stress.modes.reshape(field.gauss_points, inside.shape[1], -1)[field.points]
    modes, stress = modes.reshape(inside.size, -1), inside.ravel()
    fitted = modes @ np.linalg.lstsq(modes, stress, rcond=None)[0]
    return np.linalg.norm(stress - fitted) / np.linalg.norm(stress)


def test_it_is_the_misfit_of_the_stress_to_its_modes(small):
    reduced, answer = small
    stress = answer.state().stress
    expected = by_least_squares(reduced.fields.flow, stress)
    found = answer.estimate()
    assert found.primal_relative == pytest.approx(expected, rel=1e-4, abs=1e-8)
    assert found == Estimate.indicated(found.primal_relative, STRESS_INDICATOR)
    noise = np.random.default_rng(0).normal(size=stress.shape) * np.abs(stress).max()
    spoiled = answer.remembering(gauss=answer.gauss._replace(stress=stress + noise))
    expected = by_least_squares(reduced.fields.flow, stress + noise)
    assert reduced.known_error.startswith("indicator of the stress")
    assert (
        spoiled.estimate().primal_relative == pytest.approx(expected, rel=1e-10) and expected > 0.1
    )


def test_it_has_no_unit_and_no_preferred_sign(small):
    reduced, answer = small
    stress, unexplained = answer.state().stress, reduced.fields.flow.unexplained
    left, size = unexplained(stress)
    assert unexplained(-1e6 * stress) == pytest.approx((1e6 * left, 1e6 * size), rel=1e-6)
    assert unexplained(0.0 * stress) == (0.0, 0.0)


def test_without_modes_nothing_is_explained():
    nothing = GappyField(np.zeros((8, 0)), np.zeros((0, 4)))
    assert FlowFields(np.array([1]), nothing, None, 2).unexplained(np.ones((1, 4))) == (2.0, 2.0)


def test_an_indicator_of_the_user_comes_first(small):
    reduced, answer = small
    fields = dataclasses.replace(reduced.fields, indicator=lambda answer: 0.5)
    assert answer._replace(fields=fields).estimate() == Estimate.indicated(0.5)


def test_no_answer_has_no_estimate(small):
    failed = small[1]._replace(status=Status.DIVERGED)
    assert failed.estimate() is None


def test_it_costs_less_than_a_step():
    model = condensing.pellet()[2]
    path = condensing.loaded(9.0)
    model.march(path).answers[-1].estimate()

    def seconds(task):
        start = time.process_time()
        task()
        return time.process_time() - start

    history = model.march(path)
    march = min(seconds(lambda: model.march(path)) for _ in range(3))
    estimates = min(
        seconds(lambda: [answer.estimate() for answer in history.answers]) for _ in range(3)
    )
    assert estimates < 0.3 * march


def test_the_door_of_few_points_sees_stress_that_was_never_trained():
    """Ranges and rates widened, and plastic strain that counts as known: the stress alone still
    tells.
    """
    model = condensing.pellet()[2]
    inside, aside = condensing.loaded(9.0), condensing.loaded(9.0, height=1.4)
    trained = model.trained
    rates = {"slowest": np.full(3, -1e9), "fastest": np.full(3, 1e9), "imbalance": 1e9}
    range_ = dataclasses.replace(trained.parameters, lower=np.full(3, -1e9), upper=np.full(3, 1e9))
    wide = model.changed(trained=dataclasses.replace(trained, parameters=range_, **rates))
    with warnings.catch_warnings(action="error", category=OutsideTrainingWarning):
        wide.march(inside)
    with pytest.warns(
        OutsideTrainingWarning, match="the stress differs from combinations of trained ones"
    ):
        wide.march(aside)


def watched(known, onsets=()):
    """What was trained, from signs of a history and of its onset."""
    path, space = (
        [(0.0, np.zeros(1)), (1.0, np.ones(1))],
        hhr.ParameterSpace(("load",), (0.0,), (1.0,)),
    )
    return TrainedPaths.of([path], space, Known([known], [onsets], 1.0))


def one(misfit, stress):
    return Signs(0.0, 1.0, 0.0, misfit=misfit, stress=stress)


def warns(trained, *signs):
    """Whether any step of a history is warned of."""
    watch = Watch(trained, "warn")
    with warnings.catch_warnings(record=True, action="always") as caught:
        for number, sign in enumerate(signs, 1):
            watch.after(number, float(number), sign)
    return any("from combinations of trained ones" in str(item.message) for item in caught)


def test_a_small_misfit_is_none():
    """Where training is reproduced to round-off any other answer would seem far outside."""
    trained = watched([one(1e-12, 50.0)])
    assert trained.estimate == 0.01
    assert not warns(trained, one(1.4, 50.0))
    with pytest.raises(
        OutsideTrainingError, match=r"by 0\.032 of its size, in training by 0\.01 at most"
    ):
        Watch(trained, "refuse").after(1, 1.0, one(1.6, 50.0))


@pytest.mark.parametrize(
    "shown, passes", [(0.012, 0.036), (0.02, 0.05), (0.04, 0.05), (0.05, 0.06)]
)
def test_large_estimates_are_told_however_poor_the_training(shown, passes):
    """Three times what training showed passes; above 5 %, at most a fifth more."""
    trained = watched([one(shown, 1.0)])
    assert not warns(trained, one(0.99 * passes, 1.0)) and warns(trained, one(1.01 * passes, 1.0))


def test_a_step_is_held_against_its_own_stress():
    """What stays behind a part load is small beside all that was trained, and three quarters of it
    may be wrong.
    """
    trained = watched([one(1.0, 20.0), one(0.5, 50.0), one(1.0, 100.0)])
    assert (trained.estimate, trained.begun) == (0.05, 20.0)
    assert not warns(trained, one(1.0, 30.0), one(0.055, 1.0)) and warns(
        trained, one(1.0, 30.0), one(0.065, 1.0)
    )
    assert not warns(trained, one(1.0, 30.0), one(0.9e-3, 0.9e-3)), (
        "round-off beside a stress of 100 is no stress"
    )


def test_a_history_that_has_hardly_begun_is_held_against_onsets():
    trained = watched([one(0.2, 20.0), one(1.0, 100.0)], [one(0.1, 1.0), one(0.5, 10.0)])
    assert (trained.estimate, trained.onset) == (0.01, 0.1)
    assert not warns(trained, one(0.115, 1.0), one(0.5, 19.0)) and warns(trained, one(0.125, 1.0))
    assert warns(trained, one(0.1, 21.0), one(0.115, 1.0)), (
        "the same, behind steps as large as trained ones"
    )


@pytest.mark.parametrize("steps", [6, 60, 200])
def test_trained_paths_in_finer_and_coarser_steps_are_warned_of_where_they_are_wrong(
    trained, model, steps
):
    path = there_and_back(5.0, steps)
    with warnings.catch_warnings(record=True, action="always") as caught:
        found = model.march(path).answers
    # from an estimate of 5 % on, which is up to 1.8 times the error of its step
    if any(issubclass(item.category, OutsideTrainingWarning) for item in caught):
        pairs = zip(found, trained.full_order.march(path).answers, strict=True)
        assert (
            max(
                relative_error(here.stress().ravel(), there.stress().ravel())
                for here, there in pairs
            )
            > 0.04
        )


@pytest.mark.parametrize("share", [0.1, 0.2, 0.35])
def test_part_loads_of_trained_paths_are_right_or_warned_of(trained, model, share):
    """What stays behind them was 44 to 60 % wrong without a word, of itself, and small beside what
    was trained.
    """
    count = max(round(share * STEPS), 2)
    shares = share * np.append(np.arange(count + 1), np.arange(count)[::-1]) / count
    path = demo.history(share * np.arange(2 * count + 1) / count, shares, 10.0)
    with warnings.catch_warnings(record=True, action="always") as caught:
        found = model.march(path)
    warned = any("of its size, in training by" in str(item.message) for item in caught)
    stress = trained.full_order.march(path).answers[-1].stress()
    wrong = relative_error(found.answers[-1].stress().ravel(), stress.ravel())
    # three times what training showed passes
    assert warned or wrong < 3 * model.trained.estimate


def test_a_poor_model_says_that_its_door_is_wide():
    limits = hhr.Recipe.flowing().trust
    check_door(watched([one(0.04, 1.0)]), limits)
    with pytest.warns(
        StabilityWarning, match=r"by up to 0\.2 of its size .* warned of from 0\.24 on only"
    ):
        check_door(watched([one(0.2, 1.0)]), limits)


def test_stress_that_is_no_number_is_told():
    assert Signs(0.0, 1.0, 0.0, misfit=np.nan, stress=np.nan).estimate == np.inf
    assert warns(watched([one(0.01, 1.0)]), one(np.nan, np.nan))


def test_modes_of_round_off_have_no_amplitude():
    """A mode that known values show by 1e-13 of its norm multiplied their round-off by 1e13.

    The others are fitted.
    """
    modes = np.linalg.qr(np.random.default_rng(3).standard_normal((20, 3)))[0]
    modes[:6, 2] *= 1e-13
    field = modes[:, :2] @ [2.0, -1.0]
    known = field[:6] + 1e-14
    np.testing.assert_allclose(
        GappyField.fitted(modes, np.arange(6)).everywhere(known), field, atol=1e-13
    )
