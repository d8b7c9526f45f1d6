"""Laws of bodies at one point: closed forms, tangents, random steps, files, and mistakes."""

import json
import math
import re
import subprocess
import sys
from dataclasses import dataclass, replace
from decimal import Decimal, localcontext
from pathlib import Path
from typing import ClassVar

import laws
import numpy as np
import pytest
import ufl
from points import LAWS, POISSON, SHEAR, WOOD, YOUNG, Point, at_rest
from scipy.optimize import brentq
from toy_law import Bingham, Ludwik

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import ConformanceError, ConvergenceError, SceneError
from hhr_dolfinx.forms import laws as forms
from hhr_dolfinx.plain import as_plain
from hhr_dolfinx.plugins.inelastic.law import NUMBER, TENSOR, InternalVariables, Law, program_of
from hhr_dolfinx.plugins.inelastic.local_solver import LOCAL, START, TRIAL
from hhr_dolfinx.plugins.inelastic.update import Group, Material
from hhr_dolfinx.plugins.ufl_programs.machine import evaluated
from hhr_dolfinx.testing import check_law


@pytest.mark.parametrize("law", LAWS.values(), ids=LAWS)
def test_no_random_step_fails_or_ends_in_a_false_answer(law):
    """Of the benchmark, with fewer points; softening, which has no answer, is named instead."""
    found = laws.measured(law, 300, seed=0)
    assert found["false_answers"] == 0 and 0 < found["tangent"] < 1e-6
    assert found["failures"] == 0 or found["named"] == "its stress falls as strain grows"


def test_closed_forms():
    """Hardening and creep curves, triaxial compression.

    Armstrong and Frederick's is reached in 4000 steps.
    """
    found = laws.closed_forms()
    assert found.pop("Armstrong-Frederick") < 1e-6
    assert len(found) == 9 and max(found.values()) < 1e-9


@pytest.mark.parametrize("law", LAWS.values(), ids=LAWS)
def test_tangents_are_derivatives_of_the_stress(law):
    """Against central differences, to 1e-6, where the step is smooth; in the plane too."""
    for components in (4, 6):
        if components == 4 and law is LAWS["orthotropic"]:
            continue
        program = program_of(law, components)
        given = program.given(YOUNG, POISSON)
        strain = np.random.default_rng(2).normal(size=(30, components)) * 3e-3
        old = program.update(strain * 0.4, at_rest(program, 30), 1.0, given, tangent=False).state
        found = program.update(strain, old, 1.0, given, tangent=True)
        for place in range(components):
            moved = np.eye(components)[place] * 1e-8
            ends = [
                program.update(strain + way * moved, old, 1.0, given, tangent=False).stress
                for way in (-1, 1)
            ]
            slope = (ends[1] - ends[0]) / 2e-8
            assert found.tangents[:, :, place] == pytest.approx(slope, abs=1e-6 * YOUNG)


@pytest.mark.parametrize("name", ["Voce", "table", "Chaboche", "Hill", "Lemaitre"])
def test_a_point_just_about_to_yield_has_an_answer(name):
    """Its flow is round-off, beside which no step is ever small."""
    program = program_of(LAWS[name], 6)
    given, old, direction = (
        program.given(YOUNG, POISSON),
        at_rest(program, 60),
        np.array([1, -0.4, -0.5, 0.3, 0.1, 0]),
    )

    def flows(size):
        found = program.update(size * direction[None], at_rest(program), 1.0, given, tangent=False)
        return found.state.cumulated[0] > 0

    low, high = 0.0, 0.1
    while high - low > 1e-18 + 1e-16 * high:
        middle = (low + high) / 2
        low, high = (low, middle) if flows(middle) else (middle, high)
    sizes = high * (1 + np.arange(-30, 30) * 2e-16)
    found = program.update(sizes[:, None] * direction, old, 1.0, given, tangent=True)
    assert found.stress == pytest.approx(
        sizes[:, None] * (given.elastic @ direction), rel=1e-9, abs=1e-9
    )


HARDENING = [
    Ludwik(300.0, 500.0, 0.3),
    Ludwik(300.0, 500.0, 0.7),
    Ludwik(0.0, 500.0, 0.2),
    Ludwik(0.0, 500.0, 0.5),
]


@pytest.mark.parametrize("law", HARDENING, ids=["Ludwik .3", "Ludwik .7", "Hollomon .2", "root"])
@pytest.mark.parametrize("kind", ["solid", "plane stress"])
def test_a_law_with_an_infinite_slope_flows_by_its_closed_form(law, kind):
    """A pull ends at q = R(p), e = q/E + p, whatever the steps: the root of this equation by
    brentq.
    """

    def pulled(strain):
        def left(p):
            return YOUNG * (strain - p) - law.yield_stress - law.strength * p**law.exponent

        plastic = brentq(left, 0, strain, xtol=1e-18) if left(0) > 0 else 0.0
        return YOUNG * (strain - plastic)

    for steps in (1, 3, 40):
        how = {"components": 4, "plane_stress": True} if kind == "plane stress" else {}
        point = Point(law, **how)
        for strain in np.linspace(0, 0.02, steps + 1)[1:]:
            across = (
                {2: -POISSON * strain} if how else {}
            )  # which a law in plane stress does not read
            assert point.step({0: strain, **across})[0] == pytest.approx(pulled(strain), rel=1e-8)
        assert point.step({0: strain - 1e-4, **across})[0] == pytest.approx(
            pulled(strain) - 1e-4 * YOUNG, rel=1e-8
        )


@pytest.mark.parametrize("law", HARDENING, ids=["Ludwik .3", "Ludwik .7", "Hollomon .2", "root"])
def test_a_flow_of_any_size_has_an_infinite_slope_before_it(law):
    """Shear from where the law is about to yield, over 16 decades: q_tr = R(p) + 3 μ p, by brentq
    in log p.
    """
    start = law.yield_stress / 3 / SHEAR
    sizes = np.logspace(-16, 0, 33)
    strain = np.zeros((sizes.size, 6))
    strain[:, 3] = np.sqrt(1.5) * (start + sizes)
    program = program_of(law, 6)
    found = program.update(
        strain, at_rest(program, sizes.size), 1.0, program.given(YOUNG, POISSON), tangent=True
    )
    for trial, stress in zip(
        2 * SHEAR * strain[:, 3] * np.sqrt(1.5), found.stress[:, 3] * np.sqrt(1.5), strict=True
    ):

        def left(size, trial=trial):
            p = np.exp(size)
            return trial - 3 * SHEAR * p - law.yield_stress - law.strength * p**law.exponent

        flow = np.exp(brentq(left, -700, 1, xtol=1e-14)) if left(-700) > 0 else 0.0
        assert stress == pytest.approx(trial - 3 * SHEAR * flow, rel=1e-9)
    assert np.isfinite(found.tangents).all()


def test_check_law_accepts_hardening_with_an_infinite_slope():
    """Strengths in GPa, as on the page of laws; the energy that flow takes is positive for each
    n.
    """
    for law in HARDENING:
        check_law(
            replace(law, yield_stress=law.yield_stress / 1e3, strength=law.strength / 1e3),
            young=200.0,
        )


@dataclass(frozen=True)
class Gasket(Law):
    """Elastic, and across x a pressure k e^2 of the closure e = -ε_xx.

    Below e_max k e_max^2 (e/e_max)^n.
    """

    stiffness: float
    returned: float
    memory: ClassVar = {"closed": NUMBER}

    def statement(self, at):
        """Loading takes k e^3/3, and unloading gives back k e^3/(n + 1)."""
        c = at.constants
        closure = ufl.max_value(-at.strain[0], 0)
        closed = ufl.max_value(closure, at.old.closed)
        share = ufl.conditional(ufl.gt(closed, 0), closure / closed, 0)
        pressure = c.stiffness * closed**2 * share**c.returned
        across = ufl.as_vector([1.0] + [0.0] * (len(at.strain) - 1))
        memory = {"closed": closed, "cumulated": at.old.cumulated + closed - at.old.closed}
        return forms.Stated(0.05 * forms.hooke(at.strain, c) - pressure * across, memory)


def test_check_law_judges_a_gasket_by_the_work_of_its_path():
    """It stiffens, so that ε - C^-1 σ goes against the stress.

    It dissipates if n > 2, and creates energy if n < 2.
    """
    check_law(Gasket(5e3, 4.0), young=200.0)
    with pytest.raises(ConformanceError, match="gives back"):
        check_law(Gasket(5e3, 1.0), young=200.0)


@dataclass(frozen=True)
class Steep(Law):
    """Ludwik's law with a residual of its own, whose slope at the first iterate is infinite unless
    that is moved.
    """

    first: float
    unknowns: ClassVar = {"amount": NUMBER}

    def statement(self, at):
        """q_tr - 3 μ Δp = 300 + 500 √p."""
        trial = 2 * forms.lame(at.constants)[1] * forms.deviator(at.strain - at.old.inelastic)
        size, stiff = forms.equivalent(trial), 3 * forms.lame(at.constants)[1]
        p = at.old.cumulated + at.unknown.amount
        mean = forms.hooke(at.strain, at.constants) - 2 * stiff / 3 * forms.deviator(at.strain)
        return forms.Stated(
            mean + (1 - stiff * at.unknown.amount / size) * trial,
            {"cumulated": p},
            [size - stiff * at.unknown.amount - 300 - 500 * ufl.sqrt(p)],
            size - 300 - 500 * ufl.sqrt(at.old.cumulated),
            {"amount": at.constants.first},
        )


def test_a_step_by_an_infinite_slope_solves_nothing():
    """Newton's step is r/∞ = 0 there: the law is refused with the remedy, which then gives the root
    of hardening.
    """
    with pytest.raises(
        ConvergenceError, match=r"slope of its residual is infinite .* return a `start`"
    ):
        Point(Steep(0.0)).after([0.02, -0.01, -0.01, 0, 0, 0])
    mended = Point(Steep(1e-8)).after([0.02, -0.01, -0.01, 0, 0, 0])
    same = Point(Ludwik(300.0, 500.0, 0.5)).after([0.02, -0.01, -0.01, 0, 0, 0])
    assert mended.stress == pytest.approx(same.stress, rel=1e-9)
    assert mended.tangents == pytest.approx(same.tangents, abs=1e-9 * YOUNG)


def test_newton_steps_at_a_point_are_quadratic():
    """The size of each step of Chaboche's law is below a bound times the square of the last."""
    program = program_of(LAWS["Chaboche"], 6)
    inputs = np.zeros((program.program.inputs, 1))
    constants = program.given(YOUNG, POISSON).constants[:, 0]
    inputs[3], inputs[-len(constants) - 1] = 4e-3, 1.0
    inputs[-len(constants) :, 0] = constants
    steps = []
    for _ in range(6):
        left, slope = evaluated(program.program, inputs, TRIAL, START, LOCAL)[:2, 0]
        steps.append(abs(left / slope))
        inputs[6] -= left / slope
    sizes = np.array([step for step in steps if step > 1e-15 * inputs[6, 0]]) / inputs[6, 0]
    assert len(sizes) > 2 and (sizes[1:] < 2 * sizes[:-1] ** 2 + 1e-15).all()


def test_back_stress_ratchets_by_armstrong_and_frederick():
    """A cycle of stress about a mean adds ln(.)/γ to the strain.

    With perfect plasticity otherwise, X goes between m - a + σ0 and m + a - σ0 in each cycle,
    Lemaitre and Chaboche.
    """
    modulus, recall, strength = 60e3, 600.0, 200.0
    mean, wide, point = 20.0, 250.0, Point(LAWS["Armstrong-Frederick"])
    ends = []
    for cycle in range(3):
        for way in (1, -1):
            levels = (
                np.linspace(-way * wide, way * wide, 801)[1:]
                if cycle or way < 0
                else np.linspace(0, wide, 801)[1:]
            )
            for level in levels:
                point.step({}, stresses={0: mean + level})
        ends.append(point.state.inelastic[0, 0])
    limit, high, low = modulus / recall, mean + wide - strength, mean - wide + strength
    up = np.log((limit - low) / (limit - high)) / recall
    down = np.log((limit + high) / (limit + low)) / recall
    assert ends[2] - ends[1] == pytest.approx(up - down, rel=0.02)


def test_creep_and_relaxation_by_their_curves():
    """Primary creep, which has no error of time steps, in unequal ones, and Norton's at a constant
    strain.
    """
    primary = Point(LAWS["primary"])
    for dt in (1.0, 9.0, 90.0):
        primary.step({}, dt, {0: 200.0})
    assert primary.state.inelastic[0, 0] == pytest.approx((200 / 400) ** 5 * 100**0.3, rel=1e-8)
    relaxed = Point(LAWS["Norton"])
    relaxed.step({0: 300 / YOUNG}, 1e-12)
    for _ in range(2000):
        stress = relaxed.step({0: 300 / YOUNG}, 1e-4)[0]
    exact = (300.0**-7 + 7 * YOUNG * 0.2 / 400.0**8) ** (-1 / 7)  # of dσ/dt = -E (σ / K)^8
    assert stress == pytest.approx(exact, rel=1e-3)  # implicit Euler in 2000 steps


@pytest.mark.parametrize(
    ("exponent", "time_exponent"), [(5.0, 0.2), (10.0, 0.3), (1.0, 0.04), (1.0, 1.0)]
)
def test_primary_creep_answers_at_stresses_of_round_off(exponent, time_exponent):
    """p^(1/m) = p_old^(1/m) + (q/K)^(n/m) dt, in forty decimal digits, where such powers are no
    doubles any more.
    """
    m = Decimal(time_exponent)
    with localcontext() as context:
        context.prec = 40
        for trial in (1e-14, 1e-9, 1e-3):
            for held in (0.0, 1e-6):
                point = Point(hhr.PrimaryCreep(400.0, exponent, time_exponent))
                point.state = point.state._replace(cumulated=np.array([held]))
                found = point.after(np.array([2.0, -1.0, -1.0, 0, 0, 0]) * trial / 6 / SHEAR)
                left = found.stress[0, 0] - found.stress[0, 1]
                grown = (Decimal(left) / 400) ** (Decimal(exponent) / m) + Decimal(held) ** (1 / m)
                flow = float(grown**m - Decimal(held))
                assert left + 3 * SHEAR * flow == pytest.approx(trial, rel=1e-8)
                assert np.isfinite(found.tangents).all()


def test_plasticity_with_creep_yields_above_and_creeps_below():
    point = Point(LAWS["plasticity with creep"])
    assert point.step({0: 0.01}, 1e-9)[0] == pytest.approx(
        250 + 2000 * point.state.inelastic[0, 0], rel=1e-6
    )
    yielded = point.state.memory[0, 0]
    point.step({}, 10.0, {0: 200.0})
    assert point.state.memory[0, 0] == pytest.approx(yielded, rel=1e-12)
    assert point.state.cumulated[0] - yielded == pytest.approx(10 * (200 / 400) ** 8, rel=1e-6)


def test_drucker_prager_in_triaxial_compression_and_at_its_tip():
    """Axial stress under a pressure by √(s:s/2) + η σ_m = k.

    A pull in all directions ends in the tip, σ_m = k / η.
    """
    law, pressure = hhr.DruckerPrager(100.0, 0.3, 0.1), 50.0
    point = Point(law)
    point.step({}, stresses=dict.fromkeys(range(3), -pressure))
    for strain in np.linspace(-0.001, -0.01, 10):
        stress = point.step({0: strain}, stresses={1: -pressure, 2: -pressure})
    # with q = p - σ_1, √(s:s/2) = q / √3 and σ_m = -p - q/3
    assert -pressure - stress[0] == pytest.approx(
        (100 + 0.3 * pressure) / (1 / np.sqrt(3) - 0.1), rel=1e-9
    )
    # dilatancy: tr(Δεp) = ψ Δλ, and the axial part -Δλ/√3 + ψ/3 Δλ
    plastic = point.state.inelastic[0]
    assert plastic[:3].sum() / plastic[0] == pytest.approx(
        0.1 / (0.1 / 3 - 1 / np.sqrt(3)), rel=1e-9
    )
    tip = Point(law).after([0.01, 0.011, 0.012, 0, 0, 0]).stress[0]
    assert tip == pytest.approx([100 / 0.3] * 3 + [0] * 3, abs=1e-9)


def test_drucker_prager_refuses_to_create_energy():
    """Dilatancy above friction: Δεp:σ = Δλ (k + (ψ - η) σ_m) < 0 under a large pressure.

    Of formulas in a step.
    """
    with pytest.raises(
        SceneError, match=r"dilatancy 0.3 of DruckerPrager is above its friction 0.1"
    ):
        hhr.DruckerPrager(100.0, 0.1, 0.3)
    formula = program_of(hhr.DruckerPrager(100.0, "f", 0.3), 6)
    strain = np.array([[0.01, 0, 0, 0, 0, 0]])
    refused, held = (formula.with_numbers({"friction": friction}) for friction in (0.1, 0.4))
    with pytest.raises(
        ConvergenceError, match="dilatancy is above its friction, so that flow would create energy"
    ):
        refused.update(strain, at_rest(refused), 1.0, refused.given(YOUNG, POISSON), tangent=False)
    same = Point(hhr.DruckerPrager(100.0, 0.4, 0.3)).after(strain[0]).stress
    there = held.update(strain, at_rest(held), 1.0, held.given(YOUNG, POISSON), tangent=False)
    assert there.stress == pytest.approx(same, rel=1e-12)


def test_drucker_prager_in_plane_stress_without_hardening_says_what_helps():
    """At the tip nothing resists a strain across.

    With the hardening that is advised the stress is on the cone.
    """
    strain = [0.0207, -0.00213, 0, 0.00629]
    with pytest.raises(
        ConvergenceError, match=r"in plane stress have no slope .* a little hardening"
    ):
        Point(hhr.DruckerPrager(100.0, 0.3, 0.1), 4, plane_stress=True).after(strain)
    found = Point(hhr.DruckerPrager(100.0, 0.3, 0.1, 1e-3), 4, plane_stress=True).after(strain)
    mean = found.stress[0, :3].sum() / 3
    shear = found.stress[0] - mean * np.array([1, 1, 1, 0])
    assert np.sqrt(shear @ shear / 2) + 0.3 * mean == pytest.approx(
        100 + 1e-3 * found.state.cumulated[0], rel=1e-9
    )


def test_hill_yields_along_each_axis_of_its_frame():
    """σ_i = σ0 / √(G + H), √(F + H), √(F + G) along the axes; √(2 N) for shear.

    Equal constants are von Mises'.
    """
    f, g, h, n = 0.6, 0.4, 0.5, 1.4
    law = hhr.Hill(250.0, 0.0, f, g, h, 1.5, 1.6, n)
    for axis, total in ((0, g + h), (1, f + h), (2, f + g)):
        assert Point(law).step({axis: 0.01})[axis] == pytest.approx(250 / np.sqrt(total), rel=1e-9)
    assert Point(law).step({3: 0.01})[3] / np.sqrt(2) == pytest.approx(
        250 / np.sqrt(2 * n), rel=1e-9
    )
    turned = hhr.Hill(
        250.0, 0.0, f, g, h, 1.5, 1.6, n, ((0.0, 1.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    )
    assert Point(turned).step({1: 0.01})[1] == pytest.approx(250 / np.sqrt(g + h), rel=1e-9)
    strain = np.random.default_rng(0).normal(size=6) * 5e-3
    plain, same = (
        Point(law).after(strain)
        for law in (LAWS["linear"], hhr.Hill(250.0, 2000.0, *[0.5] * 3, *[1.5] * 3))
    )
    assert same.stress == pytest.approx(plain.stress, rel=1e-10)
    assert same.tangents == pytest.approx(plain.tangents, abs=1e-9 * YOUNG)


def test_orthotropic_elasticity_by_its_compliance():
    point = Point(hhr.Orthotropic(*WOOD))
    assert point.step({0: 1e-3})[0] == pytest.approx(12.0, rel=1e-12)
    assert point.strain[:3] == pytest.approx([1e-3, -0.4e-3, -0.4e-3], rel=1e-12)
    assert Point(hhr.Orthotropic(*WOOD)).step({3: 1e-3})[3] == pytest.approx(
        2 * 700 * 1e-3, rel=1e-12
    )
    isotropic = hhr.Orthotropic.transverse(YOUNG, YOUNG, POISSON, POISSON, SHEAR)
    strain = np.random.default_rng(0).normal(size=6)
    assert Point(isotropic).after(strain).stress[0] == pytest.approx(
        Point(LAWS["linear"]).given.elastic @ strain
    )
    around = Point(LAWS["orthotropic"]).given.elastic
    assert around == pytest.approx(around.T, rel=1e-9) and np.linalg.eigvalsh(around).min() > 0


def test_damage_grows_as_lemaitre_says_and_softening_is_refused():
    """Uniaxial: σ = (1 - D) (σ0 + H r), and the law is refused where that has its maximum."""
    point, last = Point(LAWS["Lemaitre"]), 0.0
    with pytest.raises(
        ConvergenceError, match=r"Lemaitre has no answer .* its stress falls as strain grows"
    ):
        for strain in np.linspace(0, 0.5, 5001)[1:]:
            last = point.step({0: strain})[0]
    plastic, damage, hardened = point.state.memory[0, :6], *point.state.memory[0, 6:]
    assert last == pytest.approx((1 - damage) * (250 + 20e3 * hardened), rel=1e-9)
    assert plastic[0] == pytest.approx(point.state.cumulated[0], rel=1e-9)
    rising = 20e3 * (1 - damage) ** 2 - (250 + 20e3 * hardened) ** 3 / (2 * YOUNG * 5)
    assert abs(rising) < 0.01 * 20e3 and 0.05 < damage < 0.5


def test_heat_strains_without_stress_and_is_not_taken_for_flow():
    """Free, the body grows by α ΔT; held along one axis it yields as without heat under that
    strain.
    """
    point = Point(LAWS["heated"])
    assert np.abs(point.step({}, stresses={})).max() < 1e-9
    assert point.strain == pytest.approx([2.8e-3] * 3 + [0] * 3)
    held, plain = Point(LAWS["heated"]), Point(LAWS["Armstrong-Frederick"])
    for strain in (0.0, 5e-4, -1e-3):
        assert held.step({0: strain}) == pytest.approx(plain.step({0: strain - 2.8e-3}), abs=1e-6)


def test_a_stiffness_that_changes_keeps_the_plastic_strain():
    """Held where it yielded and softened by heat, the body has E (ε - εp), and yields again at its
    hardening.
    """
    point, plain = (
        Point(hhr.ChangingStiffness(LAWS["linear"], 200e3)),
        Point(LAWS["linear"], young=200e3),
    )
    loaded = point.step({0: 3e-3})[0]
    assert loaded == pytest.approx(plain.step({0: 3e-3})[0], rel=1e-10)
    point.given = point.program.with_numbers({"modulus": 100e3}).given(YOUNG, POISSON)
    assert point.step({0: 3e-3})[0] == pytest.approx(loaded / 2, rel=1e-9)
    assert point.step({0: 1e-2})[0] == pytest.approx(
        (250 + 2000 * 1e-2) / (1 + 2000 / 100e3), rel=1e-9
    )
    with pytest.raises(
        SceneError, match=r"modulus = -1\.0 of ChangingStiffness must be a number above 0"
    ):
        hhr.ChangingStiffness(None, -1.0)
    with pytest.raises(SceneError, match="whose moduli are constant numbers"):
        hhr.ChangingStiffness(LAWS["orthotropic"], 1e5)
    with pytest.raises(SceneError, match="negative energies"):
        hhr.Orthotropic(1.0, 1.0, 1.0, 0.9, 0.9, 0.9, 1.0, 1.0, 1.0)


def test_a_memory_that_is_no_number_is_no_answer():
    class Lost(Law):
        memory: ClassVar = {"kept": NUMBER}

        def constants(self):
            return {}

        def statement(self, at):
            return forms.Stated(
                forms.hooke(at.strain, at.constants), {"kept": ufl.ln(at.strain[0])}
            )

    point = Point(Lost())
    assert point.after([1e-3, 0, 0, 0, 0, 0]).state.memory[0, 0] == pytest.approx(np.log(1e-3))
    with pytest.raises(ConvergenceError, match="Lost has no answer"):
        point.after([-1e-3, 0, 0, 0, 0, 0])


@pytest.mark.parametrize("name", ["Arrhenius", "heated", "orthotropic", None])
def test_heat_around_a_law_that_has_a_temperature_too_keeps_both(name):
    """Held, the stress is that of the law at the strain without heat; names of the law are its
    own.
    """
    inner = LAWS[name] if name else hhr.Plasticity(1e9)
    law = hhr.Heated(LAWS[name] if name else None, 2e-5, 150.0, 50.0)
    assert len(law.constants()) == len(inner.constants() if name else {}) + 3
    held, plain = Point(law), Point(inner)
    shift = 2e-3 * np.array([1, 1, 1, 0, 0, 0])
    for strain in (
        np.zeros(6),
        np.array([1e-3, -5e-4, 0, 8e-4, 0, 0]),
        np.array([-1e-3, 5e-4, 0, 8e-4, 0, 0]),
    ):
        one, other = held.after(strain, 1e-2), plain.after(strain - shift, 1e-2)
        assert one.stress == pytest.approx(other.stress, rel=1e-9, abs=1e-7)
        assert one.state.cumulated == pytest.approx(other.state.cumulated, rel=1e-9)
        held.state, plain.state = one.state, other.state


@pytest.mark.parametrize("name", ["Hill", "orthotropic"])
def test_frames_in_the_plane_turn_about_its_normal(name):
    """Those that do not are refused there, and are right in space."""
    tilted = ((1.0, 0.0, 0.0), (0.0, 0.6, 0.8), (0.0, -0.8, 0.6))
    with pytest.raises(SceneError, match=r"its third vector must be \(0, 0, 1\)"):
        program_of(replace(LAWS[name], frame=tilted), 4)
    plane, solid = Point(LAWS[name], 4), Point(LAWS[name], 6)
    strain = np.array([0.01, -0.004, 0.001, 0.005])
    assert plane.after(strain).stress[0] == pytest.approx(
        solid.after([*strain, 0, 0]).stress[0, :4], rel=1e-9
    )


@pytest.mark.parametrize("name", [name for name in LAWS if not LAWS[name].elastic])
def test_plane_stress_at_rest_and_where_nothing_flows(name):
    """Quotients of a deviator that is zero are not in the way, nor a limit that holds where a body
    flows.
    """
    point = Point(LAWS[name], 4, plane_stress=True)
    shift = 2.8e-3 if name == "heated" else 0.0
    stiff = 150e3 if name == "stiffness" else YOUNG
    for strain in (0.0, 1e-6):
        found = point.after(np.array([shift + strain, shift + strain, 0.0, 0.0]), 1e-9)
        assert found.stress[0, :2] == pytest.approx(stiff / (1 - POISSON) * strain, abs=1e-6)
        assert np.isfinite(found.tangents).all() and found.tangents[0, 0, 0] > 0


@pytest.mark.parametrize("name", ["linear", "Voce", "Chaboche", "Norton", "Drucker-Prager"])
def test_plane_stress_by_one_more_unknown(name):
    """As the point in space of which the strain across is found from outside."""
    plane, solid = Point(LAWS[name], 4, plane_stress=True), Point(LAWS[name])
    for strains in ((2e-3, -1e-3, 1e-3), (4e-3, 1e-3, -2e-3), (1e-3, 3e-3, 1e-3)):
        there = dict(zip((0, 1, 3), strains, strict=True))
        found = plane.step(there | {2: 0.0})
        assert found == pytest.approx(solid.step(there | {4: 0.0, 5: 0.0})[:4], abs=1e-7)


def test_sudden_heat_in_plane_stress_has_an_answer():
    """Swelling ten times the strain to yield, in one step from rest: that of the law alone without
    it.
    """
    strain = np.random.default_rng(0).normal(size=(100, 4)) * [1e-3, 1e-3, 0, 1e-3]
    for name in ("Voce", "table", "Chaboche", "Hill", "Lemaitre"):
        hot, cold = (
            program_of(law, 4, plane_stress=True)
            for law in (hhr.Heated(LAWS[name], 1.0, 6e-3), LAWS[name])
        )
        found, other = (
            law.update(
                moved, at_rest(law, 100), 1.0, law.given(YOUNG, POISSON), tangent=False
            ).stress
            for law, moved in ((hot, strain), (cold, strain - [6e-3, 6e-3, 0, 0]))
        )
        assert found == pytest.approx(other, rel=1e-9, abs=1e-9)


class Standard(Law):
    """Voce's hardening, or a back stress, as a generalised standard material of potentials."""

    def __init__(self, back):
        self.back = back
        self.memory = {"back": TENSOR} if back else {}
        self.unknowns = {"inelastic": TENSOR, "cumulated": NUMBER, **self.memory}

    def constants(self):
        return {"s0": 200.0, "q": 100.0, "b": 10.0, "modulus": 60e3, "recall": 600.0}

    def statement(self, at):
        c = at.constants
        lam, mu = forms.lame(c)

        def energy(strain, state):
            rest, p = strain - state["inelastic"], state["cumulated"]
            found = (
                lam / 2 * forms.trace(rest) ** 2
                + mu * ufl.dot(rest, rest)
                + c.q * (p + ufl.exp(-c.b * p) / c.b)
            )
            return (
                found + c.modulus / 3 * ufl.dot(state["back"], state["back"])
                if self.back
                else found
            )

        def driving(force):
            return forms.deviator(
                force["inelastic"] + force["back"] if self.back else force["inelastic"]
            )

        def yields(force, state):
            return forms.equivalent(driving(force)) + force["cumulated"] - c.s0

        def flow(force, state):
            way = 1.5 * driving(force) / forms.equivalent(driving(force))
            return {"back": way - c.recall * state["back"]} if self.back else {}

        return forms.standard(at, energy, yields, flow)


@pytest.mark.parametrize("back", [False, True])
def test_a_standard_material_of_potentials_is_the_law_of_one_unknown(back):
    law = hhr.Chaboche(200.0, ((60e3, 600.0),) if back else (), 100.0, 10.0)
    one, other = Point(law), Point(Standard(back))
    for strain in np.cumsum(np.random.default_rng(3).normal(size=(12, 6)) * 1.5e-3, axis=0):
        found, same = one.after(strain), other.after(strain)
        assert same.stress == pytest.approx(found.stress, rel=1e-8, abs=1e-6)
        assert same.tangents == pytest.approx(found.tangents, abs=1e-6 * YOUNG)
        one.state, other.state = found.state, same.state


def test_a_law_of_ones_own_answers_by_its_equation():
    """Bingham's, against the root of its equation."""
    point, law = Point(Bingham(250.0, 1e4)), Bingham(250.0, 1e4)
    stress = point.step({0: 0.01}, 0.1)[0]
    plastic = point.state.inelastic[0, 0]
    root = brentq(lambda flow: law.viscosity * flow / 0.1 - (YOUNG * (0.01 - flow) - 250), 0, 0.01)
    assert plastic == pytest.approx(root, rel=1e-9) and stress == pytest.approx(
        YOUNG * (0.01 - root), rel=1e-9
    )


def test_the_laws_of_the_page_keep_the_contract():
    """Examples of docs/laws.md, as they are printed.

    One creeps by the sum of both rates, one is Chaboche's law.
    """
    text = (Path(__file__).parents[3] / "docs" / "laws.md").read_text()
    names = {"__name__": "laws_of_the_page"}
    exec("\n".join(re.findall(r"```python\n(.*?)```", text, re.DOTALL)), names)
    point = Point(names["CeramicCreep"](1e-9, 1e-18, 5.0))
    point.step({}, 1e-9, {0: 100.0})
    point.step({}, 10.0, {0: 100.0})
    assert point.state.inelastic[0, 0] == pytest.approx(
        10 * (1e-9 * 100 + 1e-18 * 100**5), rel=1e-9
    )
    one, other = Point(names["Prager"](200.0, 20e3)), Point(hhr.Chaboche(200.0, ((20e3, 0.0),)))
    for strain in np.cumsum(np.random.default_rng(3).normal(size=(8, 6)) * 2e-3, axis=0):
        found, same = one.after(strain, tangent=False), other.after(strain, tangent=False)
        assert found.stress == pytest.approx(same.stress, rel=1e-8, abs=1e-6)
        one.state, other.state = found.state, same.state
    assert other.state.cumulated[0] > 0.01


def test_laws_are_data_that_need_neither_ufl_nor_dolfinx(tmp_path):
    """A reader makes the same law of numbers, in a process in which both are out of reach."""
    tree, arrays = as_plain(program_of(LAWS["Chaboche"], 6))
    assert sum(array.nbytes for array in arrays.values()) < 60e3
    script = (
        "import sys; sys.modules.update(dict.fromkeys(('ufl', 'dolfinx', 'basix', 'petsc4py', "
        "'mpi4py')))\nimport json, numpy as np\nfrom hhr_dolfinx.plain import restored\nfrom "
        "hhr_dolfinx.plugins.inelastic.law import LawProgram\nfrom "
        "hhr_dolfinx.plugins.inelastic.law import InternalVariables as State\nfrom "
        "hhr_dolfinx.plugins.ufl_programs.program import Program\n"
        "with np.load(sys.argv[1]) as found:\n"
        "    arrays = {name.replace('|', '/'): found[name] for name in found}\nlaw = "
        "restored(json.loads(sys.argv[2]), arrays, {'LawProgram': LawProgram, 'Program': "
        "Program})\nrest = State(np.zeros((1, 6)), np.zeros(1), np.zeros((1, 12)))\nstrain = "
        "np.array([[4e-3, -1e-3, 0, 1e-3, 0, 0]])\nprint(repr(law.update(strain, rest, 1.0, "
        "law.given(210e3, 0.3), tangent=False).stress.tolist()))\n"
    )
    path = tmp_path / "law.npz"
    np.savez(path, **{name.replace("/", "|"): array for name, array in arrays.items()})
    told = subprocess.run(
        [sys.executable, "-c", script, path, json.dumps(tree)], capture_output=True, text=True
    )
    assert told.returncode == 0, told.stderr
    here = Point(LAWS["Chaboche"]).after([4e-3, -1e-3, 0, 1e-3, 0, 0], tangent=False).stress
    assert json.loads(told.stdout) == here.tolist()


@dataclass(frozen=True)
class Wrong(Law):
    """A law with a mistake."""

    mistake: str
    modulus: float = 1.0
    memory: ClassVar = {"damage": NUMBER}
    unknowns: ClassVar = {"amount": NUMBER}

    def statement(self, at):
        kept = {"damage": at.old.damage}
        stress = forms.hooke(at.strain, at.constants)
        return {
            "stress": lambda: forms.Stated(stress[0], kept, [at.unknown.amount]),
            "memory": lambda: forms.Stated(stress, {"damaged": at.old.damage}, [at.unknown.amount]),
            "residual": lambda: forms.Stated(stress, kept),
            "none": lambda: None,
            "undeclared": lambda: forms.Stated(
                stress * at.constants.strength, kept, [at.unknown.amount]
            ),
            "number": lambda: forms.Stated(
                math.sqrt(at.constants.modulus + 1) * stress, kept, [at.unknown.amount]
            ),
            "start": lambda: forms.Stated(stress, kept, [at.unknown.amount], start={"amnt": 1.0}),
            "limit": lambda: forms.Stated(stress, kept, [at.unknown.amount], limit=at.dt),
            "memory size": lambda: forms.Stated(stress, {"damage": at.strain}, [at.unknown.amount]),
            "list": lambda: forms.Stated([*stress], kept, [at.unknown.amount]),
            "alone": lambda: forms.Stated(stress, kept, at.unknown.amount),
            "key": lambda: {}["plastic"],
            "operation": lambda: forms.Stated(
                ufl.bessel_J(1, at.strain[0]) * stress, kept, [at.unknown.amount]
            ),
        }[self.mistake]()


@pytest.mark.parametrize(
    ("mistake", "said"),
    [
        ("stress", "a stress of 1 components for 6"),
        ("memory", r"returns the memory \['damaged'\]"),
        ("residual", "1 unknowns and 0 residuals"),
        ("none", "returns None: return a Stated"),
        (
            "undeclared",
            (
                r"no attribute 'strength'. Its constants are \['modulus'\], fields that are "
                "declared float"
            ),
        ),
        ("number", "State it by functions of UFL"),
        ("start", r"'amnt', and has the unknowns \['amount'\]"),
        ("limit", "a limit without a reason"),
        ("memory size", "damage with 1 components, and returns 6"),
        ("list", "a list is no expression of UFL: ufl.as_vector"),
        ("alone", "residual of Wrong must be a list"),
        ("key", r"fails: 'plastic'. Its constants are \['modulus'\]"),
        ("operation", "BesselJ is no operation of a program"),
    ],
)
def test_a_law_with_a_mistake_is_refused_by_name(mistake, said):
    with pytest.raises(SceneError, match=said):
        program_of(Wrong(mistake), 6)


@pytest.mark.parametrize(
    ("kind", "values"),
    [
        (hhr.Plasticity, ("2 +",)),
        (hhr.Plasticity, (1.0, "open('x')")),
        (hhr.Norton, ("", 2.0)),
        (hhr.Plasticity, ("sy", -1.0)),
        (hhr.Norton, ("K", 0.5)),
        (hhr.Norton, ("K", None)),
        (hhr.Plasticity, ([80],)),
        (hhr.Plasticity, (80.0, None)),
        (hhr.Plasticity, (0.0,)),
        (hhr.Norton, (0.0, 4.0)),
        (hhr.Norton, (np.nan, 4.0)),
        (hhr.DruckerPrager, (1.0, 30.0, 0.1)),
        (hhr.Chaboche, (200.0, ((1e3, -1.0),))),
        (hhr.TabulatedHardening, (((0, 250.0), (0.1, 240.0)),)),
        (hhr.Hill, (250.0, 0.0, *[0.5] * 3, *[1.5] * 3, ((1, 0, 0), (1, 1, 0), (0, 0, 1)))),
        (hhr.Hill, (250.0, 0.0, *[0.5] * 3, *[1.5] * 3, None)),
        (hhr.Hill, (250.0, 0.0, 0.0, *[0.5] * 2, *[1.5] * 3)),
        (hhr.TabulatedHardening, ((0.0, 2.0),)),
        (hhr.TabulatedHardening, (((0.0, 1.0), (np.inf, 2.0)),)),
        (hhr.Chaboche, (2.0, ((60.0,),))),
        (hhr.Chaboche, (2.0, None)),
        (hhr.Heated, ("Plasticity", 1e-5, 300.0)),
    ],
)
def test_constants_outside_their_limits_are_refused_where_they_are_written(kind, values):
    with pytest.raises(
        SceneError, match=r"formula|must (be|hold)|does not fall|orthogonal|needs pairs|is no law"
    ):
        kind(*values)


def test_names_that_each_law_has_and_limits_of_others_are_refused():
    with pytest.raises(SceneError, match="has a field 'name': give it another name"):
        type("Named", (Law,), {"__annotations__": {"name": "float"}})
    limited = dataclass(frozen=True)(
        type("Limited", (Law,), {"__annotations__": {"y": "float"}, "limits": {"yy": (0, 1)}})
    )
    with pytest.raises(SceneError, match=r"limits 'yy', and has the constants \['y'\]"):
        limited(1.0)


def test_a_step_without_an_answer_is_said_and_not_a_strain_that_is_no_number():
    """An infinite strain is the fault of an iterate; the caller refuses it."""
    program = program_of(LAWS["Norton"], 6)
    given = program.given(YOUNG, POISSON)
    with pytest.raises(
        ConvergenceError, match=r"Norton has no answer at 1 points, such as for the strain"
    ):
        program.update(
            np.full((1, 6), 1e-3) * [1, 0, 0, 0, 0, 0],
            at_rest(program),
            np.inf,
            given,
            tangent=False,
        )
    program.update(np.full((1, 6), np.nan), at_rest(program), 1.0, given, tangent=False)


@pytest.mark.parametrize("indices", [[[0, 1], [1, 2]], [[0, 1], [3]], [[-1, 0]], [[1, 2]]])
def test_groups_that_do_not_hold_each_gauss_point_once_are_refused(indices):
    with pytest.raises(SceneError, match=r"each of its Gauss points 0 .. . once"):
        Material([Group(np.array(part), YOUNG, POISSON, None) for part in indices], 4)


@pytest.mark.parametrize(
    ("young", "poisson"), [(0.0, 0.3), (np.inf, 0.3), (np.nan, 0.3), (1.0, 0.5), (1.0, np.nan)]
)
def test_constants_without_energy_are_refused(young, poisson):
    with pytest.raises(SceneError, match=r"must be positive and finite, and poisson"):
        Material([Group(np.arange(2), young, poisson, None)], 4)


def test_the_material_of_some_gauss_points_answers_as_the_whole_does():
    """With laws of different memory beside each other."""
    rng = np.random.default_rng(8)
    laws = [program_of(LAWS[name], 4) for name in ("linear", "Chaboche", "Norton")] + [None]
    whole = Material(
        [Group(np.arange(k, 60, 4), YOUNG, POISSON, law) for k, law in enumerate(laws)], 4
    )
    strain = rng.normal(size=(60, 4)) * 3e-3
    old = whole.update(strain / 2, whole.at_rest(), 0.1, tangent=False).state
    kept = np.sort(rng.choice(60, 17, replace=False))
    part = whole.restricted(kept).update(
        strain[kept], InternalVariables(*(item[kept] for item in old)), 0.1, tangent=True
    )
    everywhere = whole.update(strain, old, 0.1, tangent=True)
    assert np.array_equal(part.tangents, everywhere.tangents[kept])
    assert np.array_equal(part.state.memory, everywhere.state.memory[kept])
    assert everywhere.state.memory[1::4].any() and not everywhere.state.memory[::4].any()
