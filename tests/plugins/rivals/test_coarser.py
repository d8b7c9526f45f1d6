"""A coarser mesh as a rival: exact on the same mesh, better with smaller cells, body by body."""

import dataclasses

import numpy as np
import pytest
from contract import blocks
from hertz_half_discs import scene as half_discs
from mpi4py import MPI

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import NotOfferedError
from hhr_dolfinx.geometries import two_blocks
from hhr_dolfinx.geometries.two_blocks import FIRST, SECOND

pytestmark = pytest.mark.filterwarnings("ignore::hhr_dolfinx.errors.SmallStrainWarning")


def off(model, full, mu):
    """Errors of displacement, forces and their sum, relative."""
    found, exact = model.solve(mu), full.solve(mu)
    apart = found.displacement() - exact.displacement()
    return (
        np.linalg.norm(apart) / np.linalg.norm(exact.displacement()),
        np.linalg.norm(found.forces() - exact.forces()) / np.linalg.norm(exact.forces()),
        abs(found.forces().sum() / exact.forces().sum() - 1),
    )


def test_the_same_mesh_is_exact(hertz):
    model = hhr.CoarserMesh(hertz, half_discs())
    assert model.sizes == hertz.sizes
    assert max(off(model, hertz, 0.31)) < 1e-12
    stress = model.solve(0.31).stress()
    np.testing.assert_allclose(stress, hertz.solve(0.31).stress(), atol=1e-9 * abs(stress).max())


def test_errors_fall_with_the_size_of_cells(hertz):
    """Both discs of second rate: four times as many cells halve errors at least."""
    coarse, finer = (
        hhr.CoarserMesh(hertz, half_discs(arc_segments=segments, flat_segments=segments // 4))
        for segments in (16, 32)
    )
    for mu in (0.25, 0.43):
        first, second = off(coarse, hertz, mu), off(finer, hertz, mu)
        assert second[0] < 0.6 * first[0] < 0.05
        assert second[2] < 0.7 * first[2] < 0.1


def test_bodies_that_touch_keep_their_own_displacements():
    """A flank that is pushed slides on the body below: points of the interface are in both."""
    scene = blocks()
    full = hhr.FullOrderModel(scene, MPI.COMM_SELF)
    model = hhr.CoarserMesh(full, scene)
    corner = scene.parameters.upper
    assert max(off(model, full, corner)) < 1e-12


def test_what_is_not_the_same_scene_is_refused(hertz):
    scene = half_discs()
    wider = dataclasses.replace(
        scene, parameters=hhr.ParameterSpace(("mu",), (0.15,), (0.5,)), parameter_units={}
    )
    with pytest.raises(NotOfferedError, match="its parameters differ"):
        hhr.CoarserMesh(hertz, wider)


def rings(count):
    """A ring within a ring, of so many cells around: sides that face each other are far apart."""

    def warp(points, _):
        angles = 2 * np.pi * points[:, 1]
        return points[:, :1] * np.column_stack([np.cos(angles), np.sin(angles)])

    inner, outer = two_blocks.side(FIRST, 0, False), two_blocks.side(SECOND, 0, True)
    push = hhr.Amplitude(slopes={"px": -0.01})
    return hhr.Scene(
        name="rings",
        geometry=lambda comm: two_blocks.two_blocks(
            comm,
            first=((1.0, 0.0), (2.0, 1.0), (2, count)),
            second=((2.0, 0.0), (3.0, 1.0), (2, count)),
            warp=warp,
            closed=1,
        ),
        hypothesis="plane_strain",
        bodies=(hhr.Body(FIRST, 200.0, 0.3), hhr.Body(SECOND, 70.0, 0.3)),
        contacts=(
            hhr.NodeToSurface(two_blocks.side(FIRST, 0, True), two_blocks.side(SECOND, 0, False)),
        ),
        parameters=hhr.ParameterSpace(("px",), (0.5,), (1.5,)),
        displacements=(
            *hhr.Displacement.clamp(inner, 2),
            hhr.Displacement(outer, 0, push),
            hhr.Displacement(outer, 1),
        ),
    )


@pytest.mark.filterwarnings("ignore")
def test_pressures_of_a_ring_stay_on_their_side():
    """The same ring is exact; of half as many cells the open side stays open."""
    full = hhr.FullOrderModel(rings(48), MPI.COMM_SELF)
    assert max(off(hhr.CoarserMesh(full, rings(48)), full, 1.0)) < 1e-12
    model = hhr.CoarserMesh(full, rings(24))
    exact, found = full.solve(1.0).forces(), model.solve(1.0).forces()
    opened = full.problem.contact_points[:, 0] < -1.0
    assert exact[opened].max() < 1e-6 * exact.max()
    assert found[opened].max() < 1e-6 * exact.max()
    assert found.sum() == pytest.approx(exact.sum(), rel=0.05)


@pytest.mark.parametrize(
    ("changed", "reason"),
    [
        ({"bodies": blocks().bodies[::-1]}, "its bodies differ"),
        ({"hypothesis": "plane_stress"}, "its hypothesis differ"),
        ({"contacts": (hhr.Obstacle(two_blocks.side(FIRST, 1, True), (0, 1), 1.1),)}, "contacts"),
    ],
)
def test_scenes_that_are_not_alike_are_refused(changed, reason):
    scene = blocks()
    full = hhr.FullOrderModel(scene, MPI.COMM_SELF)
    with pytest.raises(NotOfferedError, match=reason):
        hhr.CoarserMesh(full, dataclasses.replace(scene, **changed))


def test_tables_of_a_coarser_mesh(hertz):
    model = hhr.CoarserMesh(hertz, half_discs(arc_segments=28, flat_segments=7))
    table = hhr.answer_points(model, [[0.2], [0.4]])
    assert "2 rows, 2 ok" in repr(table)


def test_rivals_of_a_study_may_be_a_coarser_mesh(hertz):
    """As the documentation says it."""
    training = hhr.train(hertz.scene, [5], held_out=0, comm=MPI.COMM_SELF)
    coarse = half_discs(arc_segments=28, flat_segments=7)
    rival = hhr.Rival(
        "coarser mesh", "28 segments", lambda: hhr.CoarserMesh(training.full_order, coarse)
    )
    settings = hhr.StudySettings([5], tests=6, queries=6, naive=False)
    rows = hhr.run_study(training, settings, rivals=[rival]).report["work_precision"]
    (row,) = [row for row in rows if row["method"] == "coarser mesh"]
    assert 0 < row["dual_full_floored_p95"] < 0.3
