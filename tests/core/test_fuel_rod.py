"""The fuel rod: pellet and cladding by themselves against closed forms, and what condensation makes
of both.
"""

import fuel_rod as demo
import numpy as np
import pytest
from needs import needs

import hhr_dolfinx as hhr
from hhr_dolfinx.geometries import pellet_cladding as geometry

APART = {
    "E1": 170e3,
    "nu1": 0.28,
    "E2": 90e3,
    "nu2": 0.37,
    "q": 12.0,
    "P": 7.0,
    "gap": 0.03,
    "alpha": 9.5e-6,
}


@pytest.fixture(scope="module")
def training():
    return hhr.train(demo.scene(**demo.QUICK_MESH), hhr.Sobol(32), held_out=20)


@pytest.fixture(scope="module")
def apart(training):
    """Nodes of pellet side and cladding, their displacements, and stresses by cell, where nothing
    touches.
    """
    full = training.full_order
    answer = full.solve(APART)
    assert not answer.active.any()
    return full, answer.displacement().reshape(-1, 2), answer.stress()


def test_a_free_pellet(apart):
    """The mean displacement of its side is exact on any mesh: mean stresses vanish against linear
    displacements.
    """
    full, displacement, stress = apart
    surface = full.discretisation.surface(geometry.PELLET_SIDE)
    order = np.argsort(surface.points[:, 1])
    z, radial = surface.points[order, 1], displacement[surface.nodes[order], 0]
    mean = np.diff(z) @ (radial[1:] + radial[:-1]) / 2 / np.ptp(z)
    assert mean == pytest.approx(demo.free_growth(APART["q"], APART["alpha"]), rel=1e-9)
    # its middle is pressed and its side pulled; it is an hourglass
    assert radial[-1] > 1.05 * radial[0] and stress[:, 2].min() < -100


def test_the_cladding_by_itself(apart):
    """Lame's tube in plane strain under a pressure from outside, and the swelling of the tube.

    0.2 % on two cells.
    """
    full, displacement, _ = apart
    nodes = full.problem.points[:, 0] > demo.RADIUS + 1e-3
    r = full.problem.points[nodes, 0]
    inner, outer = r.min(), r.max()
    factor = -APART["P"] * outer**2 / (outer**2 - inner**2) / (APART["E2"] / (1 + APART["nu2"]))
    exact = factor * ((1 - 2 * APART["nu2"]) * r + inner**2 / r)
    exact += demo.CLADDING_EXPANSION * demo.CLADDING_HEAT * r
    assert displacement[nodes, 0] == pytest.approx(exact, rel=2e-3)


@needs("moduli")
def test_condensation(training):
    """Few solutions are enough: moduli are exact factors, and heat and pressure are linear."""
    full, model = training.full_order, training.condense()
    assert sum(model.offline.evaluations) <= 20
    exact = [full.solve(point) for point in full.parameters.random(10, seed=7)]
    scale = max(np.linalg.norm(answer.forces()) for answer in exact)
    assert scale > 0
    for expected in exact:
        answer, displacement, stress = (
            model.solve(expected.parameter),
            expected.displacement(),
            expected.stress(),
        )
        assert np.linalg.norm(answer.forces() - expected.forces()) < 1e-4 * scale
        assert np.linalg.norm(answer.displacement() - displacement) < 1e-4 * np.linalg.norm(
            displacement
        )
        assert np.linalg.norm(answer.stress() - stress) < 1e-3 * np.linalg.norm(stress)


def test_the_view_shows_contact(training):
    assert all(training.full_order.solve(point).active.any() for point in demo.POINTS)
