"""Rigid tools that forces drive: beside tools whose motion is imposed, bodies that are moved in
their place, and contact problems of a textbook.
"""

import itertools
import warnings
from dataclasses import replace

import numpy as np
import pytest
from mpi4py import MPI
from needs import needs
from scenes import block_scene, slope
from scipy.optimize import nnls

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import FarSlidingWarning, SceneError
from hhr_dolfinx.geometries import block

pytestmark = [
    needs("rigid_tools"),
    pytest.mark.filterwarnings("ignore:parameters .* have no effect"),
]
BOX = {"F": (0.0, 0.02), "slide": (0.0, 0.5), "depth": (0.0, 0.02)}
AT = {"F": 0.01, "slide": 0.0, "depth": 0.01}
BOTTOM, TOP = (block.side(1, upper=upper) for upper in (False, True))
LID = block.side(2, upper=True)


def flat(friction=None, *, moved=False, **others):
    """A wide block below a flat obstacle; its foot may be moved in the place of the obstacle."""
    foot = slope("slide", -1.0) if moved else 0.0
    return block_scene(
        "flat",
        BOX,
        upper=(2.0, 1.0),
        cells=(12, 6),
        contacts=(hhr.Obstacle(TOP, normal=(0, 1), offset=1.0, friction=friction),),
        displacements=(hhr.Displacement(BOTTOM, 0, foot), hhr.Displacement(BOTTOM, 1)),
        **others,
    )


def cube(obstacle, **others):
    """A cube whose foot is held, below an obstacle."""
    return block_scene(
        "cube",
        BOX,
        lower=(0, 0, 0),
        upper=(1, 1, 1),
        cells=(5, 4, 3),
        hypothesis="solid",
        contacts=(obstacle,),
        displacements=hhr.Displacement.clamp(block.side(2, upper=False), 3),
        **others,
    )


def full(scene):
    return hhr.FullOrderModel(scene, MPI.COMM_SELF)


def lowered(scene):
    """The scene whose obstacle at rest is lower by a parameter."""
    return replace(scene, openings=(hhr.Opening(0, slope("depth", -1.0)),))


def path_of(*points):
    return [(float(k), np.array(point)) for k, point in enumerate(points)]


@pytest.mark.parametrize("simplices", [False, True])
def test_a_motion_is_that_of_an_obstacle(simplices):
    """The tool that is moved down, and the obstacle that an opening lowers."""
    scene = flat(simplices=simplices)
    found = full(hhr.drive(scene, 0, at=(0.3, 1.0), motion={1: "-depth"})).solve(AT)
    expected = full(lowered(scene)).solve(AT).forces()
    assert found.forces() == pytest.approx(expected, rel=1e-12, abs=1e-14 * expected.max())


@needs("friction")
def test_a_tool_drags_by_friction():
    """A tool that moves over the body, and a body that moves below it the other way: one motion of
    both, seen from the other. Contacts stick, slip, and slip back.
    """
    path = path_of((0, 0, 0), (0, 0, 0.01), (0, 0.002, 0.01), (0, 0.01, 0.012), (0, 0.005, 0.011))
    dragged = hhr.drive(flat(0.3), 0, at=(1.0, 1.0), motion={0: "slide", 1: "-depth"})
    found = full(dragged).march(path).answers
    expected = full(lowered(flat(0.3, moved=True))).march(path).answers
    slid = [np.abs(answer.slip.position).max() for answer in expected]
    assert max(slid) > 1e-3
    for one, other in zip(found, expected, strict=True):
        size = np.abs(other.multipliers).max()
        assert one.multipliers == pytest.approx(other.multipliers, abs=1e-12 * size)


@needs("floating", "friction")
@pytest.mark.parametrize("made", [full, hhr.condense], ids=["full", "condensed"])
def test_a_force_presses_and_friction_resists(made):
    """Pressures bear the force, and their sum times the coefficient is what drags a tool that
    slides, whatever the motion is beyond.
    """
    scene = hhr.drive(flat(0.3), 0, at=(1.0, 1.0), force={1: "-F", 2: 0.0}, motion={0: "slide"})
    path = path_of((0.001, 0, 0), (0.01, 0, 0), (0.01, 0.1, 0), (0.01, 0.5, 0), (0.02, 0, 0))
    with warnings.catch_warnings():  # along a plane contact is the same everywhere
        warnings.simplefilter("error", FarSlidingWarning)
        answers = made(scene).march(path).answers
    pressures, shears = np.split(np.array([answer.multipliers for answer in answers]), 2, axis=1)
    assert pressures.sum(axis=1) == pytest.approx([0.01, 0.01, 0.01, 0.02], rel=1e-9)
    assert shears.sum(axis=1) == pytest.approx([0, 0.003, 0.003, -0.006], abs=1e-9)


def turned(scene, at, moment="0.001 * F"):
    return hhr.drive(scene, 0, at=at, force={1: "-F", 2: moment})


@needs("floating")
@pytest.mark.parametrize("along", [0.4, 1.0, 1.3, 1.6])
def test_a_tool_tilts_below_a_force_beside_its_middle(along):
    """Conditions of equilibrium, from S of the obstacle at rest: forces that balance the force and
    its moment, and pressures where the straight line of the tool touches alone.
    """
    model = hhr.condense(
        replace(
            turned(flat(), (along, 1.4)),
            outputs=(hhr.ToolMotion("sinks", 1), hhr.ToolMotion("turns", 2)),
        )
    )
    answer = model.solve(AT)
    forces, motion = answer.forces(), answer.outputs()
    rest = full(flat())
    arms = rest.problem.contact_points[:, 0] - along
    assert forces.sum() == pytest.approx(0.01, rel=1e-12)
    # a force on the body along -y is one on the tool along +y
    assert forces @ arms == pytest.approx(-1e-5, rel=1e-9)
    gap = rest.schur @ forces + motion["sinks"] + motion["turns"] * arms
    size = np.abs(motion["turns"] * arms).max() + abs(motion["sinks"])
    assert gap[forces > 0] == pytest.approx(0.0, abs=1e-12 * size)
    assert gap.min() >= -1e-12 * size
    assert (along in (0.4, 1.6)) == bool((gap > 1e-3 * size).any())


@needs("floating")
def test_gradients_along_a_force_and_its_moment():
    """By differences, of forces and motions."""
    model = hhr.condense(replace(turned(flat(), (1.6, 1.0)), outputs=(hhr.ToolMotion("turns", 2),)))
    step = 1e-6
    slopes = model.solve(AT, gradient=True).gradient.multipliers[:, 0]
    more, less = (model.solve(AT | {"F": 0.01 + sign * step}).forces() for sign in (1, -1))
    assert slopes == pytest.approx((more - less) / (2 * step), abs=1e-8)


@needs("floating", "obstacles")
@pytest.mark.parametrize("order", [1, 2])
def test_a_sphere_that_sinks_by_a_force(order):
    """Forces along the normals of the sphere, by least squares on S where the tool is at rest, with
    gaps that shrink by the motion of the sphere along each normal.
    """
    if order == 2:
        pytest.importorskip("hhr_dolfinx.plugins.second_order")
    scene = cube(hhr.Sphere(LID, center=(0.5, 0.5, 3.0), radius=2.0), order=order)
    axes = {0: 0.0, 1: 0.0, 2: "-F"}
    driven = hhr.drive(scene, 0, at=(0.5, 0.5, 3.0), force=axes)
    driven = replace(driven, outputs=tuple(hhr.ToolMotion(f"u{k}", k) for k in range(3)))
    model = full(driven)
    answer = model.solve(AT)
    motion = np.array([answer.outputs()[f"u{k}"] for k in range(3)])
    rest = full(scene)
    sums = np.asarray(rest.problem.contact.toarray()).reshape(len(answer.forces()), -1, 3).sum(1)
    factor = np.linalg.cholesky(rest.schur)
    gaps = rest.problem.gaps[:, 0] + sums @ motion
    expected = nnls(factor.T, np.linalg.solve(factor, -gaps))[0]
    assert answer.forces() == pytest.approx(expected, abs=1e-9 * expected.max())
    assert answer.forces() @ sums == pytest.approx([0, 0, 0.01], abs=1e-11)
    assert motion[:2] == pytest.approx(0.0, abs=1e-12)


@needs("floating", "obstacles")
def test_a_tool_in_axisymmetry():
    """A sphere on a disc: the force of the whole turn, and the gaps at the depth that it finds."""
    scene = block_scene(
        "ring",
        BOX,
        cells=(6, 5),
        hypothesis="axisymmetric",
        contacts=(hhr.Circle(TOP, center=(0.0, 3.0), radius=2.0),),
        displacements=hhr.Displacement.clamp(BOTTOM, 2),
    )
    driven = hhr.drive(scene, 0, at=(0.0, 3.0), force={1: "-F"})
    answer = full(replace(driven, outputs=(hhr.ToolMotion("sinks", 1),))).solve(AT)
    rest = full(scene)
    along = rest.problem.contact.toarray().reshape(len(answer.forces()), -1, 2).sum(1)[:, 1]
    assert answer.forces() @ along == pytest.approx(0.01, rel=1e-11)
    factor = np.linalg.cholesky(rest.schur)
    gaps = rest.problem.gaps[:, 0] + along * answer.outputs()["sinks"]
    expected = nnls(factor.T, np.linalg.solve(factor, -gaps))[0]
    assert answer.forces() == pytest.approx(expected, abs=1e-9 * expected.max())


@needs("floating", "constraints")
def test_a_tool_is_a_meshed_body_that_is_stiff():
    """A stiff beam of the mesh, driven by the same force and moment at its rigid upper side."""
    from hhr_dolfinx.geometries.two_blocks import FIRST, SECOND, side, two_blocks

    def meshed(comm):
        return two_blocks(comm, first=((0, 0), (2, 1), (12, 6)), second=((0, 1), (2, 1.5), (12, 1)))

    top = side(FIRST, 1, upper=True)
    beam = side(SECOND, 1, upper=False)
    foot = hhr.Displacement.clamp(side(FIRST, 1, upper=False), 2)
    body = hhr.Body(FIRST, 1.0, 0.3)
    scene = replace(flat(), geometry=meshed, bodies=(body, hhr.Body(SECOND, 1e9, 0.0)))
    force = {1: "-F", 2: "0.001 * F"}
    as_a_body = replace(
        scene,
        contacts=(hhr.NodeToNode(top, beam, normal=(0, 1)),),
        displacements=foot,
        constraints=(
            hhr.RigidMotion(hhr.Nodes(_of_the_beam)),
            hhr.MeanMotion(hhr.Nodes(_of_the_beam), 0, 0.0, (1.5, 1.0)),
        ),
        loads=tuple(
            hhr.CoupledForce(hhr.Nodes(_of_the_beam), component, amplitude, (1.5, 1.0))
            for component, amplitude in force.items()
        ),
    )
    expected = full(as_a_body).solve(AT).forces()
    found = full(hhr.drive(flat(), 0, at=(1.5, 1.0), force=force)).solve(AT).forces()
    assert found == pytest.approx(expected, abs=1e-7 * expected.max())


def _of_the_beam(x):
    return x[1] > 1.25


@needs("floating")
@pytest.mark.filterwarnings("ignore:kappa.B~. = ")
def test_a_hyper_reduced_model_has_the_tool():
    """Forces of all training points, and of points between."""
    driven = hhr.drive(flat(), 0, at=(1.5, 1.0), force={1: "-F - 0.001", 2: 0.0})
    training = hhr.train(driven, [9, 1, 1])
    model = training.build()
    for force in (0.0013, 0.007, 0.0197):
        point = {"F": force, "slide": 0.0, "depth": 0.0}
        expected = training.full_order.solve(point).forces()
        assert model.solve(point).forces() == pytest.approx(expected, abs=1e-8 * expected.max())


@needs("floating", "obstacles")
@pytest.mark.filterwarnings("ignore:kappa.B~. = ", "ignore:contact alone holds")
def test_a_box_with_a_tool_that_nothing_presses_is_hyper_reduced():
    """Without a force the tool moves with its obstacle and deforms nothing: no mode is made of the
    round-off of that.
    """
    scene = replace(flat(), contacts=(hhr.Circle(TOP, center=(1.0, "3 - depth"), radius=2.0),))
    training = hhr.train(hhr.drive(scene, 0, at=(1.0, 3.0), force={1: "-F"}), [5, 1, 4])
    model = training.build()
    point = {"F": 0.013, "slide": 0.0, "depth": 0.011}
    expected = training.full_order.solve(point).forces()
    found = model.solve(point, outside="ignore").forces()
    assert found == pytest.approx(expected, abs=1e-3 * expected.max())


@needs("floating", "pages")
def test_files_keep_a_driven_tool(tmp_path):
    model = hhr.condense(replace(turned(flat(), (1.6, 1.0)), outputs=(hhr.ToolMotion("turns", 2),)))
    hhr.save_model(tmp_path / "model.h5", model)
    found = hhr.load_model(tmp_path / "model.h5")
    assert found.outputs(AT)["turns"] == pytest.approx(model.outputs(AT)["turns"], rel=1e-12)


@needs("floating")
def test_two_tools_stand_in_one_scene():
    """One from above, one from the right, each with its force."""
    right = block.side(0, upper=True)
    scene = replace(
        flat(),
        contacts=(*flat().contacts, hhr.Obstacle(right, normal=(1, 0), offset=2.0)),
    )
    driven = hhr.drive(scene, 0, at=(1.0, 1.0), force={1: "-F"}, name="above")
    driven = hhr.drive(driven, 1, at=(2.0, 0.6), force={0: "-0.5 * F"}, name="beside")
    outputs = hhr.ToolMotion("down", 1, "above"), hhr.ToolMotion("left", 0, "beside")
    model = full(replace(driven, outputs=outputs))
    answer = model.solve(AT)
    sums = np.bincount(model.problem.contact_pairs, answer.forces())
    assert sums == pytest.approx([0.01, 0.005], rel=1e-11)
    assert answer.outputs()["down"] < 0
    # the corner of the foot is held, and stops a tool that does not turn
    assert answer.outputs()["left"] == pytest.approx(0.0, abs=1e-12)


@needs("floating")
def test_one_tool_on_two_surfaces():
    """A corner over the edge of the block, pushed along the diagonal: both sides bear their part of
    the force.
    """
    right = block.side(0, upper=True)
    scene = replace(
        flat(),
        contacts=(*flat().contacts, hhr.Obstacle(right, normal=(1, 0), offset=2.0)),
    )
    model = full(hhr.drive(scene, (0, 1), at=(2.0, 1.0), force={0: "-0.5 * F", 1: "-F"}))
    sums = np.bincount(model.problem.contact_pairs, model.solve(AT).forces())
    assert sums == pytest.approx([0.01, 0.005], rel=1e-11)


def test_the_mesh_of_a_file_keeps_its_names(tmp_path):
    """Groups and sets of nodes of a file stand beside the tool."""
    import meshio

    x, y = (grid.ravel() for grid in np.meshgrid(np.linspace(0, 2, 5), np.linspace(0, 1, 3)))
    rows = [[k, k + 1, k + 6, k + 5] for k in itertools.chain(range(4), range(5, 9))]
    lines = [[10 + k, 11 + k] for k in range(4)] + [[k, k + 1] for k in range(4)]
    tags = [np.full(8, 1), np.repeat([2, 3], 4)]
    names = {"solid": np.array([1, 2]), "top": np.array([2, 1]), "foot": np.array([3, 1])}
    mesh = meshio.Mesh(
        np.column_stack([x, y]),
        [("quad", rows), ("line", lines)],
        cell_data={"gmsh:physical": tags, "gmsh:geometrical": tags},
        field_data=names,
    )
    meshio.write(tmp_path / "block.msh", mesh, file_format="gmsh22", binary=False)
    scene = replace(
        flat(),
        geometry=hhr.MeshFile(tmp_path / "block.msh"),
        bodies=(hhr.Body("solid", 1.0, 0.3),),
        contacts=(hhr.Obstacle("top", normal=(0, 1), offset=1.0),),
        displacements=hhr.Displacement.clamp("foot", 2),
    )
    driven = full(hhr.drive(scene, 0, at=(1.0, 1.0), motion={1: "-depth"}, name="punch"))
    expected = full(lowered(scene)).solve(AT).forces()
    assert driven.solve(AT).forces() == pytest.approx(expected, rel=1e-11)
    with pytest.raises(SceneError, match="has a group or set 'foot'"):
        full(hhr.drive(scene, 0, at=(1.0, 1.0), motion={1: "-depth"}, name="foot"))


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"contacts": 1, "force": {1: "-F"}}, "contact 1 is not among the 1"),
        ({"at": (1.0,), "force": {1: "-F"}}, "must be 2 or 3 coordinates"),
        ({"at": (1.0, np.nan), "force": {1: "-F"}}, "must be 2 or 3 coordinates"),
        ({"force": {3: "-F"}}, "component 3 .* does not exist: name one of .0, 1, 2."),
        ({"force": {1: "-F"}, "motion": {1: "depth"}}, "has a force and a motion"),
        ({}, "no force and no motion"),
        ({"force": {1: "-F"}, "name": ""}, "must be a text"),
        ({"force": {1: "-X"}}, "X"),
        ({"contacts": None, "force": {1: "-F"}}, "contact None is not among"),
        ({"contacts": (), "force": {1: "-F"}}, "needs a contact"),
        ({"contacts": -1, "force": {1: "-F"}}, "contact -1 is not among"),
        ({"force": [0.0, "-F"]}, "by component"),
        ({"force": {1.0: "-F"}}, "component 1.0 .* does not exist"),
        ({"at": None, "force": {1: "-F"}}, "must be 2 or 3 coordinates"),
    ],
)
def test_mistakes_are_named(arguments, words):
    arguments = {"contacts": 0, "at": (1.0, 1.0)} | arguments
    with pytest.raises(SceneError, match=words):
        hhr.drive(flat(), **arguments)


def test_a_point_of_another_dimension_is_named():
    driven = hhr.drive(flat(), 0, at=(1.0, 1.0, 0.0), motion={1: "-depth"})
    with pytest.raises(SceneError, match="must have 2 coordinates"):
        full(driven)


def test_a_pair_of_surfaces_is_no_tool():
    pair = hhr.NodeToNode(TOP, BOTTOM, normal=(0, 1))
    with pytest.raises(SceneError, match="a tool is a rigid obstacle"):
        hhr.drive(replace(flat(), contacts=(pair,)), 0, at=(1.0, 1.0), force={1: "-F"})


def test_an_output_of_a_tool_that_is_not_there_is_named():
    output = hhr.ToolMotion("sinks", 1, "punch")
    driven = hhr.drive(flat(), 0, at=(1.0, 1.0), motion={1: "-depth"})
    with pytest.raises(SceneError, match="no tool 'punch', but tool"):
        full(replace(driven, outputs=(output,)))


@needs("floating", "obstacles")
def test_a_small_tool_on_a_long_body_may_turn():
    """Its turn has a hundredth of the effect of its pressing: no body of facets that spins, which
    would be held.
    """
    middle, width = 6.0, 0.1
    line = np.array([(middle - width / 2, 1.0), (middle + width / 2, 1.0)])
    scene = block_scene(
        "strip",
        BOX,
        upper=(10.0, 1.0),
        cells=(400, 4),
        contacts=(hhr.Profile(TOP, curve=line, smooth=False),),
        displacements=hhr.Displacement.clamp(block.side(0, upper=False), 2),
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", message=".* lie beyond the end of the Profile")
        warnings.filterwarnings("ignore", message="parameters .* have no effect")
        model = full(hhr.drive(scene, 0, at=(middle, 1.0), force={1: "-1e-5 * F", 2: 0.0}))
    forces = model.solve(AT).forces()
    arms = model.problem.contact_points[:, 0] - middle
    assert forces.sum() == pytest.approx(1e-7, rel=1e-9)
    assert forces @ arms == pytest.approx(0.0, abs=1e-9 * 1e-7)
    assert (forces > 0).sum() == 5


@needs("floating")
@pytest.mark.parametrize("at", [(0.5, 0.5, 1.0), (3.0, -2.0, 4.0), (300.0, -200.0, 400.0)])
def test_moments_refer_to_the_reference_point(at):
    """A force at a place, by its moments about points over the contact, beside it, and far off."""
    scene = cube(hhr.Obstacle(LID, normal=(0, 0, 1), offset=1.0))
    place = 0.8, 0.7
    moments = {3: f"{at[1] - place[1]!r} * F", 4: f"{place[0] - at[0]!r} * F"}
    model = full(hhr.drive(scene, 0, at=at, force={2: "-F"} | moments))
    forces = model.solve(AT).forces()
    centre = forces @ model.problem.contact_points[:, :2] / forces.sum()
    assert centre == pytest.approx(place, abs=1e-9 * max(1.0, abs(at[0])))


@needs("floating", "nodal_loads")
def test_places_do_not_hold_the_cell_of_a_tool():
    """A half model, whose tool is on the plane of symmetry; and an output near the tool."""
    symmetry = hhr.Nodes(lambda x: x[0] < 1e-6)
    by_tag, by_place = (
        replace(flat(), displacements=(*flat().displacements, hhr.Displacement(place, 0)))
        for place in (block.side(0, upper=False), symmetry)
    )
    sag = hhr.DisplacementAt("sag", (0.05, 0.95), 1)
    driven = [
        hhr.drive(replace(scene, outputs=(sag,)), 0, at=(0.0, 1.0), force={1: "-F", 2: "-F"})
        for scene in (by_tag, by_place)
    ]
    expected, found = (full(scene).solve(AT) for scene in driven)
    assert found.forces() == pytest.approx(expected.forces(), rel=1e-12, abs=1e-15)
    arms = full(flat()).problem.contact_points[:, 0]
    assert found.forces() @ arms == pytest.approx(0.01, rel=1e-9)
    assert found.outputs()["sag"] == expected.outputs()["sag"] < 0


@pytest.mark.parametrize("quadrilaterals", [False, True])
def test_the_mesh_of_a_file_may_be_of_second_order(tmp_path, quadrilaterals):
    import gmsh

    pytest.importorskip("hhr_dolfinx.plugins.second_order")
    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.model.occ.addRectangle(0, 0, 0, 2, 1)
    gmsh.model.occ.synchronize()
    gmsh.option.setNumber("Mesh.MeshSizeMax", 0.3)
    gmsh.option.setNumber("Mesh.RecombineAll", int(quadrilaterals))
    gmsh.option.setNumber("Mesh.SubdivisionAlgorithm", int(quadrilaterals))
    gmsh.model.addPhysicalGroup(2, [1], 1, "solid")
    gmsh.model.addPhysicalGroup(1, [1], 2, "foot")
    gmsh.model.addPhysicalGroup(1, [3], 3, "top")
    gmsh.model.mesh.generate(2)
    gmsh.model.mesh.setOrder(2)
    gmsh.write(str(tmp_path / "block.msh"))
    gmsh.finalize()
    scene = replace(
        flat(),
        geometry=hhr.MeshFile(tmp_path / "block.msh"),
        bodies=(hhr.Body("solid", 1.0, 0.3),),
        contacts=(hhr.Obstacle("top", normal=(0, 1), offset=1.0),),
        displacements=hhr.Displacement.clamp("foot", 2),
    )
    found = full(hhr.drive(scene, 0, at=(1.0, 1.0), motion={1: "-depth"})).solve(AT).forces()
    expected = full(lowered(scene)).solve(AT).forces()
    assert found == pytest.approx(expected, rel=1e-9, abs=1e-12 * expected.max())


def test_tags_of_a_tool_are_no_tags_of_the_mesh():
    """A mistyped tag is named as in the scene at rest."""
    driven = hhr.drive(flat(), 0, at=(1.0, 1.0), motion={1: "-depth"})
    mistyped = (*driven.displacements, hhr.Displacement(22, 1))
    with pytest.raises(SceneError, match="22"):
        full(replace(driven, displacements=mistyped))


def test_a_tool_is_driven_once():
    driven = hhr.drive(flat(), 0, at=(1.0, 1.0), motion={1: "-depth"})
    with pytest.raises(SceneError, match="of tool 'tool' already"):
        hhr.drive(driven, 0, at=(1.0, 1.0), motion={0: "slide"}, name="other")
    with pytest.raises(SceneError, match="has a body 'tool'"):
        hhr.drive(driven, 0, at=(1.0, 1.0), motion={0: "slide"})


@needs("floating", "obstacles")
def test_one_tool_of_two_obstacles_on_one_surface():
    """Two feet, of which the nearer to the force bears more: their moment is that of the force."""
    feet = tuple(
        hhr.Profile(TOP, curve=np.array([(low, 1.0), (low + 0.4, 1.0)]), smooth=False)
        for low in (0.2, 1.3)
    )
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".* lie beyond the end of the Profile")
        scene = replace(flat(), contacts=feet)
        model = full(hhr.drive(scene, (0, 1), at=(0.7, 1.0), force={1: "-F", 2: 0.0}))
    forces = model.solve(AT).forces()
    arms = model.problem.contact_points[:, 0] - 0.7
    sums = np.bincount(model.problem.contact_pairs, forces)
    assert forces.sum() == pytest.approx(0.01, rel=1e-9)
    assert forces @ arms == pytest.approx(0.0, abs=1e-11)
    assert sums[0] > 1.5 * sums[1] > 0


@needs("friction", "obstacles")
def test_a_curved_tool_that_slides_far_warns():
    scene = replace(
        flat(), contacts=(hhr.Circle(TOP, center=(1.0, 3.0), radius=2.0, friction=0.3),)
    )
    driven = hhr.drive(scene, 0, at=(1.0, 3.0), motion={0: "slide", 1: "-depth"})
    path = path_of((0, 0, 0), (0, 0, 0.01), (0, 0.4, 0.01))
    with pytest.warns(FarSlidingWarning):
        hhr.condense(driven).march(path)
