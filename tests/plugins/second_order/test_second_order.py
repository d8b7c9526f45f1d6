"""Cells of second order: patch tests, curved sides, rates, locking, and all that is reduced from
them.
"""

from __future__ import annotations

import dataclasses
from functools import partial

import contact_patch_test as patch
import contract
import hertz_half_discs
import numpy as np
import pytest
from mpi4py import MPI
from needs import DOUBLE_PASS, MORTAR, NODE_TO_SURFACE, needs
from scenes import slope, stacked
from second_order import bowl, rings
from shell import invoke

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import LockingWarning, PairingWarning, ParameterError
from hhr_dolfinx.geometries.two_blocks import FIRST, SECOND, side, two_blocks
from hhr_dolfinx.warn import collected, ignored

pressed = partial(stacked, order=2)


@needs("floating")
@pytest.mark.parametrize("simplices", [False, True])
@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize(
    "pairing",
    [
        "node to node",
        *(
            pytest.param(name, marks=needs("nonmatching"))
            for name in ("node to surface", "double pass")
        ),
        pytest.param("mortar", marks=needs("mortar")),
        "obstacle",
    ],
)
def test_a_constant_pressure_passes(dim, simplices, pairing):
    """Patch test: 5e-12 was measured.

    Areas are positive, also at the corners of six-node triangles.
    """
    full = hhr.FullOrderModel(
        pressed(dim, simplices, pairing, alike=pairing != "mortar"), MPI.COMM_SELF
    )
    areas = full.problem.contact_areas
    assert areas.min() > 0
    np.testing.assert_allclose(full.solve({"p": 0.5}).forces() / areas, 0.5, rtol=1e-10)


def test_forces_on_tetrahedra_are_four_times_as_good_with_as_many_unknowns():
    """Beside hexahedra of second order, 46,875 dofs: 1.4 % off with linear functions, .18 % with
    quadratic ones.
    """
    force = 0.01323671
    errors = []
    for cells, order in ((12, 1), (6, 2)):
        full = hhr.FullOrderModel(bowl(cells, order), MPI.COMM_SELF)
        assert len(full.problem.free) == 6591
        errors.append(abs(full.solve({"push": 0.05}).forces().sum() / force - 1))
    assert errors[1] < 0.004 and errors[0] > 4 * errors[1]


@needs("plots")
@pytest.mark.parametrize(
    ("cells", "order", "stress", "peak"), [(6, 1, 0.252, 0.068), (6, 2, 0.045, 0.024)]
)
def test_the_error_of_the_mesh_is_estimated(cells, order, stress, peak):
    """Beside hexahedra of second order, 46,875 dofs: the estimates were .261 and .073, .040 and
    .056.
    """
    full = hhr.FullOrderModel(bowl(cells, order), MPI.COMM_SELF)
    found = hhr.mesh_error(full, full.solve({"push": 0.05}))
    assert found.energy == pytest.approx(stress, rel=0.2)
    assert peak < found.peak_pressure < 3 * peak
    away = hhr.mesh_error(full, full.solve({"push": 0.0}))
    assert away.energy == 0.0 or away.energy < 1.0
    assert np.isnan(away.peak_pressure)


@needs("plots")
def test_no_error_where_the_mesh_leaves_nothing_out():
    """A constant stress: recovered it is what it was."""
    full = hhr.FullOrderModel(pressed(2, True, "node to node"), MPI.COMM_SELF)
    assert max(hhr.mesh_error(full, full.solve({"p": 0.5}))) < 1e-6


@needs("plots")
def test_a_check_says_the_order_and_the_error_of_the_mesh(tmp_path):
    (tmp_path / "scene.py").write_text(
        "import sys\nfrom dataclasses import replace\nimport hertz_half_discs as demo\n"
        "def scene():\n    return replace(demo.scene(), order=2)\n"
    )
    code, said = invoke(
        "check", tmp_path / "scene.py", "--mesh-error", "--picture", tmp_path / "scene.png"
    )
    assert code == 0 and "cells of second order" in said, said
    assert "% of the peak pressure" in " ".join(said.split())
    assert (tmp_path / "scene.png").exists()


def second(scene, **changes):
    return dataclasses.replace(scene, order=2, **changes)


@pytest.fixture(scope="module")
def training():
    return hhr.train(second(contract.blocks()), hhr.Sobol(24), held_out=20, comm=MPI.COMM_SELF)


@needs("exact_errors")
def test_reduced_models_are_as_good_as_of_first_order(training):
    """Condensation is exact; bounds hold and are those of the error.

    1e-3 was measured as on first order.
    """
    full = training.full_order
    model, condensed = training.build(), training.condense()
    for point in full.parameters.random(10, 3):
        exact, found = full.solve(point), model.solve(point)
        np.testing.assert_allclose(
            condensed.solve(point).forces(), exact.forces(), rtol=1e-8, atol=1e-12
        )
        size = np.linalg.norm(exact.forces())
        error, known = np.linalg.norm(found.forces() - exact.forces()), found.estimate()
        assert error <= known.forces_euclid * (1 + 1e-9) + 1e-12 and error < 0.02 * size
        assert found.outputs()["force"] == pytest.approx(exact.outputs()["force"], rel=0.01)


@needs("plots")
def test_pictures(training, tmp_path):
    import pyvista

    from hhr_dolfinx.plugins.plots.fields import write_fields

    full = training.full_order
    answer = full.solve(full.parameters.middle)
    write_fields(tmp_path / "fields.vtu", full, answer)
    grid = pyvista.read(tmp_path / "fields.vtu")
    assert grid.n_points == len(full.problem.points)
    pressures = answer.forces() / full.problem.contact_areas
    np.testing.assert_allclose(
        grid.point_data["contact_pressure"].max(), pressures.max(), rtol=1e-12
    )
    # quadrilaterals of nine nodes
    assert {kind for kind in grid.celltypes.tolist()} == {70}


@needs("friction", "mortar")
def test_friction_slips_with_its_coefficient():
    """All of it slips under a shear that it cannot bear: tangential forces are .2 of pressures, by
    mortar and nodes.
    """
    for pairing in (hhr.NodeToNode, hhr.Mortar):
        faces = side(FIRST, 1, True), side(SECOND, 1, False)
        contacts = (pairing(*faces, (0.0, 1.0), friction=0.2),)
        full = hhr.FullOrderModel(
            second(contract.blocks(friction=0.2), contacts=contacts), MPI.COMM_SELF
        )
        low = np.array(full.parameters.lower)
        answer = full.march([(0.0, low), (1.0, [0.05, 0.0]), (2.0, [0.05, 0.1])]).answers[-1]
        forces, friction = answer.forces(), full.law
        tangential, bound = (
            np.abs(forces[friction.tangential]),
            0.2 * forces[friction.normal][friction.owner],
        )
        assert (tangential <= bound * (1 + 1e-9)).all()
        slips = answer.slip.statuses[friction.owner] == 2
        np.testing.assert_allclose(tangential[slips], bound[slips], rtol=1e-9)


@needs("moduli")
@pytest.mark.filterwarnings(
    "ignore:displacements are of second order:hhr_dolfinx.errors.PairingWarning"
)
def test_shapes_as_parameters():
    scene = second(contract.blocks(box=contract.SHAPE, shapes=(contract.crowned(),)))
    training = hhr.train(scene, hhr.Sobol(8), held_out=0, comm=MPI.COMM_SELF)
    point = training.full_order.parameters.middle
    exact = training.full_order.solve(point).forces()
    np.testing.assert_allclose(
        training.condense().solve(point).forces(), exact, rtol=1e-6, atol=1e-9
    )


@needs("floating", "friction")
@pytest.mark.parametrize("pairing", [hhr.NodeToNode, NODE_TO_SURFACE, DOUBLE_PASS, MORTAR])
@pytest.mark.parametrize("simplices", [False, True])
def test_what_slides_far_is_known_by_nodes_of_the_other_body(pairing, simplices):
    """Conditions name neighbours of their slave too: the distance is that between nodes of the
    master.
    """
    contacts = (pairing(side(FIRST, 1, True), side(SECOND, 1, False), (0.0, 1.0), friction=0.2),)
    full = hhr.FullOrderModel(
        pressed(2, simplices, "node to node", contacts=contacts), MPI.COMM_SELF
    )
    np.testing.assert_allclose(full.law.spacing, 1 / 6, rtol=1e-6)
    resting = pressed(2, simplices, "obstacle")
    rough = dataclasses.replace(resting.contacts[0], friction=0.2), *resting.contacts[1:]
    full = hhr.FullOrderModel(dataclasses.replace(resting, contacts=rough), MPI.COMM_SELF)
    assert not full.law.spacing.any()


def warned_of_sag(scene):
    with collected() as caught:
        hhr.FullOrderModel(scene, MPI.COMM_SELF)
    return any("the gap is one of the mesh" in str(item.message) for item in caught)


def test_gaps_of_chords_are_told_of_and_those_of_curved_sides_are_not():
    """Displacements of second order on straight sides do not mend a gap.

    Arcs of 10 degrees are off by 1e-5.
    """
    straight = rings(0.2, 1)
    pressing = (hhr.Opening(0, hhr.Amplitude(-0.002)),)
    assert warned_of_sag(dataclasses.replace(straight, openings=pressing))
    assert warned_of_sag(second(straight, openings=pressing))
    assert not warned_of_sag(dataclasses.replace(rings(0.2, 2), openings=pressing))
    assert warned_of_sag(
        dataclasses.replace(rings(1.0, 2), openings=(hhr.Opening(0, hhr.Amplitude(-2e-4)),))
    )


def test_displacements_of_second_order_on_straight_sides_of_a_round_are_told_of():
    """The largest pressure beside that of Hertz for the same force, sqrt(F E / (2 (1 - nu^2) pi
    R*)) of two discs.

    1.4 % off of first order, 32 % of second order.
    """
    outputs = hhr.LargestPressure("p0", 0), hhr.ContactForce("force", 0, (0.0, 1.0))
    coarse = hertz_half_discs.scene(arc_segments=28, flat_segments=7)
    off = []
    for order in (1, 2):
        with collected() as caught:
            full = hhr.FullOrderModel(
                dataclasses.replace(coarse, order=order, outputs=outputs), MPI.COMM_SELF
            )
        told = any(
            "straight" in str(item.message) and "order=1" in str(item.message) for item in caught
        )
        assert told == (order == 2)
        found = full.solve({"mu": 0.15}).outputs()
        body = coarse.bodies[0]
        off.append(
            found["p0"] / np.sqrt(abs(found["force"]) * body.young / (1 - body.poisson**2) / np.pi)
            - 1
        )
    assert abs(off[0]) < 0.06 < 0.3 < off[1]


@needs("floating", "elasticity")
def test_pressures_of_nodes_near_incompressibility_are_told_of():
    """Of elastic bodies alone: what flows bears its limit load to 1 %, and is no mistake."""
    stiff = hhr.Body(FIRST, 3.0, 0.3), hhr.Body(SECOND, 5.0, 0.499)
    with pytest.warns(
        LockingWarning, match=r"body 2 .* nu = 0\.499.* single nodes alternate.* refine"
    ):
        hhr.FullOrderModel(pressed(2, False, "node to node", bodies=stiff), MPI.COMM_SELF)


@needs("mortar")
@pytest.mark.parametrize("swapped", [False, True])
def test_a_slave_beyond_the_edge_of_its_master(swapped):
    """Flat parts count that lie in front of the master: the force is that of mortar to 1 %."""
    first, second = ((0.0, 0.0), (1.0, 1.0), (4, 4)), ((0.35, 1.0), (1.35, 2.0), (4, 4))
    faces = [side(FIRST, 1, True), side(SECOND, 1, False)][:: -1 if swapped else 1]
    top = hhr.Displacement(side(SECOND, 1, True), 1, slope("p", -0.02))
    held = [hhr.Displacement(side(FIRST, 1, False), axis) for axis in (0, 1)]
    held += [hhr.Displacement(side(SECOND, 1, True), 0), top]
    found = []
    for pairing in (hhr.NodeToSurface, hhr.Mortar):
        scene = pressed(
            2, False, "node to node", contacts=(pairing(*faces),), displacements=held, loads=()
        )
        scene = dataclasses.replace(
            scene, geometry=lambda comm: two_blocks(comm, first=first, second=second)
        )
        with ignored(PairingWarning):
            full = hhr.FullOrderModel(scene, MPI.COMM_SELF)
        assert full.problem.contact_areas.min() > 0
        found.append(full.solve({"p": 1.0}).forces().sum())
    assert found[0] == pytest.approx(found[1], rel=0.01)


@pytest.mark.filterwarnings(
    "ignore:displacements are of second order:hhr_dolfinx.errors.PairingWarning"
)
def test_conditions_at_imposed_displacements_are_independent(hertz):
    """The ends of the arcs are held: with a function of their own there, rows of B were
    dependent.
    """
    full = hhr.FullOrderModel(second(hertz_half_discs.scene()), MPI.COMM_SELF)
    values = np.linalg.svd(full.problem.contact.toarray(), compute_uv=False)
    assert values[-1] > 0.2 * values[0]
    assert full.solve(0.3).forces().sum() == pytest.approx(
        hertz.solve(0.3).forces().sum(), rel=0.02
    )
    assert full.problem.contact_areas.min() > 0


@needs("floating", "nonmatching")
def test_a_coarse_slave_is_told_to_take_mortar():
    with pytest.warns(PairingWarning, match="Take Mortar"):
        hhr.FullOrderModel(pressed(2, False, "node to surface", alike=False), MPI.COMM_SELF)
    nested = patch.scene(
        hhr.NodeToSurface, (6, 2), (3, 2), poisson=0.3
    )  # nodes of the slave lie on nodes
    with pytest.warns(PairingWarning, match="Take Mortar"):
        hhr.FullOrderModel(dataclasses.replace(nested, order=2), MPI.COMM_SELF)


@needs("plots", "floating")
def test_the_error_of_the_mesh_is_that_of_an_answer_of_its_scene():
    full = hhr.FullOrderModel(pressed(2, False, "node to node"), MPI.COMM_SELF)
    other = hhr.FullOrderModel(pressed(2, False, "node to node", order=1), MPI.COMM_SELF).solve(
        {"p": 0.5}
    )
    with pytest.raises(ParameterError, match="of another scene or mesh"):
        hhr.mesh_error(full, other)
    with pytest.raises(ParameterError, match="an answer"):
        hhr.mesh_error(full, {"p": 0.5})
