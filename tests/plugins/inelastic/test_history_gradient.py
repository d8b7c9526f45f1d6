"""Derivatives of laws and of histories: holds, kinks at single points, and closed forms."""

import dataclasses

import numpy as np
import pytest
from condensing import up
from needs import needs
from points import WOOD
from scenes import block_scene, slope
from tubes import POISSON, YOUNG, tube

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import NotOfferedError
from hhr_dolfinx.geometries import block, two_blocks
from hhr_dolfinx.plugins.inelastic.law import InternalVariables
from hhr_dolfinx.plugins.inelastic.law_slopes import Along, Inputs, slopes_of
from hhr_dolfinx.plugins.inelastic.outside import OutsideLaw
from hhr_dolfinx.plugins.inelastic.update import Group, Material

SHARP = hhr.MarchSettings("tangent", 1e-11, 1e-9, 1e-11, outside="ignore")
ASKED = dataclasses.replace(SHARP, gradient=True)
LAWS = {
    "plasticity": hhr.Plasticity(1.0, 5.0),
    "voce": hhr.Voce(1.0, 0.5, 20.0, 2.0),
    "table": hhr.TabulatedHardening(((0.0, 1.0), (0.05, 1.4), (0.2, 1.6))),
    "chaboche": hhr.Chaboche(1.0, ((30.0, 40.0), (8.0, 5.0)), 0.3, 10.0),
    "norton": hhr.Norton(2.0, 4.0),
    "arrhenius": hhr.Arrhenius(2.0, 4.0, 3e3, 700.0, 650.0),
    "primary": hhr.PrimaryCreep(3.0, 3.0, 0.4),
    "creep and yield": hhr.PlasticityWithCreep(1.0, 5.0, 3.0, 4.0),
    "drucker": hhr.DruckerPrager(1.0, 0.3, 0.1, 20.0),
    "hill": hhr.Hill(1.0, 5.0, 0.6, 0.5, 0.4, 1.4, 1.5, 1.6),
    "lemaitre": hhr.Lemaitre(1.0, 40.0, 0.5),
    "heated": hhr.Heated(hhr.Voce(1.0, 0.5, 20.0, 2.0), 1e-3, 400.0, 390.0),
    "softer": hhr.ChangingStiffness(hhr.Plasticity(1.0, 5.0), 150.0),
    "wood": hhr.Orthotropic(*WOOD),
}


def given_states(law, points, seed=3):
    """A material of a law, and random steps from the states that random steps left behind."""
    rng = np.random.default_rng(seed)
    material = Material([Group(np.arange(points), YOUNG, POISSON, law)], law.strains)
    sizes = 10 ** rng.uniform(-2.5, -1.5, (2, points, 1))
    first, second = sizes * rng.standard_normal((2, points, law.strains))
    old = material.update(first, material.at_rest(), 0.3, tangent=False).state
    return material, Inputs(first + second, old, 0.7), rng


def moved(material, given, along, way, step):
    """The step with inputs moved along a direction."""
    (group,) = material.groups
    numbers = material.given[0].constants[:, 0] + step * along.constants[0][:, 0, way]
    law = group.law.with_numbers(dict(zip(group.law.constants, numbers[2:].tolist(), strict=True)))
    shifted = Material([Group(group.indices, float(numbers[0]), POISSON, law)], law.strains)
    old = InternalVariables(
        *(part + step * change[..., way] for part, change in zip(given.old, along.old, strict=True))
    )
    return shifted.update(
        given.strain + step * along.strain[..., way], old, given.dt, tangent=False
    )


@pytest.mark.parametrize("plane_stress", [False, True])
@pytest.mark.parametrize("name", LAWS)
def test_derivatives_of_laws_are_those_of_their_steps(name, plane_stress):
    """Central differences of the update along strain, old state, E and constants together, at
    points without a kink.
    """
    law = LAWS[name].at_points(4, plane_stress=plane_stress)
    material, given, rng = given_states(law, 60)
    ways = 2
    strain = rng.standard_normal((*given.strain.shape, ways)) * 1e-2
    old = InternalVariables(
        *(rng.standard_normal((*part.shape, ways)) * 1e-3 for part in given.old)
    )
    values = material.given[0].constants
    constants = values[:, :, None] * rng.uniform(-0.2, 0.2, (*values.shape, ways))
    constants[1] = 0.0
    if law.elastic:  # constants that state the elasticity are numbers
        constants[:] = 0.0
    along = Along(strain, old, [constants], np.full(ways, 1e-5))
    found = slopes_of(material, given, along)
    for way in range(ways):
        step = 1e-5
        more, less = (moved(material, given, along, way, sign * step) for sign in (1, -1))
        clear = found.reach[:, way] > 10 * step
        assert clear.mean() > 0.9
        pairs = zip(
            (more.stress, *more.state),
            (less.stress, *less.state),
            (found.stress, *found.state),
            strict=True,
        )
        for high, low, slopes in pairs:
            right = (high - low)[clear] / (2 * step)
            if right.size:
                assert slopes[clear][..., way] == pytest.approx(
                    right, abs=max(2e-5 * np.abs(right).max(), 1e-10)
                )


def test_a_kink_is_found_at_its_point_alone():
    """One of three points ends exactly on its yield surface.

    The others are a million times as far from theirs.
    """
    law = hhr.Plasticity(1.0, 5.0).at_points(4)
    material = Material([Group(np.arange(3), YOUNG, POISSON, law)], 4)
    shear = YOUNG / (2 + 2 * POISSON)
    at_yield = 1.0 / (np.sqrt(1.5) * 2 * shear)
    strain = np.zeros((3, 4))
    strain[:, 3] = 0.5 * at_yield, at_yield, 1e6 * at_yield
    rest = material.at_rest()
    old = InternalVariables(*(part[..., None] for part in rest))
    along = Along(strain[:, :, None], old, [np.zeros((4, 1, 1))], np.ones(1))
    reach = slopes_of(material, Inputs(strain, rest, 1.0), along).reach[:, 0]
    assert reach[1] < 1e-14
    assert reach[[0, 2]] == pytest.approx([1.0, 1.0 - 1e-6], rel=1e-12)


def pulled(law, **space):
    """A cylinder pulled along its axis, free at its side: uniaxial stress."""
    held = (hhr.Displacement(block.side(axis, upper=False), axis) for axis in (0, 1))
    return block_scene(
        "bar", {"pull": (0.0, 0.03)} | space, upper=(1, 2), cells=(1, 1), hypothesis="axisymmetric",
        bodies=(hhr.Body(block.SOLID, YOUNG, POISSON, law),),
        contacts=(hhr.Obstacle(block.side(0, upper=True), (1, 0), 2.0),),
        displacements=(*held, hhr.Displacement(block.side(1, upper=True), 1, slope("pull", 2.0))),
        outputs=(hhr.DisplacementAt("side", (1.0, 2.0), 0),),
    )  # fmt: skip


def relaxed(pull, start, hardening, resistance, durations, exponent=4.0):
    """Stress of a bar pulled at once, and then held for some durations: one equation for each step
    of implicit Euler.

    It takes complex numbers, of which the imaginary part is a derivative.
    """
    stress = (
        YOUNG * (start + hardening * pull) / (YOUNG + hardening)
    )  # plastic at once, without time to creep
    found = [stress]
    for duration in durations:
        before = stress
        for _ in range(12):
            rate = (stress / resistance) ** exponent
            left = stress + YOUNG * duration * rate - before
            stress = stress - left / (1 + YOUNG * duration * exponent * rate / stress)
        found.append(stress)
    return np.array(found)


@pytest.mark.filterwarnings("ignore:the time steps of this history")
def test_a_bar_that_relaxes_has_the_derivatives_of_its_closed_form():
    """Plasticity with creep, pulled in an instant and held.

    The side moves by -ν σ/E - (pull - σ/E)/2.

    In the limit of many steps σ^(1-m) = σ0^(1-m) + (m - 1) E t / K^m.
    """
    law = hhr.PlasticityWithCreep("s", "H", "K", 4.0)
    full = hhr.FullOrderModel(pulled(law, s=(0.5, 2.0), H=(1.0, 10.0), K=(2.0, 5.0)))
    point = np.array([0.02, 1.0, 5.0, 3.0])
    durations = 0.1 * 1.4 ** np.arange(10)
    times = np.cumsum([0.0, 1e-9, *durations])
    history = full.march(
        [(0.0, point * [0, 1, 1, 1]), *((time, point) for time in times[1:])], ASKED
    )
    expected = relaxed(*point, durations)
    slopes = np.array(
        [np.imag(relaxed(*(point + 1e-30j * way), durations)) / 1e-30 for way in np.eye(4)]
    )
    for place, answer in enumerate(history.answers):
        outputs = answer.outputs()
        side = -POISSON * expected[place] / YOUNG - (point[0] - expected[place] / YOUNG) / 2
        assert outputs["side"] == pytest.approx(side, rel=1e-7)
        right = (0.5 - POISSON) * slopes[:, place] / YOUNG - 0.5 * (np.arange(4) == 0)
        assert outputs.gradient["side"] == pytest.approx(right, rel=1e-6, abs=1e-9)
        assert not outputs.one_sided
    spent = 3 * YOUNG * durations.sum() / point[3] ** 4
    whole = (expected[0] ** -3 + spent) ** (-1 / 3)
    by_resistance = whole**4 * spent * 4 / 3 / point[3]
    fine = np.repeat(durations / 128, 128)
    assert relaxed(*point, fine)[-1] == pytest.approx(whole, rel=2e-3)
    changed = relaxed(*(point + 1e-30j * np.eye(4)[3]), fine)[-1]
    assert np.imag(changed) / 1e-30 == pytest.approx(by_resistance, rel=2e-3)


@pytest.mark.parametrize(
    "law", [hhr.Plasticity(1.0, 5.0), hhr.PlasticityWithCreep(1.0, 5.0, 20.0, 4.0)]
)
def test_derivatives_at_a_hold_of_a_load(law):
    """Nothing yields in it that is held by a constant load, and what creeps goes on as differences
    of histories say.
    """
    full = hhr.FullOrderModel(tube(law, 0.9, cells=8))
    loaded = up(0.8, steps=4)
    path = [(time, point + 0.01) for time, point in [*loaded, (loaded[-1][0] + 0.1, loaded[-1][1])]]
    before, held = full.march(path, ASKED).answers[-2:]
    if isinstance(law, hhr.Plasticity):
        size = np.abs(before.gradient.unknown).max()
        assert held.gradient.unknown == pytest.approx(before.gradient.unknown, abs=1e-9 * size)
    shift = 1e-6 * np.ones(1)
    ends = [
        full.march([(time, point + way * shift) for time, point in path], SHARP).answers[-1]
        for way in (1, -1)
    ]
    right = (ends[0].unknown - ends[1].unknown) / 2e-6
    assert held.gradient.unknown[:, 0] == pytest.approx(right, abs=1e-6 * np.abs(right).max())


def drawn(law):
    """Two blocks without friction: pressed, and the upper one drawn aside, which the lower one
    hardly feels.
    """
    top = two_blocks.side(two_blocks.SECOND, 1, True)
    return hhr.Scene(
        name="drawn",
        geometry=lambda comm: two_blocks.two_blocks(
            comm, first=((0.0, 0.0), (3.0, 1.0), (6, 2)), second=((0.5, 1.0), (2.5, 2.0), (5, 2))
        ),
        hypothesis="plane_strain",
        bodies=(hhr.Body(two_blocks.FIRST, 3.0, 0.3, law), hhr.Body(two_blocks.SECOND, 5.0, 0.3)),
        contacts=(
            hhr.NodeToSurface(
                two_blocks.side(two_blocks.SECOND, 1, False),
                two_blocks.side(two_blocks.FIRST, 1, True),
            ),
        ),
        parameters=hhr.ParameterSpace(("drag", "push"), (0.0, 0.0), (0.03, 0.06)),
        outputs=(hhr.ContactForce("force", 0, (0.0, 1.0)),),
        displacements=(
            *hhr.Displacement.clamp(two_blocks.side(two_blocks.FIRST, 1, False), 2),
            hhr.Displacement(top, 0, slope("drag")),
            hhr.Displacement(top, 1, slope("push", -1.0)),
        ),
    )


@needs("nonmatching")
def test_derivatives_where_one_body_is_held_and_another_moves():
    """Differences of laws over 1e-5 of the box were 5 to 37 % off there, since points of the held
    body are at yield.
    """
    full = hhr.FullOrderModel(drawn(hhr.Plasticity(0.03, 0.3)))

    def path(push):
        return [(0.0, [0.001, 0.001]), (1.0, [0.001, push]), (2.0, [0.024, push])]

    found = full.march(path(0.037), ASKED).answers[-1].outputs()
    ends = [
        full.march(path(0.037 + step), SHARP).answers[-1].outputs()["force"]
        for step in (1e-5, -1e-5)
    ]
    assert found.gradient["force"][1] == pytest.approx((ends[0] - ends[1]) / 2e-5, rel=1e-5)
    assert not found.one_sided


def test_derivatives_of_a_step_that_ends_at_yield_are_one_sided():
    """And of the steps after it; those that end beside it are not."""
    full = hhr.FullOrderModel(pulled(hhr.Plasticity(1.0, 5.0)))
    at_yield = 1.0 / YOUNG
    for share, expected in ((0.999, False), (1.0, True), (1.001, False)):
        path = [
            (0.0, [0.0]),
            (1.0, [0.5 * at_yield]),
            (2.0, [share * at_yield]),
            (3.0, [2 * at_yield]),
        ]
        sides = [answer.gradient.one_sided for answer in full.march(path, ASKED).answers]
        assert sides == [False, expected, expected]


class Bilinear(OutsideLaw):
    """Elasticity as code, which is twice as stiff in pull."""

    def __init__(self):
        super().__init__("Bilinear", {}, False)

    def evaluate(self, step):
        stiff = np.where(step.strain[:, :3].sum(axis=1) > 0, 2.0, 1.0)[:, None]
        return stiff * step.strain, {}, stiff[:, :, None] * np.eye(4)


def test_code_at_a_kink_is_refused_by_the_number_of_its_points():
    """One of three points has no strain: its derivatives differ."""
    material = Material([Group(np.arange(3), 1.0, 0.0, Bilinear().at_points(4))], 4)
    strain = np.array([[1.0, 0, 0, 0], [0, 0, 0, 0], [-1.0, 0, 0, 0]])
    change = np.ones((3, 4, 1))
    old = InternalVariables(*(np.zeros((*part.shape, 1)) for part in material.at_rest()))
    along = Along(change, old, [np.zeros((2, 1, 1))], np.full(1, 1e-5))
    with pytest.raises(NotOfferedError, match="1 of 3 points have a kink there"):
        slopes_of(material, Inputs(strain, material.at_rest(), 1.0), along)
    rows = [0, 2]
    two = Material([Group(np.arange(2), 1.0, 0.0, Bilinear().at_points(4))], 4)
    old = InternalVariables(*(np.zeros((*part.shape, 1)) for part in two.at_rest()))
    along = along._replace(strain=change[rows], old=old)
    found = slopes_of(two, Inputs(strain[rows], two.at_rest(), 1.0), along)
    assert found.stress[:, :, 0] == pytest.approx(np.array([[2.0] * 4, [1.0] * 4]), rel=1e-9)
