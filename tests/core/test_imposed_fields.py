"""Imposed displacements that depend on the place, and rings that close."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from mpi4py import MPI
from needs import needs
from scenes import block_scene, pair_scene, slope, space

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.geometries import block
from hhr_dolfinx.geometries.two_blocks import FIRST, SECOND, side, two_blocks

INNER, OUTER, LENGTH, YOUNG = 8.0, 10.0, 20.0, 2.6
"""Of a ring; with Poisson's ratio .3 the shear modulus is one."""


def ring(comm):
    """A ring within another one that it does not touch."""

    def warp(points, _):
        angle = 2 * np.pi * points[:, 1]
        return np.column_stack(
            [points[:, 0] * np.cos(angle), points[:, 0] * np.sin(angle), points[:, 2]]
        )

    first = (INNER, 0.0, 0.0), (OUTER, 1.0, LENGTH), (3, 48, 8)
    second = (OUTER + 1.0, 0.0, 0.0), (OUTER + 2.0, 1.0, LENGTH), (1, 48, 1)
    return two_blocks(comm, first=first, second=second, warp=warp, closed=1)


def twisted(*fields, **others) -> hhr.Scene:
    """The inner ring, clamped at one end and moved at the other."""
    end = side(FIRST, 2, True)
    given = {
        "geometry": ring,
        "hypothesis": "solid",
        "contacts": (
            hhr.NodeToNode(side(FIRST, 0, True), side(SECOND, 0, False), (1.0, 0.0, 0.0)),
        ),
        "displacements": (
            *hhr.Displacement.clamp(side(FIRST, 2, False), 3),
            hhr.Displacement(end, 2),
            *(
                hhr.Displacement(end, axis, slope("turn"), field)
                for axis, field in enumerate(fields)
            ),
            *hhr.Displacement.clamp(side(SECOND, 2, False), 3),
        ),
    }
    return pair_scene(
        "twisted", {"turn": (0.0, 0.01)}, None, None, ((YOUNG, 0.3), (YOUNG, 0.3)), **given | others
    )


@needs("nonmatching")
def test_a_ring_that_is_turned_bears_the_torque_of_its_section():
    """T = G J θ / L with J = π (R^4 - r^4) / 2, from the strain energy T θ / 2.

    Facets take 1 % of the section.
    """
    radial = hhr.NodeToSurface(side(FIRST, 0, True), side(SECOND, 0, False))
    full = hhr.FullOrderModel(twisted("-y", "x", contacts=(radial,)), MPI.COMM_SELF)
    turn = 0.01
    moved = full.solve(turn).displacement()
    polar = 0.5 * np.pi * (OUTER**4 - INNER**4)
    assert moved @ (full.problem.stiffness_terms[0] @ moved) / turn == pytest.approx(
        polar * turn / LENGTH, rel=0.015
    )
    # no seam: all meridians move alike
    points, moved = full.problem.points, moved.reshape(-1, 3)
    own = np.isclose(np.hypot(points[:, 0], points[:, 1]), OUTER) & np.isclose(
        points[:, 2], LENGTH / 2
    )
    along = (points[own, 0] * moved[own, 1] - points[own, 1] * moved[own, 0]) / OUTER
    assert own.sum() == 48
    np.testing.assert_allclose(along, 0.5 * turn * OUTER, rtol=1e-10)


@pytest.mark.parametrize(("cells", "closed"), [(2, 1), (1, 1), (8, 5), (8, True), (8, "z")])
def test_rings_that_cannot_close(cells, closed):
    """Of two cells both would have the same corners, of which no mesh can be made."""
    box = (0.0, 0.0), (1.0, 1.0), (2, cells)
    with pytest.raises(ValueError, match="three cells at least"):
        two_blocks(MPI.COMM_SELF, first=box, second=((2.0, 0.0), (3.0, 1.0), (2, 8)), closed=closed)


@pytest.mark.parametrize(
    ("field", "message"),
    [
        ("turn * x", "names .*'turn'.*coordinates are"),
        ("1 / (x - x)", "is not finite"),
        ("x +", "cannot be read"),
    ],
)
def test_fields_that_cannot_be(field, message):
    with pytest.raises(SceneError, match=message):
        hhr.FullOrderModel(twisted("-y", field), MPI.COMM_SELF)


def shearing(*fields, gap=0.5) -> hhr.Scene:
    """A square above a plane whose sides are moved by one parameter; None leaves one free."""
    sides = (block.side(0, False), block.side(0, True), block.side(1, True))
    return block_scene(
        "shearing",
        {"load": (0.0, 0.1)},
        contacts=(hhr.Obstacle(block.side(1, False), (0.0, -1.0), gap),),
        displacements=tuple(
            hhr.Displacement(tag, axis, slope("load"), field)
            for tag, pair in zip(sides, fields, strict=True)
            for axis, field in enumerate(pair or ())
        ),
    )


def test_a_linear_field_goes_on_inside():
    """A patch test: what is imposed on three sides is linear, and without stress on the fourth, so
    all of it is.
    """
    turn = (
        "-y",
        "x",
    )  # pure shear, ("y", "x"), has a traction on the lower side, which none imposes
    full = hhr.FullOrderModel(shearing(turn, turn, turn), MPI.COMM_SELF)
    points = full.problem.points
    expected = 0.1 * np.column_stack([-points[:, 1], points[:, 0]])
    np.testing.assert_allclose(full.solve(0.1).displacement().reshape(-1, 2), expected, atol=1e-14)
    # values that differ where sides meet are refused, those that are equal there are not
    with pytest.raises(SceneError, match="impose different values on one node"):
        hhr.FullOrderModel(shearing(turn, ("y", "x"), turn), MPI.COMM_SELF)


@needs("shapes")
def test_fields_know_the_mesh_before_shapes_move_it():
    scene = shearing(None, None, ("0 * x", "-x"), gap=0.02)
    wide = hhr.Shape(block.SOLID, ("wide * x", "y"))
    scene = dataclasses.replace(
        scene, parameters=space(load=(0.0, 0.1), wide=(1.0, 2.0)), shapes=(wide,)
    )
    full = hhr.FullOrderModel(scene, MPI.COMM_SELF)
    answer = full.solve((0.1, 2.0))
    corner = np.linalg.norm(
        full.problem.at(np.array([0.1, 2.0])).points - (2.0, 1.0), axis=1
    ).argmin()
    np.testing.assert_allclose(
        answer.displacement().reshape(-1, 2)[corner], (0.0, -0.1), atol=1e-14
    )
    assert answer.active.any()
    # what a model interpolates between shapes is the same, whose grid has settled to 1e-5 of what
    # varies
    found, exact = (model.solve((0.07, 1.3)) for model in (hhr.condense(full, fields=True), full))
    np.testing.assert_allclose(found.displacement(), exact.displacement(), atol=1e-7)


@needs("friction", "mortar", "shapes", "volume_loads")
def test_a_press_fit_slips_as_a_whole_at_the_torque_of_its_pressures():
    """What slips as a whole bears f times the pressure at its radius, less what slip along the axis
    takes.
    """
    import press_fit_torque
    from parts import press_fit_torque_study

    full = hhr.FullOrderModel(press_fit_torque.scene(around=12, along=6, radial=2), MPI.COMM_SELF)
    design = np.array([0.02, 0.15, 10.0, 150e3, 10.0])
    exact, found = (
        one.march(press_fit_torque_study.path(design)) for one in (full, hhr.condense(full))
    )
    wanted = press_fit_torque_study.torques(exact)
    np.testing.assert_allclose(
        press_fit_torque_study.torques(found), wanted, rtol=1e-5, atol=1e-3
    )  # 1e-7 was measured
    last = exact.answers[-1]
    assert set(last.slip.statuses.tolist()) == {2}
    pressed = last.multipliers[full.problem.law.normal].sum()
    # torque already turns the slip along the axis, which the shrinking left, by some tenths of a
    # percent
    assert wanted[-1] == pytest.approx(design[1] * pressed * press_fit_torque.RADIUS, rel=1e-2)
    assert (
        wanted[0] == pytest.approx(0.0, abs=1e-6 * wanted[-1]) and (np.diff(wanted[:4]) > 0).all()
    )
