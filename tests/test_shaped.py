"""Reduced problems assembled for any shape on the RID alone: the same as projected ones, without DOLFINx."""

import pickle
import subprocess
import sys
import warnings
from dataclasses import replace
from itertools import product

import numpy as np
import press_fit
import pytest
from bare import WAIT

import hhr_dolfinx as hhr
from hhr_dolfinx import compat
from hhr_dolfinx.errors import ParameterError, SceneError
from hhr_dolfinx.geometries import block, two_blocks
from hhr_dolfinx.geometries.gmsh_model import gmsh, mesh_of
from hhr_dolfinx.models.eliminations.shaped import tributary_areas
from hhr_dolfinx.models.functionals.cells import CellRule, element_stiffness
from hhr_dolfinx.reduction.projection import load_nodes, project, reduced_domain
from hhr_dolfinx.reduction.shaped import rid_assembly
from hhr_dolfinx.shapes import Shape

pytestmark = pytest.mark.filterwarnings("ignore:displacements are of second order:hhr_dolfinx.errors.PairingWarning")
"""Crowned sides are straight where displacements are of second order: reduced models are compared with these."""

FIELDS = ("stiffness", "contact_test", "contact_trial", "loads", "gaps")
FIRST, SECOND, side = two_blocks.FIRST, two_blocks.SECOND, two_blocks.side
BOTTOM, TOP = side(FIRST, 1, True), side(SECOND, 1, False)
"""Facing sides of a lower and an upper block in the plane."""


def stacked(
    *, contact, names, shapes, cells=(8, 12), bodies=None, hypothesis="plane_strain", left=0.0, lifted=False, **options
):
    """Two blocks on top of each other, the upper one pushed down by ``push`` and pressed from the side.

    The lower one stands on its lower side or, ``lifted``, hangs on its left one, which moves too.
    """
    first = (left, 0.0), (left + 2.0, 1.0), (cells[0], 4)
    second = (left, 1.05), (left + 2.0, 1.85), (cells[1], 4)
    moving = hhr.Displacement(side(FIRST, 0, False), 1, hhr.Amplitude(slopes={"push": 0.3}))
    stand = moving if lifted else hhr.Displacement(side(FIRST, 1, False), 1)
    push = hhr.Displacement(side(SECOND, 1, True), 1, hhr.Amplitude(slopes={"push": -1.0}))
    held = [hhr.Displacement(side(body, 0, False), 0) for body in (FIRST, SECOND)]
    bounds = {"push": (0.05, 0.1), "c": (-0.1, 0.1), "t": (0.8, 1.2), "E1": (1.0, 3.0), "nu1": (0.2, 0.4), "p": (0, 1)}
    return hhr.Scene(
        name="stacked",
        geometry=lambda comm: two_blocks.two_blocks(comm, first=first, second=second, **options),
        hypothesis=hypothesis,
        bodies=bodies or (hhr.Body(FIRST, "2 * E1", "nu1"), hhr.Body(SECOND, 2.0, 0.3)),
        contacts=(contact,),
        parameters=hhr.ParameterSpace(names, *zip(*(bounds[name] for name in names), strict=True)),
        displacements=(stand, *held, push),
        openings=(hhr.Opening(0, hhr.Amplitude(slopes={"c": 0.1})),),
        loads=(hhr.Pressure(side(SECOND, 0, True), hhr.Amplitude(slopes={"push": 3.0})),),
        shapes=shapes,
    )


def crowned(x="x", y="y"):
    """Shapes of both blocks: the upper side of the lower one is crowned, the upper one changes its height."""
    return Shape(FIRST, (x, f"{y} * (1 - c * ({x} - 1)**2 / 2)")), Shape(SECOND, (x, f"1.05 + ({y} - 1.05) * t"))


def floor(hypothesis="plane_stress"):
    """A block with slanting sides above a rigid floor, of which nothing else is fixed."""
    return hhr.Scene(
        name="floor",
        geometry=lambda comm: block.block(comm, lower=(0.0, 0.0), upper=(1.5, 2.0), cells=(6, 8)),
        hypothesis=hypothesis,
        bodies=(hhr.Body(block.SOLID, "E1", "nu1"),),
        contacts=(hhr.Obstacle(block.side(1, False), (0.0, -1.0), 0.02),),
        parameters=hhr.ParameterSpace(("push", "c", "E1", "nu1"), (0.05, -0.1, 1.0, 0.2), (0.1, 0.1, 2.0, 0.4)),
        displacements=(
            hhr.Displacement(block.side(0, False), 0),
            hhr.Displacement(block.side(1, True), 1, hhr.Amplitude(slopes={"push": -1.0})),
        ),
        shapes=(Shape(block.SOLID, ("x * (1 + c * y)", "y + c * x * (2 - y) / 10")),),
    )


def bulging():
    """The same, but flat at the ends, where closest points stay in front of the other surface."""
    return Shape(FIRST, ("x", "y * (1 - c * max(0, (x - 0.3) * (1.7 - x))**2)")), crowned()[1]


def higher():
    """Two blocks that change their height."""
    return Shape(FIRST, ("x", "y * (1 + c)")), Shape(SECOND, ("x", "1.05 + c + (y - 1.05) * t"))


NODES = hhr.NodeToNode(BOTTOM, TOP, (0.0, 1.0))
NAMES = ("push", "c", "t", "E1", "nu1")
RUBBER = (hhr.Body(FIRST, 3.0, 0.499), hhr.Body(SECOND, 2.0, 0.3))
SCENES = {
    "quadrilaterals": lambda: stacked(contact=NODES, names=NAMES, shapes=crowned(), cells=(8, 8)),
    "triangles": lambda: stacked(contact=NODES, names=NAMES, shapes=crowned(), cells=(8, 8), simplices=True),
    "one body moves": lambda: stacked(
        contact=hhr.NodeToSurface(TOP, BOTTOM), names=("push", "c", "E1", "nu1"), shapes=bulging()[:1]
    ),
    "along a normal": lambda: stacked(
        contact=hhr.NodeToSurface(TOP, BOTTOM, (0.0, -1.0)), names=NAMES, shapes=crowned(), simplices=True
    ),
    "a moved surface": lambda: stacked(contact=hhr.Mortar(TOP, BOTTOM), names=NAMES, shapes=crowned(), lifted=True),
    "segments": lambda: stacked(contact=hhr.Mortar(TOP, BOTTOM), names=NAMES, shapes=crowned()),
    "standard multipliers": lambda: stacked(
        contact=hhr.Mortar(TOP, BOTTOM, multipliers="standard"), names=NAMES, shapes=crowned()
    ),
    "both ways": lambda: stacked(contact=hhr.DoublePass(TOP, BOTTOM), names=NAMES, shapes=higher(), cells=(6, 13)),
    "axisymmetric": lambda: stacked(
        contact=NODES, names=NAMES, shapes=crowned("r", "z"), cells=(8, 8), hypothesis="axisymmetric", left=0.5
    ),
    "axisymmetric triangles": lambda: stacked(
        contact=NODES, names=NAMES, shapes=crowned("r", "z"), cells=(8, 8), hypothesis="axisymmetric", simplices=True
    ),
    "rubber": lambda: stacked(
        contact=NODES, names=("push", "c", "t"), shapes=crowned(), cells=(8, 8), bodies=RUBBER
    ),
    "rubber rings": lambda: stacked(
        contact=NODES, names=("push", "c", "t"), shapes=crowned("r", "z"), cells=(8, 8), bodies=RUBBER,
        hypothesis="axisymmetric", left=0.5,
    ),
    "obstacle in plane stress": floor,
    "hexahedra": lambda: press_fit.scene(**press_fit.QUICK_MESH),
}  # fmt: skip


def curved(*, simplices, contact, dim=2):
    """Two blocks of cells of second order, with nodes of their own on both sides: shapes curve these cells."""

    def make():
        for body, low in ((FIRST, 0.0), (SECOND, 1.05)):
            box = (0, 0, low, 2, 1, 1) if dim == 3 else (0, low, 0, 2, 1)
            solid = (gmsh.model.occ.addBox if dim == 3 else gmsh.model.occ.addRectangle)(*box)
            gmsh.model.occ.synchronize()
            gmsh.model.addPhysicalGroup(dim, [solid], body)
            for axis, upper in product(range(dim), (False, True)):
                faces = [
                    tag
                    for _, tag in gmsh.model.getBoundary([(dim, solid)], oriented=False)
                    if abs(
                        gmsh.model.occ.getCenterOfMass(dim - 1, tag)[axis]
                        - gmsh.model.getBoundingBox(dim, solid)[axis + 3 * upper]
                    )
                    < 1e-6
                ]
                gmsh.model.addPhysicalGroup(dim - 1, faces, side(body, axis, upper))
        if not simplices:
            gmsh.model.mesh.setTransfiniteAutomatic()
        gmsh.model.mesh.generate(dim)
        gmsh.model.mesh.setOrder(2)

    last = dim - 1
    plain = stacked(contact=contact, names=NAMES, shapes=crowned())
    coordinates = ("x", "y", "z * (1 - c * (x - 1)**2 / 2)"), ("x", "y", "1.05 + (z - 1.05) * t")
    sides = [hhr.Displacement(side(body, axis, False), axis) for body in (FIRST, SECOND) for axis in range(last)]
    return replace(
        plain,
        geometry=lambda comm: mesh_of(make, comm, dim, options={"Mesh.MeshSizeMax": 0.6 if dim == 3 else 0.25}),
        hypothesis="solid" if dim == 3 else "plane_strain",
        displacements=(
            hhr.Displacement(side(FIRST, last, False), last),
            hhr.Displacement(side(SECOND, last, True), last, hhr.Amplitude(slopes={"push": -1.0})),
            *sides,
        ),
        loads=(hhr.Pressure(side(SECOND, 0, True), hhr.Amplitude(slopes={"push": 3.0})),),
        shapes=tuple(map(Shape, (FIRST, SECOND), coordinates)) if dim == 3 else crowned(),
    )


def facing(dim=2):
    """Facing sides of these."""
    return side(FIRST, dim - 1, True), side(SECOND, dim - 1, False)


FLAT = (
    "quadrilaterals",
    "triangles",
    "along a normal",
    "a moved surface",
    "segments",
    "both ways",
    "axisymmetric triangles",
    "obstacle in plane stress",
    "hexahedra",
)
"""Scenes on flat cells whose displacement is made of second order."""
SECOND_ORDER = {
    **{f"{name}, second order": lambda name=name: replace(SCENES[name](), order=2) for name in FLAT},
    "curved quadrilaterals": lambda: curved(simplices=False, contact=NODES),
    "curved triangles": lambda: curved(simplices=True, contact=hhr.Mortar(TOP, BOTTOM)),
    "curved tetrahedra": lambda: curved(simplices=True, contact=hhr.Mortar(*facing(3)), dim=3),
    "curved hexahedra": lambda: curved(simplices=False, contact=hhr.NodeToNode(*facing(3), (0.0, 0.0, 1.0)), dim=3),
}


def projected(full, point, basis, sets):
    """The full problem at a point, projected, with the nodes that its conditions touch there: surfaces slide."""
    problem = full.problem.at(point)
    touched = np.flatnonzero(abs(problem.contact[sets.A_lambda]).T @ np.ones(len(sets.A_lambda)))
    return project(problem, basis, replace(sets, A_c=np.intersect1d(touched, sets.A), A_c_tilde=touched))


def reduced(scene, share=0.4, modes=12, every_shape=True):
    """A full model, a random basis, a RID around some of the contact, and what assembles there."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        full = hhr.FullOrderModel(scene)
    problem = full.problem
    basis = np.random.default_rng(1).standard_normal((problem.free.size, modes))
    basis[~problem.free] = 0.0
    slaves = problem.contact_slaves
    nodes = np.append(slaves[: max(2, int(share * len(slaves)))], load_nodes(problem))
    sets = reduced_domain(problem.touching() if every_shape else problem, nodes)
    return full, basis, sets, rid_assembly(full, basis, sets)


def apart(found, wanted):
    """Largest difference of all arrays of two reduced problems, each relative to the largest entry."""
    return {
        name: np.abs(getattr(found, name) - getattr(wanted, name)).max() / (np.abs(getattr(wanted, name)).max() or 1.0)
        for name in FIELDS
    }


SCENES |= SECOND_ORDER


SLOW = ("hexahedra, second order", "curved hexahedra")
"""What takes five seconds each; tetrahedra are as much of second order and in space."""


@pytest.mark.parametrize("name", [pytest.param(name, marks=[pytest.mark.slow] * (name in SLOW)) for name in SCENES])
def test_it_is_the_projection_of_the_full_problem_at_any_point(name):
    full, basis, sets, assembly = reduced(SCENES[name]())
    assert full.problem.varies and len(sets.A_lambda) > 1
    space = full.parameters
    for point in (*space.random(2, seed=3), np.array(space.upper, dtype=float)):
        found, wanted = assembly(point), projected(full, point, basis, sets)
        assert max(apart(found, wanted).values()) < 1e-10, apart(found, wanted)
        assert np.array_equal(found.pairs, wanted.pairs) and found.terms is None
        theta = full.problem.theta(point)
        assert np.abs(wanted.loads @ theta).max() > 0 or name == "hexahedra"
    # the displacement that moves the surface is the first term but one
    assert name != "a moved surface" or np.abs(found.gaps[:, 1]).max() > 0.1


@pytest.mark.parametrize("name", ["quadrilaterals", "axisymmetric", "hexahedra"])
def test_positions_and_areas_of_conditions(name):
    full, _, sets, assembly = reduced(SCENES[name]())
    point = full.parameters.random(1, seed=5)[0]
    found, problem = assembly.conditions(assembly.coordinates(point)), full.problem.at(point)
    assert np.abs(found.points - problem.contact_points[sets.A_lambda]).max() < 1e-10
    wanted = problem.contact_areas[sets.A_lambda]
    # slaves at the edge of the patch have no more facets than those of the patch: those of the RID have all
    assert np.abs(found.areas / wanted - 1).max() < 1e-6


def test_nothing_but_the_domain_and_its_surroundings_is_kept():
    full, _, sets, assembly = reduced(SCENES["hexahedra"](), share=0.1)
    problem = full.problem
    inside = np.unique(problem.cell_nodes[sets.cells]).size
    surfaces = np.unique(np.concatenate([patch.nodes for patch in assembly.patches])).size
    assert len(assembly.reference) <= inside + surfaces < len(problem.points)
    moving = sum(len(body.cells) for body in assembly.bodies)
    hub = np.isin(sets.cells, full.discretisation.cells_of(press_fit.geometry.HUB)).sum()
    assert moving == hub < len(sets.cells)  # the shaft stays as it is, and is projected once
    whole = [len(np.unique(full.discretisation.surface(tag).facets, axis=0)) for tag in problem_tags(full)]
    assert all(len(part.facets) < count for part, count in zip(assembly.patches[0].surfaces, whole, strict=True))


def problem_tags(full):
    """Tags of the first contact pair."""
    return full.scene.contacts[0].tags


def test_it_needs_no_finite_element_library(tmp_path):
    cases = {name: reduced(SCENES[name]()) for name in ("hexahedra", "one body moves", "rubber rings")}
    kept = []
    for full, _, _, assembly in cases.values():
        point = full.parameters.random(1, seed=7)[0]
        kept.append((assembly, point, assembly(point)))
    (tmp_path / "kept").write_bytes(pickle.dumps(kept))
    program = (
        "import pickle, sys, numpy as np\n"
        "from pathlib import Path\n"
        "for assembly, point, wanted in pickle.loads(Path('kept').read_bytes()):\n"
        "    found = assembly(point)\n"
        "    assert np.abs(found.stiffness - wanted.stiffness).max() < 1e-13 * np.abs(wanted.stiffness).max()\n"
        "    assert np.abs(found.contact_trial - wanted.contact_trial).max() < 1e-12\n"
        "print(*{'dolfinx', 'ufl', 'basix', 'petsc4py', 'numba', 'gmsh'} & set(sys.modules))\n"
    )
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, cwd=tmp_path, timeout=WAIT)
    assert run.returncode == 0, run.stderr[-3000:]
    assert run.stdout.strip() == ""


def test_a_shape_that_slides_surfaces_out_of_the_domain_is_refused():
    """The upper block moves along the lower one: other nodes face each other than where the domain was closed."""
    slides = (Shape(SECOND, ("x + 4 * c", "y")),)
    bodies = (hhr.Body(FIRST, 2.0, 0.3), hhr.Body(SECOND, 2.0, 0.3))
    contact = hhr.NodeToSurface(TOP, BOTTOM)
    full, _, _, assembly = reduced(
        stacked(contact=contact, names=("push", "c"), shapes=slides, bodies=bodies), 0.3, every_shape=False
    )
    assembly(full.problem.middle)
    with pytest.raises(ParameterError, match=r"slide|not there|cannot be evaluated"):
        assembly(np.array(full.parameters.lower, dtype=float))


def test_what_the_full_model_refuses_is_refused():
    """Where the lower side falls off towards its ends the closest points of the outermost nodes lie beyond them."""
    names = ("push", "c", "E1", "nu1")
    scene = stacked(contact=hhr.NodeToSurface(TOP, BOTTOM), names=names, shapes=crowned()[:1])
    full, _, _, assembly = reduced(scene)
    point = (0.1, -0.05, 2.0, 0.3)
    for refused in (full.problem.at, assembly):
        with pytest.raises(ParameterError, match=r"in contact|not there"):
            refused(np.array(point))


def test_graded_bodies_and_scenes_of_one_shape_are_refused():
    graded = (hhr.Body(FIRST, 1.0, 0.3, grading=lambda x: 1 + x[0]), hhr.Body(SECOND, 2.0, 0.3))
    with pytest.raises(SceneError, match="graded"):
        reduced(stacked(contact=NODES, names=("push", "c", "t"), shapes=crowned(), cells=(8, 8), bodies=graded))
    with pytest.raises(SceneError, match="does not depend on parameters"):
        reduced(stacked(contact=NODES, names=("push", "c", "E1", "nu1"), shapes=(), cells=(8, 8)))


DISTORTED = ("x + c * sin(3 * x) * y", "y * (1 + c * (x - 1)**2)")


@pytest.mark.parametrize(("simplices", "most"), [(True, 1e-12), (False, 1e-3)])
def test_the_rule_of_shapes_is_as_good_as_the_usual_one(simplices, most):
    """A block meshed in its place and one moved there; on triangles both rules are exact."""
    value, names = 0.1, ("push", "c")
    bodies = (hhr.Body(FIRST, 2.0, 0.3), hhr.Body(SECOND, 2.0, 0.3))

    def warp(points, tag):
        x, y = points.T
        moved = np.column_stack([x + value * np.sin(3 * x) * y, y * (1 + value * (x - 1) ** 2)])
        return moved if tag == FIRST else points

    options = {"contact": hhr.Mortar(TOP, BOTTOM), "names": names, "bodies": bodies, "simplices": simplices}
    moved = hhr.FullOrderModel(stacked(shapes=(Shape(FIRST, DISTORTED),), **options))
    plain = hhr.FullOrderModel(stacked(shapes=(), warp=warp, **options))
    found, wanted = (model.solve((0.1, value)) for model in (moved, plain))
    assert np.abs(found.displacement() - wanted.displacement()).max() < most * np.abs(wanted.displacement()).max()
    assert np.linalg.norm(found.multipliers - wanted.multipliers) < most * np.linalg.norm(wanted.multipliers)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("simplex", [False, True])
def test_rigid_motions_cost_nothing(dim, simplex):
    corners = np.array([[(k >> axis) & 1 for axis in range(dim)] for k in range(2**dim)], dtype=float)
    if simplex:
        corners = np.vstack([np.zeros(dim), np.eye(dim)])
    corners = corners + 0.1 * np.random.default_rng(0).standard_normal(corners.shape)
    gauss = np.array([0.2, 0.7])[(np.arange(2**dim)[:, None] >> np.arange(dim)) & 1] / (dim if simplex else 1)
    kind = {2: ("quadrilateral", "triangle"), 3: ("hexahedron", "tetrahedron")}[dim][simplex]
    rule = CellRule(np.full(len(gauss), 1 / len(gauss)), *compat.shape_functions(kind, gauss))
    spin = np.zeros((dim, dim))
    spin[0, 1] = 1.0
    spin[1, 0] = -1.0
    motions = [np.tile(axis, (len(corners), 1)) for axis in np.eye(dim)] + [corners @ spin]
    for mean in (False, True):
        (stiffness,) = element_stiffness(corners[None], rule, "solid", 1.3, 0.7, mean)
        assert np.abs(stiffness - stiffness.T).max() < 1e-12
        for motion in motions:
            assert np.abs(stiffness @ motion.ravel()).max() < 1e-12


def test_areas_of_facets():
    points = np.array([[0.0, 0, 0], [2, 0, 0], [0, 3, 0], [2, 3, 0]])
    ones = np.ones(4)
    assert np.allclose(tributary_areas(np.arange(4)[None], points, ones), 1.5)
    assert np.allclose(tributary_areas(np.array([[0, 1, 2], [1, 2, 3]]), points, ones), [1, 2, 2, 1])
    radii = np.array([1.0, 2.0])
    areas = tributary_areas(np.array([[0, 1]]), np.column_stack([radii, [0, 0]]), radii)
    assert np.allclose(areas, [2 / 3, 5 / 6])  # of int r (2 - r) dr and int r (r - 1) dr from 1 to 2
