"""Hyper-reduction where shapes are parameters: the projection at any shape, and the full order at
unseen points.
"""

import numpy as np
import pytest
from needs import needs
from scenes import output_slopes, pair_scene, slope, slope_errors

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import StabilityWarning
from hhr_dolfinx.geometries.two_blocks import FIRST, SECOND, side
from hhr_dolfinx.plugins.moduli.interpolate import GridSettings
from hhr_dolfinx.reduction.projection import open_conditions, reduced_domain

pytestmark = pytest.mark.filterwarnings("ignore")
BOX = {
    "push": (0.005, 0.02),
    "slide": (-0.01, 0.01),
    "E1": (1.0, 6.0),
    "crown": (0.01, 0.04),
    "tall": (0.8, 1.2),
}
SHAPED = "E1", "crown", "tall"
"""Parameters that stay along a path."""
OUTPUTS = (
    hhr.LargestPressure("peak", 0),
    hhr.ContactForce("up", 0, (0.0, 1.0)),
    hhr.VonMises("stress", FIRST),
)
FORCES, DISPLACEMENT = 0.02, 0.01
"""Errors asked for at unseen points, relative to the largest of them: of forces, and of
displacements.
"""


def pair(contact=None, *, cells=(8, 8), dim=2, **others):
    """A block pressed on another one, which has a crown, a height and Young's modulus as
    parameters.
    """
    up = "yz"[dim - 2]
    crowned = *("x", "y")[: dim - 1], f"1 + ({up} - 1) * tall - crown * {up} * (x - 1.5)**2"
    wide = (1.0, 0.0)[: dim - 1], (2.0, 1.0)[: dim - 1]
    boxes = [
        ((*wide[0], k), (*wide[1], k + 1.0), (*[n] * (dim - 1), 4)) for k, n in enumerate(cells)
    ]
    top = side(SECOND, dim - 1, True)
    axes = (0.0,) * (dim - 1) + (1.0,)
    facing = side(FIRST, dim - 1, True), side(SECOND, dim - 1, False)
    given = {
        "hypothesis": "solid" if dim == 3 else "plane_strain",
        "contacts": (contact or hhr.NodeToNode(*facing, axes),),
        "displacements": (
            *hhr.Displacement.clamp(side(FIRST, dim - 1, False), dim),
            hhr.Displacement(top, 0, slope("slide")),
            *(hhr.Displacement(top, axis) for axis in range(1, dim - 1)),
            hhr.Displacement(top, dim - 1, slope("push", -1.0)),
        ),
        "shapes": (hhr.Shape(FIRST, crowned),),
    }
    return pair_scene("pair", BOX, *boxes, (("E1", 0.3), (4.0, 0.25)), **given | others)


@pytest.fixture(scope="module")
def made():
    """The default recipe on meshes with matching nodes: a training and its model."""
    training = hhr.train(pair(outputs=OUTPUTS), hhr.Sobol(64), held_out=4)
    return training, training.build()


@pytest.fixture(scope="module")
def beside():
    """A RID of a part of the surface, whose forces elsewhere are fitted, on meshes that do not
    match.
    """
    contact = hhr.NodeToSurface(
        side(SECOND, 1, False), side(FIRST, 1, True)
    )  # normals follow the shape
    training = hhr.train(pair(contact, cells=(24, 23), outputs=OUTPUTS), hhr.Sobol(32), held_out=0)
    few = hhr.Recipe(hhr.Pod(1e-5), (hhr.Deim(hhr.Pod(1e-3)), hhr.LoadNodes()), hhr.Rid(0))
    return training, training.build(few.as_it_is())


KINDS = "made", "beside"


def projected(full, facts, point):
    """(1.61) and (5.23) at a point from dense matrices of the mesh there: K~, B~1, B~2, loads,
    gaps.
    """
    there = full.problem.at(point)
    inside = np.zeros(there.free.size, dtype=bool)
    inside[facts.sets.A] = True
    test = np.where(inside[:, None], facts.basis, 0.0)
    rows = there.contact.toarray()[facts.sets.A_lambda]
    stiffness = test.T @ there.stiffness.toarray() @ facts.basis
    return (
        stiffness,
        rows @ test,
        rows @ facts.basis,
        test.T @ there.loads.toarray(),
        there.gaps[facts.sets.A_lambda],
    )


def apart(found, expected):
    """Distance of two arrays relative to the size of the second."""
    return np.linalg.norm(found - expected) / np.linalg.norm(expected)


@needs("nonmatching")
@pytest.mark.parametrize("name", KINDS)
def test_it_is_the_projection_of_the_problem_at_any_shape(request, name):
    """To five times the tolerance of the grid, 2e-5.

    K~ of the middle of the box is far off in a corner.
    """
    training, model = request.getfixturevalue(name)
    full, facts = training.full_order, model.offline.facts
    for point in full.parameters.random(3, seed=3):
        found = model.compliances.problem_at(point)
        names = "stiffness contact_test contact_trial loads gaps"
        for what, expected in zip(names.split(), projected(full, facts, point), strict=True):
            assert apart(getattr(found, what), expected) < 1e-4, what
    corner = np.array(full.parameters.upper)
    in_the_middle = np.tensordot(
        model.problem.terms.weights(corner), model.problem.terms.stiffness, 1
    )
    assert apart(in_the_middle, model.compliances.problem_at(corner).stiffness) > 1e-3


def test_soft_modes_are_as_exact_as_stiff_ones(made):
    """S of the RID, of which K~^-1 is a part, is off by 1e-6.

    In modes without scaling it was 50 times as much.
    """
    training, model = made
    full, facts = training.full_order, model.offline.facts
    for point in full.parameters.random(3, seed=4):
        stiffness, test, trial, *_ = projected(full, facts, point)
        found = model.compliances(point).schur
        assert apart(found, trial @ np.linalg.solve(stiffness, test.T)) < 1e-5


def errors_of(model, full, points):
    """Largest errors of forces and displacements, relative to the largest of all points."""
    exact = [full.solve(point) for point in points]
    found = [model.solve(point, outside="ignore") for point in points]
    return [largest_error([getattr(a, name)() for a in exact], [getattr(b, name)() for b in found])
            for name in ("forces", "displacement")]  # fmt: skip


def largest_error(exact, found):
    """Largest difference of arrays, one by one, relative to the largest of them."""
    off = [np.linalg.norm(b - a) for a, b in zip(exact, found, strict=True)]
    return max(off) / max(np.linalg.norm(a) for a in exact)


def test_unseen_points_are_those_of_the_full_order(made):
    training, model = made
    full = training.full_order
    forces, displacement = errors_of(model, full, full.parameters.random(10, seed=9))
    assert forces < FORCES and displacement < DISPLACEMENT


def test_unseen_points_in_space():
    """Two blocks of hexahedra."""
    training = hhr.train(pair(dim=3, cells=(4, 4)), hhr.Sobol(64), held_out=4)
    full = training.full_order
    forces, displacement = errors_of(training.build(), full, full.parameters.random(10, seed=9))
    assert forces < FORCES and displacement < DISPLACEMENT


@needs("nonmatching")
def test_fields_outside_of_the_domain_follow_the_shape(beside):
    """Gaps and B V of all conditions: those of the middle of the box are off by a thousandth and
    more.
    """
    training, model = beside
    assert 1 < len(model.offline.facts.sets.A_lambda) < len(training.full_order.problem.gaps)
    for point in training.full_order.parameters.random(3, seed=3):
        there = training.full_order.problem.at(point)
        gaps, rows = model.fields.surface_at(point)
        assert (
            apart(gaps, there.gaps) < 1e-4
            and apart(rows, there.contact @ model.offline.facts.basis) < 1e-4
        )
        assert (
            apart(model.fields.gaps, gaps) > 1e-3 and apart(model.fields.contact_basis, rows) > 1e-4
        )


@needs("nonmatching")
@pytest.mark.parametrize("name", KINDS)
def test_slopes_are_those_of_differences(request, name):
    """Also those of forces outside of the RID, by an output, whose gaps follow the shape."""
    model = request.getfixturevalue(name)[1]
    point = model.parameters.random(1, seed=9)[0]
    assert slope_errors(model, point).max() < 1e-5
    found = model.outputs(point, gradient=True).gradient
    width = np.subtract(model.parameters.upper, model.parameters.lower)
    for name, slopes in output_slopes(model, point, "peak", "up", "stress").items():
        assert np.abs((found[name] - slopes) * width).max() < 1e-4 * np.abs(slopes * width).max(), (
            name
        )


@needs("nonmatching")
@pytest.mark.parametrize("name", KINDS)
def test_a_file_answers_to_the_last_bit(request, name, tmp_path):
    model = request.getfixturevalue(name)[1]
    hhr.save_model(tmp_path / "model.npz", model)
    again = hhr.load_model(tmp_path / "model.npz")
    for point in model.parameters.random(3, seed=5):
        found, expected = (
            item.solve(point, gradient=True, outside="ignore") for item in (again, model)
        )
        for what in ("forces", "displacement"):
            assert np.array_equal(getattr(found, what)(), getattr(expected, what)())
        assert np.array_equal(found.gradient.multipliers, expected.gradient.multipliers)
        assert (
            again.outputs(point, outside="ignore").values
            == model.outputs(point, outside="ignore").values
        )


def test_outputs_are_those_of_the_full_order(made):
    training, model = made
    for point in training.full_order.parameters.random(3, seed=9):
        found, expected = model.outputs(point), training.full_order.outputs(point)
        for name in expected:
            assert found[name] == pytest.approx(expected[name], rel=FORCES), name


def test_a_projection_that_is_not_resolved_is_told(made, monkeypatch):
    from hhr_dolfinx.plugins.shapes import reduction

    training, _ = made
    monkeypatch.setattr(reduction, "SHAPE_GRID", GridSettings(1e-9, 3))
    with pytest.warns(StabilityWarning, match="was made at 3 shapes, and between them an error of"):
        hhr.build(training.full_order, training.snapshots, hhr.Recipe().as_it_is())


@needs("nonmatching")
def test_a_domain_is_closed_at_all_shapes():
    """Nodes shift along a surface: conditions of other nodes act on a RID that is closed in the
    middle of the box.
    """
    shifted = hhr.Shape(SECOND, ("x + 32 * (crown - 0.025) * (x - 1) * (2 - x)", "y"))
    contact = hhr.NodeToSurface(side(FIRST, 1, True), side(SECOND, 1, False), (0.0, 1.0))
    problem = hhr.FullOrderModel(pair(contact, cells=(8, 9), shapes=(shifted,))).problem
    assert problem.reshaped is not None
    corners = [problem.at([*problem.middle[:3], crown, 1.0]) for crown in BOX["crown"]]
    opened = []
    for looked_at in (problem, problem.reshaped.touching()):
        sets = [reduced_domain(looked_at, np.array([node])) for node in problem.contact_slaves]
        opened.append(sum(open_conditions(there, item).size for there in corners for item in sets))
    assert opened[0] > 0 and opened[1] == 0


@needs("friction")
def test_paths_with_friction_are_those_of_the_full_order():
    """Forces and displacements along an unseen path at an unseen shape, where contacts slip and
    stick.
    """
    contact = hhr.NodeToNode(
        side(FIRST, 1, True), side(SECOND, 1, False), (0.0, 1.0), friction=hhr.Coulomb(0.3)
    )
    training = hhr.train(
        pair(contact), [path(seed) for seed in range(16)], held_out=[path(20), path(21)]
    )
    model = training.build()
    for seed in (30, 31):
        exact, found = (item.march(path(seed)).answers for item in (training.full_order, model))
        sticks = np.array([answer.active[training.full_order.law.tangential] for answer in exact])
        assert sticks.any() and not sticks[1:].all()
        for name, most in (("forces", 2 * FORCES), ("displacement", DISPLACEMENT)):
            off = largest_error(
                [getattr(a, name)() for a in exact], [getattr(b, name)() for b in found]
            )
            assert off < most, name


def path(seed):
    """From the least push to three random pushes and slides, at one random shape."""
    space = pair().parameters
    points = space.random(3, seed=seed)
    still = np.isin(space.names, SHAPED)
    points[:, still] = points[0, still]
    return [
        (0.0, np.where(still, points[0], space.lower)),
        *((1.0 + k, point) for k, point in enumerate(points)),
    ]
