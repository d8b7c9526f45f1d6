"""The indentation demo: its meshes, a coarse history beside closed forms, and its fit on a model of
two lines.
"""

import dataclasses
from types import SimpleNamespace

import indentation as demo
import numpy as np
import pytest
from mpi4py import MPI
from parts import indentation_study as study

import hhr_dolfinx as hhr
from hhr_dolfinx.geometries import sphere_on_block as geometry

COARSE = 7


@pytest.fixture(scope="module")
def full():
    return hhr.FullOrderModel(demo.scene(COARSE))


@pytest.mark.parametrize(("count", "unknowns"), [(10, 3513), (14, 8235), (19, 19776)])
def test_one_number_makes_a_mesh(count, unknowns):
    cells = geometry.indentation_cells(count)
    mesh, _, facet_tags = geometry.sphere_on_block(MPI.COMM_SELF, width=0.4, depth=0.4, **cells)
    assert (
        3 * len(mesh.geometry.x) == unknowns
        and len(facet_tags.find(geometry.BLOCK_TOP)) == count**2
    )
    np.testing.assert_allclose(
        [mesh.geometry.x.min(axis=0), mesh.geometry.x.max(axis=0)], [[0, 0, -4], [4, 4, 4]]
    )


@pytest.mark.parametrize(("width", "depth"), [(0.5, 0.29), (0.4, 0.0)])
def test_a_sphere_without_a_top_is_refused(width, depth):
    with pytest.raises(ValueError, match="where the sphere ends"):
        geometry.sphere_on_block(MPI.COMM_SELF, width=width, depth=depth)


def test_too_few_cells_are_refused():
    with pytest.raises(ValueError, match="3 cells"):
        geometry.indentation_cells(3)


def test_loading_and_unloading(full):
    """Beside what 20,000 unknowns give: a mean pressure of 2.87 yield stresses."""
    history = full.march(demo.path(demo.DEPTH, 100.0, 0.0), demo.MARCH)
    force = np.array([answer.outputs().values["force"] for answer in history.answers])
    assert (np.diff(force[:16]) > 0).all() and (np.diff(force[15:]) <= 0).all() and force[-1] == 0
    deepest = study.pressures(full, history)[15]
    assert deepest["E* a / (sy R)"] > 30 and deepest["mean pressure / sy"] == pytest.approx(
        2.87, rel=0.06
    )
    last = history.answers[-1].outputs().values
    # the imprint stays, and the surface beside it has risen
    assert (
        -demo.DEPTH < last["pole"] < -0.6 * demo.DEPTH
        and 0 < last["rise at 1.1"] < 0.2 * demo.DEPTH
    )
    # the first step back is elastic: from an extrapolation it took dozens
    assert history.cuts == 0 and history.answers[16].iterations <= 8


def test_a_block_that_does_not_yield_is_as_hertz_says():
    """Contact radius under the force found, by the second moment of the pressure.

    1 % off on finer meshes.
    """
    base, bodies = (
        demo.scene(COARSE),
        (hhr.Body(1, demo.SPHERE_E, 0.3), hhr.Body(2, demo.BLOCK_E, 0.3)),
    )
    space = hhr.ParameterSpace(("depth",), (0.0,), (0.03,))
    model = hhr.FullOrderModel(dataclasses.replace(base, bodies=bodies, parameters=space))
    forces = model.solve(0.02).forces()
    distance = np.hypot(*model.problem.contact_points[:, :2].T)
    modulus = 1 / sum((1 - 0.3**2) / young for young in (demo.SPHERE_E, demo.BLOCK_E))
    radius = np.sqrt(2.5 * forces @ distance**2 / forces.sum())
    assert radius == pytest.approx((3 * forces.sum() * demo.RADIUS / modulus) ** (1 / 3), rel=0.03)


class Lines:
    """A model whose forces are (sy + 1e-3 H k) k on the way down, and half of that on the way
    up.
    """

    parameters = hhr.ParameterSpace(("depth", "sy", "H"), (0.0, 100.0, 0.0), (0.03, 300.0, 3000.0))

    def march(self, path, settings):
        answers = []
        for k, (_, (_, yield_stress, hardening)) in enumerate(path[1:], start=1):
            share = k if k <= 16 else k / 2
            values = {"force": (yield_stress + 1e-3 * hardening * share) * share}
            found = SimpleNamespace(
                values=values, gradient={"force": np.array([0.0, share, 1e-3 * share**2])}
            )
            answers.append(SimpleNamespace(outputs=lambda found=found: found))
        return SimpleNamespace(answers=answers)


def test_constants_are_found_again():
    model, constants = Lines(), np.array([150.0, 1200.0])
    (exact,) = study.curve(model, constants)
    size = np.full(exact.size, 0.01 * exact.max())
    start = np.array([250.0, 300.0])
    np.testing.assert_allclose(study.fitted(model, exact, size, start), constants, rtol=1e-6)
    data, size = study.measured(model, constants, seed=0)
    found = study.fitted(model, data, size, start)
    slopes = study.curve(model, constants, gradient=True)[1] / size[:, None]
    deviations = np.sqrt(np.diag(np.linalg.inv(slopes.T @ slopes)))
    assert (np.abs(found - constants) < 3 * deviations).all()
    samples = study.posterior(model, data, size, found, 4000, seed=0)
    # hardening is hardly seen by these lines, so that the box cuts its posterior
    assert samples.shape == (4000, 2) and np.abs(samples[:, 0].mean() - found[0]) < deviations[0]
    assert 0.3 * deviations[0] < samples[:, 0].std() < 1.5 * deviations[0]


def test_the_default_search_is_as_quick_as_the_elastic_one():
    """In space a new tangent costs as much as ten iterations: none is made where steps take few of
    them by the last.

    All searches find the same.
    """
    full, path = hhr.FullOrderModel(demo.scene(6)), demo.path(0.02, 150.0, 6e3)
    made, linearised = [], type(full.equilibrium).linearised
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            type(full.equilibrium), "linearised", lambda *a: made.append(None) or linearised(*a)
        )
        found, other = (
            full.march(path, hhr.MarchSettings(search)) for search in ("frozen", "elastic")
        )
    assert len(made) <= 2 and sum(found.iterations) <= 1.1 * sum(other.iterations)
    for history in (other, full.march(path, hhr.MarchSettings("tangent"))):
        for one, two in zip(found.answers, history.answers, strict=True):
            assert np.array_equal(one.active, two.active) and np.allclose(
                one.stress(), two.stress(), atol=1e-4 * 150
            )
            # a residual of 1e-5 of the loads
            assert one.unknown == pytest.approx(two.unknown, abs=2e-4 * np.abs(two.unknown).max())
