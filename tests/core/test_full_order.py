"""Full-order contact against closed forms."""

import dataclasses

import hertz_half_discs as demo
import numpy as np
import pytest
from dolfinx import jit
from scenes import (
    THESIS,
    block_scene,
    check_contact_conditions,
    pressed_block,
    pressed_pair,
    slope,
    space,
)
from tubes import lame, lame_displacement, lame_tube

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import FileError
from hhr_dolfinx.geometries import block

AREAS = {"plane_strain": 1.5, "plane_stress": 1.5, "axisymmetric": np.pi * 1.5**2, "solid": 1.5**2}


@pytest.mark.parametrize("simplices", [False, True])
@pytest.mark.parametrize("hypothesis", AREAS)
def test_uniform_pressure_is_exact(hypothesis, simplices):
    """Patch test: P1 and Q1 hold the linear field, so the pressure is exact at every node."""
    full_order = hhr.FullOrderModel(pressed_block(hypothesis, simplices=simplices))
    solution = full_order.solve(0.05)
    modulus = 3.0 / (1 - 0.3**2) if hypothesis == "plane_strain" else 3.0
    pressure = solution.forces() / full_order.problem.contact_areas
    assert pressure == pytest.approx(modulus * (0.05 - 0.01) / 2, rel=1e-10)
    assert solution.forces().sum() == pytest.approx(modulus * 0.02 * AREAS[hypothesis], rel=1e-10)
    check_contact_conditions(full_order.problem, solution.displacement(), solution.forces(), 0.05)


@pytest.mark.parametrize("push", [0.0, 0.01 - 1e-9, 0.01])
def test_no_contact_and_grazing_contact(push):
    """Gap exactly closed at last: force and slack are both zero, and round-off must not make
    statuses cycle.
    """
    solution = hhr.FullOrderModel(pressed_block("plane_strain")).solve(push)
    assert solution.converged and not solution.cycled
    assert np.abs(solution.forces()).max() < 1e-12
    assert push == 0.01 or not solution.active.any()


def test_initial_overlap_is_pushed_apart():
    solution = hhr.FullOrderModel(pressed_block("plane_stress", gap=-0.02)).solve(0.0)
    assert solution.forces().sum() == pytest.approx(3.0 * 0.02 / 2 * 1.5, rel=1e-10)


def test_several_pairs_act_independently():
    """A block between two rigid walls, stretched sideways by a squeeze from floor and lid."""
    right, floor = block.side(0, upper=True), block.side(1, upper=False)
    held = hhr.Displacement(block.side(0, upper=False), 0)
    scene = block_scene(
        "between_walls",
        {"push": (0.0, 0.1)},
        young=2.0,
        poisson=0.25,
        contacts=(hhr.Obstacle(right, (1, 0), 1.0), hhr.Obstacle(floor, (0, -1), 0.0)),
        displacements=(held, hhr.Displacement(block.side(1, upper=True), 1, slope("push", -1.0))),
    )
    full_order = hhr.FullOrderModel(scene)
    forces = full_order.solve(0.05).forces()
    on_wall = np.isclose(full_order.problem.contact_points[:, 0], 1.0)
    # rows stand pair by pair; the corner belongs to both surfaces and has a condition in each
    assert on_wall.tolist() == [True] * 5 + [False] * 4 + [True]
    # plane strain, eps_x = 0, eps_y = -0.05: sigma_y = -(lambda + 2 mu) 0.05, sigma_x = -lambda
    # 0.05
    lam, mu = 2.0 * 0.25 / (1.25 * 0.5), 2.0 / 2.5
    assert forces[:5].sum() == pytest.approx(0.05 * lam, rel=1e-10)
    assert forces[5:].sum() == pytest.approx(0.05 * (lam + 2 * mu), rel=1e-10)


def test_lame_tube_converges_with_and_without_the_wall():
    """u_r and the wall pressure converge at rate 2 to Lame's closed form."""
    free, pressed = (lame_displacement(*lame(1.0, outer), 2.0) for outer in (0.0, 1.0))
    gap = free / 2
    # the outer pressure that leaves the outer radius at the wall: u(1, q) = gap, linear in q
    wall_pressure = (free - gap) / (free - pressed)
    errors = []
    for cells in (4, 8, 16):
        open_tube = hhr.FullOrderModel(lame_tube(cells, gap=1.0))
        solution = open_tube.solve(1.0)
        assert not solution.active.any()
        outer = np.isclose(open_tube.problem.points[:, 0], 2.0)
        u_r = solution.displacement().reshape(-1, 2)[outer, 0].mean()
        pressure = hhr.FullOrderModel(lame_tube(cells, gap)).solve(1.0).forces().sum() / (
            2 * np.pi * 2.0 * 0.2
        )
        errors.append((abs(u_r / free - 1), abs(pressure / wall_pressure - 1)))
    assert np.log2(np.divide(errors[-2], errors[-1])) == pytest.approx(2.0, abs=0.1)
    assert max(errors[-1]) < 2e-3


def test_hertz_line_contact():
    """a^2 = 4 P R* / (pi E*), p0 = 2 P / (pi a) (Hertz, 1882).

    A by the second moment, sum(x^2 f) / P = a^2 / 4.
    """
    # contact begins at mu = 0.1, below the box of the demo's training
    scene = dataclasses.replace(
        demo.scene(arc_segments=240, pole_ratio=1.035), parameters=space(mu=(0.1, 0.15))
    )
    full_order = hhr.FullOrderModel(scene)
    problem = full_order.problem
    solution = full_order.solve(0.1045)
    forces = solution.forces()
    load, modulus = forces.sum(), 15.0 / (2 * (1 - 0.35**2))
    half_width = np.sqrt(4 * load * 0.5 / (np.pi * modulus))
    assert 0.02 < half_width < 0.06 and solution.active.sum() > 20
    measured = 2 * np.sqrt(forces @ problem.contact_points[:, 0] ** 2 / load)
    assert measured == pytest.approx(half_width, rel=0.03)
    assert (forces / problem.contact_areas).max() == pytest.approx(
        2 * load / (np.pi * half_width), rel=0.03
    )


def test_sizes_of_the_thesis(hertz):
    """Section 1.5.1: 678 nodes and 55 pairs."""
    assert hertz.problem.free.size == 1356
    assert hertz.problem.contact.shape == (55, 1356)


@pytest.mark.parametrize(("length", "stress"), [(1e3, 1e-6), (1.0, 1e-6), (1.0, 1e12), (1e-9, 1.0)])
def test_units_do_not_matter(hertz, hertz_reduction, length, stress):
    """Forces per unit depth scale with stress * length.

    1e-9 relative: round-off times cond(K) ~ 1e5.
    """
    scene = demo.scene(radius=length, gap=0.1 * length)
    bodies = tuple(dataclasses.replace(body, young=body.young * stress) for body in scene.bodies)
    scene = dataclasses.replace(
        scene, bodies=bodies, parameters=space(mu=(0.15 * length, 0.45 * length))
    )
    full_order = hhr.FullOrderModel(scene)
    snapshots = hhr.compute_snapshots(full_order, full_order.problem.parameters.grid([31]))
    reduction = hhr.build(full_order, snapshots, THESIS.as_it_is())
    inside = reduction.offline.sets.A_lambda
    assert np.array_equal(inside, hertz_reduction.offline.sets.A_lambda)
    for mu in (0.168, 0.4321):
        reference = hertz_reduction.solve(mu).forces()
        forces, full = (
            model.solve(mu * length).forces() / (stress * length)
            for model in (reduction, full_order)
        )
        assert full == pytest.approx(hertz.solve(mu).forces(), rel=1e-9, abs=1e-9 * reference.max())
        assert forces[inside] == pytest.approx(reference[inside], abs=1e-9 * reference.max())


def test_a_killed_compilation_names_the_file_to_remove(tmp_path, monkeypatch):
    """FFCx marks what it compiles by a file, which a kill leaves: later runs wait for it in
    vain.
    """

    def killed(*given, **options):
        raise KeyboardInterrupt

    scene = pressed_pair("plane_strain", [(10.0, 0.3), (8.0, 0.3)], cells=2)
    options = jit.get_options() | {"cache_dir": tmp_path, "timeout": 1}
    monkeypatch.setattr(jit, "get_options", lambda *given: options)
    with monkeypatch.context() as patched, pytest.raises(KeyboardInterrupt):
        patched.setattr("ffcx.codegeneration.jit._compile_objects", killed)
        hhr.FullOrderModel(scene)
    (left,) = tmp_path.glob("*.c")
    with pytest.raises(
        FileError, match="waits for another run that compiles it, or that was killed"
    ) as caught:
        hhr.FullOrderModel(scene)
    assert f"remove {left}, and run again" in str(caught.value)
