"""Young's moduli that are formulas where bodies flow: in space, of bodies that hang together, in materials."""

import numpy as np
import pytest
from condensing import EVERY, apart
from dolfinx.mesh import compute_midpoints, meshtags
from scenes import pressed_pair

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.geometries import block, two_blocks
from hhr_dolfinx.plugins.inelastic.update import Group, Material

MATERIALS = {"E1": (2.0, 4.0), "E2": (2.0, 9.0)}
"""Of two blocks on each other, by their bounds."""


def blocks(first, second, hypothesis="solid", materials=MATERIALS, cells=2, **others):
    """The lower one yields; imposed displacements move the upper one."""
    yields = hhr.Plasticity(0.05, 0.2)
    bodies = hhr.Body(two_blocks.FIRST, first, 0.3, yields), hhr.Body(two_blocks.SECOND, second, 0.35)
    return pressed_pair(hypothesis, bodies, materials, cells=cells, **others)


def push(*moduli, steps=4):
    shares = np.arange(steps + 1) / steps
    return [(float(s), np.array([0.005 + 0.045 * s, 0.01 * s, 0.05 * s, 0.001, *moduli])) for s in shares]


def test_in_space_and_where_a_load_imposes_displacements():
    varying = hhr.FullOrderModel(blocks("E1", "2 * E2"))
    numbers = hhr.FullOrderModel(blocks(3.7, 6.2, materials={}))
    one, other = varying.march(push(3.7, 3.1)), numbers.march(push())
    assert one.answers[-1].plastic_strain().max() > 1e-3 and one.answers[-1].forces().max() > 0
    assert max(apart(one, other, EVERY)) < 1e-10
    assert max(apart(varying.march(push(2.7, 3.1)), other)) > 1e-3
    assert np.array_equal(varying.march(push(3.7, 3.1)).answers[-1].unknown, one.answers[-1].unknown)


def glued(first, second, materials):
    """One column of two layers that hang together, on a rigid floor: both moduli act on the nodes between."""

    def geometry(comm):
        mesh, _, facets = block.block(comm, lower=(0, 0), upper=(1, 2), cells=(3, 4))
        cells = np.arange(mesh.topology.index_map(2).size_local, dtype=np.int32)
        upper = compute_midpoints(mesh, 2, cells)[:, 1] > 1
        return mesh, meshtags(mesh, 2, cells, np.where(upper, 2, 1).astype(np.int32)), facets

    box = {"push": (0.0, 0.1)} | materials
    return hhr.Scene(
        name="glued",
        geometry=geometry,
        hypothesis="plane_strain",
        bodies=(hhr.Body(1, first, 0.3, hhr.Plasticity(0.05, 0.2)), hhr.Body(2, second, 0.3)),
        contacts=(hhr.Obstacle(block.side(1, upper=False), (0, -1), 0.005),),
        parameters=hhr.ParameterSpace(tuple(box), *zip(*box.values(), strict=True)),
        displacements=(
            hhr.Displacement(block.side(1, upper=True), 0),
            hhr.Displacement(block.side(1, upper=True), 1, hhr.Amplitude(slopes={"push": -1.0})),
        ),
    )  # fmt: skip


def pressed(*moduli):
    return [(float(k), np.array([0.02 * k, *moduli])) for k in range(5)]


def test_bodies_that_hang_together_are_factored_anew():
    varying = hhr.FullOrderModel(glued("E1", "E2", MATERIALS))
    assert varying.system.bodies is None
    numbers = hhr.FullOrderModel(glued(3.7, 6.2, {}))
    for search in ("frozen", "elastic"):
        settings = hhr.MarchSettings(search, iterations=300)
        for _ in range(2):
            varying.march(pressed(2.1, 2.2), settings)  # whose factors are then at hand
            one, other = varying.march(pressed(3.7, 6.2), settings), numbers.march(pressed(), settings)
            assert one.answers[-1].plastic_strain().max() > 1e-3
            assert max(apart(one, other, EVERY)) < 1e-10


def test_a_common_formula_makes_one_part():
    varying = hhr.FullOrderModel(glued("E1", "E1", {"E1": (2.0, 4.0)}))
    assert len(varying.problem.moduli) == 1 and varying.system.bodies is not None
    numbers = hhr.FullOrderModel(glued(3.7, 3.7, {}))
    assert max(apart(varying.march(pressed(3.7)), numbers.march(pressed()), EVERY)) < 1e-10


def test_what_is_not_built_in():
    law = hhr.Plasticity(1.0)
    assert hhr.Body(1, "E", 0.3, law).varies
    for options in ({"poisson": "nu"}, {"grading": lambda x: 1.0}):
        with pytest.raises(SceneError, match=r"body 1 flows, and its Poisson's ratio .* a constant poisson"):
            hhr.Body(1, **({"young": 3.0, "poisson": 0.3, "law": law} | options))
    material = Material([Group(np.arange(1), "E", 0.3, law)], 4, ("E",))
    for ask in (
        lambda: material.elastic,
        lambda: material.update(np.ones((1, 4)), material.at_rest(), 1.0, tangent=False),
    ):
        with pytest.raises(SceneError, match=r"young = E is a formula of the parameters: material.moduli_at\(point\)"):
            ask()
    with pytest.raises(SceneError, match=r"young = E is -1 at E = -1: .* Change the formula"):
        material.moduli_at(np.array([-1.0]))
    creeping = Material([Group(np.arange(1), 1.0, 0.3, hhr.Norton("K", 2.0))], 4, ("K",))
    with pytest.raises(SceneError, match=r"'K' is a formula of the parameters: law_at\(law, names, point\)"):
        creeping.update(np.ones((1, 4)), creeping.at_rest(), 1.0, tangent=False)
    with pytest.raises(SceneError, match="names"):
        Material([Group(np.arange(1), "F", 0.3, law)], 4, ("E",))


def test_a_material_has_the_numbers_of_a_point():
    names, law = ("E", "s"), hhr.Plasticity("s", 2.0)
    material = Material([Group(np.arange(2), "2 * E", 0.3, law), Group(np.arange(2, 4), 5.0, 0.2, None)], 4, names)
    point = np.array([3.0, 7.0])
    elastic, whole = material.moduli_at(point), material.at(point)
    assert [group.young for group in elastic.groups] == [6.0, 5.0] == [group.young for group in whole.groups]
    assert elastic.groups[0].law == law and whole.groups[0].law == hhr.Plasticity(7.0, 2.0)
    expected = Material([Group(np.arange(2), 6.0, 0.3, law), Group(np.arange(2, 4), 5.0, 0.2, None)], 4, names)
    assert np.array_equal(elastic.elastic, expected.elastic) and np.array_equal(whole.elastic, expected.elastic)
    assert elastic.moduli_at(-point) is elastic
    assert material.moduli_at(np.array([3.0, 8.0])) is elastic and material.at(point) is whole
    assert material.constants(point) == [{"young": 6.0, "yield_stress": 7.0}, {}]
    assert material.at(np.array([4.0, 7.0])).groups[0].young == 8.0
    assert whole.at(-point) is whole and whole.elastic is whole.at(-point).elastic
    assert material.restricted(np.array([1])).at(point).groups[0].law == hhr.Plasticity(7.0, 2.0)
    constant = Material([Group(np.arange(2), 5.0, 0.2, law)], 4, names)
    assert constant.at(point).elastic is constant.elastic
