"""Bodies that constraints join and contact alone holds."""

from dataclasses import replace

import numpy as np
import pytest
from bolted_columns import AREA, column, scene
from needs import needs
from scenes import check_contact_conditions
from tied_blocks import tied

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import NotSolvableError
from hhr_dolfinx.geometries import two_blocks

pytestmark = needs("floating")
BOX = {"p": (0.4, 1.0), "q": (0.1, 0.15)}
CELLS = 4


def halves():
    """Two blocks of 1 x 1, one above the other, tied, in a corner: the lower one has a wall and a
    floor.
    """
    made = tied(cells=((CELLS, CELLS),) * 2, box=BOX)
    wall = hhr.Obstacle(two_blocks.side(1, 0, upper=False), (-1, 0), 0.01)
    return replace(
        made,
        contacts=(wall, hhr.Obstacle(two_blocks.side(1, 1, upper=False), (0, -1), 0.02)),
        displacements=(),
        loads=(
            hhr.Pressure(two_blocks.side(2, 1, upper=True), "p"),
            *(hhr.Pressure(two_blocks.side(body, 0, upper=True), "q") for body in (1, 2)),
        ),
    )


@needs("mortar", "nonmatching")
@pytest.mark.parametrize("kind", ["Mortar", "NodeToSurface"])
def test_tied_halves_in_a_corner(kind):
    """They move as one in three ways; forces balance p on a width of 1 and q on a height of 2, and
    its moment.
    """
    two = halves()
    full = hhr.FullOrderModel(
        replace(two, constraints=(replace(two.constraints[0], pairing=getattr(hhr, kind)),))
    )
    problem = full.problem
    assert problem.kernel.motions.shape[1] == 3
    for point in ([0.4, 0.15], [0.9, 0.12]):
        answer = full.solve(point)
        check_contact_conditions(problem, answer.displacement(), answer.forces(), point)
        wall = problem.contact_pairs == 0
        forces, places = answer.forces(), problem.contact_points
        assert [forces[wall].sum(), forces[~wall].sum()] == pytest.approx(
            [2 * point[1], point[0]], rel=1e-9
        )
        turning = forces[~wall] @ places[~wall, 0] - forces[wall] @ places[wall, 1]
        assert turning == pytest.approx(0.5 * point[0] - 2 * point[1], rel=1e-9)
        u = answer.displacement().reshape(-1, 2)
        (first, second) = (
            u[np.flatnonzero(np.abs(problem.points - place).sum(axis=1) < 1e-9)]
            for place in ([0, 1], [1, 1])
        )
        assert first[0] == pytest.approx(first[1], abs=1e-12) and second[0] == pytest.approx(
            second[1], abs=1e-12
        )


@pytest.mark.filterwarnings("ignore:kappa")
@needs("mortar")
def test_small_models_of_joined_bodies():
    """Condensed exactly, and hyper-reduced, in balance; bounds are not below errors."""
    training = hhr.train(halves(), hhr.Sobol(16), held_out=2)
    full, exact, small = training.full_order, training.condense(), training.build()
    for point in ([0.4, 0.15], [0.9, 0.12]):
        u = full.solve(point).displacement()
        for model, near in ((exact, 1e-9), (small, 1e-3)):
            answer = model.solve(point)
            assert answer.displacement() == pytest.approx(u, abs=near * np.abs(u).max())
            assert answer.forces().sum() == pytest.approx(point[0] + 2 * point[1], rel=1e-9)


@needs("mortar")
def test_gradients_of_joined_bodies_are_differences():
    """Of displacements and forces, in the full and the condensed model."""
    for model in (hhr.FullOrderModel(halves()), hhr.condense(halves())):
        at = np.array([0.6, 0.12])
        exact = model.solve(at, gradient=True).gradient
        for k, step in enumerate(1e-5 * np.eye(2)):
            ahead, back = (model.solve(at + sign * step) for sign in (1, -1))
            assert exact.multipliers[:, k] == pytest.approx(
                (ahead.forces() - back.forces()) / 2e-5, abs=1e-6
            )


@pytest.mark.parametrize("order", [1, pytest.param(2, marks=needs("second_order"))])
def test_a_force_apart_presses_a_plate(order, tmp_path):
    """Between the sides of a section the upper part of a bolt is loose: the plate bears the force,
    a mechanism.
    """
    made = scene(
        column(tmp_path / "bolt.inp", order),
        (hhr.ForcedSection("CUT"),),
        (hhr.BoltForce("CUT", "-2 * p"),),
        0.1,
    )
    full = hhr.FullOrderModel(made)
    assert full.problem.kernel.motions.shape[1] == 1
    for model in (full, hhr.condense(made)):
        found = model.solve(0.5).outputs()
        assert abs(found["plate"]) == pytest.approx(1.0, rel=1e-9)
        assert found["head"] == pytest.approx(0.1, rel=1e-9)
    assert full.solve(0.5).stress()[:, 2] == pytest.approx(np.full(3, -1.0 / AREA), rel=1e-9)


@pytest.mark.filterwarnings("ignore:kappa")
@needs("moduli")
def test_moduli_may_be_parameters(tmp_path):
    """Of a bolt whose upper part is loose: its middle moves by the gap and the shortening above it,
    F / (E A).
    """
    made = scene(
        column(tmp_path / "bolt.inp"),
        (hhr.ForcedSection("CUT"),),
        (hhr.BoltForce("CUT", "-2 * p"),),
        0.1,
    )
    made = replace(
        made,
        bodies=(hhr.Body("BOLT", young="E", poisson=0.3),),
        parameters=hhr.ParameterSpace(("p", "E"), (0.1, 500.0), (1.0, 2000.0)),
        outputs=(hhr.DisplacementAt("above", (0.0, 0.0, 2.0), 2), *made.outputs),
    )
    training = hhr.train(made, hhr.Sobol(8), held_out=2)
    for model in (training.full_order, training.build()):
        found = model.solve([0.5, 800.0]).outputs()
        assert abs(found["plate"]) == pytest.approx(1.0, rel=1e-6)
        assert found["above"] == pytest.approx(0.1 + 1 / (800.0 * AREA), rel=1e-8)


def test_what_nothing_holds_is_named(tmp_path):
    """A bolt that a force draws away from the plate; and joined halves without one of their
    walls.
    """
    made = scene(
        column(tmp_path / "bolt.inp"),
        (hhr.ForcedSection("CUT"),),
        (hhr.BoltForce("CUT", "2 * p"),),
        0.1,
    )
    answer = hhr.FullOrderModel(made).solve(0.5, raise_on_failure=False)
    assert not answer.converged
    loose = halves()
    with pytest.raises(
        NotSolvableError, match=r"body 1 .* with body 2 .* moves along axis 0.*loads drive"
    ):
        hhr.FullOrderModel(replace(loose, contacts=loose.contacts[1:]))


@needs("inelastic")
def test_laws_of_tied_halves_that_contact_holds():
    """Forces balance the loads while both halves yield; tied nodes move as one."""
    made = halves()
    bodies = tuple(replace(body, law=hhr.Plasticity(0.5, 20.0)) for body in made.bodies)
    full = hhr.FullOrderModel(replace(made, bodies=bodies))
    point = np.array([1.0, 0.15])
    answer = full.march([(0.0, 0.4 * point + 0.06), (1.0, point)]).answers[-1]
    wall, forces = full.problem.contact_pairs == 0, answer.forces()
    assert answer.plastic_strain().max() > 1e-3
    assert [forces[wall].sum(), forces[~wall].sum()] == pytest.approx(
        [2 * point[1], point[0]], rel=1e-9
    )
    u = answer.displacement().reshape(-1, 2)
    (first, second) = (
        u[np.flatnonzero(np.abs(full.problem.points - place).sum(axis=1) < 1e-9)]
        for place in ([0, 1], [1, 1])
    )
    assert first[0] == pytest.approx(first[1], abs=1e-12) and second[0] == pytest.approx(
        second[1], abs=1e-12
    )
