"""Reference points of rigid and distributing couplings: their motions and forces, against beams in
closed form.
"""

from dataclasses import replace

import numpy as np
import pytest
from needs import needs
from scenes import block_scene

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.geometries import block

LENGTH, YOUNG = 4.0, 1000.0
ROOT = block.side(0, upper=False)
END = block.side(0, upper=True)


def beam(dim, constraints=(), loads=(), wall=9.0, cells=2, poisson=0.0, **more):
    """A cantilever along x of 4 x 1 (x 1) about the axis y = z = 0 with elements of second order, a
    wall above it.
    """
    low = (0.0,) + (-0.5,) * (dim - 1)
    given = {
        "contacts": (hhr.Obstacle(block.side(1, upper=True), (0.0, 1.0, 0.0)[:dim], wall),),
        "displacements": hhr.Displacement.clamp(ROOT, dim),
        "hypothesis": "plane_stress" if dim == 2 else "solid",
        "order": 2,
    } | more
    return block_scene(
        "beam",
        {"p": (0.1, 1.0)},
        lower=low,
        upper=(LENGTH,) + (0.5,) * (dim - 1),
        cells=(3,) + (cells,) * (dim - 1),
        young=YOUNG,
        poisson=poisson,
        constraints=constraints,
        loads=loads,
        **given,
    )


@needs("second_order")
@pytest.mark.parametrize("rigid", [True, False])
@pytest.mark.parametrize("dim", [2, 3])
def test_an_end_moment_and_an_eccentric_force_bend_a_cantilever(dim, rigid):
    """At nu = 0 the displacement of a beam is exact, quadratic: w = M L^2 / 2 E I, and u = F L / E
    A + M L e / E I.

    A distributing coupling has nodal forces of the same resultant as that stress, which differ from
    it in two cells.
    """
    stiff = YOUNG / 12
    near = 1e-12 if rigid else 2e-3
    ties = (hhr.RigidMotion(END),) if rigid else ()
    turn = 2 if dim == 2 else 5
    middle = (LENGTH,) + (0.0,) * (dim - 1)
    moment = hhr.FullOrderModel(beam(dim, ties, (hhr.CoupledForce(END, turn, "2 * p", middle),)))
    # 2 p = 1.2
    u = moment.solve(0.6).displacement().reshape(-1, dim)
    x, y = moment.problem.points[:, 0], moment.problem.points[:, 1]
    assert u[:, 0] == pytest.approx(-1.2 / stiff * x * y, rel=1e-9, abs=near)
    assert u[:, 1] == pytest.approx(1.2 / stiff * x**2 / 2, rel=1e-9, abs=near)
    # a force along x at y = 0.8 is the moment -0.8 F about z
    eccentric = (LENGTH + 1.0, 0.8) + (0.0,) * (dim - 2)
    pulled = hhr.FullOrderModel(beam(dim, ties, (hhr.CoupledForce(END, 0, "2 * p", eccentric),)))
    u = pulled.solve(0.6).displacement().reshape(-1, dim)
    assert u[:, 0] == pytest.approx(1.2 * x / YOUNG + 0.8 * 1.2 / stiff * x * y, rel=1e-9, abs=near)


@needs("second_order")
@pytest.mark.parametrize("rigid", [True, False])
def test_an_imposed_motion_of_the_point_is_that_of_its_force(rigid):
    """The point moves by -w of the tip less 1.5 of its slope.

    All six components of it are imposed, the others as 0.
    """
    stiff = YOUNG / 12
    point = (LENGTH + 1.5, 0.0, 0.0)
    curvature = 1.2 / stiff
    across = curvature * LENGTH * (LENGTH / 2 + 1.5)
    ways = {1: across, 5: curvature * LENGTH}
    means = tuple(hhr.MeanMotion(END, k, f"{ways.get(k, 0.0)!r} * p", point) for k in range(6))
    full = hhr.FullOrderModel(beam(3, ((hhr.RigidMotion(END),) if rigid else ()) + means))
    u = full.solve(1.0).displacement().reshape(-1, 3)
    x, y = full.problem.points[:, 0], full.problem.points[:, 1]
    near = 1e-10 if rigid else 1e-3
    assert u[:, 0] == pytest.approx(-curvature * x * y, rel=1e-9, abs=near)
    assert u[:, 1] == pytest.approx(curvature * x**2 / 2, rel=1e-9, abs=near)


@needs("second_order")
def test_a_square_bar_twists():
    """Theta = T L / G 0.1406 a^4 (St Venant), far from the ends, of which one cannot warp."""
    length = LENGTH * 3
    shear = YOUNG / 2 / 1.3
    twist = lambda loads, constraints=(): hhr.FullOrderModel(  # noqa: E731
        replace(
            beam(3, constraints, loads, poisson=0.3),
            geometry=lambda comm: block.block(
                comm, lower=(0.0, -0.5, -0.5), upper=(length, 0.5, 0.5), cells=(18, 3, 3)
            ),
        )
    )
    full = twist((hhr.CoupledForce(END, 3, "0.4 * p", (length, 0.0, 0.0)),))
    u = full.solve(0.5).displacement().reshape(-1, 3)
    points = full.problem.points
    # of the section in the middle less that of another one: far from both ends
    angle = [
        np.mean(u[at, 2][points[at, 1] > 0.4] / 0.5)
        for at in (np.isclose(points[:, 0], s) for s in (4.0, 8.0))
    ]
    assert angle[1] - angle[0] == pytest.approx(0.2 * 4.0 / (shear * 0.1406), rel=0.01)
    imposed = (
        twist((), (hhr.MeanMotion(END, 3, "0.1 * p", (length, 0.0, 0.0)),))
        .solve(0.5)
        .displacement()
        .reshape(-1, 3)
    )
    part = np.linalg.lstsq(u.reshape(-1, 1), imposed.ravel(), rcond=None)[0][0]
    assert imposed == pytest.approx(part * u, abs=1e-9 * np.abs(imposed).max())


@needs("second_order")
@pytest.mark.filterwarnings("ignore:kappa")
@pytest.mark.parametrize("rigid", [True, False])
def test_all_models_agree_where_the_end_meets_a_wall(rigid):
    """A rigid or a free end is pulled and turned below a wall, in full, condensed and hyper-reduced
    models.
    """
    point = (LENGTH + 1.0, 0.7)
    ties = (hhr.RigidMotion(END), hhr.MeanMotion(END, 2, "0.004 * p", point)) if rigid else ()
    loads = (hhr.CoupledForce(END, 0, "5 * p", point), hhr.CoupledForce(END, 2, "4 * p", point))
    training = hhr.train(beam(2, ties, loads, wall=0.501), hhr.Sobol(12), held_out=4)
    exact = training.full_order.solve(0.8)
    assert exact.forces().max() > 0.05
    for model in (hhr.condense(training.full_order), training.build()):
        found = model.solve(0.8)
        assert found.displacement() == pytest.approx(
            exact.displacement(), abs=1e-4 * np.abs(exact.displacement()).max()
        )
        assert found.forces() == pytest.approx(exact.forces(), abs=1e-3 * exact.forces().max())


@needs("nodal_loads")
def test_what_imposed_displacements_imply_is_left_out():
    """A rigid end on a plane of symmetry, held twice over, is that without its redundant
    equations.
    """
    side = block.side(1, upper=False)
    force = (hhr.NodalForce(hhr.Nodes.near((LENGTH, 0.5)), (-1.0, 0.3), "p"),)
    held = (*hhr.Displacement.clamp(ROOT, 2), hhr.Displacement(side, 1))
    once, twice = (
        hhr.FullOrderModel(beam(2, ties, force, order=1, displacements=held))
        .solve(0.7)
        .displacement()
        for ties in (
            (hhr.RigidMotion(END),),
            (
                hhr.RigidMotion(END),
                hhr.RigidMotion(END),
                hhr.MeanMotion(END, 1, point=(LENGTH, -0.5)),
            ),
        )
    )
    assert twice == pytest.approx(once, abs=1e-13) and np.abs(once).max() > 1e-4
    broken = hhr.RigidMotion(END), hhr.MeanMotion(END, 1, 0.1, (LENGTH, -0.5))
    with pytest.raises(SceneError, match="imposed displacements alone, which break them"):
        hhr.FullOrderModel(beam(2, broken, order=1, displacements=held))


@needs("nodal_loads")
def test_a_set_that_stays_a_plane():
    """Components of a rigid motion alone: the end stays straight along x, and gets thinner."""
    ties = (hhr.RigidMotion(END, components=(0,)),)
    loads = (hhr.NodalForce(hhr.Nodes.near((LENGTH, 0.5)), (1.0, 0.0), "p"),)
    full = hhr.FullOrderModel(beam(2, ties, loads, order=1, poisson=0.3))
    at = np.isclose(full.problem.points[:, 0], LENGTH)
    y, u = full.problem.points[at, 1], full.solve(1.0).displacement().reshape(-1, 2)[at]
    assert np.polyval(np.polyfit(y, u[:, 0], 1), y) == pytest.approx(u[:, 0], abs=1e-13)
    assert np.abs(np.diff(u[np.argsort(y), 1], 2)).max() >= 0 and np.ptp(u[:, 1]) > 1e-5


@needs("nodal_loads")
def test_mistakes():
    def full(dim, *constraints_and_loads):
        return hhr.FullOrderModel(beam(dim, *constraints_and_loads, order=1))

    elsewhere = hhr.MeanMotion(END, 0, point=(0.0, 0.0, 0.0))
    turned = hhr.CoupledForce(hhr.Nodes.near((4, 0, 0)), 5, 1.0)
    for make, why in (
        (lambda: hhr.MeanMotion(END, 6), "must be 0 to 5"),
        (lambda: hhr.CoupledForce(END, 0, 1.0, (0.0, np.nan)), "must be finite coordinates"),
        (lambda: hhr.RigidMotion(END, components=(3,)), "must be among 0, 1 and 2"),
        (lambda: full(2, (hhr.MeanMotion(END, 3),)), "does not exist in 2 dimensions"),
        (lambda: full(2, (elsewhere,)), "number of"),
        (lambda: full(3, (), (turned,)), "leave component 5 undetermined"),
    ):
        with pytest.raises(SceneError, match=why):
            make()
