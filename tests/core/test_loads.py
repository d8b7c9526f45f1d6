"""Loads of a user's own against closed forms, in the full order and reduced, and sums of sparse
columns.
"""

import dataclasses

import numpy as np
import pytest
from mpi4py import MPI
from mpirun import launch
from needs import needs
from processes import folders_of
from scenes import (
    block_scene,
    check_contact_conditions,
    check_like,
    largest_difference,
    pressed_block,
    pressed_pair,
    slope,
    space,
)
from scipy.sparse import csc_matrix, csr_matrix
from toy_nonaffine_load import Square, WindLoad

import hhr_dolfinx as hhr
from hhr_dolfinx.amplitudes import Amplitudes, Coverage, Theta
from hhr_dolfinx.errors import SceneError, SceneWarning
from hhr_dolfinx.geometries import block, two_blocks

YOUNG, HEIGHT, WIDTH, GAP = 3.0, 2.0, 1.5, 0.01


def column(load, box, top=0.0):
    """A column without lateral strain above a floor, under a load, whose top goes down by an
    amplitude.
    """
    scene = pressed_block("plane_strain", young=YOUNG, poisson=0.0, gap=GAP, cells=6)
    *fixed, lid = scene.displacements
    lid = hhr.Displacement(lid.tag, lid.component, top)
    return dataclasses.replace(scene, parameters=box, displacements=(*fixed, lid), loads=(load,))


def heavy_column():
    """The top goes down by ``drop``: the floor carries weight HEIGHT / 2 + E (drop - GAP) / HEIGHT
    per area.
    """
    weight = hhr.BodyForce(block.SOLID, (0.0, -1.0), slope("weight"))
    return column(weight, space(weight=(0.0, 0.1), drop=(0.0, 0.1)), slope("drop", -1.0))


def windy_column():
    """The top is held, the lower end blown down: the floor carries 0.05 speed^2 - E GAP / HEIGHT
    per area.
    """
    return column(
        WindLoad(block.side(1, False), (0.0, -1.0), 0.05, "speed"), space(speed=(0.0, 2.0))
    )


def pressure_of(scene, mu):
    if scene.parameters.names == ("speed",):
        return max(0.05 * mu[0] ** 2 - YOUNG * GAP / HEIGHT, 0.0)
    return max(mu[0] * HEIGHT / 2 + YOUNG * (mu[1] - GAP) / HEIGHT, 0.0)


SCENES = [
    pytest.param(heavy_column, [5, 5], marks=needs("volume_loads"), id="weight"),
    pytest.param(windy_column, [9], id="wind"),
]


@pytest.mark.parametrize(("make", "counts"), SCENES)
def test_loads_of_a_users_own(make, counts):
    """Full order and reduced against the closed form and each other, at points between those of the
    training.
    """
    scene = make()
    training = hhr.train(scene, counts)
    full, reduced = training.full_order, training.build()
    for mu in scene.parameters.random(6, seed=2):
        exact = full.solve(mu)
        check_contact_conditions(full.problem, exact.displacement(), exact.forces(), mu)
        assert exact.forces().sum() == pytest.approx(
            WIDTH * pressure_of(scene, mu), rel=1e-10, abs=1e-14
        )
        answer, field = reduced.solve(mu), exact.displacement()
        assert answer.displacement() == pytest.approx(field, abs=1e-9 * np.abs(field).max())
        assert answer.forces() == pytest.approx(exact.forces(), abs=1e-9)


@needs("ranks", "volume_loads")
def test_loads_on_two_ranks():
    program = (
        f"import dataclasses, sys; sys.path[:0] = {folders_of(__file__)!r}\n"
        "import pytest, ufl, made_loads, scenes, test_loads as t, hhr_dolfinx as hhr\n"
        "for scene, mu in ((t.heavy_column(), (0.05, 0.03)), (t.windy_column(), (1.5,))):\n"
        "    force = hhr.FullOrderModel(scene).solve(mu).forces().sum()\n"
        "    assert force == pytest.approx(t.WIDTH * t.pressure_of(scene, mu), rel=1e-10)\n"
        "load = made_loads.of_form(lambda v, ds: ufl.inner(v, v) * ds)\n"
        "with pytest.raises(hhr.errors.SceneError, match='linear in v'):\n"
        "    block = scenes.pressed_block('plane_strain')\n"
        "    hhr.FullOrderModel(dataclasses.replace(block, **load))\n"
        "print('all is well')\n"
    )
    assert launch(2, ["-c", program]).count("all is well") == 2


@needs("inelastic", "volume_loads")
def test_a_body_that_flows_carries_its_weight():
    """Below its yield stress, in one step of a history, as in the elastic model."""
    scene = heavy_column()
    bodies, mu = (
        (dataclasses.replace(scene.bodies[0], law=hhr.Plasticity(1e3)),),
        np.array([0.05, 0.03]),
    )
    flowing = hhr.FullOrderModel(dataclasses.replace(scene, bodies=bodies))
    history = flowing.march([(0.0, np.zeros(2)), (1.0, mu)])
    assert history.answers[-1].forces().sum() == pytest.approx(
        WIDTH * pressure_of(scene, mu), rel=1e-6
    )


def test_a_parameter_of_an_amplitude_that_is_not_affine_is_not_idle():
    idle = dataclasses.replace(windy_column(), parameters=space(idle=(0.0, 1.0), speed=(0.0, 2.0)))
    with pytest.warns(SceneWarning, match=r"parameters \('idle',\) of scene"):
        hhr.FullOrderModel(idle)


def test_amplitudes_are_counted_one_after_another():
    """Affine terms first, then the columns of each that is not."""
    line, box = (
        Coverage(np.array([0.0, 1.0, 3.0]), 0, 1.0, np.array([0.0, 0.0])),
        space(a=(0.0, 3.0), b=(0.0, 3.0)),
    )
    amplitudes = Amplitudes.collect([Square(1, 5.0), hhr.Amplitude(2.0, {"b": 1.0}), line], box)
    assert amplitudes.firsts == [2, 3, 8]
    theta = amplitudes(np.array([2.0, 3.0]))
    full = np.zeros(8)
    full[theta.terms] = theta.values
    # up to the middle of the edge from 1 to 3: the whole first edge, 3/4 on its first and 1/4 on
    # its second node
    assert full == pytest.approx(np.array([1.0, 5.0, 45.0, 0.0, 1.0, 0.0, 0.75, 0.25]))
    assert amplitudes.idle(box) == ()


@dataclasses.dataclass(frozen=True)
class Astray:
    """An amplitude that answers as it should in the middle of the box, where it is tried, and
    below; astray above.
    """

    answer: tuple
    count = 1

    def __call__(self, point):
        return self.answer if point[0] > 0.05 else ([0], [point[0]])


@pytest.mark.parametrize("answer", [([-1], [0.1]), ([1], [0.1]), ([0], []), ([], [0.1])])
def test_amplitudes_keep_to_their_columns(answer):
    """With the column -1 they scaled the load of another amplitude, and answers were 94 % wrong
    without a word.
    """
    amplitudes = Amplitudes.collect([Astray(answer), hhr.Amplitude(2.0)], space(a=(0.0, 0.1)))
    assert amplitudes(np.array([0.04])).values.tolist() == [1.0, 2.0, 0.04]
    with pytest.raises(
        SceneError, match=r"Astray.* at \[0\.08\]: give as many values as columns, 0 to 0"
    ):
        amplitudes(np.array([0.08]))


@pytest.mark.parametrize("kind", [csc_matrix, csr_matrix, np.asarray, np.asfortranarray])
@pytest.mark.parametrize("terms", [slice(None), np.array([5, 0, 2])])
def test_sums_of_columns(kind, terms):
    """Sparse and dense matrices, all terms and some of them, in any order."""
    dense = np.random.default_rng(0).standard_normal((7, 6)) * (
        np.arange(42).reshape(7, 6) % 3 == 0
    )
    values = np.arange(1.0, 7.0)[terms]
    found = kind(dense) @ Theta(terms, values)
    assert type(found) is np.ndarray and found == pytest.approx(dense[:, terms] @ values)
    assert kind(np.zeros((7, 6))) @ Theta(terms, values) == pytest.approx(np.zeros(7))


def test_the_stiffness_is_the_sum_of_its_terms(hertz):
    problem = hertz.problem
    parts = dataclasses.replace(
        problem, stiffness_terms=(0.25 * problem.stiffness, 0.75 * problem.stiffness)
    )
    assert abs(parts.stiffness - problem.stiffness).max() < 1e-12 * abs(problem.stiffness).max()
    assert problem.stiffness is problem.stiffness_terms[0] and len(problem.stiffness_terms) == 1


def curved_pair(formula):
    """A pair with a modulus, an opening and a load that is a formula, pushed by a formula or, the
    same, by a number.
    """
    top, flank = (two_blocks.side(two_blocks.SECOND, axis, True) for axis in (1, 0))
    moved = hhr.Displacement(top, 1, "-0.03 * (1 + push)**2" if formula else slope("down", -1.0))
    load = hhr.Pressure(flank, "load**2 + 0.02")
    made = pressed_pair(
        "plane_strain", (("E1", 0.3), (5.0, 0.3)), {"E1": (1.0, 6.0)}, cells=3, loads=(load,)
    )
    box = {"push": (0.0, 0.4)} if formula else {"down": (0.03, 0.06)}
    box |= {"slide": (-0.02, 0.02), "load": (0.0, 0.1), "gap": (0.0, 0.01), "E1": (1.0, 6.0)}
    return dataclasses.replace(
        made, parameters=space(**box), displacements=(moved, *made.displacements[:3])
    )


@needs("moduli")
def test_a_displacement_by_a_formula_is_the_displacement_it_gives():
    """Full, reduced and condensed, beside openings, loads by formulas and lifts of a modulus, which
    θ counts before.
    """
    formula, plain = (
        hhr.train(curved_pair(kind), hhr.Sobol(64), held_out=0) for kind in (True, False)
    )
    for mu in ((0.1, -0.01, 0.05, 0.004, 2.0), (0.35, 0.02, 0.09, 0.009, 5.0)):
        expected = plain.full_order.solve((0.03 * (1 + mu[0]) ** 2, *mu[1:]), gradient=True)
        found = formula.full_order.solve(mu, gradient=True)
        check_like(found, expected, displacement=1e-12, forces=1e-10)
        slopes = expected.gradient.multipliers.copy()
        slopes[:, 0] *= 0.06 * (1 + mu[0])
        assert largest_difference(found.gradient.multipliers, slopes) < 1e-9
        # as near as the same models of scenes without formulas,
        # tests/plugins/moduli/test_varying_reduced.py
        for model, tolerance in ((formula.build(checked=False), 2e-2), (formula.condense(), 1e-4)):
            check_like(
                model.solve(mu, outside="ignore"),
                expected,
                displacement=tolerance,
                forces=tolerance,
            )


def test_a_formula_of_a_displacement_is_checked_as_others_are():
    with pytest.raises(SceneError, match="lift"):
        dataclasses.replace(curved_pair(True), displacements=(hhr.Displacement(1, 0, "2 * lift"),))


@dataclasses.dataclass(frozen=True)
class Wave:
    count: int = 1

    def __call__(self, point):
        return [0], [1 + np.sin(point[0])]


@pytest.mark.parametrize("at", [0.0, 0.3, -1.0, 1.0])
def test_amplitudes_without_a_derivative_are_differenced_by_the_box(at):
    """By steps of the box, inside of it, at zero and at its ends too: the square of 1e-5 of its
    width.
    """
    _, slopes = Amplitudes.collect([Wave()], space(a=(-1.0, 1.0))).slopes_at(np.array([at]))
    assert slopes[-1, 0] == pytest.approx(np.cos(at), abs=1e-9)


@pytest.mark.parametrize("order", [1, pytest.param(2, marks=needs("second_order"))])
@pytest.mark.parametrize("height", [0.0, 0.04, 0.25, 0.41, 0.875, 1.0])
def test_partial_pressures_are_integrated_exactly(order, height):
    """Nodal forces work on polynomials of the degree of the cells as the pressure does, wherever it
    ends.
    """
    scene = block_scene(
        "wall", {"p": (0.0, 10.0), "h": (0.0, 1.0)}, simplices=True, order=order,
        contacts=(hhr.Obstacle(block.side(1, True), normal=(0.0, 1.0), offset=2.0),),
        displacements=hhr.Displacement.clamp(block.side(0, False), 2),
        loads=(hhr.PartialPressure(block.side(0, True), slope("p"), "h"),),
    )  # fmt: skip
    problem = hhr.FullOrderModel(scene, MPI.COMM_SELF).problem
    point = np.array([3.0, height])
    forces = (problem.external @ problem.amplitudes(point)).reshape(-1, 2)
    y = problem.points[:, 1]
    for power in range(order + 1):
        assert forces[:, 0] @ y**power == pytest.approx(
            -3.0 * height ** (power + 1) / (power + 1), abs=1e-13
        )
    assert not forces[:, 1].any()
    amplitudes = problem.amplitudes
    acting, slopes = amplitudes.slopes_at(point)
    if 0.0 < height < 1.0 and height % 0.25:
        step = np.array([0.0, 1e-6])
        ahead, behind = (problem.external @ amplitudes(point + way * step) for way in (1, -1))
        found = problem.external[:, acting] @ slopes[:, 1]
        np.testing.assert_allclose(found, (ahead - behind) / 2e-6, atol=1e-8)


PARTIAL = {"push": (0.0, 0.004), "h": (0.3, 1.8), "q": (0.5, 2.0)}


def partly_pressed(cells, curved):
    """A block on a floor under a pressure up to ``h``, whose left side moves by a formula, with
    more formulas.
    """
    left, right = block.side(0, False), block.side(0, True)
    return block_scene(
        "partly_pressed",
        PARTIAL,
        upper=(2.0, 1.0),
        cells=(cells, 4),
        young=100.0,
        contacts=(hhr.Obstacle(block.side(1, False), (0.0, -1.0), 1e-3),),
        displacements=(hhr.Displacement(left, 0, "-200 * push**2"), hhr.Displacement(left, 1)),
        loads=(
            hhr.PartialPressure(block.side(1, True), slope("q", 0.5), "h", axis=0),
            *(hhr.Traction(right, (0.0, -1.0), f"0.002 * q**{k + 2}") for k in range(curved)),
        ),
    )


@needs("exact_errors")  # forces outside the RID by the exact problem, not by training forces
@pytest.mark.parametrize(("cells", "curved"), [(8, 0), (2, 5)])
def test_a_displacement_by_a_formula_beside_a_partial_pressure(cells, curved):
    """On the imposed side the displacement is the formula itself, in the full order and
    hyper-reduced.
    """
    scene = partly_pressed(cells, curved)
    training = hhr.train(scene, hhr.Sobol(16))
    full = training.full_order
    side = 2 * np.flatnonzero(np.isclose(full.problem.points[:, 0], 0.0))
    for model in (full, hhr.condense(scene, fields=True), training.build(hhr.Recipe().as_it_is())):
        for mu in scene.parameters.random(3, seed=2):
            field = model.solve(mu).displacement()
            assert field[side] == pytest.approx(np.full(side.size, -200.0 * mu[0] ** 2), rel=1e-12)
            assert field == pytest.approx(
                full.solve(mu).displacement(), abs=1e-9 * np.abs(field).max()
            )


@dataclasses.dataclass(frozen=True)
class Lowered(hhr.Obstacle):
    """A floor that goes down by ``down``, an affine term of its gaps."""

    def gap_terms(self, surfaces, rows):
        """One column."""
        return [hhr.Term(slope("down"), np.ones((rows.gap.size, 1)))]


def test_affine_terms_of_gaps_are_counted_with_the_affine_ones():
    """Blown down by a non-affine load, the column presses with 0.05 speed^2 - E (GAP + down) /
    HEIGHT per area.
    """
    scene = windy_column()
    floor = scene.contacts[0]
    lowered = Lowered(floor.surface, floor.normal, floor.offset)
    scene = dataclasses.replace(
        scene, contacts=(lowered,), parameters=space(speed=(0.0, 2.0), down=(0.0, 0.05))
    )
    full = hhr.FullOrderModel(scene)
    for mu in ((1.5, 0.0), (1.9, 0.03), (0.5, 0.04)):
        pressure = max(0.05 * mu[0] ** 2 - YOUNG * (GAP + mu[1]) / HEIGHT, 0.0)
        assert full.solve(mu).forces().sum() == pytest.approx(
            WIDTH * pressure, rel=1e-10, abs=1e-14
        )
