"""Heat of surfaces that slide: closed forms, a coupled full model, speeds without a balance."""

import copy
import dataclasses
import pickle

import numpy as np
import pytest
from heated_pairs import Coupled, blocks, conducted, heat, rod_scene
from scipy.optimize import brentq

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import ConvergenceError, SceneError, StabilityWarning
from hhr_dolfinx.geometries.two_blocks import FIRST, SECOND, side

BOX = hhr.ParameterSpace(("push", "T", "v"), (-0.01, -200.0, -1e3), (0.01, 200.0, 2e4))
FAST = hhr.ParameterSpace(BOX.names, BOX.lower, (0.01, 200.0, 1e6))
FIXED = (
    hhr.FixedTemperature(side(FIRST, 1, False), 0.0),
    hhr.FixedTemperature(side(SECOND, 1, True), "T"),
)


def rubbing_rods(share=0.7, speed="v", build=hhr.condense_heat, box=BOX, **more):
    """Rods of the modulus 200 and 100, the length 1 and no lateral strain."""
    given = {
        "conductivity": {FIRST: 20.0, SECOND: 50.0},
        "conductance": {0: 3.0},
        "expansion": {FIRST: 2e-5, SECOND: 1e-5},
        "temperatures": FIXED,
        "sliding": {0: hhr.SlidingHeat(0.3, speed, share)},
    }
    return build(rod_scene(parameters=box), hhr.Heat(**given | more))


def equations_of_rods(speed, share):
    """Of the pressure, the heat flow to the second rod, and temperatures of both surfaces."""
    made = 0.3 * abs(speed)
    return [
        [1 / 200 + 1 / 100, 0, -2e-5 / 2, -1e-5 / 2],  # p / E = push + mean expansion
        [-share * made, 1, 20, 0],  # what the first surface takes leaves at the bottom
        [made * (1 - share), 1, 0, -50],
        [0, 1, -3, 3],  # through the contact
    ]


def balance_of_rods(push, warm, speed, share):
    """Solution of these equations."""
    right = [push + 1e-5 / 2 * warm, 0, -50 * warm, 0]
    return np.linalg.solve(equations_of_rods(speed, share), right)


@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("speed", [0.0, 500.0, -500.0, 2e4])
def test_rods_that_rub(share, speed):
    answer = rubbing_rods(share).solve({"push": 0.005, "T": 50.0, "v": speed})
    pressure, flow, first, second = balance_of_rods(0.005, 50.0, speed, share)
    assert answer.outputs()["peak"] == pytest.approx(pressure, rel=1e-10)
    assert answer.outputs()["heat 0"] == pytest.approx(flow, rel=1e-10)
    assert answer.outputs()["friction heat 0"] == pytest.approx(
        0.3 * abs(speed) * pressure, rel=1e-10
    )
    assert answer.temperature().max() == pytest.approx(max(first, second, 50.0), rel=1e-10)
    np.testing.assert_allclose(answer.jump, first - second, rtol=1e-9)
    assert not answer.several


def critical_speed():
    """Where pressures grow without bounds, 142,353."""
    return brentq(lambda v: np.linalg.det(equations_of_rods(v, 0.7)), 0.0, 1e6, rtol=1e-14)


def test_there_is_no_balance_above_the_critical_speed_of_pressed_rods():
    """Heat expands rods by more than their pressure compresses them; below it a pressure grows
    without bounds. Rods apart have two: apart, and hot (Barber, Proc. R. Soc. A 312, 1969).
    """
    model = rubbing_rods(box=FAST)
    critical = critical_speed()
    near = model.solve({"push": 0.005, "T": 0.0, "v": 0.999 * critical})
    still = model.solve({"push": 0.005, "T": 0.0, "v": 0.0})
    assert near.outputs()["peak"] == pytest.approx(1000 * still.outputs()["peak"], rel=1e-6)
    with pytest.raises(ConvergenceError, match="find no balance"):
        model.solve({"push": 0.005, "T": 0.0, "v": 1.001 * critical})
    apart = {"push": -0.005, "T": 0.0, "v": 2 * critical}
    with pytest.warns(StabilityWarning, match="several balances"):
        assert not model.solve(apart).forces().any()
    cold, hot = model.balances(apart)
    expected = balance_of_rods(-0.005, 0.0, 2 * critical, 0.7)[0]
    assert not cold.forces().any() and hot.outputs()["peak"] == pytest.approx(expected, rel=1e-9)


OMEGA = 1e3


def rubbing(hypothesis):
    """The two blocks, whose upper one turns: at the same speed all over in the plane, about the
    axis by the radius.
    """
    place = "x" if hypothesis == "plane_strain" else "r"
    return heat(sliding={0: hhr.SlidingHeat("0.2 + T / 1e3", f"{OMEGA} * {place}", 0.8)})


class Rubbing(Coupled):
    """The coupled full model with this heat."""

    def _settled(self, push, warm, stored, before, rounds=400):
        m = len(self.pairs)
        forces, gaps = np.zeros(m), self.gaps.copy()
        factor = (0.2 + warm / 1e3) * OMEGA * self.points[self.pairs[:, 0], 0]
        for _ in range(rounds):
            h = self.areas * conducted(np.maximum(forces, 0) / self.areas, np.maximum(gaps, 0))
            made = np.zeros(len(self.points))
            np.add.at(made, self.pairs[:, 0], 0.8 * factor * forces)
            np.add.at(made, self.pairs[:, 1], 0.2 * factor * forces)
            temperature, flows = self._heated(h, warm, stored, before + made)
            new, gaps = self._touching(temperature - 10.0, push)
            if np.abs(new - forces).max() <= 1e-14 * np.abs(new).max():
                return new, flows, temperature
            forces = (forces + new) / 2
        raise AssertionError("the reference does not settle")


@pytest.mark.filterwarnings("ignore:parameters")  # of the mesh alone, without heat
@pytest.mark.parametrize("hypothesis", ["plane_strain", "axisymmetric"])
def test_answers_are_those_of_a_coupled_full_model(hypothesis):
    """Steady, and in implicit steps with all modes; forces and flows sorted along the contact."""
    scene = blocks(hypothesis)
    model = hhr.condense_heat(scene, rubbing(hypothesis))
    full = hhr.FullOrderModel(blocks(hypothesis))
    reference = Rubbing(full.problem, hypothesis)
    ours = np.argsort(full.problem.contact_points[:, 0])
    theirs = np.argsort(reference.points[reference.pairs[:, 0], 0])

    def beside(answer, found):
        forces, flows, temperature = found
        for one, other in ((answer.forces()[ours], forces), (answer.heat[ours], flows)):
            other = other[theirs]
            np.testing.assert_allclose(one, other, rtol=0, atol=1e-9 * np.abs(other).max())
        np.testing.assert_allclose(
            answer.temperature(), temperature, rtol=0, atol=1e-9 * temperature.max()
        )
        assert answer.friction_heat.sum() > 0.05 * np.abs(flows).sum()

    for push, warm in ((0.002, 20.0), (0.006, 150.0)):
        beside(model.solve({"push": push, "T": warm}), reference.solve(push, warm))
    times = [0.01, 0.02, 0.1]
    points = [(0.002, 20.0), (0.006, 150.0), (0.003, 60.0)]
    transient = hhr.condense_transient_heat(scene, rubbing(hypothesis), tolerance=0)
    expected = reference.march(*zip(*points, strict=True), times, 15.0)
    for answer, found in zip(transient.march(points, times, 15.0), expected, strict=True):
        beside(answer, found)


@pytest.mark.filterwarnings("ignore:parameters")
def test_few_modes_are_near_all():
    """1e-4 of what steps change, which are 135 degrees at most."""
    every, few = (
        hhr.condense_transient_heat(blocks(), rubbing("plane_strain"), tolerance)
        for tolerance in (0, 1e-4)
    )
    steps = {"push": 0.006, "T": 150.0}, [0.003, 0.01, 0.03, 0.1], 15.0
    for one, other in zip(every.march(*steps), few.march(*steps), strict=True):
        np.testing.assert_allclose(other.temperature(), one.temperature(), rtol=0, atol=135e-4)


def fed(share=0.7):
    """The second rod has no fixed temperature: friction and its source feed it."""
    return rubbing_rods(
        share,
        "v * (1 + 0 * x)",
        temperatures=FIXED[:1],
        supplies=[hhr.HeatSource(SECOND, "T")],
    )


def test_a_body_that_friction_feeds_passes_its_heat_on():
    answer = fed(0.25).solve({"push": 0.005, "T": 30.0, "v": 300.0})
    outputs = answer.outputs()
    made = 0.3 * 300.0 * outputs["peak"]
    assert outputs["heat 0"] == pytest.approx(-30.0 - 0.75 * made, rel=1e-10)
    first = (30.0 + made) / 20
    second = first + (30.0 + 0.75 * made) / 3
    # from the surface up its rise is 30 / 50 (y - y^2 / 2), which is exact at the ends of 4 cells
    places = np.linspace(0.0, 1.0, 5)
    rise = np.trapezoid(30.0 / 50 * (places - places**2 / 2), places)
    expansion = 2e-5 * first / 2 + 1e-5 * (second + rise)
    assert outputs["peak"] * (1 / 200 + 1 / 100) == pytest.approx(0.005 + expansion, rel=1e-9)


@pytest.mark.parametrize("build", [rubbing_rods, fed])
def test_gradients_are_those_of_differences(build):
    model = build()
    point = np.array([0.005, 60.0, 400.0])
    gradient = model.outputs(point, gradient=True).gradient
    for axis, step in enumerate((1e-8, 1e-4, 1e-2)):
        up, down = (model.outputs(point + sign * step * np.eye(3)[axis]) for sign in (1, -1))
        for name in ("peak", "heat 0", "friction heat 0"):
            slope = (up[name] - down[name]) / (2 * step)
            assert gradient[name][axis] == pytest.approx(slope, rel=2e-5), (name, axis)


def test_gradients_of_steps_are_those_of_differences():
    model = rubbing_rods(
        build=lambda *given: hhr.condense_transient_heat(*given, tolerance=0),
        capacity={FIRST: 3.0, SECOND: 2.0},
    )
    point, times = np.array([0.005, 60.0, 400.0]), [0.01, 0.02, 0.1]
    gradient = model.outputs(point, times, 5.0, gradient=True)[-1].gradient
    for axis, step in enumerate((1e-8, 1e-4, 1e-2)):
        up, down = (
            model.outputs(point + sign * step * np.eye(3)[axis], times, 5.0)[-1] for sign in (1, -1)
        )
        for name in ("peak", "heat 0", "friction heat 0"):
            slope = (up[name] - down[name]) / (2 * step)
            assert gradient[name][axis] == pytest.approx(slope, rel=2e-5), (name, axis)


def test_a_pressed_rod_above_the_critical_speed_grows_hot():
    """In time there is an answer: pressure grows, the faster the hotter it is."""
    model = rubbing_rods(
        build=hhr.condense_transient_heat,
        box=FAST,
        capacity={FIRST: 3.0, SECOND: 2.0},
    )
    times = np.linspace(0.02, 0.4, 20)
    point = {"push": 0.005, "T": 0.0, "v": 1.5 * critical_speed()}
    answers = model.march(point, times, 0.0)
    peaks = [answer.outputs()["peak"] for answer in answers]
    assert (np.diff(peaks, 2) > 0)[2:].all() and peaks[-1] > 2 * peaks[0]


def test_a_rigid_obstacle_takes_its_share_away(tmp_path):
    """A rod on a rigid floor: p / E = push + expansion by share * mu v p / k; files have it."""
    scene = rod_scene(parameters=BOX)
    floor = hhr.Obstacle(side(FIRST, 1, True), (0.0, 1.0), 1.0)
    scene = dataclasses.replace(
        scene,
        contacts=(floor,),
        displacements=(
            hhr.Displacement(side(FIRST, 1, False), 1, hhr.Amplitude(slopes={"push": 1.0})),
            *(hhr.Displacement(side(FIRST, 0, upper), 0) for upper in (False, True)),
            *hhr.Displacement.clamp(side(SECOND, 1, True), 2),
        ),
    )
    model = hhr.condense_heat(
        scene,
        hhr.Heat(
            conductivity={FIRST: 20.0, SECOND: 50.0},
            conductance={},
            expansion={FIRST: 2e-5},
            temperatures=FIXED,
            sliding={0: hhr.SlidingHeat(0.3, "v", share=0.6)},
        ),
    )
    point = {"push": 0.005, "T": 0.0, "v": 500.0}
    answer = model.solve(point)
    expected = 0.005 / (1 / 200 - 2e-5 / 2 * 0.6 * 0.3 * 500.0 / 20)
    assert answer.outputs()["peak"] == pytest.approx(expected, rel=1e-10)
    hhr.save_heat_model(tmp_path / "rod.npz", model)
    again = hhr.load_heat_model(tmp_path / "rod.npz").solve(point)
    assert again.outputs() == answer.outputs()


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ({"sliding": {1: hhr.SlidingHeat(0.3, "v")}}, "contact 1 slides"),
        ({"sliding": {0: 0.3}}, r"the sliding 0\.3 of contact 0 must be a hhr\.SlidingHeat"),
        ({"sliding": 0.3}, r"must be a mapping, such as \{1: hhr\.SlidingHeat"),
        ({"sliding": {0: hhr.SlidingHeat(-0.3, "v")}}, "of contact 0, which slides, is -"),
        (
            {"sliding": {0: hhr.SlidingHeat(0.3, "1 / (v - v)")}},
            "of contact 0, which slides, is inf",
        ),
        ({"sliding": {0: hhr.SlidingHeat(0.3, "w*x")}}, r"the speed 'w\*x' of contact 0"),
        ({"sliding": {0: hhr.SlidingHeat("0.3 + p", 1.0)}}, "neither pressure nor gap"),
        (
            {"sliding": {0: hhr.SlidingHeat("table(v, 0, 0.3, 10, 0.2)", "v")}},
            "friction or speed of contact 0, which slides, ends at",
        ),
    ],
)
def test_what_does_not_fit_is_refused(more, said):
    with pytest.raises(SceneError, match=said):
        rubbing_rods(**more)


@pytest.mark.parametrize(
    "item",
    [
        hhr.SlidingHeat("0.3 - 10 * exp(-(v - 1234.5) ** 2)", 1.0),
        hhr.SlidingHeat(0.3, "1 / (v - 1234.5)"),
    ],
)
@pytest.mark.parametrize("build", [hhr.condense_heat, hhr.condense_transient_heat])
def test_what_no_sample_sees_is_refused_by_answers(item, build):
    """Negative friction, and a speed without a value, at one place of the box."""
    model = rubbing_rods(build=build, sliding={0: item}, capacity={FIRST: 3.0, SECOND: 2.0})
    point = [0.005, 0.0, 1234.5]
    with pytest.raises(SceneError, match=r"contact 0, which slides, is .* v = 1234\.5"):
        model.solve(point) if build is hhr.condense_heat else model.march(point, [1.0], 0.0)


def test_copies_have_the_answers():
    """Also of models with a mesh, whose stress stays out."""
    model = rubbing_rods()
    for again in (copy.deepcopy(model), pickle.loads(pickle.dumps(model))):
        point = [0.005, 60.0, 400.0]
        assert again.solve(point).outputs() == model.solve(point).outputs()


def test_contacts_are_named_by_whole_numbers_of_any_kind():
    sliding = {np.int64(0): hhr.SlidingHeat(0.3, "v")}
    model = rubbing_rods(conductance={np.int64(0): 3.0}, sliding=sliding)
    assert model.solve([0.005, 0.0, 1e3]).outputs()["friction heat 0"] > 0


def test_a_share_is_a_part():
    with pytest.raises(SceneError, match=r"share 1\.5"):
        hhr.SlidingHeat(0.3, "v", 1.5)
    named = rod_scene(parameters=hhr.ParameterSpace(("push", "T", "x"), BOX.lower, BOX.upper))
    with pytest.raises(SceneError, match="'x', which speeds take for a coordinate"):
        hhr.condense_heat(named, heat(sliding={0: hhr.SlidingHeat(0.3, 1.0)}))
