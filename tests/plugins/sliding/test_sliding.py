"""Bodies that slide past the mesh they were paired on: beside other meshes, the full order, and the
laws.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import sliding_punch as demo
from mpi4py import MPI
from needs import needs
from parts import sliding_punch_study as study
from scenes import pair_scene, slope

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import NotOfferedError, SceneError
from hhr_dolfinx.geometries.two_blocks import FIRST, SECOND, side, two_blocks
from hhr_dolfinx.plugins.sliding.slider import RepairingSlider

CELLS = 60


def drawn(model, *ways, push=demo.PUSH):
    """A history of a punch that is pushed, and drawn to some ways."""
    return model.march(
        [
            (0.0, (0.0, 0.0)),
            (1.0, (push, 0.0)),
            *((2.0 + k, (push, way)) for k, way in enumerate(ways)),
        ]
    )


@pytest.fixture(scope="module")
def smooth():
    return hhr.slide(demo.scene(None, cells=CELLS))


@pytest.fixture(scope="module")
def rough():
    return hhr.slide(demo.scene(cells=CELLS))


def test_without_friction_it_is_as_if_meshed_there(smooth):
    """A mesh of its own, paired where it lies.

    Rows of the pushed place and of the meshed one differ by .3 %.
    """
    history = drawn(smooth, 1.1, 6.05, 3.0)
    for answer, way in zip(history.answers[1:], (1.1, 6.05, 3.0), strict=True):
        assert answer.outputs()["pressed"] == pytest.approx(study.pressed_at(way, CELLS), rel=0.01)
        assert abs(answer.outputs()["drawn"]) < 0.02 * answer.outputs()["pressed"]
    # back where it began, along whichever way, there is no memory: pairings settle to a thousandth
    # of a facet
    back = drawn(smooth, 7.9, 0.0).answers
    np.testing.assert_allclose(
        back[-1].slip.pressure, back[0].slip.pressure, atol=2e-3 * back[0].slip.pressure.max()
    )


def test_rows_where_nothing_has_moved_are_those_of_the_pairing():
    """Pressures and tangential rows on the mesh, from those of the dofs of surfaces.

    Far nodes face nothing.
    """
    scene = demo.scene(cells=CELLS)
    fixed = hhr.FullOrderModel(scene, MPI.COMM_SELF).problem
    model = hhr.slide(scene, condensed=False)
    nothing = np.zeros(len(model.base.problem.gaps))
    paired = RepairingSlider(model).surfaces.paired(nothing, nothing, np.zeros(2))
    rows = (paired.matrix @ model.base.problem.contact).toarray()
    x = [model.slave_points()[:, 0], fixed.contact_points[fixed.law.normal, 0]]
    order, other = (np.argsort(values) for values in x)
    count = order.size
    np.testing.assert_allclose(paired.gap[order], fixed.gaps[:count, 0][other], atol=1e-12)
    for shift in (0, count):
        np.testing.assert_allclose(
            rows[shift + order], fixed.contact.toarray()[shift + other], atol=1e-12
        )


@pytest.mark.parametrize("pairing", [hhr.NodeToSurface, hhr.Mortar])
def test_a_long_step_does_not_pass_through(pairing):
    """Trial overlaps of .25 among cells .05 deep: what lies behind by more than a cell was taken
    for another side.
    """
    scene = demo.scene(None, cells=CELLS)
    pair = pairing(*scene.contacts[0].tags)
    lower, upper = ((-6.0, -4.0), (6.0, 0.0), (CELLS, 80)), ((-1.0, 0.0), (1.0, 1.0), (12, 20))
    thin = dataclasses.replace(
        scene,
        contacts=(pair,),
        parameters=hhr.ParameterSpace(("push", "way"), (0.0, 0.0), (0.3, 8.0)),
        geometry=lambda comm: two_blocks(
            comm, first=lower, second=upper, warp=demo.punch(demo.START)
        ),
    )
    model = hhr.slide(thin)
    pushes = [(float(k), (push, 0.0)) for k, push in enumerate(np.linspace(0.0, 0.25, 11))]
    drawn_ = [(11.0 + k, (0.25, way)) for k, way in enumerate(np.linspace(0.5, 4.0, 8))]
    wanted = model.march([*pushes, *drawn_]).answers[-1].outputs()["pressed"]
    for path in ([pushes[0], pushes[-1]], [pushes[0], pushes[-1], drawn_[-1]]):
        found = model.march(path).answers[-1].outputs()["pressed"]
        exact = wanted if len(path) == 3 else model.march(pushes).answers[-1].outputs()["pressed"]
        assert found > 100
        # pairings settle to a thousandth of a facet: 2e-4 was measured
        assert found == pytest.approx(exact, rel=2e-3)


def test_mistakes_of_a_pair_are_those_of_the_pairing():
    """What never faces where it is meshed is no pair that has left: wrong normals, and bodies in
    each other.
    """
    scene = demo.scene(cells=CELLS)
    tags = scene.contacts[0].tags
    for normal in ((0.0, 1.0), (1.0, 0.0), (0.0, 0.0), (0.0, -1.0, 0.0)):
        for pairing in (hhr.NodeToSurface, hhr.Mortar):
            wrong = dataclasses.replace(scene, contacts=(pairing(*tags, normal),))
            for make in (hhr.slide, lambda scene: hhr.FullOrderModel(scene, MPI.COMM_SELF)):
                with pytest.raises(SceneError):
                    make(wrong)
    deep = dataclasses.replace(scene, geometry=lambda comm: demo.geometry(comm, CELLS, height=-0.5))
    with pytest.raises(SceneError, match="more than a cell"):
        hhr.slide(deep)
    with pytest.raises(SceneError, match="no Scene"):
        hhr.slide(None)


def test_friction_of_a_single_parameter_is_that_of_the_point():
    """While loads grow in proportion the coefficient does not: 27 % of the force else."""
    box = hhr.ParameterSpace(("push", "way", "mu"), (0.0, 0.0, 0.0), (0.05, 8.0, 0.6))
    scene = demo.scene(cells=CELLS)
    pair = dataclasses.replace(scene.contacts[0], friction="mu")
    scene = dataclasses.replace(scene, parameters=box, contacts=(pair,))
    model = hhr.slide(scene)
    found = model.solve((0.03, 0.03, 0.4)).outputs()["drawn"]
    steps = [(float(share), (0.03 * share, 0.03 * share, 0.4)) for share in np.linspace(0, 1, 41)]
    # the tolerance of increments to a single parameter is 1e-3
    assert found == pytest.approx(model.march(steps).answers[-1].outputs()["drawn"], rel=5e-3)


def test_what_is_drawn_bears_coulomb_and_forgets_where_it_was(rough):
    history = drawn(rough, *np.linspace(0.1, 4.0, 40))
    values = study.forces(history)
    # the normals of the punch's place are tilted, by as much on either side: 1 % was measured
    np.testing.assert_allclose(values[10:, 1], demo.FRICTION * values[10:, 0], rtol=0.015)
    assert abs(values[0, 1]) < 0.1 * values[0, 0]
    first, last = (history.answers[k].slip.statuses for k in (0, -1))
    pressed = [history.answers[k].slip.pressure > 0 for k in (0, -1)]
    assert 1 in first and set(last[pressed[1]].tolist()) == {2} and not last[~pressed[1]].any()
    middles = [
        answer.slip.pressure
        @ (rough.slave_points()[:, 0] + answer.parameter[1])
        / answer.slip.pressure.sum()
        for answer in history.answers
    ]
    np.testing.assert_allclose(np.diff(middles[5:]), 0.1, atol=0.03)
    # Archard: pressure times the way along which it slid
    worn = float(history.answers[-1].slip.wear @ rough.law.area)
    assert worn == pytest.approx(values[5:, 0].mean() * 3.9, rel=0.1)


def test_condensed_is_the_full_order(rough):
    full = hhr.slide(demo.scene(cells=CELLS), condensed=False)
    ways = (0.2, 1.0, 5.0, 4.0)
    one, other = drawn(rough, *ways), drawn(full, *ways)
    for found, wanted in zip(one.answers, other.answers, strict=True):
        np.testing.assert_allclose(
            found.multipliers, wanted.multipliers, atol=1e-9 * wanted.multipliers.max()
        )
        np.testing.assert_allclose(found.displacement(), wanted.displacement(), atol=1e-10)


def test_a_punch_that_leaves_the_block_bears_nothing(smooth):
    box = hhr.ParameterSpace(("push", "way"), (0.0, 0.0), (0.05, 40.0))
    model = hhr.slide(dataclasses.replace(demo.scene(None, cells=CELLS), parameters=box))
    answers = drawn(model, 30.0, 1.0).answers
    assert answers[0].outputs()["pressed"] > 1 and answers[1].outputs()["pressed"] == 0.0
    assert answers[2].outputs()["pressed"] == pytest.approx(
        drawn(smooth, 1.0).answers[1].outputs()["pressed"], rel=1e-3
    )


def in_space(axis: int) -> hhr.Scene:
    """A pad on a slab, pushed and drawn along x or y.

    The scene of one is that of the other, turned.
    """

    def warp(points, tag):
        if tag == FIRST:
            return points
        bulge = 0.15 * (points[:, :2] ** 2).sum(axis=1) * (1 - points[:, 2])
        return points + np.column_stack([0 * bulge, 0 * bulge, bulge])

    top = side(SECOND, 2, True)
    moved = dict.fromkeys(range(3), hhr.Amplitude()) | {axis: slope("way"), 2: slope("push", -1.0)}
    return pair_scene(
        "pad",
        {"push": (0.0, 0.05), "way": (0.0, 1.2)},
        ((-2.0, -2.0, -1.0), (2.0, 2.0, 0.0), (16, 16, 3)),
        ((-0.5, -0.5, 0.0), (0.5, 0.5, 1.0), (5, 5, 3)),
        ((1000.0, 0.3),) * 2,
        warp=warp,
        hypothesis="solid",
        contacts=(hhr.NodeToSurface(side(SECOND, 2, False), side(FIRST, 2, True), friction=0.2),),
        displacements=(
            *hhr.Displacement.clamp(side(FIRST, 2, False), 3),
            *(hhr.Displacement(top, k, amplitude) for k, amplitude in moved.items()),
        ),
        outputs=tuple(
            hhr.ContactForce(name, 0, tuple(np.eye(3)[k])) for k, name in enumerate("xyz")
        ),
    )


def test_in_space_it_knows_no_directions():
    along = []
    for axis in (0, 1):
        model = hhr.slide(in_space(axis))
        answers = drawn(model, *np.linspace(0.1, 1.2, 12)).answers
        values = np.array([[answer.outputs()[name] for name in "xyz"] for answer in answers])
        assert answers[0].slip.pressure.max() > 0
        np.testing.assert_allclose(values[5:, axis], -0.2 * values[5:, 2], rtol=0.03)
        np.testing.assert_allclose(values[:, 1 - axis], 0.0, atol=2e-3 * values[:, 2].max())
        along.append(values[:, [axis, 2]])
    np.testing.assert_allclose(along[0], along[1], atol=1e-6 * np.abs(along[0]).max())


@needs("floating", "elasticity")
def test_what_is_not_built_in_is_refused_by_name(rough):
    with pytest.raises(NotOfferedError, match="derivatives of bodies that slide"):
        rough.march(demo.path(2), hhr.MarchSettings(gradient=True))
    scene = demo.scene(cells=CELLS)
    with pytest.raises(NotOfferedError, match="of the full order cannot be kept in a file"):
        hhr.save_model("nowhere.npz", hhr.slide(scene, condensed=False))
    faces = side(SECOND, 1, False), side(FIRST, 1, True)
    pressed = hhr.Pressure(side(SECOND, 1, True), slope("push"))
    changes = {
        "is a NodeToNode": {"contacts": (hhr.NodeToNode(*faces, (0.0, -1.0)),)},
        "'gap' is not built in": {"outputs": (hhr.GapAt("gap", 0, (0.0, 0.0)),)},
        # arms are those of the mesh
        "'turns' is not built in": {"outputs": (hhr.ContactMoment("turns", 0, (0.0, 0.0)),)},
        "contact alone holds": {"displacements": scene.displacements[:3], "loads": (pressed,)},
        "moduli of scene": {"bodies": (hhr.Body(FIRST, "1000 + push", 0.3), scene.bodies[1])},
    }
    for message, change in changes.items():
        with pytest.raises(SceneError, match=message):
            hhr.slide(dataclasses.replace(scene, **change))


def test_pressures_are_those_of_the_slave_nodes(smooth):
    """Forces on dofs of surfaces have no areas, and were divided by them: all pressures were
    NaN.
    """
    answer = drawn(smooth).answers[-1]
    for full in (None, hhr.FullOrderModel(demo.scene(None, cells=CELLS), MPI.COMM_SELF)):
        with pytest.raises(
            NotOfferedError,
            match=r"Pressures of the slave nodes are answer\.slip\.pressure over the areas",
        ):
            answer.pressure(full)
    pressed = answer.slip.pressure / smooth.law.area
    assert pressed @ smooth.law.area == pytest.approx(answer.outputs()["pressed"], rel=0.01)


@needs("plots", "tables")
def test_what_tables_and_fields_say_of_sliding(rough, tmp_path):
    """The whole force of a table is that of the pressures of slave nodes.

    Fields of dofs are refused.
    """
    points = np.array([(0.03, 0.0), (0.02, 0.005)])
    answers = hhr.answer_points(rough, points)
    for point, total in zip(points, answers.total_force, strict=True):
        answer = rough.solve(point)
        assert total == pytest.approx(answer.slip.pressure.sum(), rel=1e-12)
        assert total == pytest.approx(
            answer.outputs()["pressed"], rel=0.05
        )  # normals are tilted by .1 at most
    full = hhr.FullOrderModel(demo.scene(cells=CELLS), MPI.COMM_SELF)
    with pytest.raises(SceneError, match="past their mesh, whose fields are not built in"):
        hhr.write_fields(tmp_path / "fields.vtu", full, answer)
