"""Shapes that depend on parameters: the mesh moved in the geometry function, closed forms, the
door.
"""

import dataclasses

import numpy as np
import pytest
import scenes
from mpirun import launch
from needs import cases_of, needs
from processes import folders_of
from scenes import (
    check_alike,
    check_contact_conditions,
    largest_difference,
    meshed,
    pressed_block,
    pressed_pair,
    slope_errors,
)

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import NotSolvableError, ParameterError, SceneError
from hhr_dolfinx.geometries import block, two_blocks

BODIES = ("E1", 0.3), (4.0, 0.25)
SPACE = {"E1": (1.0, 6.0), "crown": (0.0, 0.03), "tall": (0.8, 1.2)}
MOVED = {"push": 0.008, "slide": 0.01, "load": 0.05, "gap": 0.002}
POINT = MOVED | {"E1": 2.0, "crown": 0.025, "tall": 0.9}
AT = list(POINT.values())
CROWNED = hhr.Shape(1, ("x", "1 + (y - 1) * tall - crown * y * (x - 1.5)**2"))
MESHES = {
    "plane_strain": {"cells": 4},
    "plane_stress": {"cells": 4, "simplices": True, "matching": False},
}


BY_RULE = 1e-5
"""On distorted quadrilaterals the integrand of K is no polynomial, and a scene with shapes may take
another rule for it than a plain one: far below the error of the mesh.
"""


def check_like(answer, other, tolerance=BY_RULE):
    """Fields of two answers on one mesh; the rows of the second may come in another order."""
    rows, others = (item.fields.problem.at(item.parameter) for item in (answer, other))
    first, second = (
        np.lexsort((item.contact_slaves, item.contact_pairs)) for item in (rows, others)
    )
    assert largest_difference(rows.contact_points[first], others.contact_points[second]) < 1e-12
    assert largest_difference(rows.contact_areas[first], others.contact_areas[second]) < 1e-12
    assert np.array_equal(answer.active[first], other.active[second])
    assert largest_difference(answer.forces()[first], other.forces()[second]) < tolerance
    for name in ("displacement", "stress"):
        assert largest_difference(getattr(answer, name)(), getattr(other, name)()) < tolerance, name


@pytest.fixture(scope="module", params=cases_of(MESHES))
def pair(request):
    """Two blocks, the lower one with a crown and a height, and matching nodes or not."""
    scene = pressed_pair(request.param, BODIES, SPACE, shapes=(CROWNED,), **MESHES[request.param])
    return hhr.FullOrderModel(scene)


def test_at_a_point_it_is_the_plain_scene_meshed_there(pair):
    hypothesis = pair.scene.hypothesis
    geometry = meshed(pair.scene, AT).geometry
    numbers = pressed_pair(
        hypothesis, ((2.0, 0.3), BODIES[1]), geometry=geometry, **MESHES[hypothesis]
    )
    plain = hhr.FullOrderModel(numbers)
    expected = plain.solve(MOVED)
    assert (
        0 < expected.active.sum() < len(expected.active)
    )  # the crown has lost contact at its ends
    pair.solve([*MOVED.values(), 5.0, 0.0, 1.2])
    found = pair.solve(POINT)
    tolerance = 1e-11 if MESHES[hypothesis].get("simplices") else BY_RULE
    check_like(found, expected, tolerance)
    problem = pair.problem.at(POINT)
    check_contact_conditions(problem, found.displacement(), found.forces(), found.parameter)
    for name in ("stiffness", "mass"):
        assert (
            largest_difference(
                getattr(problem, name).toarray(), getattr(plain.problem, name).toarray()
            )
            < tolerance
        )


def test_conditions_keep_their_order_and_the_mesh_its_place(pair):
    """Asking for other shapes leaves no trace."""
    base, before = pair.problem, pair.discretisation.mesh.geometry.x.copy()
    for point in pair.parameters.random(5, seed=2):
        problem = base.at(point)
        assert np.array_equal(problem.contact_slaves, base.contact_slaves)
        assert np.array_equal(problem.contact_pairs, base.contact_pairs)
        assert not problem.varies and problem.contact.nnz >= len(problem.gaps)
    assert np.array_equal(pair.discretisation.mesh.geometry.x, before)
    at_middle = base.at(base.middle)
    assert largest_difference(at_middle.stiffness.toarray(), base.stiffness.toarray()) < 1e-14
    assert np.array_equal(at_middle.points, base.points)
    answer = pair.solve(POINT)
    assert largest_difference(pair.stress_of(answer.displacement(), POINT), answer.stress()) < 1e-14


def test_gradients_are_those_of_differences(pair):
    """Both difference the assembly, with steps of their own."""
    assert slope_errors(pair, AT).max() < 1e-5


@needs("nonmatching")
def test_interpolated_condensation_answers_at_shapes_that_were_not_trained():
    scene = pressed_pair("plane_stress", BODIES, SPACE, shapes=(CROWNED,), cells=3, matching=False)
    training = hhr.train(scene, hhr.Sobol(32), held_out=8)
    model, full = training.condense(), training.full_order
    check_alike(
        full, model, full.parameters.random(6, seed=5), forces=1e-3, displacement=1e-3, stress=1e-2
    )
    assert slope_errors(model, AT).max() < 1e-5
    exact, found = (item.solve(AT, gradient=True).gradient for item in (full, model))
    box = np.subtract(full.parameters.upper, full.parameters.lower)
    assert largest_difference(found.multipliers * box, exact.multipliers * box) < 1e-3


def test_the_store_tells_shapes_apart(tmp_path, pair):
    """Two maps that agree in the middle of the box."""
    other = hhr.Shape(1, ("x", "1 + (y - 1) * (1 + 2 * (tall - 1)) - crown * y * (x - 1.5)**2"))
    moved = hhr.FullOrderModel(dataclasses.replace(pair.scene, shapes=(other,)))
    point = np.array([AT])
    for model in (pair, moved):
        for again in (0, 1):
            store = hhr.SnapshotStore(tmp_path, model)
            found = hhr.compute_snapshots(model, point, store=store)
            assert store.found == again
            assert largest_difference(found.forces[:, 0], model.solve(point[0]).forces()) < 1e-9
    assert len(list(tmp_path.glob("*.npz"))) == 2


def tall_block(hypothesis="plane_stress", shape=("w * x", "h * y"), space=None, **others):
    """A block on an obstacle, ``w`` times as wide and ``h`` times as high."""
    parameters = scenes.space(push=(0.0, 0.1), w=(0.5, 2.0), h=(0.5, 2.0), **space or {})
    shapes = (hhr.Shape(block.SOLID, shape),)
    return dataclasses.replace(
        pressed_block(hypothesis), **{"parameters": parameters, "shapes": shapes} | others
    )


def test_a_block_of_any_size_on_an_obstacle():
    """Uniform stress: p = E (push - gap) / (2 h) over a width of 1.5 w, and the gradient of it."""
    model = hhr.FullOrderModel(tall_block())
    for push, w, h in ((0.05, 0.7, 1.6), (0.1, 2.0, 0.5), (0.02, 1.0, 1.0)):
        answer = model.solve([push, w, h], gradient=True)
        pressure = 3.0 * (push - 0.01) / (2 * h)
        total = 1.5 * w * pressure
        assert answer.forces().sum() == pytest.approx(total, rel=1e-11)
        assert answer.stress()[:, 1] == pytest.approx(np.full(16, -pressure), rel=1e-11)
        slopes, found = (
            [1.5 * w * 3.0 / (2 * h), total / w, -total / h],
            answer.gradient.multipliers.sum(axis=0),
        )
        assert found[0] == pytest.approx(slopes[0], rel=1e-9)
        if push < 0.1:
            assert found == pytest.approx(slopes, rel=1e-8)
    assert not model.solve([0.005, 1.0, 1.0]).forces().any()


def check_fit(space, shape, misfit):
    """A condensed block that touches an obstacle to round-off in the middle of the box, by uniform
    stress.

    With a height of 2.3 and a misfit d, p = E (push + d) / (2.3 + d), the bottom moves by d and the
    top by -push.
    """
    obstacle = hhr.Obstacle(block.side(1, False), (0.0, -1.0), 0.3)
    scene = tall_block(
        shape=("x", shape), contacts=(obstacle,), parameters=scenes.space(push=(0.01, 0.1), **space)
    )
    model = hhr.condense(scene, fields=True)
    for mu in scene.parameters.random(5, seed=1):
        answer = model.solve(mu)
        d = misfit(*mu[1:])
        pressure = 3.0 * (mu[0] + d) / (2.3 + d)
        assert answer.forces().sum() == pytest.approx(1.5 * max(pressure, 0.0), rel=1e-7, abs=1e-12)
        if pressure > 0:
            ends = answer.displacement().reshape(-1, 2)[:, 1]
            assert (ends.min(), ends.max()) == pytest.approx((-mu[0], d), rel=1e-5, abs=1e-7)
    assert answer.estimate() is not None


@pytest.mark.parametrize(
    ("space", "depth", "misfit"),
    [
        pytest.param({"d": (-0.005, 0.005)}, "0.1 + 0.2 + d", lambda d: d, id="misfit"),
        pytest.param(
            {"a": (-0.1, 0.1), "b": (-0.1, 0.1)},
            "0.1 + 0.2 + a * b",
            lambda a, b: a * b,
            id="product",
        ),
    ],
)
def test_a_box_about_a_fit(space, depth, misfit):
    """Gaps are round-off in the middle of the box, and matter elsewhere."""
    check_fit(space, f"y - (2 - y) / 2 * ({depth})", misfit)


def test_a_fit_in_all_of_the_box():
    """Gaps are round-off everywhere: the shape moves inner nodes and those of the sides alone."""
    check_fit(
        {"a": (-0.2, 0.2)},
        "y - (2 - y) / 2 * (0.1 + 0.2 + a - a) + a * y * (2 - y) / 9",
        lambda a: 0.0,
    )


@needs("moduli")
def test_a_box_about_a_poissons_ratio_of_zero():
    """Lamé's first constant is 0 in the middle.

    Between rigid sides p = E (1 - nu) push / ((1 + nu) (1 - 2 nu) 2 h).
    """
    left, right = (hhr.Displacement(block.side(0, upper), 0) for upper in (False, True))
    bottom = hhr.Obstacle(block.side(1, False), (0.0, -1.0), 0.0)
    scene = tall_block(
        "plane_strain",
        ("x", "h * y"),
        parameters=scenes.space(push=(0.01, 0.1), nu=(-0.3, 0.3), h=(0.8, 1.2)),
        bodies=(hhr.Body(block.SOLID, 3.0, "nu"),),
        contacts=(bottom,),
    )
    scene = dataclasses.replace(scene, displacements=(left, right, scene.displacements[-1]))
    model = hhr.condense(scene, fields=True)
    for push, nu, h in scene.parameters.random(4, seed=1):
        answer = model.solve([push, nu, h])
        pressure = 3.0 * (1 - nu) / ((1 + nu) * (1 - 2 * nu)) * push / (2 * h)
        assert answer.forces().sum() == pytest.approx(1.5 * pressure, rel=1e-5)
        assert answer.displacement()[1::2].min() == pytest.approx(-push, rel=1e-5)
        assert answer.displacement()[1::2].mean() == pytest.approx(-push / 2, rel=1e-5)


def wedge(normal):
    """A block whose lid turns by up to 0.2 rad under one that turns with it.

    Its normals are those of the mesh.
    """
    tilt = "(y + slope * (x - 1.5) * {})"
    shapes = (hhr.Shape(1, ("x", tilt.format("y"))), hhr.Shape(2, ("x", tilt.format("(2 - y)"))))
    surfaces = two_blocks.side(1, 1, True), two_blocks.side(2, 1, False)
    contacts = (hhr.NodeToSurface(*surfaces, normal),)
    bodies, space = ((2.0, 0.3), (4.0, 0.25)), {"slope": (-0.2, 0.2)}
    return pressed_pair(
        "plane_strain", bodies, space, cells=4, matching=False, shapes=shapes, contacts=contacts
    )


@needs("nonmatching")
def test_a_contact_surface_that_turns_takes_its_normals_along():
    model = hhr.FullOrderModel(wedge(None))
    for slope in (-0.2, 0.13):
        problem = model.problem.at([0.03, 0.0, 0.0, 0.0, slope])
        normal, rows = np.array([-slope, 1.0]) / np.hypot(slope, 1.0), np.arange(len(problem.gaps))
        slaves = problem.contact.toarray().reshape(rows.size, -1, 2)[rows, problem.contact_slaves]
        assert slaves == pytest.approx(np.tile(normal, (len(slaves), 1)), abs=1e-9)
        assert problem.gaps[:, 0] == pytest.approx(0.0, abs=1e-12)
    fixed = hhr.FullOrderModel(wedge((0.0, 1.0))).problem.at([0.03, 0.0, 0.0, 0.0, 0.2])
    turned = model.problem.at([0.03, 0.0, 0.0, 0.0, 0.2])
    assert abs(fixed.contact - turned.contact).max() > 0.1


DOOR = [
    (
        {"shape": ("w * x",)},
        r"shape of body 1 has 1 formulas: one for each of \('x', 'y'\) is needed",
    ),
    ({"shape": ("w * x", "h * y", "1")}, "has 3 formulas"),
    (
        {"shape": ("w * x", "h * z")},
        r"the shape of body 1 names \['z'\]: coordinates are \('x', 'y'\), parameters",
    ),
    (
        {"shape": ("w * x", "h * y"), "space": {"x": (0.0, 1.0)}},
        r"parameters \['x'\] have the names of coordinates",
    ),
    (
        {"shape": ("w * r", "h * z"), "hypothesis": "axisymmetric", "space": {"z": (0.0, 1.0)}},
        r"\['z'\] have",
    ),
    (
        {"shape": ("w * x", "h * y"), "hypothesis": "axisymmetric"},
        r"names \['x', 'y'\]: coordinates are \('r', 'z'\)",
    ),
    (
        {"shape": ("w * x", "h +")},
        "a coordinate of the shape of body 1: the formula 'h \\+' cannot be read",
    ),
    ({"shape": ("w * x", None)}, "a coordinate of the shape of body 1 = None must be"),
    ({"shape": "w * x"}, "coordinates of the shape of body 1 must be a tuple"),
    (
        {"shapes": (hhr.Shape(9, ("x", "h * y")),)},
        r"shapes\[0\] of scene .* is of body 9: give one shape for",
    ),
    (
        {"shapes": (hhr.Shape(1, ("w * x", "y")), hhr.Shape(1, ("x", "h * y")))},
        r"shapes\[1\] of scene .* is of body 1",
    ),
    ({"shapes": ("h * y",)}, r"shapes\[0\] of scene .* it must be a Shape"),
    (
        {"shape": ("x", "y * (1.5 - h)")},
        "turns 16 cells inside out .*narrow the box, or move the nodes around it too",
    ),
    ({"shape": ("x * w * (x - 0.8)", "h * y")}, "turns .* cells inside out at"),
    ({"shape": ("w * x", "h * y / (h - h)")}, "is not finite at .*: check its formulas"),
    ({"shape": ("w * x", "sqrt(h - 1) * y")}, "is not finite at"),
    ({"shape": ("w * x", "y * 0 * h")}, "inside out"),
    (
        {"shape": ("w * x", "h * table(y, 0, 0, 0.5, 0.5)")},
        "outside the table .*Give the table further points",
    ),
]


@pytest.mark.parametrize(
    ("given", "said"),
    [pytest.param(*item, id=item[1][:25]) for item in DOOR],
)
def test_shapes_that_are_none_are_refused_at_the_door(given, said):
    """And maps that turn cells inside out, or have no value, somewhere in the box."""
    with pytest.raises(SceneError, match=said):
        hhr.FullOrderModel(tall_block(**given))


def test_bodies_that_share_nodes_move_alike():
    """One block of two bodies: a shape of one of them tears it off, whatever the other one does."""
    from dolfinx import mesh as dmesh

    def geometry(comm):
        mesh, cells, facets = block.block(comm, lower=(0.0, 0.0), upper=(1.5, 2.0), cells=(4, 4))
        middles = dmesh.compute_midpoints(mesh, 2, cells.indices)
        bodies = np.where(middles[:, 0] < 0.7, 1, 2).astype(np.int32)
        return mesh, dmesh.meshtags(mesh, 2, cells.indices, bodies), facets

    def made(shapes):
        bodies = hhr.Body(1, 3.0, 0.3), hhr.Body(2, 3.0, 0.3)
        return hhr.FullOrderModel(tall_block(geometry=geometry, bodies=bodies, shapes=shapes))

    together = tuple(hhr.Shape(tag, ("w * x", "h * y")) for tag in (1, 2))
    total = made(together).solve([0.05, 0.7, 1.6]).forces().sum()
    assert total == pytest.approx(1.05 * 3.0 * 0.04 / 3.2, rel=1e-11)
    apart = together[0], hhr.Shape(2, ("w * x", "y * (2 - h) + 0 * x"))
    # alone it takes the nodes of its neighbour along, as far as that one's cells bear it
    for shapes, said in (
        (apart, "tears it from its .* must move them alike"),
        (together[:1], "4 cells inside out"),
    ):
        with pytest.raises(SceneError, match=said):
            made(shapes)


@needs("nonmatching")
def test_surfaces_that_stop_facing_each_other_are_told():
    """The upper block slides off as a shape: nodes without a facet, elsewhere than in the
    middle.
    """
    shapes, bodies = (hhr.Shape(2, ("x + off", "y")),), ((2.0, 0.3), (4.0, 0.25))
    scene = pressed_pair(
        "plane_strain", bodies, {"off": (-0.6, 0.6)}, cells=4, matching=False, shapes=shapes
    )
    model = hhr.FullOrderModel(scene)
    with pytest.raises((ParameterError, SceneError), match=r"Narrow the box|do not face"):
        model.solve([0.03, 0.0, 0.0, 0.0, 0.55])


def test_what_a_shape_has_no_answer_for_yet(pair):
    with pytest.raises((SceneError, NotSolvableError), match=r"training\.condense\(\)"):
        known = hhr.compute_snapshots(pair, pair.parameters.random(2, 0)).known_statuses()
        hhr.exact_condensation(pair, known)


PROGRAM = """
import sys
sys.path[:0] = {folders!r}
import test_shapes
import hhr_dolfinx as hhr
try:
    hhr.FullOrderModel(test_shapes.tall_block())
except hhr.errors.SceneError as error:
    print(error, flush=True)
"""


def test_several_ranks_are_refused():
    said = launch(2, ["-c", PROGRAM.format(folders=folders_of(__file__))])
    assert said.count("depends on parameters: build its model on one rank") == 2


@needs("studies")
def test_a_study_of_shapes_measures_both_models_and_advises_the_condensed_one(tmp_path):
    """p = E (push - gap) / (2 h) over 1.5 w is what both answer; S of four conditions
    interpolates.
    """
    settings = hhr.StudySettings(hhr.Sobol(8), held_out=4, tests=4, queries=7, naive=False)
    study = hhr.study_scene(tall_block(), settings, tmp_path)
    report = study.report
    assert [item["method"] for item in report["work_precision"]][:2] == ["HHR", "condensed"]
    assert report["advised"] == "condensed" and "thousand" in report["advice"]
    assert (
        report["errors"]["dual_full_floored"]["max"] < 1e-4
        and report["errors"]["dual_full_floored"]["n"] == 4
    )
    point = {"push": 0.05, "w": 0.7, "h": 1.6}
    view = hhr.View((tuple(point.values()),), lambda places: places[:, 0], "x", (1, "u_y"))
    study.write(tmp_path, view=view)
    force = hhr.load_model(tmp_path / "study.npz").solve(point).forces().sum()
    # ten times the largest error of four points: interpolation between shapes
    assert force == pytest.approx(1.5 * 0.7 * 3.0 * 0.04 / 3.2, rel=1e-5)
    assert {"fields.png", "pressures.png", "report.html"} <= {
        path.name for path in tmp_path.iterdir()
    }
