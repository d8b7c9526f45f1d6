"""Condensed flow: kernels beside plain ones, histories beside the full order and closed forms, limits and refusals."""

import dataclasses
import pickle
import warnings

import flowing
import numpy as np
import pellet_cladding_plastic as demo
import pytest
from scenes import pressed_pair
from test_flow_heat import axial, expansion, hot_pellet, warm_bar
from test_flow_heat import path as hot_path
from test_flow_moduli import blocks, glued, pressed, push
from test_plastic import YOUNG, tube
from toy_law import Bingham

import hhr_dolfinx as hhr
from hhr_dolfinx.contact.active_set import SchurEqualities, Status, active_set
from hhr_dolfinx.errors import (
    ConvergenceError,
    OutsideTrainingError,
    OutsideTrainingWarning,
    ParameterError,
    ReductionError,
    SceneError,
    UnstableModelError,
)
from hhr_dolfinx.geometries import block, two_blocks
from hhr_dolfinx.materials.update import kernel_of
from hhr_dolfinx.models import condensed_arrays as codes
from hhr_dolfinx.models import condensed_step
from hhr_dolfinx.models.condensed_arrays import StepLoad, StepModel, Work
from hhr_dolfinx.models.condensed_contact import touch
from hhr_dolfinx.reduction.condense_flow import CorrectionSettings, condense_flow

TIGHT = hhr.MarchSettings(
    relative_stress=1e-8, relative_force=1e-8, floor_stress=1e-6, iterations=300, outside="ignore"
)
QUIET = hhr.MarchSettings(outside="ignore")
FINE = hhr.MarchSettings(outside="ignore", relative_force=1e-11)
WHOLE = {"modes": 1e-9, "cubature": 1e-9, "attempts": 1}
"""Settings that leave nothing out."""

pytestmark = [
    pytest.mark.filterwarnings("ignore::hhr_dolfinx.errors.UncheckedWarning"),
    pytest.mark.filterwarnings("ignore:no training solution has contact"),
]


def condensed(full, histories, **settings):
    return condense_flow(full, hhr.SnapshotSet.of_histories(histories), CorrectionSettings(**settings))


def apart(one, other):
    """Largest distances of displacements and contact forces, each over the largest of the history."""
    pairs = list(zip(one.answers, other.answers, strict=True))
    found = []
    for name in ("displacement", "forces"):
        fields = [(getattr(a, name)(), getattr(b, name)()) for a, b in pairs]
        size = max(np.linalg.norm(b) for _, b in fields)
        found.append(max(np.linalg.norm(a - b) for a, b in fields) / size if size else 0.0)
    return found


def walled_tube(law, wall=2.003, cells=6, poisson=0.3, young=YOUNG, unit=1.0, **space):
    """The thick tube with its pressure in a wall that it reaches; ``unit`` is that of stress."""
    base = tube(law, unit, cells=cells, poisson=poisson)
    box = {"p": (0.0, unit)} | space
    return dataclasses.replace(
        base,
        bodies=(dataclasses.replace(base.bodies[0], young=young),),
        contacts=(hhr.Obstacle(block.side(0, upper=True), (1, 0), wall),),
        parameters=hhr.ParameterSpace(tuple(box), *zip(*box.values(), strict=True)),
    )


def up(pressure, steps=8, dt=0.1, constants=()):
    return [(dt * k, np.array([pressure * k / steps, *constants])) for k in range(steps + 1)]


def cycle(pressure, dt=0.1):
    """Loaded, unloaded and loaded again."""
    shares = np.concatenate([np.linspace(0, 1, 9), np.linspace(0.75, 0, 4), np.linspace(0.25, 1, 4)])
    return [(dt * k, np.array([pressure * share])) for k, share in enumerate(shares)]


@pytest.fixture(scope="module")
def tubes():
    """Plasticity with hardening against a wall: full model, training and condensed model."""
    full = hhr.FullOrderModel(walled_tube(hhr.Plasticity(1.0, 5.0)))
    histories = [full.march(up(0.9), TIGHT), full.march(cycle(0.8), TIGHT)]
    return full, histories, condensed(full, histories)


def pressures(shares, seconds, gap, height=0.9):
    """A path of the pellet: shares of its largest pressure, seconds of each step."""
    return demo.history(np.cumsum([0.0, *seconds]), shares, gap, height)


def loaded(gap, top=1.0, seconds=1.0, steps=flowing.STEPS, height=0.9):
    return pressures(np.arange(steps + 1) / steps * top, [seconds / steps] * steps, gap, height)


INSIDE = [(gap, top, seconds) for gap, top, seconds in zip(
    (5.0, 15.0, 5.0, 15.0, 10.0, 8.0), (0.6, 1.0, 1.0, 0.6, 0.8, 0.95), (0.7, 0.7, 1.3, 1.3, 1.0, 1.1), strict=True
)]  # fmt: skip


@pytest.fixture(scope="module")
def pellet():
    """Plasticity against creep: full model, training and condensed model, with two histories held out."""
    full = flowing.flowing_full()
    histories = [full.march(loaded(*item), TIGHT) for item in INSIDE]
    held = [full.march(loaded(7.0 + 4 * k, 0.9 - 0.1 * k, 0.9 + 0.2 * k), TIGHT) for k in range(3)]
    sets = [hhr.SnapshotSet.of_histories(item) for item in (histories, held)]
    return full, histories, condense_flow(full, sets[0], None, sets[1])


def contact_arrays(schur):
    """A step of nothing but contact."""
    size, nothing = len(schur), np.zeros
    shapes = nothing((2, 4)), nothing((2, 4)), nothing((size, 4)), nothing(0), np.ascontiguousarray(schur)
    rest = nothing((size, 2)), nothing((2, 2)), nothing((2, size)), np.array([1]), np.ones(1)
    return StepModel(*shapes, *rest), Work.of(2, size, 1, 4)


def contact_load(slack):
    return StepLoad(np.zeros(4), np.zeros(4), np.zeros(slack.size), slack, np.zeros((4, 1)), np.zeros(1), 1.0)


def test_statuses_are_those_of_the_active_set():
    """P-matrices of three kinds, one slack after another from the statuses before, some of them zero."""
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
            slack = (slack, slack, slack, abs(slack), -abs(slack), np.where(np.arange(size) % 3, slack, 0.0))[query]
            assert touch(arrays, contact_load(slack), work)
            expected = active_set(SchurEqualities.symmetric(schur), slack, slack < 0)
            assert expected.status is Status.CONVERGED
            worst = max(worst, np.abs(work.forces - expected.forces).max() / max(expected.forces.max(), 1e-300))
            # a rigid motion along with the gaps changes nothing: slack + moved g with g = 1
            shifted = arrays._replace(moved=np.outer(slack, [1.0, 0.0]))
            work.there[:] = (-0.5, 0.0)
            assert touch(shifted, contact_load(slack / 2), work)
            assert work.forces == pytest.approx(expected.forces, abs=1e-9 * expected.forces.max(initial=1e-300))
            work.there[:] = 0.0
    assert worst < 1e-10


def test_dependent_conditions_never_let_bodies_overlap():
    """Some rows twice, mostly with other gaps: found, or not found; never a solution with a condition forgotten."""
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


def test_arrays_are_integrals_over_what_flowed(tubes):
    """Q = 1 - ∫ (G V)^T 2 μ dev G V and P, by sums over all Gauss points that flowed; modes are orthonormal."""
    pair = hhr.FullOrderModel(blocks("E1", "2 * E2", hypothesis="plane_strain", cells=3))
    corners = [pair.march(push(*moduli, steps=5), TIGHT) for moduli in ((2.0, 2.0), (4.0, 9.0))]
    for full, histories in (tubes[:2], (pair, corners)):
        model = condensed(full, histories, **WHOLE)
        flow, basis, problem, equilibrium = model.flow, model.fields.basis, full.problem, full.equilibrium
        assert basis.T @ (problem.stiffness @ basis) == pytest.approx(np.eye(basis.shape[1]), abs=1e-12)
        flowed = np.any([answer.gauss.state.cumulated > 0 for item in histories for answer in item.answers], axis=0)
        elastic = equilibrium.material.moduli_at(problem.middle).elastic
        weights = (equilibrium.operator.weights.ravel() * elastic[:, -1, -1])[flowed, None, None]

        def deviators(columns):
            strain = np.stack([equilibrium.strain_of(column) for column in columns.T], axis=2)[flowed]
            strain[:, :3] -= strain[:, :3].mean(axis=1, keepdims=True)
            return strain

        tested = weights * deviators(basis)
        expected = np.einsum("pcj,pck->jk", tested, deviators(basis))
        assert flow.rest == pytest.approx(np.eye(len(flow.rest)) - expected, abs=1e-12)
        forced = np.linalg.solve(dense(problem), problem.contact.toarray().T)
        assert forced == pytest.approx(full.per_force, abs=1e-10 * np.abs(forced).max())
        crossed = np.einsum("pcj,pck->jk", tested, deviators(forced))
        assert flow.crossed == pytest.approx(crossed, abs=1e-10 * np.abs(crossed).max())
        assert flow.moved == pytest.approx(problem.contact @ basis, abs=1e-14)
        assert flow.schur.sum(axis=0) == pytest.approx(problem.contact @ forced, abs=1e-10 * np.abs(forced).max())


def dense(problem):
    """K with ones for what is held."""
    free = np.flatnonzero(problem.free)
    stiffness = np.eye(problem.free.size)
    stiffness[np.ix_(free, free)] = problem.stiffness.toarray()[np.ix_(free, free)]
    return stiffness


def test_with_all_modes_training_is_reproduced(tubes, pellet):
    """To the misfit of the cubature, and what is solved at all: 1e-8 of forces by the full order."""
    for full, histories in (tubes[:2], (pellet[0], pellet[1][:2])):
        model = condensed(full, histories, **WHOLE)
        for history in histories:
            primal, dual = apart(model.march(history.path, FINE), history)
            assert primal < 2e-5 and dual < 2e-4


def test_untrained_pressures_and_unloading(tubes):
    full, _, model = tubes
    for path in (up(0.85), up(0.7, steps=5), cycle(0.6), up(0.9, steps=40), up(0.9, steps=1)):
        primal, dual = apart(model.march(path, QUIET), full.march(path, TIGHT))
        assert primal < 5e-3 and dual < 5e-3


def test_below_the_yield_stress_bodies_are_elastic():
    """To round-off; nearly incompressible, so that elastic bodies too take the mean dilatation."""

    def pair(law):
        bodies = hhr.Body(two_blocks.FIRST, "E1", 0.46, law), hhr.Body(two_blocks.SECOND, "2 * E2", 0.46)
        return hhr.FullOrderModel(pressed_pair("plane_strain", bodies, {"E1": (2.0, 4.0), "E2": (2.0, 9.0)}, cells=3))

    full, elastic = pair(hhr.Plasticity(0.05, 0.2)), pair(None)
    corners = [full.march(push(*moduli, steps=5), TIGHT) for moduli in ((2.0, 2.0), (4.0, 9.0))]
    model = condensed(full, corners)
    for slide in (0.0, 0.01, -0.01):
        path = [(float(k), np.array([0.005 + 0.002 * k, slide * k / 4, 0.002 * k, 0.006, 3.2, 5.0])) for k in range(5)]
        history = model.march(path, QUIET)
        assert all(not answer.plastic_strain().any() for answer in history.answers)
        assert not history.answers[-1].unknown[: model.equilibrium.modes].any()
        for answer in history.answers:
            exact = elastic.solve(answer.parameter)
            size = np.abs(exact.displacement()).max()
            assert answer.displacement() == pytest.approx(exact.displacement(), abs=1e-10 * size)
            assert answer.forces() == pytest.approx(exact.forces(), abs=1e-10 * max(exact.forces().max(), 1.0))
    assert history.answers[-1].forces().max() > 0


def test_a_plastic_front_in_a_thick_tube():
    """Perfect plasticity: p = 2/√3 (ln c + (1 - c²/4) / 2) at a plastic radius c, between two trained radii."""

    def pressure(radius):
        return 2 / np.sqrt(3) * (np.log(radius) + (1 - radius**2 / 4) / 2)

    full = hhr.FullOrderModel(tube(hhr.Plasticity(1.0), 1.0, cells=20, poisson=0.49))
    model = condensed(full, [full.march(up(pressure(radius), 12)) for radius in (1.6, 1.8)])
    last = model.march(up(pressure(1.7), 12), QUIET).answers[-1]
    flowing_there, stress = last.plastic_strain() > 1e-6, last.stress()
    radii = np.repeat(full.problem.points[full.problem.cell_nodes].mean(axis=1)[:, 0], 4)
    assert radii[flowing_there].max() == pytest.approx(1.7, abs=2 / 20)
    inside = radii < 1.5
    assert (stress[:, 2] - stress[:, 0])[inside] == pytest.approx(2 / np.sqrt(3), rel=1e-2)


def test_a_thick_tube_in_steady_creep():
    """Norton: σ_θ - σ_r = p 2/m (2/r)^(2/m) / (2^(2/m) - 1), when rates are steady."""
    full = hhr.FullOrderModel(tube(hhr.Norton(2.0, 4.0), 0.6, cells=12))
    times = np.concatenate([[0.0, 1e-3], np.geomspace(1e-2, 4.0, 30)])

    def held(pressure):
        return [(time, np.array([pressure if k else 0.0])) for k, time in enumerate(times)]

    settings = hhr.MarchSettings(floor_stress=1e-8)
    model = condensed(full, [full.march(held(pressure), settings) for pressure in (0.4, 0.6)])
    stress = model.march(held(0.5), QUIET).answers[-1].stress()
    radii = full.problem.points[full.problem.cell_nodes].mean(axis=1)[:, 0]
    found = (stress[:, 2] - stress[:, 0]).reshape(len(radii), 4).mean(axis=1)
    assert found == pytest.approx(0.5 * 0.5 * (2 / radii) ** 0.5 / (2**0.5 - 1), rel=0.015)


def test_a_bar_that_is_held_and_heated_yields():
    """σ = -E ε0 up to the yield stress; cooled, it is left with tension; E is a parameter."""
    full = hhr.FullOrderModel(warm_bar(hhr.Plasticity(1.0), "E", E=(0.5 * YOUNG, 3 * YOUNG)).scene)
    temperatures = np.array([0.0, 200.0, 600.0, 900.0, 700.0, 0.0])

    def heated(young):
        return [(float(k), np.array([0.0, heat, young])) for k, heat in enumerate(temperatures)]

    model = condensed(full, [full.march(heated(young), TIGHT) for young in (0.8 * YOUNG, 2 * YOUNG)])
    flowed = expansion(900.0) - 1.0 / YOUNG
    expected = [-YOUNG * expansion(200.0), -1.0, -1.0, YOUNG * (flowed - expansion(700.0)), 1.0]
    assert axial(model.march(heated(YOUNG), QUIET)) == pytest.approx(expected, rel=1e-4)


def derivative_error(model, kinds, constants, seed):
    """J of a compiled step beside central differences of R, at a random state and correction."""
    rng, arrays = np.random.default_rng(seed), model.step_model
    points, components, conditions = model.points.size, model.flow.components, model.conditions
    work = Work.of(model.modes, conditions, points, components)
    elastic = Work.of(model.modes, conditions, points, components)
    plastic = 1e-3 * rng.standard_normal((components, points))
    plastic[:3] -= plastic[:3].mean(axis=0)
    slack = rng.standard_normal(conditions) * np.abs(model.flow.moved).max() * 1e-2
    strain = 5e-3 * rng.standard_normal(components * points)
    load = StepLoad(strain, strain, np.zeros(conditions), slack, plastic, np.abs(plastic[0]), 0.1)
    assert condensed_step.begin(arrays, load, elastic) == codes.EVALUATE
    load = load._replace(elastic=elastic.strain, forces=elastic.forces)
    size = 5e-3 / np.abs(model.flow.per_mode).max()

    def residual(correction):
        work.numbers[codes.LINEAR] = codes.NO_TANGENT
        work.there[:] = correction
        # one evaluation and no more: the residual and J there are what is left behind
        condensed_step.solve(arrays, load, work, kinds, constants, 1e-300, 1)
        return work.left.copy(), work.active.copy()

    here = size * rng.standard_normal(model.modes)
    value, active = residual(here)
    work.numbers[codes.LINEAR] = codes.NO_TANGENT
    work.there[:] = here
    condensed_step.solve(arrays, load, work, kinds, constants, 1e-300, 2)
    newton, turned = work.newton.copy(), active
    slopes = np.empty((model.modes, model.modes))
    for k in range(model.modes):
        step = 1e-7 * size * (np.arange(model.modes) == k)
        ends = [residual(here + sign * step) for sign in (1, -1)]
        turned = turned | ends[0][1] ^ ends[1][1]
        slopes[:, k] = (ends[0][0] - ends[1][0]) / (2e-7 * size)
    assert value.any()
    return np.abs(-newton @ slopes - np.eye(model.modes)).max(), active.sum()


@pytest.mark.parametrize("which", ["tube", "pellet"])
def test_newtons_matrix_is_the_derivative_of_the_residual(tubes, pellet, which):
    """Several statuses, plasticity and creep; a difference may cross the onset of flow at some point."""
    model = (tubes if which == "tube" else pellet)[2].equilibrium
    kernels = [kernel_of(group.law) for group in model.material.groups]
    kinds, constants = np.array([kind for kind, _ in kernels]), np.array([values for _, values in kernels])
    found = [derivative_error(model, kinds, constants, seed) for seed in range(12)]
    errors, counts = zip(*found, strict=True)
    assert np.median(errors) < 1e-5 and np.sort(errors)[-3] < 1e-3
    assert len(set(counts)) > 1


def test_first_yield_to_round_off_converges(tubes):
    """Where the first point yields by 1e-15 to 1e-1 of the pressure, with usual and with small tolerances."""
    model = tubes[2]
    low, high = 0.3, 0.9
    for _ in range(60):
        middle = (low + high) / 2
        flows = model.march(up(middle, 1), QUIET).answers[-1].plastic_strain().any()
        low, high = (low, middle) if flows else (middle, high)
    for part in (0.0, *10.0 ** np.arange(-15, 0)):
        for settings in (QUIET, TIGHT):
            history = model.march(
                [*up(high * (1 + part), 1), (1.0, np.array([high])), (2.0, np.array([0.0]))], settings
            )
            assert len(history.answers) == 3 and history.cuts == 0


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


def test_paces_between_trained_ones():
    """Creep over two decades of pace, unloaded and held for 1000 s."""
    full = hhr.FullOrderModel(walled_tube(hhr.Norton(2.0, 4.0), wall=2.005))

    def path(pressure, dt):
        return [*cycle(pressure, dt), (20 * dt + 1000.0, np.array([pressure])), (2e3, np.array([0.0]))]

    histories = [full.march(path(pressure, dt), TIGHT) for pressure in (0.5, 0.9) for dt in (1e-3, 1e-2, 1e-1)]
    model = condensed(full, histories)
    for pressure, dt in ((0.7, 3e-3), (0.6, 5e-2)):
        primal, dual = apart(model.march(path(pressure, dt), QUIET), full.march(path(pressure, dt), TIGHT))
        assert primal < 1e-2 and dual < 1e-2


def test_a_load_that_is_not_borne_is_outside():
    """Perfect plasticity beyond its limit load 2/√3 ln 2: modes that never showed it bear it, but the door speaks."""
    scene = tube(hhr.Plasticity("s"), 1.0, cells=6)
    full = hhr.FullOrderModel(
        dataclasses.replace(scene, parameters=hhr.ParameterSpace(("p", "s"), (0.0, 0.5), (2.0, 1.5)))
    )
    model = condensed(full, [full.march(up(0.7 * s, constants=(s,)), TIGHT) for s in (0.8, 1.2)])
    path = up(0.95, constants=(1.0,))
    with pytest.raises(OutsideTrainingError, match=r"step \d, to t = .* s") as caught:
        model.march([(1.25 * time, point) for time, point in path], hhr.MarchSettings(outside="refuse"))
    assert len(caught.value.history.answers) < 8


def test_a_step_that_fails_says_what_was_tried(tubes):
    """Too few iterations: what was tried last, and the steps before, all of them solved."""
    model, few = tubes[2], hhr.MarchSettings(outside="ignore", iterations=1, cuts=1)
    said = r"step 5 to t = 0.5 s did not converge: the iterations allowed are spent, with a residual of .* of the " \
        r"correction after 2 iterations. Take smaller steps; the 4 steps before are kept"  # fmt: skip
    with pytest.raises(ConvergenceError, match=said) as caught:
        model.march(up(0.9), few)
    done, exact = caught.value.history.answers, model.march(up(0.9), QUIET).answers
    assert all(np.array_equal(one.unknown, other.unknown) for one, other in zip(done, exact[:4], strict=True))
    # cut in parts they suffice for
    history = model.march(up(0.9, 2), hhr.MarchSettings(outside="ignore", iterations=3))
    assert history.cuts > 0 and len(history.answers) == 2
    expected = model.march(up(0.9, 2), QUIET)
    assert apart(history, expected)[0] < 1e-2


@pytest.fixture(scope="module")
def hot():
    """Heat, yield stress by temperature, hardening, creep, gap and Young's modulus of the pellet as parameters."""
    base, extra = hot_pellet(), {"h": (500.0, 2000.0), "K": (800.0, 1200.0)}
    bodies = (
        dataclasses.replace(base.bodies[0], law=hhr.Plasticity("90 - 0.02 * T", "h")),
        dataclasses.replace(base.bodies[1], law=hhr.Norton("K", 4.0)),
    )
    space = base.parameters
    space = hhr.ParameterSpace(
        (*space.names, *extra),
        (*space.lower, *(low for low, _ in extra.values())),
        (*space.upper, *(high for _, high in extra.values())),
    )
    outputs = (hhr.ContactForce("force", 0, direction=(1.0, 0.0)),)
    return hhr.FullOrderModel(dataclasses.replace(base, bodies=bodies, parameters=space, outputs=outputs))


def hot_history(gap, young, heat, hardening, resistance):
    return [(time, np.append(point, (hardening, resistance))) for time, point in hot_path(gap, young, heat)]


# fmt: off
HOT = [(5.0, 160e3, 100.0, 500.0, 900.0), (15.0, 220e3, 900.0, 2000.0, 1100.0), (7.0, 220e3, 500.0, 600.0, 1200.0),
       (13.0, 160e3, 800.0, 1800.0, 800.0), (9.0, 180e3, 900.0, 700.0, 1000.0), (11.0, 200e3, 200.0, 1500.0, 850.0)]
# fmt: on


@pytest.fixture(scope="module")
def hot_model(hot):
    return condensed(hot, [hot.march(hot_history(*item), TIGHT) for item in HOT])


def test_constants_moduli_and_heat_at_untrained_points(hot, hot_model):
    for item in ((8.0, 190e3, 400.0, 1000.0, 1000.0), (12.0, 170e3, 700.0, 1300.0, 950.0)):
        path = hot_history(*item)
        primal, dual = apart(hot_model.march(path, QUIET), hot.march(path, TIGHT))
        assert primal < 1e-2 and dual < 2e-2


def test_derivatives_are_those_of_histories(hot_model):
    """Beside central differences of whole histories, outputs too."""
    model = hot_model
    path = [(time, point + 10.0 * (np.arange(7) == 3)) for time, point in hot_history(9.0, 2e5, 500.0, 1e3, 1e3)]
    history = model.march(path, dataclasses.replace(FINE, gradient=True))
    for axis, step in ((1, 1e-5), (2, 1e-6), (3, 0.01), (4, 20.0), (5, 0.01), (6, 0.01)):
        shift = step * (np.arange(7) == axis)
        ends = [model.march([(time, point + way * shift) for time, point in path], FINE).answers for way in (1, -1)]
        for name in ("unknown", "multipliers"):
            found = np.stack([getattr(answer.gradient, name)[:, axis] for answer in history.answers])
            changes = np.stack([getattr(a, name) - getattr(b, name) for a, b in zip(*ends, strict=True)]) / (2 * step)
            assert np.linalg.norm(found - changes) < 1e-6 * np.linalg.norm(changes)
        found = np.array([answer.outputs().gradient["force"][axis] for answer in history.answers])
        changes = np.array([a.outputs()["force"] - b.outputs()["force"] for a, b in zip(*ends, strict=True)])
        assert np.linalg.norm(found - changes / (2 * step)) < 1e-6 * np.linalg.norm(found)


def test_outputs_and_derivatives_where_displacements_are_imposed():
    """Both moduli, a gap, a load and two motions: forces and displacements read off, each parameter."""
    outputs = (
        hhr.ContactForce("force", 0, direction=(0.0, 1.0)),
        hhr.DisplacementAt("side", (2.0, 1.0), 0, two_blocks.FIRST),
        hhr.DisplacementAt("flank", (2.0, 1.0), 0, two_blocks.SECOND),
    )
    scene = dataclasses.replace(blocks("E1", "2 * E2", hypothesis="plane_strain", cells=3), outputs=outputs)
    full = hhr.FullOrderModel(scene)
    corners = [(2.0, 2.0), (4.0, 9.0), (2.0, 9.0), (4.0, 2.0)]
    model = condensed(full, [full.march(push(*moduli, steps=5), TIGHT) for moduli in corners])
    path = [(time, np.add(point, (1e-4, 0, 1e-4, 0, 0, 0))) for time, point in push(3.1, 4.0, steps=5)]
    history, exact = model.march(path, dataclasses.replace(FINE, gradient=True)), full.march(path, TIGHT)
    assert history.answers[-1].plastic_strain().any()
    for name in ("force", "side", "flank"):
        values = np.array([[item.answers[k].outputs()[name] for k in range(5)] for item in (history, exact)])
        assert values[0] == pytest.approx(values[1], abs=5e-3 * np.abs(values).max())
    for axis, step in enumerate((1e-6, 1e-6, 1e-6, 1e-6, 1e-4, 1e-4)):
        shift = step * (np.arange(6) == axis)
        ends = [model.march([(time, point + way * shift) for time, point in path], FINE).answers for way in (1, -1)]
        for name in ("force", "side", "flank"):
            found = np.array([answer.outputs().gradient[name][axis] for answer in history.answers])
            changes = np.array([a.outputs()[name] - b.outputs()[name] for a, b in zip(*ends, strict=True)]) / (2 * step)
            # the upper body slides as a whole without friction, and no force knows
            assert np.linalg.norm(found - changes) <= 1e-5 * np.linalg.norm(changes), (name, axis)


@dataclasses.dataclass(frozen=True)
class Own:
    """Linear hardening of a user's own, which may answer nonsense as soon as anything flows."""

    yield_stress: float
    hardening: float
    answer: object = None

    def flow(self, trial, plastic_strain, shear, dt):
        over = trial - self.yield_stress - self.hardening * plastic_strain
        slope = 1 / (3 * shear + self.hardening)
        found = np.maximum(over, 0.0) * slope, np.where(over > 0, slope, 0.0)
        return self.answer(trial, plastic_strain, *found) if self.answer and (over > 0).any() else found


def with_law(model, law):
    """The same condensed model with another law at its points."""
    groups = tuple(dataclasses.replace(group, law=law) for group in model.flow.groups)
    return model.changed(flow=dataclasses.replace(model.flow, groups=groups))


def test_laws_of_a_users_own_answer_as_compiled_ones(tubes):
    """The same hardening stated by the user, and perfect plasticity as a Bingham body without viscosity."""
    model = tubes[2]
    for ours, theirs in (((1.0, 5.0), Own(1.0, 5.0)), ((1.0, 0.0), Bingham(1.0, 0.0))):
        compiled = with_law(model, hhr.Plasticity(*ours))
        one, other = compiled.march(cycle(0.75), FINE), with_law(model, theirs).march(cycle(0.75), FINE)
        assert one.answers[-1].plastic_strain().any() and one.iterations == other.iterations
        for here, there in zip(one.answers, other.answers, strict=True):
            assert here.unknown == pytest.approx(there.unknown, abs=1e-10 * np.abs(one.answers[-1].unknown).max())
            assert here.stress() == pytest.approx(there.stress(), abs=1e-10)


def _raises(kind):
    def answer(*given):
        raise kind("no way")

    return answer


def _writes(trial, cumulated, amount, slope):
    cumulated[:] = 7.0
    return amount, slope


NONSENSE = {
    "raises": (_raises(RuntimeError), SceneError, "failed with RuntimeError: no way"),
    "overflows": (_raises(ZeroDivisionError), ConvergenceError, "Own.*found no flow in a step of .* no way"),
    "is not finite": (lambda q, p, a, b: (a * np.nan, b), ConvergenceError, "Own.* flows by nan"),
    "has no slope": (lambda q, p, a, b: (a, b * np.nan), ConvergenceError, "Own.* has the slope nan"),
    "turns the stress round": (lambda q, p, a, b: (1e6 * a, b), ConvergenceError, "Own.* flows by .* was expected"),
    "flows back": (lambda q, p, a, b: (-a, b), ConvergenceError, "Own.* flows by -"),
    "is a number": (lambda q, p, a, b: (0.0, 0.0), ConvergenceError, "must answer with a flow and a slope of shape"),
    "is too short": (lambda q, p, a, b: (a[1:], b[1:]), ConvergenceError, "must answer with .* of shape"),
    "is a table": (lambda q, p, a, b: (a[None], b[None]), ConvergenceError, "must answer with .* of shape"),
    "is nothing": (lambda q, p, a, b: None, SceneError, "answered None"),
    "is complex": (lambda q, p, a, b: (1j * a, b), SceneError, "must return two arrays of numbers"),
    "writes": (_writes, SceneError, "read-only"),
}


@pytest.mark.parametrize("case", NONSENSE)
def test_a_law_that_answers_nonsense_is_named(tubes, case):
    """The steps before are kept as they were."""
    answer, kind, message = NONSENSE[case]
    model, path = with_law(tubes[2], Own(1.0, 5.0, answer)), up(0.85)
    with pytest.raises(kind, match=message) as caught:
        model.march(path, QUIET)
    done = caught.value.history.answers
    expected = tubes[2].march(path, QUIET).answers
    assert 0 < len(done) < len(expected)
    for here, there in zip(done, expected, strict=False):
        assert here.unknown == pytest.approx(there.unknown, abs=1e-14)
        assert not here.plastic_strain().any()


def test_a_wrong_slope_costs_iterations_alone(tubes):
    model = with_law(tubes[2], Own(1.0, 5.0, lambda q, p, a, b: (a, 0.3 * b)))
    with pytest.warns(hhr.errors.LawWarning, match="the slope of Own"):
        history = model.march(up(0.85), FINE)
    exact = tubes[2].march(up(0.85), FINE)
    assert sum(history.iterations) > sum(exact.iterations)
    assert apart(history, exact)[0] < 1e-8


@pytest.mark.parametrize(
    ("given", "message"),
    [({"modes": 0.0}, "modes = 0.0 must be a fraction"), ({"modes": 1.0}, "modes = 1.0"), ({"modes": -1}, "modes = -1"),
     ({"cubature": 2.0}, "cubature = 2.0"), ({"stability": "much"}, "stability = 'much'"),
     ({"most_modes": 0}, "most_modes = 0 must be a whole number from 1, or None"), ({"most_points": 2.5}, "2.5"),
     ({"attempts": 0}, "attempts = 0 must be a whole number from 1$"), ({"attempts": None}, "attempts = None")],
)  # fmt: skip
def test_settings_that_leave_nothing_are_refused(given, message):
    with pytest.raises(ReductionError, match=message):
        CorrectionSettings(**given)


def test_too_small_a_model_is_refused_in_words(pellet):
    full, histories = pellet[:2]
    with pytest.raises(UnstableModelError, match=r"the cubature on \d+ points gives a mode .*most_points"):
        condensed(full, histories, most_points=10)
    with pytest.raises(UnstableModelError, match="the displacement error, on the whole mesh"):
        condensed(full, histories, most_modes=1)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        small = condensed(full, histories, most_modes=2, trust=None)
    assert small.offline.modes == 2 and small.offline.comparison is None


def test_what_is_no_training_is_refused(tubes, pellet):
    full, histories, _ = tubes
    with pytest.raises(ReductionError, match="no body flows in any training history: train at higher loads"):
        condensed(full, [full.march(up(0.2, steps=3))])
    with pytest.raises(ReductionError, match="snapshots"):
        condensed(full, pellet[1])
    elastic = hhr.FullOrderModel(walled_tube(None))
    with pytest.raises(ReductionError, match="nothing flows in scene 'tube'"):
        condensed(elastic, histories)
    answers = hhr.SnapshotSet.of_answers(histories[0].answers)
    with pytest.raises(ReductionError, match="trained on histories"):
        condense_flow(full, answers)


def test_one_history_is_enough_for_itself(tubes):
    full, histories, _ = tubes
    primal, dual = apart(condensed(full, histories[:1]).march(histories[0].path, QUIET), histories[0])
    assert primal < 1e-2 and dual < 1e-2


def test_bodies_that_hang_together_need_one_modulus():
    """Other formulas are refused; the same one is a factor of the whole."""
    box = {"E1": (2.0, 4.0), "E2": (2.0, 9.0)}
    full = hhr.FullOrderModel(glued("E1", "E2", box))
    with pytest.raises(ReductionError, match="bodies that hang together have Young's moduli that vary by themselves"):
        condensed(full, [full.march(pressed(*moduli)) for moduli in ((2.0, 2.0), (4.0, 9.0))])
    full = hhr.FullOrderModel(glued("E1", "E1", {"E1": (2.0, 4.0)}))
    model = condensed(full, [full.march(pressed(young), TIGHT) for young in (2.0, 2.9, 4.0)])
    primal, dual = apart(model.march(pressed(3.3), QUIET), full.march(pressed(3.3), TIGHT))
    assert primal < 1e-2 and dual < 1e-2
    changing = pressed(3.3)
    changing[2][1][1] = 3.0
    with pytest.raises(ParameterError, match=r"E1 changes from 3\.3 to 3 in step 2"):
        model.march(changing)


def in_units(length, stress):
    """Two blocks, E of one a parameter, in other units; pushed to 0.05 in the first ones."""

    def geometry(comm):
        mesh, cells, facets = two_blocks.two_blocks(
            comm, first=((1.0, 0.0), (2.0, 1.0), (4, 4)), second=((1.0, 1.0), (2.0, 2.0), (4, 4))
        )
        mesh.geometry.x[:] *= length
        return mesh, cells, facets

    box = {"push": (0.0, 0.06 * length), "E1": (2.0 * stress, 4.0 * stress)}
    bodies = (
        hhr.Body(two_blocks.FIRST, "E1", 0.3, hhr.Plasticity(0.05 * stress, 0.2 * stress)),
        hhr.Body(two_blocks.SECOND, 5.0 * stress, 0.35),
    )
    base = pressed_pair("plane_strain", bodies, {"E1": box["E1"]}, cells=4)
    held = [item for item in base.displacements if not item.amplitude.slopes]
    top = two_blocks.side(two_blocks.SECOND, 1, True)
    moved = (hhr.Displacement(top, 0), hhr.Displacement(top, 1, hhr.Amplitude(slopes={"push": -1.0})))
    return hhr.FullOrderModel(dataclasses.replace(
        base, geometry=geometry, displacements=(*held, *moved), loads=(), openings=(),
        parameters=hhr.ParameterSpace(tuple(box), *zip(*box.values(), strict=True)),
    ))  # fmt: skip


def test_errors_do_not_depend_on_units():
    """mm and MPa, m and Pa, and units in which forces are tiny."""
    found = []
    for length, stress in ((1.0, 1.0), (1e-3, 1e6), (1e4, 1e-9)):
        full = in_units(length, stress)

        def path(young, steps=6):
            return [(k / steps, np.array([0.05 * length * k / steps, young * stress])) for k in range(steps + 1)]

        model = condensed(full, [full.march(path(young), TIGHT) for young in (2.0, 4.0)])
        history = model.march(path(2.9), QUIET)
        errors = apart(history, full.march(path(2.9), TIGHT))
        found.append((model.offline.modes, model.offline.points, sum(history.iterations), *errors))
        assert max(errors) < 1e-2
    for other in found[1:]:
        assert other[:3] == found[0][:3]
        assert other[3:] == pytest.approx(found[0][3:], rel=0.05)


def warned(model, paths):
    """On how many of some paths the door says something."""
    count = 0
    for path in paths:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            model.march(path)
        count += any(issubclass(item.category, OutsideTrainingWarning) for item in caught)
    return count


def test_the_door(pellet):
    """Twenty random paths each: nearly silent inside what was trained, never outside."""
    model, rng = pellet[2], np.random.default_rng(3)

    def some(make):
        return [make() for _ in range(20)]

    def inside(**others):
        return loaded(rng.uniform(5.5, 14.5), rng.uniform(0.65, 0.95), **{"seconds": rng.uniform(0.8, 1.2)} | others)

    def behind(shares, seconds):
        path = inside(seconds=1.0)
        return path + [(path[-1][0] + seconds * (k + 1), path[-1][1] * (share, 1, 1)) for k, share in enumerate(shares)]

    assert warned(model, some(inside)) <= 3
    assert warned(model, some(lambda: behind((0.75, 0.5, 0.25, 0.0), 0.2))) == 20
    assert warned(model, some(lambda: behind((1.0, 1.0), 5.0))) == 20
    assert warned(model, some(lambda: inside(seconds=rng.uniform(5, 50)))) == 20
    assert warned(model, some(lambda: inside(seconds=rng.uniform(0.01, 0.2)))) == 20
    assert warned(model, some(lambda: inside(height=rng.uniform(1.0, 1.4)))) == 20
    with pytest.raises(OutsideTrainingError, match=r"h1 = 1\.2"):
        model.march(inside(height=1.2), hhr.MarchSettings(outside="refuse"))


def test_a_copy_answers_alike(hot_model):
    path = hot_history(8.0, 190e3, 400.0, 1000.0, 1000.0)
    one, other = (model.march(path, QUIET).answers[-1] for model in (hot_model, pickle.loads(pickle.dumps(hot_model))))
    for name in ("displacement", "forces", "stress", "plastic_strain"):
        assert np.array_equal(getattr(one, name)(), getattr(other, name)())
    assert one.outputs().values == other.outputs().values


def test_the_order_of_questions_does_not_matter(hot_model):
    """Other moduli asked in between leave nothing behind."""
    path, other = hot_history(8.0, 190e3, 400.0, 1000.0, 1000.0), hot_history(12.0, 170e3, 700.0, 1300.0, 950.0)
    first = hot_model.march(path, QUIET)
    hot_model.march(other, QUIET)
    again = hot_model.march(path, QUIET)
    assert all(np.array_equal(a.unknown, b.unknown) for a, b in zip(first.answers, again.answers, strict=True))
