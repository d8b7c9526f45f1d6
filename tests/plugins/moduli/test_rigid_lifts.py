"""Bodies whose stiffness depends on parameters, moved by imposed displacements that are rigid as a
whole.
"""

import dataclasses

import numpy as np
import pytest
from bound_checks import compared
from needs import needs
from scenes import pressed_pair, slope, space

import hhr_dolfinx as hhr
from hhr_dolfinx.geometries import two_blocks

SIDE = two_blocks.side


def pressed(poisson="nu", **others):
    """Two blocks .01 apart: the upper one, whose top only moves down, closes the gap and hardly
    presses.
    """
    top, bottom = SIDE(two_blocks.SECOND, 1, True), SIDE(two_blocks.FIRST, 1, False)
    held = [hhr.Displacement(bottom, 0), hhr.Displacement(bottom, 1), hhr.Displacement(top, 0)]
    down = hhr.Displacement(top, 1, slope("push", -1.0))
    box = {"push": (0.01001, 0.0102)} | ({"nu": (0.2, 0.4)} if poisson == "nu" else {})
    scene = pressed_pair("plane_strain", ((1.0, 0.3), (2.0, poisson)), {"nu": (0.2, 0.4)})
    opened = (hhr.Opening(0, hhr.Amplitude(0.01)),)
    given = {
        "parameters": space(**box),
        "displacements": (*held, down),
        "openings": opened,
        "loads": (),
    }
    return dataclasses.replace(scene, **given | others)


@pytest.fixture(scope="module")
def training():
    return hhr.train(pressed(), hhr.Sobol(24), held_out=6)


def test_a_body_that_its_top_pushes_is_lifted_as_a_whole(training):
    problem, point = training.full_order.problem, {"push": 0.0101, "nu": 0.27}
    lift = (problem.lifts @ problem.theta(point)).reshape(-1, 2)
    upper = np.unique(problem.cell_nodes[problem.points[problem.cell_nodes].mean(axis=1)[:, 1] > 1])
    assert lift[upper] == pytest.approx(np.tile([0.0, -0.0101], (upper.size, 1)), abs=1e-14)
    assert not np.delete(lift, upper, axis=0).any()
    # the moduli multiply nothing of it
    assert not any(term.nnz for term in problem.lift_terms) and not problem.external.nnz
    plain = hhr.FullOrderModel(pressed(0.27))
    on_imposed = plain.problem.lifts.nonzero()[0]
    assert on_imposed.size and not plain.problem.free[on_imposed].any()
    one, other = training.full_order.solve(point), plain.solve({"push": 0.0101})
    assert one.displacement() == pytest.approx(other.displacement(), abs=1e-12)
    assert one.forces() == pytest.approx(other.forces(), abs=1e-12)


def test_its_errors_are_proved_and_hardly_ever_ask_the_full_model(training):
    """Measured: 3.1e-5 at most; with the lift on the imposed dofs alone, 13 %, and nothing was
    proved.
    """
    full, model = training.full_order, training.build(checked=False)
    kinds, (primal, _, *relative, moved, _, _, _) = compared(
        full, model, full.parameters.random(40, 1)
    )
    assert kinds == {"bound"} and (moved <= primal).all() and np.max(relative) < 1e-3


def test_imposed_motions_that_strain_stay_on_the_imposed_dofs():
    """The top slides while the bottom is held aside: no rigid block does that."""
    top, bottom = SIDE(two_blocks.SECOND, 1, True), SIDE(two_blocks.SECOND, 1, False)
    slid = hhr.Displacement(top, 0, slope("push"))
    moved = (
        *pressed().displacements[:2],
        slid,
        hhr.Displacement(top, 1),
        hhr.Displacement(bottom, 0),
    )
    problem = hhr.FullOrderModel(pressed(displacements=moved)).problem
    dofs = problem.lifts.nonzero()[0]
    assert dofs.size and not problem.free[dofs].any()


@needs("stress")
def test_outputs_read_the_same_of_a_body_that_is_lifted_as_a_whole():
    """Forces, gaps and energies, with their derivatives, beside those of a constant ratio, lifted
    on the top alone.
    """
    outputs = (
        hhr.ContactForce("force", 0, (0.0, 1.0)),
        hhr.GapAt("gap", 0, (1.5, 1.0)),
        hhr.ElasticEnergy("energy"),
    )
    left, right = (SIDE(two_blocks.SECOND, 0, upper) for upper in (False, True))
    aside = hhr.Pressure(right, 2e-3), hhr.Traction(left, (0.0, 1.0), 1e-3)
    varying, plain = (
        hhr.FullOrderModel(pressed(poisson, outputs=outputs, loads=aside)).outputs(
            point, gradient=True
        )
        for poisson, point in (("nu", (0.0101, 0.27)), (0.27, 0.0101))
    )
    for name in ("force", "gap", "energy"):
        assert varying[name] == pytest.approx(plain[name], rel=1e-8, abs=1e-13), name
        assert varying.gradient[name][0] == pytest.approx(
            plain.gradient[name][0], rel=1e-8, abs=1e-11
        ), name
