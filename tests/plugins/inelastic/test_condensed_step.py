"""Steps of condensed flow: compiled kernels beside plain ones, and steps of all sizes."""

import dataclasses

import numpy as np
import pytest
from condensing import QUIET, TIGHT, apart, condensed, pressures, up
from needs import needs
from scenes import pressed_pair
from tubes import tube
from yielding_scenes import MATERIALS, push

import hhr_dolfinx as hhr
from hhr_dolfinx.contact.active_set import SchurEqualities, Status, active_set
from hhr_dolfinx.errors import ConvergenceError, OutsideTrainingError
from hhr_dolfinx.geometries import two_blocks
from hhr_dolfinx.plugins.inelastic import condensed_step, small_strains
from hhr_dolfinx.plugins.inelastic.condensed_flow import laws_of
from hhr_dolfinx.plugins.inelastic.condensed_step import StepLoad, StepModel, WorkArrays, touch
from hhr_dolfinx.plugins.ufl_programs.compiled import compiled

pytestmark = pytest.mark.filterwarnings("ignore:no training solution has contact")


def contact_arrays(schur):
    """A step of nothing but contact."""
    size = len(schur)
    bodies = np.zeros((2, 4)), np.zeros((2, 4)), np.zeros((size, 4)), np.zeros(0)
    moved = np.zeros((size, 2)), np.zeros((2, 2)), np.zeros((2, size)), np.array([1]), 1.0
    model = StepModel(*bodies, np.ascontiguousarray(schur), *moved, np.zeros((2, 4), np.float32))
    return model, WorkArrays.of(2, size, 1, 4, 5)


def contact_load(slack):
    return StepLoad(np.zeros(4), np.zeros(slack.size), slack, np.zeros((5, 1)), 1.0)


def test_statuses_are_those_of_the_active_set():
    """P-matrices of three kinds, one slack after another from the statuses before, some of them
    zero.
    """
    rng, worst = np.random.default_rng(0), 0.0
    for case in range(150):
        size = int(rng.integers(1, 40))
        rows = rng.standard_normal((size, size + 5))
        schur = rows @ rows.T
        if case % 3 == 1:
            scales = 10 ** rng.uniform(-4, 4, size)
            schur = scales[:, None] * schur * scales
        if case % 3 == 2:
            places = np.arange(size)
            schur = np.exp(-np.abs(places[:, None] - places) / 20)
        arrays, work = contact_arrays(schur)
        for query in range(6):
            slack = rng.standard_normal(size) * np.sqrt(np.diag(schur))
            slack = (
                slack,
                slack,
                slack,
                abs(slack),
                -abs(slack),
                np.where(np.arange(size) % 3, slack, 0.0),
            )[query]
            assert touch(arrays, contact_load(slack), work)
            expected = active_set(SchurEqualities.symmetric(schur), slack, slack < 0)
            assert expected.status is Status.CONVERGED
            worst = max(
                worst,
                np.abs(work.forces - expected.forces).max() / max(expected.forces.max(), 1e-300),
            )
            # a rigid motion along with the gaps changes nothing: slack + moved g with g = 1
            shifted = arrays._replace(contact_of_modes=np.outer(slack, [1.0, 0.0]))
            work.there[:] = (-0.5, 0.0)
            assert touch(shifted, contact_load(slack / 2), work)
            assert work.forces == pytest.approx(
                expected.forces, abs=1e-9 * expected.forces.max(initial=1e-300)
            )
            work.there[:] = 0.0
    assert worst < 1e-10


def test_dependent_conditions_never_let_bodies_overlap():
    """Some rows twice, mostly with other gaps: found, or not found.

    Never a solution with a condition forgotten.
    """
    rng, outcomes = np.random.default_rng(1), []
    for _ in range(200):
        size = int(rng.integers(2, 12))
        rows = rng.standard_normal((size, size + 5))
        rows = rng.permutation(np.vstack([rows, rows[rng.integers(0, size, size=2)]]))
        schur = rows @ rows.T
        arrays, work = contact_arrays(schur)
        for _ in range(3):
            slack = rng.standard_normal(len(schur)) * np.sqrt(np.diag(schur))
            found = touch(arrays, contact_load(slack), work)
            outcomes.append(found)
            if found:
                size = np.abs(slack).max()
                assert (slack + schur @ work.forces).min() > -1e-8 * size
                assert work.forces.min() > -1e-8 * work.forces.max(initial=1e-300)
    assert np.mean(outcomes) > 0.5


_linearise = condensed_step._linearise


@compiled()
def linearise(model, load, work, laws):
    """Compiled functions alone call that of the package."""
    return _linearise(model, load, work, laws)


def derivative_error(model, laws, seed):
    """J of a compiled step beside central differences of R, at a random state and correction."""
    rng, arrays = np.random.default_rng(seed), model.step_model
    points, components, conditions = model.points.size, model.flow.components, model.conditions
    work, elastic = (
        WorkArrays.of(model.modes, conditions, points, components, components + 1) for _ in range(2)
    )
    plastic = 1e-3 * rng.standard_normal((components, points))
    plastic[:3] -= plastic[:3].mean(axis=0)
    slack = rng.standard_normal(conditions) * np.abs(model.flow.moved).max() * 1e-2
    strain = 5e-3 * rng.standard_normal(components * points)
    load = StepLoad(
        strain, np.zeros(conditions), slack, np.vstack([plastic, np.abs(plastic[:1])]), 0.1
    )
    assert touch(arrays, load, elastic)
    load = load._replace(forces=elastic.forces)
    size = 5e-3 / np.abs(model.flow.per_mode).max()

    def residual(correction):
        work.numbers[condensed_step.LINEAR] = condensed_step.NO_TANGENT
        work.there[:] = correction
        # one evaluation and no more: the residual and J there are what is left behind
        condensed_step.solve(arrays, load, work, laws, 1e-300, 1)
        return work.left.copy(), work.active.copy()

    here = size * rng.standard_normal(model.modes)
    value, active = residual(here)
    assert linearise(arrays, load, work, laws)
    newton, turned = work.newton.copy(), active
    slopes = np.empty((model.modes, model.modes))
    for k in range(model.modes):
        step = 1e-7 * size * (np.arange(model.modes) == k)
        ends = [residual(here + sign * step) for sign in (1, -1)]
        turned = turned | ends[0][1] ^ ends[1][1]
        slopes[:, k] = (ends[0][0] - ends[1][0]) / (2e-7 * size)
    assert value.any()
    return np.abs(-newton @ slopes - np.eye(model.modes)).max(), active.sum()


@needs("nonmatching")
@pytest.mark.parametrize("which", ["tube", "pellet"])
def test_newtons_matrix_is_the_derivative_of_the_residual(tubes, pellet, which):
    """Several statuses, plasticity and creep.

    A difference may cross the onset of flow at some point.
    """
    model = (tubes if which == "tube" else pellet)[2].equilibrium
    laws = laws_of(model.material)
    errors, counts = zip(*(derivative_error(model, laws, seed) for seed in range(12)), strict=True)
    assert np.median(errors) < 1e-5 and np.sort(errors)[-3] < 1e-3
    assert len(set(counts)) > 1


def test_first_yield_to_round_off_converges(tubes):
    """Where the first point yields by 1e-15 to 1e-1 of the pressure, with usual and with small
    tolerances.
    """
    model = tubes[2]
    low, high = 0.3, 0.9
    for _ in range(60):
        middle = (low + high) / 2
        flows = model.march(up(middle, 1), QUIET).answers[-1].plastic_strain().any()
        low, high = (low, middle) if flows else (middle, high)
    for part in (0.0, *10.0 ** np.arange(-15, 0)):
        for settings in (QUIET, TIGHT):
            history = model.march(
                [*up(high * (1 + part), 1), (1.0, np.array([high])), (2.0, np.array([0.0]))],
                settings,
            )
            assert len(history.answers) == 3 and history.cuts == 0


@needs("nonmatching")
def test_steps_of_all_sizes_are_solved(pellet):
    """Random legs up, down and held over seven decades of pace, far outside of what was trained."""
    model, rng = pellet[2], np.random.default_rng(1)
    for _ in range(40):
        steps, shares, seconds = int(rng.integers(1, 30)), [0.0], []
        for _ in range(int(rng.integers(1, 5))):
            target = rng.choice([0.0, 1.0, shares[-1], rng.random()])
            shares += list(np.linspace(shares[-1], target, steps + 1)[1:])
            seconds += [10 ** rng.uniform(-4, 3) / steps] * steps
        path = pressures(shares, seconds, rng.uniform(4, 16), rng.uniform(0.5, 1.5))
        history = model.march(path, QUIET)
        assert len(history.answers) == len(path) - 1
        for answer in history.answers:
            assert answer.converged and np.isfinite(answer.displacement()).all()


@pytest.mark.parametrize(
    ("first", "second"),
    [(hhr.Plasticity(0.05, 0.0), None), (hhr.Norton(0.05, 20.0), hhr.Norton(2.0, 1.0)),
     (hhr.Norton(0.1, 8.0), hhr.Plasticity(0.08, 0.0))],
    ids=["perfect plasticity", "creep", "both"],
)  # fmt: skip
def test_what_is_handed_out_is_in_balance(first, second, monkeypatch):
    """Random walks through the box at any pace: R, gaps and signs of forces, by other code than
    that of the steps.
    """
    monkeypatch.setattr(
        small_strains, "STRAIN_LIMIT", small_strains.RUNAWAY
    )  # some creep farther than small strains mean
    bodies = (
        hhr.Body(two_blocks.FIRST, "E1", 0.3, first),
        hhr.Body(two_blocks.SECOND, "2 * E2", 0.35, second),
    )
    full = hhr.FullOrderModel(pressed_pair("plane_strain", bodies, MATERIALS, cells=3))
    rng = np.random.default_rng(0)
    corners = [
        full.march(push(*moduli, steps=5), TIGHT) for moduli in ((2.0, 2.0), (4.0, 9.0), (2.0, 9.0))
    ]
    model = condensed(full, corners)
    low, high = np.array(full.parameters.lower), np.array(full.parameters.upper)
    for _ in range(20):
        count, largest = int(rng.integers(2, 15)), 1e-9
        points = rng.uniform(low, high, (count, low.size))
        points[:, 4:] = points[0, 4:]
        history = model.march(
            list(zip(np.cumsum(10 ** rng.uniform(-3, 3, count)), points, strict=True)), QUIET
        )
        for answer in history.answers:
            equilibrium = model.equilibrium.at(answer.parameter)
            theta, correction = (
                equilibrium.amplitudes(answer.parameter),
                answer.unknown[: equilibrium.modes],
            )
            largest = max(largest, np.linalg.norm(correction))
            residual, _ = equilibrium.residual(answer.unknown, answer.gauss, theta)
            assert np.linalg.norm(residual) <= 1.01e-5 * largest
            slack = (
                equilibrium.gaps(theta)
                + equilibrium.schur @ answer.multipliers
                - model.flow.moved @ correction
            )
            forces, length = answer.multipliers, np.abs(equilibrium.gaps(theta)).max()
            assert slack.min() > -1e-10 * length and forces.min() >= -1e-10 * forces.max()
            assert np.abs(forces * slack).max() <= 1e-10 * length * forces.max()
            deviator = answer.gauss.state.inelastic[:, :3].sum(axis=1)
            assert np.abs(deviator).max() < 1e-12


def test_a_load_that_is_not_borne_is_outside():
    """Perfect plasticity beyond its limit load 2/√3 ln 2: modes that never showed it bear it, but
    the door speaks.
    """
    scene = tube(hhr.Plasticity("s"), 1.0, cells=6)
    full = hhr.FullOrderModel(
        dataclasses.replace(
            scene, parameters=hhr.ParameterSpace(("p", "s"), (0.0, 0.5), (2.0, 1.5))
        )
    )
    model = condensed(full, [full.march(up(0.7 * s, constants=(s,)), TIGHT) for s in (0.8, 1.2)])
    path = up(0.95, constants=(1.0,))
    with pytest.raises(OutsideTrainingError, match=r"step \d, to t = .* s") as caught:
        model.march(
            [(1.25 * time, point) for time, point in path], hhr.MarchSettings(outside="refuse")
        )
    assert len(caught.value.history.answers) < 8


def test_a_step_that_fails_says_what_was_tried(tubes):
    """Too few iterations: what was tried last, and the steps before, all of them solved."""
    model, few = tubes[2], hhr.MarchSettings(outside="ignore", iterations=1, cuts=1)
    said = (
        "step 5 to t = 0.5 s did not converge: the iterations allowed are spent, with a residual "
        "of .* of the correction after 2 iterations. Take smaller steps; the 4 steps before are "
        "kept"
    )
    with pytest.raises(ConvergenceError, match=said) as caught:
        model.march(up(0.9), few)
    done, exact = caught.value.history.answers, model.march(up(0.9), QUIET).answers
    assert all(
        np.array_equal(one.unknown, other.unknown)
        for one, other in zip(done, exact[:4], strict=True)
    )
    # cut in parts they suffice for
    history = model.march(up(0.9, 2), hhr.MarchSettings(outside="ignore", iterations=4))
    assert history.cuts > 0 and len(history.answers) == 2
    expected = model.march(up(0.9, 2), QUIET)
    assert apart(history, expected)[0] < 1e-2
