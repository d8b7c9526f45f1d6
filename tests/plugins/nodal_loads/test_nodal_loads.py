"""Supports on lines of nodes and on single ones, and forces at nodes."""

from dataclasses import replace

import numpy as np
import pytest
from needs import needs, present
from scenes import block_scene

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.geometries import block

LEFT = hhr.Nodes(lambda x: np.isclose(x[0], 0) & np.isclose(x[2], 0))
RIGHT = hhr.Nodes(lambda x: np.isclose(x[0], 4) & np.isclose(x[2], 0))


def number(i, j, k):
    return 1 + i + 5 * j + 10 * k


def deck(path):
    """Four cubes of first order in a row, with sets of nodes that hold no face."""
    rows = [
        "*NODE",
        *(f"{number(i, j, k)}, {i}., {j}., {k}." for k in (0, 1) for j in (0, 1) for i in range(5)),
    ]
    rows.append("*ELEMENT, TYPE=C3D8, ELSET=BEAM")
    for i in range(4):
        nodes = [number(i + a, b, k) for k in (0, 1) for a, b in ((0, 0), (1, 0), (1, 1), (0, 1))]
        rows.append(f"{i + 1}, {', '.join(map(str, nodes))}")
    rows += ["*SURFACE, NAME=BELLY", "BEAM, S1", "*SURFACE, NAME=LID", "BEAM, S2"]
    for name, places in (
        ("LEFT", ((0, 0), (0, 1))),
        ("RIGHT", ((4, 0), (4, 1))),
        ("PIN", ((0, 0),)),
    ):
        rows += [f"*NSET, NSET={name}", ", ".join(str(number(i, j, 0)) for i, j in places)]
    path.write_text("\n".join(rows) + "\n")
    return path


def beam(path, places, order=None):
    """The cubes on two lines above a floor: ``places`` are of left and right line and the pin."""
    left, right, pin = places
    held = hhr.Displacement(left, 2), hhr.Displacement(right, 2), hhr.Displacement(pin, 0)
    return hhr.Scene(
        name="beam",
        geometry=hhr.MeshFile(path),
        hypothesis="solid",
        bodies=(hhr.Body("BEAM", young=1e3, poisson=0.3),),
        contacts=(hhr.Obstacle("BELLY", normal=(0, 0, -1), offset=0.01),),
        displacements=(
            *held,
            hhr.Displacement(pin, 1),
            hhr.Displacement(hhr.Nodes.near((4.0, 0.0, 0.0)), 1),
        ),
        loads=(hhr.Pressure("LID", "push"),),
        parameters=hhr.ParameterSpace(("push",), (0.0,), (10.0,)),
        outputs=(hhr.ContactForce("force", contact=0, direction=(0.0, 0.0, 1.0)),),
        order=order,
    )


@pytest.mark.parametrize(
    "places", [("LEFT", "RIGHT", "PIN"), (LEFT, RIGHT, hhr.Nodes.near((-1.0, 0.1, 0.0)))]
)
def test_a_beam_on_two_lines(places, tmp_path):
    """13.3106 is by trilinear elements and active sets written for it."""
    full = hhr.FullOrderModel(beam(deck(tmp_path / "beam.inp"), places))
    assert full.solve(0.001).outputs()["force"] == 0.0
    assert full.solve(5.0).outputs()["force"] == pytest.approx(13.3106, abs=1e-4)
    assert hhr.condense(full).solve(5.0).outputs()["force"] == pytest.approx(13.3106, abs=1e-4)


@needs("second_order")
def test_nodes_between_those_of_a_line_are_held_too(tmp_path):
    """With functions of second order: the line is held whole, by its name and by its places."""
    path = deck(tmp_path / "beam.inp")
    named, found = (
        hhr.FullOrderModel(beam(path, places, 2))
        for places in (("LEFT", "RIGHT", "PIN"), (LEFT, RIGHT, "PIN"))
    )
    assert named.discretisation.nodes("LEFT").size == 3
    assert np.array_equal(named.problem.free, found.problem.free)


def pulled(load, hypothesis="plane_strain", **more):
    sides = [hhr.Displacement(block.side(axis, upper=False), axis) for axis in (0, 1)]
    return block_scene(
        "pulled",
        {"p": (0.0, 1.0)},
        upper=(1, 1),
        cells=(2, 2),
        hypothesis=hypothesis,
        bodies=(hhr.Body(block.SOLID, 100.0, 0.3),),
        contacts=(hhr.Obstacle(block.side(0, upper=True), (1, 0), 1.0),),
        displacements=tuple(sides),
        loads=(load,),
        **more,
    )


@pytest.mark.parametrize("hypothesis", ["plane_strain", "axisymmetric"])
def test_forces_at_nodes_are_those_of_a_pressure(hypothesis):
    """Of linear cells, whose consistent forces of a side are known: p L / 4 at its ends, p L / 2
    between.
    """
    top, corner = (
        block.side(1, upper=True),
        hhr.Nodes(lambda x: np.isclose(x[1], 1) & (np.abs(x[0] - 0.5) > 0.4)),
    )
    middle = hhr.Nodes.near((0.5, 1.0))
    parts = [(corner, 0.25), (middle, 0.5)]
    if hypothesis == "axisymmetric":  # ∫ N 2 π r dr on two cells of length 1/2
        parts = [(hhr.Nodes.near(place), 2 * np.pi * part) for place, part in
                 (((0.0, 1.0), 1 / 24), ((0.5, 1.0), 1 / 4), ((1.0, 1.0), 5 / 24))]  # fmt: skip
    first, *others = (hhr.NodalForce(place, (0.0, -part), "p") for place, part in parts)
    scene = pulled(first, hypothesis)
    forced = hhr.FullOrderModel(replace(scene, loads=(first, *others)))
    pressed = hhr.FullOrderModel(pulled(hhr.Pressure(top, "p"), hypothesis))
    assert forced.solve(1.0).displacement() == pytest.approx(
        pressed.solve(1.0).displacement(), abs=1e-12
    )


@needs("elasticity")
@pytest.mark.parametrize("varies", [False, True])
def test_a_block_on_springs(varies):
    """Pressed from above: each half sinks by p over the bedding plus its own compression, in all
    models.
    """
    modulus = 100.0 / (1 - 0.3**2)
    held = hhr.Displacement(block.side(0, upper=False), 0)
    bedding = hhr.Springs(
        block.side(1, upper=False), 1, 50.0, "0.01 * lift" if varies else 0.0, bedding=True
    )
    scene = replace(
        pulled(hhr.Pressure(block.side(1, upper=True), "p"), "plane_strain"), displacements=(held,)
    )
    if varies:
        box = hhr.ParameterSpace(("p", "lift", "E"), (0.0, 0.0, 50.0), (1.0, 1.0, 200.0))
        scene = replace(scene, parameters=box, bodies=(replace(scene.bodies[0], young="E"),))
    far = hhr.Obstacle(block.side(0, upper=True), (1, 0), 9.0)
    scene = replace(scene, loads=(*scene.loads, bedding), contacts=(far,))
    full = hhr.FullOrderModel(scene)
    at = [0.7, 0.5, 100.0] if varies else 0.7
    u, points = full.solve(at).displacement().reshape(-1, 2), full.problem.points
    lift = 0.005 if varies else 0.0
    assert u[:, 1] == pytest.approx(lift - 0.7 / 50.0 - 0.7 / modulus * points[:, 1], abs=1e-10)


@needs("elasticity")
def test_a_spring_that_touches_shares_its_force():
    """A bar between a spring and an obstacle: forces of both are the load, in reduced models
    too.
    """
    springs = hhr.Springs(block.side(1, upper=False), 1, 20.0, bedding=True)
    scene = replace(
        pulled(hhr.Pressure(block.side(1, upper=True), "p")),
        displacements=tuple(
            hhr.Displacement(block.side(0, upper=upper), 0) for upper in (False, True)
        ),
        contacts=(hhr.Obstacle(block.side(1, upper=False), (0, -1), 0.01),),
        outputs=(hhr.ContactForce("floor", contact=0, direction=(0.0, 1.0)),),
    )
    scene = replace(scene, loads=(*scene.loads, springs))
    training = hhr.train(scene, hhr.Sobol(8), held_out=2)
    for model in (training.full_order, hhr.condense(training.full_order), training.build()):
        assert model.solve(0.15).outputs()["floor"] == pytest.approx(0.0, abs=1e-12)
        assert model.solve(0.9).outputs()["floor"] == pytest.approx(0.9 - 20.0 * 0.01, rel=1e-8)


@needs("elasticity")
@pytest.mark.parametrize(
    ("make", "why"),
    [
        (lambda: hhr.Springs(1, 1, -2.0), "positive modulus"),
        (lambda: hhr.Nodes((0.0, 0.0)), r"Nodes.near\(\(x, y, z\)\)"),
        (lambda: hhr.Nodes.near((0.0, np.nan)), "finite coordinates"),
        (lambda: hhr.NodalForce(1.5, (0.0, 1.0)), "must be an integer or a name"),
        (lambda: hhr.NodalForce(1, (0.0, 0.0)), "finite and not zero"),
        (
            lambda: hhr.FullOrderModel(pulled(hhr.NodalForce("top", (0.0, 1.0)))),
            "'top' is requested",
        ),
        (
            lambda: hhr.FullOrderModel(pulled(hhr.NodalForce(1, (0.0, 1.0, 0.0)))),
            "must have 2 components",
        ),
        (
            lambda: hhr.FullOrderModel(pulled(hhr.NodalForce(hhr.Nodes.near((0.0,)), (0.0, 1.0)))),
            "must have 2 coord",
        ),
        (
            lambda: hhr.FullOrderModel(
                pulled(hhr.NodalForce(hhr.Nodes(lambda x: x[0]), (0.0, 1.0)))
            ),
            "one bool for each",
        ),
        (
            lambda: hhr.FullOrderModel(
                pulled(hhr.NodalForce(hhr.Nodes(lambda x: x[0] > 9), (1.0, 0.0)))
            ),
            "holds no node",
        ),
        (
            lambda: hhr.FullOrderModel(
                pulled(hhr.NodalForce(hhr.Nodes(lambda x: x[2] > 9), (1.0, 0.0)))
            ),
            "fails for coord",
        ),
        (
            lambda: hhr.FullOrderModel(pulled(hhr.NodalForce(77, (1.0, 0.0)))),
            r"facet tags \[77\] are not in the mesh",
        ),
        (
            lambda: hhr.FullOrderModel(pulled(hhr.Springs(77, 0, 1.0))),
            r"facet tags \[77\] are not in the mesh",
        ),
    ],
)
def test_mistakes(make, why):
    with pytest.raises(SceneError, match=why):
        make()


@needs("second_order", "elasticity")
@pytest.mark.parametrize("simplices", [False, True])
@pytest.mark.parametrize("dim", [2, 3])
def test_a_bedding_of_second_order_passes_a_constant_stress(dim, simplices):
    """A block without lateral strain on a bed of 20 per length and area: sinks by 0.8 / 20, stress
    -0.8 all over.
    """
    bed, lid = (block.side(dim - 1, upper=upper) for upper in (False, True))
    scene = block_scene(
        "bed",
        {"p": (0.1, 1.0)},
        lower=(0.0,) * dim,
        upper=(1.0,) * dim,
        cells=(2,) * dim,
        young=100.0,
        poisson=0.0,
        hypothesis="solid" if dim == 3 else "plane_strain",
        simplices=simplices,
        order=2,
        contacts=(hhr.Obstacle(block.side(0, upper=True), (1.0,) + (0.0,) * (dim - 1), 9.0),),
        displacements=tuple(
            hhr.Displacement(block.side(k, upper=False), k) for k in range(dim - 1)
        ),
        loads=(hhr.Pressure(lid, "p"), hhr.Springs(bed, dim - 1, 20.0, bedding=True)),
    )
    full = hhr.FullOrderModel(scene)
    answer = full.solve(0.8)
    assert answer.stress()[:, dim - 1] == pytest.approx(-0.8 + 0 * answer.stress()[:, 0], rel=1e-9)
    on_bed = np.isclose(full.problem.points[:, dim - 1], 0)
    assert answer.displacement().reshape(-1, dim)[on_bed, dim - 1] == pytest.approx(-0.04, rel=1e-9)
    if present("stress"):  # that of the block, and not of its bed
        outputs = hhr.FullOrderModel(
            replace(scene, outputs=(hhr.ElasticEnergy("energy"),))
        ).outputs(0.8)
        assert outputs["energy"] == pytest.approx(0.8**2 / (2 * 100.0), rel=1e-9)


@pytest.mark.parametrize("off", [0.0, 1e-15, -1e-15])
def test_the_nearest_of_several_is_refused(off):
    """Two bodies have nodes at one place, and round-off of their coordinates chose which of them
    was held.
    """
    points = np.array([(0.0, 1.0), (0.5, 1.0 + off), (1.0, 1.0), (0.5, 1.0), (0.5, 2.0)])
    for place in ((0.5, 1.0), (0.4, 1.1), (0.25, 1.0)):  # the last one is in the middle of three
        with pytest.raises(SceneError, match="nodes are equally near"):
            hhr.Nodes.near(place).nodes(points)
    for place, found in (((0.5, 1.5 + 1e-6), 4), ((0.25 - 1e-6, 1.0), 0), ((0.75 + 1e-6, 1.0), 2)):
        assert hhr.Nodes.near(place).nodes(points).tolist() == [found]


@needs("elasticity")
def test_the_node_between_contacts_is_refused_in_a_scene():
    from scenes import lying

    scene = lying(
        bulge=0.0,
        cells=(4, 2),
        loads=(hhr.NodalForce(hhr.Nodes.near((0.5, 1.0)), (0.0, -1.0), "p"),),
    )
    with pytest.raises(SceneError, match=r"2 nodes are equally near to Nodes.near\(0.5, 1.0\)"):
        hhr.FullOrderModel(scene)
