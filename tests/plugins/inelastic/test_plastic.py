"""Bodies that flow: laws against UFL and closed forms, histories against closed forms, reduced
against full.
"""

import dataclasses

import flowing
import numpy as np
import pellet_cladding_plastic as demo
import pytest
from condensing import FINE, QUIET, TIGHT, condensed, up
from flow_histories import whole_history
from needs import needs
from points import WOOD
from scenes import node_dofs, pair_scene, pressed_block, slope
from scipy.optimize import brentq
from toy_law import Bingham, Ludwik
from tubes import POISSON, YOUNG, in_time, tube
from yielding_scenes import axial, bar

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import (
    ConvergenceError,
    NotOfferedError,
)
from hhr_dolfinx.geometries import block, two_blocks
from hhr_dolfinx.models.histories.equilibrium import SEARCHES
from hhr_dolfinx.plugins.inelastic.law import InternalVariables, program_of
from hhr_dolfinx.plugins.inelastic.project import tangent_margin
from hhr_dolfinx.plugins.inelastic.update import Group, Material

LAWS = {
    "plasticity": hhr.Plasticity(1.0, 5.0),
    "perfect plasticity": hhr.Plasticity(1.0, 0.0),
    "norton 4": hhr.Norton(2.0, 4.0),
    "norton 20": hhr.Norton(2.0, 20.0),
    "bingham": Bingham(1.0, 20.0),
}


def material(law, points, components=4):
    return Material(
        [Group(np.arange(points), YOUNG, POISSON, program_of(law, components))], components
    )


def some_states(seed, points=40, components=4):
    """Strains around yield, and a state reached by an earlier step."""
    rng = np.random.default_rng(seed)
    strain = rng.standard_normal((points, components)) * 10 ** rng.uniform(-3.5, -1, (points, 1))
    plastic = (
        0.3 * rng.standard_normal((points, components)) * np.abs(strain).max(axis=1, keepdims=True)
    )
    plastic[:, :3] -= plastic[:, :3].mean(axis=1, keepdims=True)
    return strain, InternalVariables(
        plastic, np.abs(rng.standard_normal(points)) * 1e-2, np.zeros((points, 0))
    )


@pytest.mark.parametrize("exponent", [1.0, 2.5, 4.0, 5.0, 20.0])
def test_norton_over_many_decades(exponent):
    """x + 3 mu dt (x / K)^m = q_tr, to round-off over K and q in twelve decades."""
    shear = YOUNG / 2 / (1 + POISSON)
    trial = np.concatenate([[0.0], 10.0 ** np.linspace(-6, 6, 200)])
    strain = np.zeros((trial.size, 4))
    strain[:, 3] = trial / np.sqrt(1.5) / (2 * shear)
    for resistance in 10.0 ** np.arange(-3, 4):
        there = material(hhr.Norton(resistance, exponent), trial.size)
        flow = there.update(strain, there.at_rest(), 0.1, tangent=False).state.cumulated
        stress = resistance * (flow / 0.1) ** (1 / exponent)
        assert stress + 3 * shear * flow == pytest.approx(trial, rel=1e-9)


def flow_of(law, trial, cumulated, stiff, dt):
    """Root of the equation of a law in one dimension, by bisection."""
    if isinstance(law, hhr.Norton):
        return (
            brentq(
                lambda x: x + stiff * dt * (x / law.resistance) ** law.exponent - trial, 0, trial
            )
            if trial
            else 0
        )
    over = max(trial - law.yield_stress - getattr(law, "hardening", 0.0) * cumulated, 0.0)
    return over / (stiff + (law.viscosity / dt if isinstance(law, Bingham) else law.hardening))


def uniaxial(law, strains):
    """Stress of a bar under the given axial strains, one scalar equation per step."""
    plastic, cumulated, stresses = 0.0, 0.0, []
    for strain in strains:
        trial = YOUNG * (strain - plastic)
        flow = flow_of(law, abs(trial), cumulated, YOUNG, 0.1)  # 3 mu -> E in one dimension
        if isinstance(law, hhr.Norton):
            flow = (abs(trial) - flow) / YOUNG
        plastic, cumulated = plastic + np.sign(trial) * flow, cumulated + flow
        stresses.append(YOUNG * (strain - plastic))
    return np.array(stresses)


@pytest.mark.parametrize("exponent", [0.3, 0.7])
def test_pressed_blocks_harden_by_ludwik_in_full_and_condensed(exponent):
    """Uniaxial stress on a floor: pressure σ0 + K p^n with e = σ/E + p, by brentq, in steps of
    several sizes.
    """
    law = Ludwik(300.0, 500.0, exponent)
    base = pressed_block("plane_stress", young=YOUNG, gap=0.0, cells=2)
    full = hhr.FullOrderModel(
        dataclasses.replace(base, bodies=(hhr.Body(block.SOLID, 200e3, 0.3, law),))
    )

    def pressed(push):
        strain = push / 2
        over = lambda p: 200e3 * (strain - p) - 300.0 - 500.0 * p**exponent  # noqa: E731
        return (
            1.5 * 200e3 * (strain - (brentq(over, 0, strain, xtol=1e-18) if over(0) > 0 else 0.0))
        )

    histories = []
    for steps in (1, 4, 13):
        path = [(float(k), np.array([0.06 * k / steps])) for k in range(steps + 1)]
        histories.append(full.march(path, TIGHT))
        for (_, point), answer in zip(path[1:], histories[-1].answers, strict=True):
            assert answer.forces().sum() == pytest.approx(pressed(point[0]), rel=1e-6, abs=1e-6)
    model = condensed(full, histories[1:])
    for steps in (1, 3, 20):
        path = [(float(k), np.array([0.05 * k / steps])) for k in range(steps + 1)]
        history = model.march(path, TIGHT)
        for (_, point), answer in zip(path[1:], history.answers, strict=True):
            assert answer.forces().sum() == pytest.approx(pressed(point[0]), rel=1e-6, abs=1e-6)


@pytest.mark.parametrize("law", ["plasticity", "perfect plasticity", "norton 4", "bingham"])
@pytest.mark.parametrize("search", ["tangent", "frozen", "elastic"])
def test_uniaxial_cycle_with_unloading(law, search):
    """Loading, unloading, flow the other way and back, by every search operator and a law of a
    user's own.
    """
    full = hhr.FullOrderModel(bar(LAWS[law]))
    strains = np.concatenate(
        [np.linspace(0, 0.02, 6), np.linspace(0.015, -0.02, 8), np.linspace(-0.01, 0.01, 4)]
    )
    path = [(0.1 * k, np.array([strain])) for k, strain in enumerate(strains)]
    tight = hhr.MarchSettings(search, 1e-12, 1e-10, 1e-10, iterations=400)
    history = full.march(path, tight)
    assert axial(history) == pytest.approx(uniaxial(LAWS[law], strains[1:]), abs=1e-8)
    assert np.abs(history.answers[-1].stress()[:, [0, 2, 3]]).max() < 1e-8


@pytest.mark.filterwarnings("ignore:no training solution has contact")
def test_a_plastic_front_in_a_thick_tube():
    """Perfectly plastic tube in plane strain: p = 2 σ0/√3 (ln c + (1 - c²/4) / 2) at a plastic
    radius c.

    Exact for an incompressible material; with nu = 0.49 the front differs by less than an element.
    Condensed flow finds one between two that were trained.
    """

    def path(radius):
        return up(2 / np.sqrt(3) * (np.log(radius) + (1 - radius**2 / 4) / 2), 20)

    full = hhr.FullOrderModel(tube(hhr.Plasticity(1.0), 1.0, poisson=0.49))
    small = condensed(full, [full.march(path(radius)) for radius in (1.6, 1.8)])
    middles = np.repeat(full.problem.points[full.problem.cell_nodes].mean(axis=1)[:, 0], 4)
    for model, radius, off, accuracy in ((full, 1.5, 1.5 / 24, 5e-3), (small, 1.7, 2 / 24, 1e-2)):
        last = model.march(path(radius), QUIET).answers[-1]
        flowing, stress = last.plastic_strain() > 1e-6, last.stress()
        assert middles[flowing].max() == pytest.approx(radius, abs=off)
        # hoop less radial stress where it yields; modes are off at the front
        yields = flowing if model is full else middles < 1.5
        assert (stress[:, 2] - stress[:, 0])[yields] == pytest.approx(2 / np.sqrt(3), rel=accuracy)


@pytest.mark.filterwarnings("ignore:no training solution has contact")
def test_thick_tube_in_steady_creep():
    """Norton: σ_θ - σ_r = p 2/m (2/r)^(2/m) / (2^(2/m) - 1), when creep strains are ten times the
    elastic ones.
    """
    full = hhr.FullOrderModel(tube(hhr.Norton(2.0, 4.0), 0.6))
    times = np.concatenate([[0.0, 1e-3], np.geomspace(1e-2, 4.0, 60)])

    def held(pressure):
        return [(time, np.array([pressure if k else 0.0])) for k, time in enumerate(times)]

    settings = hhr.MarchSettings(floor_stress=1e-8)
    small = condensed(full, [full.march(held(pressure), settings) for pressure in (0.4, 0.6)])
    points = full.problem.points[full.problem.cell_nodes]
    # radii of the 2 x 2 Gauss points of each cell, in the order of the rule
    low, high = points[:, :, 0].min(axis=1), points[:, :, 0].max(axis=1)
    nodes = np.array([0.5 - 0.5 / 3**0.5, 0.5 + 0.5 / 3**0.5])
    radii = np.repeat(low[:, None] + (high - low)[:, None] * nodes, 2, axis=1)
    for model, how, accuracy in ((full, settings, 0.01), (small, QUIET, 0.015)):
        stress = model.march(held(0.5), how).answers[-1].stress()
        difference = np.sort((stress[:, 2] - stress[:, 0]).reshape(len(points), 4), axis=1)[:, ::-1]
        assert difference == pytest.approx(
            0.5 * 0.5 * (2 / radii) ** 0.5 / (2**0.5 - 1), rel=accuracy
        )


def test_newton_converges_quadratically():
    """With consistent tangents the residual squares from one iteration to the next."""
    model = hhr.FullOrderModel(tube(hhr.Plasticity(1.0, 5.0), 1.0)).equilibrium
    theta = model.amplitudes(np.array([0.7]))
    x, rest, norms = np.zeros(model.size), model.material.at_rest(), []
    for _ in range(8):
        update = model.material.update(model.strain(x, theta), rest, 1.0, tangent=True)
        residual, _ = model.residual(x, update, theta)
        norms.append(np.linalg.norm(residual))
        operator = model.linearised(update.tangents)
        x = x + operator.correct(residual, x, theta, np.zeros(model.conditions, dtype=bool))[0]
    norms = np.array(norms) / norms[0]
    small = np.flatnonzero((norms < 1e-2) & (norms > 1e-13))
    assert small.size >= 2 and norms.min() < 1e-12
    for k in small[:-1]:
        assert norms[k + 1] < 100 * norms[k] ** 2 + 1e-13


@needs("nonmatching")
def test_whole_basis_on_the_whole_domain_gives_the_full_history():
    """Its projected tangents, too, are those of the full model."""
    full = flowing.flowing_full()
    settings = hhr.MarchSettings(relative_force=1e-10, floor_stress=1e-8)
    exact, reduced = whole_history(full, demo.path(10.0, 12), settings)
    assert any(answer.active.any() for answer in exact.answers)
    last, before, model = exact.answers[-1], exact.answers[-2], full.equilibrium
    strain = model.strain(last.unknown, model.amplitudes(last.parameter))
    tangents = model.material.update(strain, before.gauss.state, 1 / 12, tangent=True).tangents
    assert tangent_margin(reduced, tangents, model.stiffness(tangents)) == pytest.approx(
        1.0, abs=1e-8
    )


def test_what_converged_is_kept_when_a_step_fails():
    """A bar of perfect plasticity under more than it bears: step, time and point are named, and the
    rest is kept.
    """
    scene = bar(hhr.Plasticity(1.0), 2.0)
    pulled = hhr.Traction(
        block.side(1, upper=True), (0.0, 1.0), hhr.Amplitude(slopes={"pull": 1.0})
    )
    full = hhr.FullOrderModel(
        dataclasses.replace(scene, displacements=scene.displacements[:2], loads=(pulled,))
    )
    path = [(k / 10, np.array([1.4 * k / 10])) for k in range(11)]
    with pytest.raises(
        ConvergenceError, match=r"step \d+ to t = 0\.\d+ s did not converge.*Gauss point \d+"
    ) as caught:
        full.march(path, hhr.MarchSettings(cuts=2))
    done = caught.value.history.answers
    assert len(done) == 7, "7 x 0.14 is less than the yield stress of 1, 8 x 0.14 is more"
    assert done[-1].stress()[:, 1] == pytest.approx(0.98)


def test_a_step_too_long_is_cut():
    full = hhr.FullOrderModel(tube(hhr.Plasticity(1.0, 1.0), 2.0))
    history = full.march(
        [(0.0, np.zeros(1)), (1.0, np.array([1.2]))], hhr.MarchSettings("tangent", iterations=4)
    )
    assert history.cuts == 1 and len(history.answers) == 1


def test_moving_lifts_in_the_reduced_model():
    """Whole basis and RID on a scene driven by an imposed displacement: the full history."""
    scene = tube(LAWS["plasticity"], 1.0, cells=6)
    move = hhr.Displacement(block.side(0, upper=False), 0, slope("p"))
    wall = hhr.Obstacle(block.side(0, upper=True), (1, 0), 2.001)
    moved = dataclasses.replace(
        scene, displacements=(*scene.displacements, move), loads=(), contacts=(wall,)
    )
    path = [(0.1 * k, np.array([0.002 * k])) for k in range(8)]
    tight = hhr.MarchSettings(relative_force=1e-10, floor_stress=1e-11)
    last = whole_history(hhr.FullOrderModel(moved), path, tight, field=5e-9, force=1e-7)[0].answers[
        -1
    ]
    assert last.plastic_strain().max() > 1e-3 and last.active.all()


def test_a_soft_body_converges_beside_a_stiff_one():
    """Each body by its own forces: one a millionth as stiff and strong yields the same, whatever
    squeezes the other.
    """
    first, second = two_blocks.FIRST, two_blocks.SECOND
    held = [(two_blocks.side(body, 1, False), axis) for body in (first, second) for axis in (0, 1)]
    squeeze = hhr.Displacement(two_blocks.side(second, 1, True), 1, slope("squeeze", -1.0))
    scene = pair_scene(
        "soft_and_stiff",
        {"push": (0.0, 2.0), "squeeze": (0.0, 0.3)},
        ((0.0, 0.0), (1.0, 1.0), (3, 3)),
        ((0.0, 3.0), (1.0, 4.0), (2, 2)),
        ((YOUNG * 1e-6, POISSON, hhr.Plasticity(1e-6, 5e-6)), (YOUNG, POISSON)),
        contacts=(hhr.Obstacle(two_blocks.side(first, 0, True), (1, 0), 3.0),),
        displacements=(*(hhr.Displacement(tag, axis) for tag, axis in held), squeeze),
        loads=(hhr.Traction(two_blocks.side(first, 1, True), (0.3, -1.0), slope("push", 1e-6)),),
    )
    full = hhr.FullOrderModel(scene)
    lasts = []
    for squeezed in (0.0, 0.3):
        path = [(0.1 * k, np.array([1.5, squeezed]) * k / 8) for k in range(9)]
        lasts.append(full.march(path, hhr.MarchSettings(floor_stress=1e-9)).answers[-1])
    soft = node_dofs(full.problem, np.flatnonzero(full.problem.points[:, 1] < 1.5))
    alone, beside = (answer.unknown[soft] for answer in lasts)
    assert lasts[0].plastic_strain().max() > 1e-3
    assert beside == pytest.approx(alone, abs=2e-4 * np.abs(alone).max())


@pytest.mark.parametrize("name", ["plasticity", "norton 4"])
def test_a_body_that_flows_is_never_answered_for_as_an_elastic_one(name):
    """A query is one step from rest in which it flows."""
    law, full = LAWS[name], hhr.FullOrderModel(bar(LAWS[name]))
    answer = full.solve(0.01, duration=0.1)
    assert answer.stress()[:, 1] == pytest.approx(uniaxial(law, [0.01])[0], rel=1e-4)
    assert answer.plastic_strain().min() > 1e-4 and answer.converged
    (step,) = full.march([(0.0, [0.0]), (0.1, [0.01])]).answers
    assert answer.displacement() == pytest.approx(step.displacement(), rel=1e-4, abs=1e-9)


def test_a_query_starts_where_the_box_is_nearest_to_zero(monkeypatch):
    """At the lower end of a box around zero the bar would be pushed by all of it: no place to be at
    rest.
    """
    full, asked = hhr.FullOrderModel(bar(LAWS["plasticity"])), []
    honest = full.march
    monkeypatch.setattr(
        full, "march", lambda path, settings: asked.append(path) or honest(path, settings)
    )
    full.solve(0.01)
    assert [point.tolist() for _, point in asked[0]] == [[0.0], [0.01]]


@pytest.mark.parametrize("name", ["plasticity", "norton 4"])
def test_a_strip_in_plane_stress_is_a_bar(name):
    """Its thickness changes too, by the law.

    Beside elastic bodies as well, whose stress across vanishes.
    """
    path = [
        (float(time), np.array([pull])) for time, pull in enumerate((0.0, 0.02, 0.05, 0.03, -0.02))
    ]
    found = []
    for hypothesis in ("axisymmetric", "plane_stress"):
        scene = dataclasses.replace(bar(LAWS[name]), hypothesis=hypothesis)
        found.append(axial(hhr.FullOrderModel(scene).march(path, FINE)))
    assert found[1] == pytest.approx(found[0], rel=1e-6)


@pytest.mark.parametrize("heated", [False, True])
def test_a_strip_of_wood_in_plane_stress_is_pulled_by_its_modulus(heated):
    """Along the fibres, which lie along y; what it swells by heat is no stress."""
    law = hhr.Orthotropic(*WOOD, frame=((0, 1, 0), (-1, 0, 0), (0, 0, 1)))
    scene = dataclasses.replace(
        bar(hhr.Heated(law, 1e-3, 1.0) if heated else law), hypothesis="plane_stress"
    )
    stresses = axial(hhr.FullOrderModel(scene).march([(0.0, [0.0]), (1.0, [0.01])], FINE))
    assert stresses == pytest.approx([WOOD[0] * (0.01 - 1e-3 * heated)], rel=1e-6)


@pytest.mark.filterwarnings("ignore:no training solution has contact")
def test_flow_that_is_not_associated_is_found_by_all_searches():
    """Its tangents are not symmetric, of which the factors of full models take the symmetric
    part.
    """
    full = hhr.FullOrderModel(tube(hhr.DruckerPrager(1.0, 0.3, 0.05, 20.0), 0.9))
    answers = []
    for search in SEARCHES:
        tight = hhr.MarchSettings(search, 1e-9, 1e-9, 1e-9, iterations=200)
        answers.append(full.march(up(0.9), tight).answers[-1])
    assert answers[0].plastic_strain().max() > 1e-3
    for other in answers[1:]:
        assert other.displacement() == pytest.approx(answers[0].displacement(), rel=1e-6)
    with pytest.raises(NotOfferedError, match="need symmetric tangents"):
        full.march(up(0.9), hhr.MarchSettings("tangent", 1e-9, 1e-9, 1e-9, gradient=True))


@pytest.mark.parametrize("simplices", [False, True])
@pytest.mark.parametrize("hypothesis", ["plane_strain", "solid"])
def test_without_a_law_time_gives_the_elastic_answer(hypothesis, simplices):
    """For strains of 4 and of 6 components; in time one look at each answer.

    A gap that closes has no forces to measure residuals by: round-off of the stiffness is the
    measure.
    """
    scene = pressed_block(hypothesis, simplices=simplices, cells=3)
    full = hhr.FullOrderModel(scene)
    for model in (in_time(scene), full):
        history = model.march([(0.1 * k, np.array([0.0095 * k])) for k in range(6)])
        assert max(history.iterations) <= 2 and history.answers[0].forces().sum() == 0
        for answer in history.answers:
            elastic = full.solve(answer.parameter)
            assert answer.displacement() == pytest.approx(elastic.displacement(), abs=1e-8)
            assert answer.forces() == pytest.approx(elastic.forces(), abs=1e-6)
            assert not answer.plastic_strain().any()
