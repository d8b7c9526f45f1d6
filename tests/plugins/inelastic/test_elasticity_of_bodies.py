"""Ratios that are formulas, and graded elasticity, where bodies flow: the numbers, many bodies,
laws of places.
"""

import dataclasses
from typing import ClassVar

import numpy as np
import pytest
import ufl
from condensing import EVERY, TIGHT, apart, condensed
from dolfinx.mesh import compute_midpoints, meshtags
from needs import needs
from outside_laws import von_mises
from scenes import block_scene, largest_difference, pressed_pair, slope
from toy_law import Bingham

import hhr_dolfinx as hhr
from hhr_dolfinx import compat
from hhr_dolfinx.certify.accuracy import relative_error
from hhr_dolfinx.errors import NotOfferedError, ParameterError, ReductionError, SceneError
from hhr_dolfinx.geometries import block, two_blocks
from hhr_dolfinx.plugins.inelastic.law import program_of
from hhr_dolfinx.plugins.inelastic.law_slopes import Along, Inputs, slopes_of
from hhr_dolfinx.plugins.inelastic.outside import OutsideLaw
from hhr_dolfinx.plugins.inelastic.update import Group, Material

NEWTON = hhr.MarchSettings("tangent", 1e-11, 1e-10, 1e-12, outside="ignore")
PLASTIC = hhr.Plasticity(0.05, 0.2)
LAWS = {"plasticity": PLASTIC, "creep": hhr.Norton(0.15, 3.0), "of a user": Bingham(0.04, 0.5)}
FIELDS = *EVERY, "plastic_strain"
RATIO = {"E1": (2.0, 4.0), "nu1": (0.1, 0.4)}
AT = (3.1, 0.23)


def waves(x):
    """Grading of both bodies, between 0.8 and 1.6."""
    return 1.1 + 0.5 * ufl.sin(3 * x[0]) * x[1]


def blocks(hypothesis, law, first, second, box, grading=None, **others):
    """The lower block flows; (E, ν) of both are numbers or formulas."""
    lower = hhr.Body(two_blocks.FIRST, *first, law, grading)
    upper = hhr.Body(two_blocks.SECOND, *second, grading=grading)
    return hhr.FullOrderModel(
        pressed_pair(hypothesis, (lower, upper), box, **{"cells": 2} | others)
    )


def path(*constants, steps=4, top=1.0):
    shares = top * np.arange(steps + 1)[:, None] / steps
    moved = [0.005, 0.0, 0.0, 0.001] + shares * [0.045, 0.01, 0.05, 0.0]
    return [(float(k), np.array([*point, *constants])) for k, point in enumerate(moved)]


@pytest.mark.parametrize(
    ("hypothesis", "law"),
    [
        ("plane_strain", "plasticity"),
        ("plane_stress", "creep"),
        ("axisymmetric", "of a user"),
        ("solid", "plasticity"),
        ("plane_stress", "of a user"),
    ],
)
def test_formulas_of_the_ratio_are_the_numbers(hypothesis, law):
    """Of both bodies, of which one flows, and all is graded: to the tolerance of Newton's
    method.
    """
    formulas = ("E1", "nu1"), (5.0, "0.1 + nu1 / 2")
    varying = blocks(hypothesis, LAWS[law], *formulas, RATIO, waves)
    plain = blocks(hypothesis, LAWS[law], (AT[0], AT[1]), (5.0, 0.1 + AT[1] / 2), {}, waves)
    expected = plain.march(path(), NEWTON)
    assert max(apart(varying.march(path(3.1, 0.35), NEWTON), expected)) > 1e-3
    one = varying.march(path(*AT), NEWTON)
    assert one.answers[-1].plastic_strain().max() > 1e-3 and one.answers[-1].forces().max() > 0
    assert max(apart(one, expected, FIELDS)) < 1e-9


@needs("volume_loads")
@pytest.mark.parametrize("hypothesis", ["plane_strain", "plane_stress", "axisymmetric", "solid"])
def test_where_nothing_flows_it_is_the_elastic_scene(hypothesis):
    """Graded, with a ratio of a parameter, and heated: K by forms against K at Gauss points.

    Elastic bodies use the mean dilatation too, since the ratio is large somewhere in the box. In
    plane stress there is none, and three points integrate triangles exactly.
    """
    heat = hhr.ThermalExpansion(two_blocks.FIRST, 1e-4, "T", field=lambda x: 1 + x[0])
    others = {
        "loads": (heat, hhr.Pressure(two_blocks.side(two_blocks.SECOND, 0, True), slope("load")))
    }
    box = {"nu1": (0.1, 0.46), "T": (0.0, 100.0)}
    given = (3.0, "nu1"), (5.0, 0.46), box, (lambda x: 1 + x[0] / 2)
    others["simplices"] = hypothesis == "plane_stress"
    elastic, flowing = (
        blocks(hypothesis, law, *given, **others) for law in (None, hhr.Plasticity(1e6))
    )
    point = {"push": 0.03, "slide": 0.01, "load": 0.05, "gap": 0.001, "T": 80.0, "nu1": 0.17}
    one, other = elastic.solve(point), flowing.solve(point)
    for name in ("displacement", "forces"):
        assert relative_error(getattr(other, name)(), getattr(one, name)()) < 1e-11
    assert one.forces().max() > 0 and other.plastic_strain().max() == 0


def column(bodies, split):
    """A column of one or two bodies on a rigid floor, which hang together where x is 0.5."""

    def geometry(comm):
        mesh, _, facets = block.block(comm, lower=(0, 0), upper=(1, 1), cells=(4, 3))
        cells = np.arange(mesh.topology.index_map(2).size_local, dtype=np.int32)
        right = compute_midpoints(mesh, 2, cells)[:, 0] > 0.5
        return (
            mesh,
            meshtags(mesh, 2, cells, np.where(right & split, 2, 1).astype(np.int32)),
            facets,
        )

    lid = block.side(1, upper=True)
    scene = block_scene(
        "column",
        {"push": (0.0, 0.1)},
        geometry=geometry,
        bodies=bodies,
        contacts=(hhr.Obstacle(block.side(1, upper=False), (0, -1), 0.005),),
        displacements=(hhr.Displacement(lid, 0), hhr.Displacement(lid, 1, slope("push", -1.0))),
    )
    return hhr.FullOrderModel(scene).march(
        [(float(k), np.array([0.02 * k])) for k in range(5)], NEWTON
    )


WOOD = (9.0, 3.0, 1.5), (0.4, 0.3, 0.2), (1.0, 0.8, 0.3)


@dataclasses.dataclass(frozen=True)
class AtPoints(hhr.Orthotropic):
    """Orthotropic elasticity that is solved at Gauss points, not known as linear."""

    linear_stress = None


def wood(factor):
    moduli, ratios, shears = WOOD
    return AtPoints(
        *(factor * value for value in moduli), *ratios, *(factor * value for value in shears)
    )


@pytest.mark.parametrize("law", ["plasticity", "creep", "wood"])
def test_a_graded_body_is_that_of_many_bodies(law):
    """A grading that jumps inside of a body, against two that hang together.

    A law's own elasticity is graded too.
    """

    def jump(x):
        return ufl.conditional(ufl.lt(x[0], 0.5), 1.0, 1.8)

    one, other = (wood(1.0), wood(1.8)) if law == "wood" else (LAWS[law], LAWS[law])
    graded = column((hhr.Body(1, 3.0, 0.3, one, jump),), split=False)
    parted = column((hhr.Body(1, 3.0, 0.3, one), hhr.Body(2, 5.4, 0.3, other)), split=True)
    assert graded.answers[-1].forces().min() > 0.005
    assert max(apart(graded, parted, EVERY)) < 1e-9


@pytest.mark.parametrize("hypothesis", ["plane_strain", "plane_stress", "axisymmetric"])
def test_a_grading_is_the_modulus_of_a_law_of_places(hypothesis):
    """E = 3 (1 + x / 5), as the grading and as a formula of the coordinates in the law.

    Stored strains are its own.
    """
    first, second = ("r", "z") if hypothesis == "axisymmetric" else ("x", "y")
    softer = hhr.ChangingStiffness(PLASTIC, f"3 * (1 + {first} * {second} / 5)")
    found = blocks(hypothesis, PLASTIC, (3.0, 0.3), (5.0, 0.3), {}).march(path(), NEWTON)
    lower = hhr.Body(two_blocks.FIRST, 3.0, 0.3, PLASTIC, lambda x: 1 + x[0] * x[1] / 5)
    stated = hhr.Body(two_blocks.FIRST, 3.0, 0.3, softer)
    graded, placed = (
        hhr.FullOrderModel(pressed_pair(hypothesis, (body, (5.0, 0.3)), cells=2)).march(
            path(), NEWTON
        )
        for body in (lower, stated)
    )
    assert max(apart(graded, found)) > 1e-2
    assert max(apart(graded, placed, FIELDS)) < 1e-9


class Outside(OutsideLaw):
    """Von Mises' plasticity in numpy."""

    def evaluate(self, step):
        c = step.constants
        tangents, stress, amount = von_mises(
            step.strain - step.old["strain"],
            step.old["stress"],
            step.old["cumulated"],
            young=c["young"],
            poisson=c["poisson"],
            yield_stress=c["yield_stress"],
            hardening=c["hardening"],
        )
        return stress, {"cumulated": step.old["cumulated"] + amount}, tangents


def test_code_has_the_graded_modulus_and_the_ratio():
    law = Outside("Outside", {"yield_stress": 0.05, "hardening": 0.2}, False)
    models = [
        blocks("plane_strain", item, ("E1", "nu1"), (5.0, 0.3), RATIO, waves)
        for item in (law, PLASTIC)
    ]
    one, other = (model.march(path(*AT), NEWTON) for model in models)
    assert max(apart(one, other, FIELDS)) < 1e-9


@pytest.mark.parametrize(
    ("law", "plane_stress"),
    [
        (None, False),
        (PLASTIC, False),
        (hhr.Norton(2.0, 4.0), False),
        (PLASTIC, True),
        (hhr.Norton(2.0, 4.0), True),
    ],
)
def test_derivatives_along_the_constants_of_elasticity(law, plane_stress):
    """Central differences of the update of graded points along E and ν, at points without a
    kink.
    """
    points = 40
    program = None if law is None else law.at_points(4, plane_stress=plane_stress)
    rng = np.random.default_rng(5)
    grading = rng.uniform(0.5, 2.0, points)

    def material(young="E", poisson="nu"):
        return Material(
            [Group(np.arange(points), young, poisson, program, grading=grading)], 4, ("E", "nu")
        )

    whole = material()
    point, step = np.array([3.0, 0.3]), 1e-5
    here = whole.moduli_at(point)
    first, change = 0.02 * rng.standard_normal((2, points, 4))
    old = here.update(first, here.at_rest(), 0.3, tangent=False).state
    nothing = [np.repeat(np.zeros_like(part)[..., None], 2, axis=-1) for part in (change, *old)]
    along = Along(
        nothing[0], type(old)(*nothing[1:]), whole.constants_along(point, np.eye(2)), np.ones(2)
    )
    found = slopes_of(here, Inputs(first + change, old, 0.7), along)
    for way in range(2):
        more, less = (
            material(*(point + side * step * np.eye(2)[way])).update(
                first + change, old, 0.7, tangent=False
            )
            for side in (1, -1)
        )
        clear = found.reach[:, way] > 10 * step
        assert clear.mean() > 0.9
        pairs = [(more.stress, less.stress, found.stress)]
        pairs += zip(more.state, less.state, found.state, strict=True) if law is not None else []
        for high, low, slopes in pairs:
            right = (high - low)[clear] / (2 * step)
            if right.size:
                assert slopes[clear][..., way] == pytest.approx(
                    right, abs=max(2e-5 * np.abs(right).max(), 1e-10)
                )


def test_gradients_of_histories_are_those_of_differences():
    """Along E, ν and loads, of graded bodies; the error of central differences."""
    model = blocks("plane_strain", PLASTIC, ("E1", "nu1"), (5.0, "nu1"), RATIO, waves)
    asked = dataclasses.replace(NEWTON, gradient=True)
    last = model.march(path(*AT), asked).answers[-1]
    assert not last.gradient.kinks and not last.gradient.grazing.any()
    step = 1e-5
    for axis in (4, 5):
        sides = []
        for side in (1, -1):
            moved = [(time, point + side * step * np.eye(6)[axis]) for time, point in path(*AT)]
            sides.append(model.march(moved, NEWTON).answers[-1])
        for found, name in (
            (last.gradient.unknown, "unknown"),
            (last.gradient.multipliers, "multipliers"),
        ):
            right = (getattr(sides[0], name) - getattr(sides[1], name)) / (2 * step)
            assert largest_difference(found[:, axis], right) < 1e-5


@pytest.fixture(scope="module")
def trained():
    """Graded, with a ratio of a parameter, and histories at both ends."""
    full = blocks("plane_strain", PLASTIC, ("E1", "nu1"), (5.0, 0.3), RATIO, waves, cells=4)
    return full, [
        full.march(path(young, ratio), TIGHT)
        for young, ratio in ((2.2, 0.12), (3.8, 0.12), (3.0, 0.38))
    ]


def test_reduced_models_and_files(trained, tmp_path):
    """A whole RID leaves out modes alone.

    A model of a file is the same bit by bit, by numbers at Gauss points.
    """
    full, histories = trained
    recipe = hhr.Recipe.flowing(domain=hhr.Rid(9)).as_it_is()
    model = hhr.build(full, hhr.SnapshotSet.of_histories(histories), recipe)
    expected = full.march(path(*AT), TIGHT)
    found = model.march(path(*AT), TIGHT)
    assert max(apart(found, expected)) < 0.02
    hhr.save_model(tmp_path / "model.npz", model)
    read = hhr.load_model(tmp_path / "model.npz").march(path(*AT), TIGHT)
    assert max(apart(read, found, FIELDS)) == 0.0


def test_condensed_models_are_graded_and_have_no_ratio(trained, tmp_path):
    with pytest.raises(
        ReductionError,
        match=r"Poisson's ratio of a body is a formula, .* no factor times a constant",
    ):
        condensed(*trained)
    full = blocks(
        "plane_strain", PLASTIC, ("E1", 0.3), (5.0, 0.3), {"E1": (2.0, 4.0)}, waves, cells=4
    )
    model = condensed(
        full, [full.march(path(young), TIGHT) for young in (2.0, 4.0)], modes=1e-6, cubature=1e-6
    )
    expected = full.march(path(2.9), TIGHT)
    found = model.march(path(2.9), TIGHT)
    assert max(apart(found, expected, EVERY)) < 0.01
    hhr.save_model(tmp_path / "model.npz", model)
    read = hhr.load_model(tmp_path / "model.npz").march(path(2.9), TIGHT)
    assert max(apart(read, found, FIELDS)) == 0.0


@dataclasses.dataclass(frozen=True)
class Own(hhr.Law):
    """Elasticity of its own with a memory."""

    modulus: float
    memory: ClassVar = {"last": 1}
    elastic: ClassVar = True


def test_what_is_refused():
    for options in ({"young": "E"}, {"poisson": "nu"}):
        with pytest.raises(
            SceneError, match=r"body 1 has the elasticity of its law AtPoints: .* must be a number"
        ):
            hhr.Body(1, **({"young": 3.0, "poisson": 0.3, "law": wood(1.0)} | options))
    with pytest.raises(
        SceneError, match="has a grading, and Own states elasticity and flow of its own"
    ):
        hhr.Body(1, 3.0, 0.3, Own(1.0), lambda x: 1.0 + x[0])
    with pytest.raises(SceneError, match=r"the grading of body 1 is -.* must be positive"):
        blocks("plane_strain", PLASTIC, (3.0, 0.3), (5.0, 0.3), {}, lambda x: 1.2 - x[0])
    varying = blocks("plane_strain", PLASTIC, (3.0, "nu1"), (5.0, 0.3), {"nu1": (0.1, 0.4)})
    with pytest.raises(
        ParameterError, match=r"nu1 changes from 0.2 to 0.3 in step 1 .* depends on it \(nu1\):"
    ):
        varying.march([(0.0, path(0.2)[0][1]), (1.0, path(0.3)[1][1])])
    material = Material([Group(np.arange(1), 3.0, "nu", program_of(PLASTIC, 4))], 4, ("nu",))
    with pytest.raises(
        SceneError,
        match=r"poisson = nu is a formula of the parameters: material.moduli_at\(point\)",
    ):
        _ = material.elastic
    with pytest.raises(
        SceneError, match=r"poisson = nu is 0.6 at nu = 0.6: Poisson's ratio must lie in"
    ):
        material.moduli_at(np.array([0.6]))


CROWNED = "x", "y + crown * y * (x - 1.3)**2"


def crowned(hypothesis, crown, **others):
    """Blocks of which the lower one has a crown, of a parameter or a number, by which its mesh is
    made.
    """
    law = hhr.Voce("0.05 + 0.01 * y", 0.02, 20.0, 0.2)
    bodies = (
        hhr.Body(two_blocks.FIRST, "E1", "nu1", law, waves),
        hhr.Body(two_blocks.SECOND, 5.0, 0.3),
    )
    heat = hhr.ThermalExpansion(
        two_blocks.FIRST, 1e-4, "100 * push", field=lambda x: 1 + x[0] * x[1]
    )
    flank = hhr.Pressure(two_blocks.side(two_blocks.SECOND, 0, True), slope("load"))
    output = hhr.VonMises("stress", two_blocks.FIRST, "mean")
    given = {"cells": 4, "loads": (flank, heat), "outputs": (output,), **others}
    if isinstance(crown, str):
        given["shapes"] = (hhr.Shape(two_blocks.FIRST, CROWNED),)
        return hhr.FullOrderModel(
            pressed_pair(hypothesis, bodies, RATIO | {"crown": (-0.1, 0.1)}, **given)
        )
    base = pressed_pair(hypothesis, bodies, RATIO, **given)

    def geometry(comm):
        mesh, cells, facets = base.geometry(comm)
        own = np.unique(compat.geometry_dofmap(mesh)[cells.find(two_blocks.FIRST)])
        x, y = mesh.geometry.x[own, :2].T
        mesh.geometry.x[own, 1] = y + crown * y * (x - 1.3) ** 2
        return mesh, cells, facets

    return hhr.FullOrderModel(dataclasses.replace(base, geometry=geometry))


@needs("shapes", "volume_loads")
@pytest.mark.parametrize("hypothesis", ["plane_strain", "plane_stress"])
def test_shapes_of_inelastic_bodies_are_those_of_their_meshes(hypothesis, tmp_path):
    """Graded and heated, with laws of places, on a mesh that has this shape: gaps, strains and
    places change.
    """
    varying = crowned(hypothesis, "crown")
    expected = crowned(hypothesis, -0.08).march(path(*AT), NEWTON)
    assert max(apart(varying.march(path(*AT, 0.02), NEWTON), expected)) > 1e-2
    for known in (0, 4):  # solved, and from the store, which compares its equilibrium on this shape
        store = hhr.SnapshotStore(tmp_path, varying)
        (found,) = hhr.compute_snapshots(
            varying, [path(*AT, -0.08)], store=store, settings=NEWTON
        ).histories
        assert store.found == known
        assert found.answers[-1].plastic_strain().max() > 1e-3 and not found.answers[0].active.all()
        assert max(apart(found, expected, FIELDS)) < 1e-9
        for one, other in zip(found.answers, expected.answers, strict=True):
            assert one.outputs()["stress"] == pytest.approx(
                other.outputs()["stress"], rel=1e-9, abs=1e-15
            )
    with pytest.raises(
        ParameterError, match=r"crown changes from 0 to 0.01 in step 1 .* or a shape depends on it"
    ):
        varying.march([(0.0, path(*AT, 0.0)[0][1]), (1.0, path(*AT, 0.01)[1][1])])
    with pytest.raises(
        NotOfferedError, match="derivatives of histories along shapes are not built in"
    ):
        varying.march(path(*AT, -0.08), dataclasses.replace(NEWTON, gradient=True))
    with pytest.raises(ReductionError, match="shapes of the scene are parameters, with which"):
        condensed(varying, [found])
    with pytest.raises(
        NotOfferedError, match=r"not built in for bodies with laws whose shape depends"
    ):
        hhr.build(varying, hhr.SnapshotSet.of_histories([found]), hhr.Recipe.flowing())
