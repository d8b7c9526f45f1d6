"""Small scenes with closed-form answers, and checks every contact solution must pass."""

import dataclasses

import numpy as np

import hhr_dolfinx as hhr
from hhr_dolfinx.contact.rows import joined
from hhr_dolfinx.formulas import coordinate_names
from hhr_dolfinx.geometries import block, stacked_blocks, two_blocks
from hhr_dolfinx.reduction.projection import open_conditions, reduced_domain

THESIS = hhr.Recipe.thesis(1e-8)
"""The recipe of the thesis for the half-discs.

Built ``as_it_is``, since the trust check warns of it, with reason.
"""


def node_dofs(problem, nodes):
    """All dofs of the given nodes, (len(nodes) * block_size,)."""
    return (np.asarray(nodes)[:, None] * problem.block_size + np.arange(problem.block_size)).ravel()


def with_bodies(scene, **changes):
    """The scene with other constants or another law of all of its bodies."""
    return dataclasses.replace(
        scene, bodies=tuple(dataclasses.replace(body, **changes) for body in scene.bodies)
    )


def whole_domain(problem):
    """The RID that is the whole domain: plain Galerkin projection with all contact conditions."""
    return reduced_domain(problem, np.arange(len(problem.points)))


def check_closed(problem, asked, sets):
    """By the definitions of (5.5), (5.6), (5.20) and section 5.2.3, by brute force."""
    contact, dim = problem.contact.toarray(), problem.block_size
    in_A = np.zeros(problem.free.size, dtype=bool)
    in_A[sets.A] = True
    outside = np.setdiff1d(np.arange(len(problem.cell_nodes)), sets.cells)
    assert not np.isin(sets.A // dim, problem.cell_nodes[outside]).any()
    touching = {j for j, row in enumerate(contact) if in_A[np.flatnonzero(row)].any()}
    assert touching <= set(sets.A_lambda), "a force outside the RID acts on it"
    assert open_conditions(problem, sets).size == 0
    columns = np.flatnonzero(contact[sets.A_lambda].any(axis=0))
    assert sets.A_c_tilde.tolist() == columns.tolist()
    assert sets.A_c.tolist() == columns[in_A[columns]].tolist()
    # every node asked for keeps its free dofs, and a condition belongs to the RID if those of its
    # slave do
    dofs = node_dofs(problem, asked)
    assert in_A[dofs[problem.free[dofs]]].all()
    for row, slave in enumerate(problem.contact_slaves):
        own = node_dofs(problem, [slave])
        own = own[problem.free[own]]
        assert own.size == 0 or in_A[own].all() == (row in sets.A_lambda)


def slope(name, size=1.0):
    """An amplitude that grows with a parameter."""
    return hhr.Amplitude(slopes={name: size})


def space(**box):
    """Parameters by their bounds."""
    return hhr.ParameterSpace(tuple(box), *zip(*box.values(), strict=True))


def block_scene(
    name, box, *, lower=(0.0, 0.0), upper=(1.0, 1.0), cells=(4, 4), young=1.0, poisson=0.3, **others
):
    """A scene of one block, in plane strain unless ``others``, parts of a scene or ``simplices``,
    say otherwise.

    ``box`` has the bounds of its parameters by their names.
    """
    simplices = others.pop("simplices", False)
    given = {
        "geometry": lambda comm: block.block(
            comm, lower=lower, upper=upper, cells=cells, simplices=simplices
        ),
        "hypothesis": "plane_strain",
        "bodies": (hhr.Body(block.SOLID, young, poisson),),
        "parameters": space(**box),
    }
    return hhr.Scene(name=name, **given | others)


def pair_scene(name, box, first, second, bodies, *, simplices=False, warp=None, **others):
    """A scene of two blocks, boxes (lower, upper, cells), in plane strain unless ``others`` say
    otherwise.

    Bodies are (young, poisson) or a Body.
    """
    tagged = zip((two_blocks.FIRST, two_blocks.SECOND), bodies, strict=True)
    given = {
        "geometry": lambda comm: two_blocks.two_blocks(
            comm, first=first, second=second, simplices=simplices, warp=warp
        ),
        "hypothesis": "plane_strain",
        "bodies": tuple(
            body if isinstance(body, hhr.Body) else hhr.Body(tag, *body) for tag, body in tagged
        ),
        "parameters": space(**box),
    }
    return hhr.Scene(name=name, **given | others)


def pressed_block(hypothesis, *, young=3.0, poisson=0.3, gap=0.01, cells=4, simplices=False):
    """A block of height 2 pushed by ``push`` in [0, 0.1] on a rigid floor ``gap`` below it.

    Its strain is uniform: the pressure is E (push - gap) / 2, and with E / (1 - nu^2) in plane
    strain.
    """
    dim = 3 if hypothesis == "solid" else 2
    up = dim - 1
    normal = tuple(-1.0 if axis == up else 0.0 for axis in range(dim))
    fixed = tuple(hhr.Displacement(block.side(axis, upper=False), axis) for axis in range(up))
    push = hhr.Displacement(block.side(up, upper=True), up, slope("push", -1.0))
    size = {
        "lower": (0.0,) * dim,
        "upper": (1.5,) * up + (2.0,),
        "cells": (cells,) * dim,
        "simplices": simplices,
    }
    return block_scene(
        f"pressed_{hypothesis}",
        {"push": (0.0, 0.1)},
        **size,
        young=young,
        poisson=poisson,
        hypothesis=hypothesis,
        contacts=(hhr.Obstacle(block.side(up, upper=False), normal, gap),),
        displacements=(*fixed, push),
    )


def check_contact_conditions(problem, displacement, forces, mu, relative=1e-10):
    """All of (1.21): equilibrium on free dofs, no penetration, no adhesion, complementarity.

    Round-off in u is about 1e-16 cond(K); 1e-10 leaves room for cond(K) up to 1e6.
    """
    theta = problem.theta(mu)
    homogeneous = displacement - problem.lifts @ theta
    internal = problem.stiffness @ homogeneous
    residual = (internal + problem.contact.T @ forces - problem.loads @ theta)[problem.free]
    slack = problem.gaps @ theta - problem.contact @ homogeneous
    force = np.abs(problem.loads @ theta).max()
    length = max(np.abs(problem.gaps @ theta).max(), np.abs(homogeneous).max())
    assert np.abs(residual).max() <= relative * force
    assert forces.min() >= -relative * force
    assert slack.min() >= -relative * length
    assert np.abs(forces * slack).max() <= relative * force * length


PAIR_BOX = {"push": (0.005, 0.06), "slide": (-0.02, 0.02), "load": (0.0, 0.1), "gap": (0.0, 0.01)}
"""Parameters of :func:`pressed_pair` that move it, by their bounds."""


def pressed_pair(
    hypothesis, bodies, parameters=None, *, cells=4, simplices=False, matching=True, **others
):
    """Two blocks of height 1 on each other: the lower one is clamped, the upper one pushed, slid
    and pressed aside.

    Nothing in it is uniform, displacements that move are imposed on the upper body, and contact is
    lost in places. Bodies are (young, poisson) or a Body; ``parameters`` are bounds by name beside
    ``PAIR_BOX``. Where nodes do not face each other the lower surface is the slave of
    ``NodeToSurface``. ``others`` replace parts of the scene.
    """
    dim = 3 if hypothesis == "solid" else 2
    up = dim - 1
    lower, upper = (1.0,) + (0.0,) * (dim - 2), (2.0,) + (1.0,) * (dim - 2)
    first = (*lower, 0.0), (*upper, 1.0), (cells,) * dim
    second = (*lower, 1.0), (*upper, 2.0), (cells + (0 if matching else 1),) * dim
    normal = (0.0,) * up + (1.0,)
    side = two_blocks.side
    clamped = side(two_blocks.FIRST, up, False)
    top, flank = side(two_blocks.SECOND, up, True), side(two_blocks.SECOND, 0, True)
    surfaces = side(two_blocks.FIRST, up, True), side(two_blocks.SECOND, up, False)
    held = [hhr.Displacement(clamped, axis) for axis in range(dim)] + [
        hhr.Displacement(top, k) for k in range(1, up)
    ]
    moved = hhr.Displacement(top, 0, slope("slide")), hhr.Displacement(top, up, slope("push", -1.0))
    given = {
        "contacts": others.get("contacts")
        or ((hhr.NodeToNode if matching else hhr.NodeToSurface)(*surfaces, normal),),
        "loads": (hhr.Pressure(flank, slope("load")),),
        "openings": (hhr.Opening(0, slope("gap")),),
    }
    given |= {"hypothesis": hypothesis, "displacements": (*held, *moved), "simplices": simplices}
    return pair_scene(
        f"pair_{hypothesis}", PAIR_BOX | (parameters or {}), first, second, bodies, **given | others
    )


def largest_difference(found, expected):
    """Largest difference of two arrays, relative to the largest entry."""
    return np.abs(np.subtract(found, expected)).max() / np.abs(expected).max()


def check_like(found, exact, **tolerances):
    """Hold fields of an answer, by their names, to those of another one, relative to the largest
    entry.
    """
    for name, tolerance in tolerances.items():
        assert largest_difference(getattr(found, name)(), getattr(exact, name)()) < tolerance, name


def check_alike(full, model, points, **tolerances):
    """The same for answers of a model and of the full order."""
    for point in points:
        check_like(model.solve(point, outside="ignore"), full.solve(point), **tolerances)


def slope_errors(model, point, step=1e-5):
    """Relative errors of the gradient of a model, (multipliers, unknown), beside central
    differences, (P,) each.

    The statuses must not change within a step.
    """
    space = model.parameters
    answer = model.solve(point, gradient=True)
    assert not answer.gradient.one_sided
    width, names = np.subtract(space.upper, space.lower), ("multipliers", "unknown")

    def values(moved):
        found = model.solve(moved, outside="ignore")
        assert np.array_equal(found.active, answer.active)
        return np.concatenate([getattr(found, name) for name in names])

    changes = np.split(
        space.differences(values, np.array(point, dtype=float), step) * width,
        [answer.multipliers.size],
    )
    errors = []
    for name, change in zip(names, changes, strict=True):
        size = np.linalg.norm(getattr(answer, name))
        off = np.linalg.norm(getattr(answer.gradient, name) * width - change, axis=0)
        errors.append(
            off / (np.linalg.norm(change, axis=0) + 1e-3 * size) if size else np.zeros(off.size)
        )
    return np.transpose(errors)


def output_slopes(model, point, *names, step=1e-6):
    """Derivatives of outputs by central differences of a part of the box, (P,) each, by their
    names.
    """

    def values(moved):
        outputs = model.outputs(moved, outside="ignore")
        return np.array([outputs[name] for name in names])

    return dict(
        zip(
            names,
            model.parameters.differences(values, np.array(point, dtype=float), step),
            strict=True,
        )
    )


def squeezed(deepest):
    """A soft block, squeezed on a rigid floor that is half a length below it."""
    top = block.side(1, True)
    return block_scene(
        "squeezed",
        {"down": (0.0, deepest)},
        upper=(10.0, 10.0),
        young=3.0,
        contacts=(hhr.Obstacle(block.side(1, False), (0.0, -1.0), 0.5),),
        displacements=(hhr.Displacement(top, 0), hhr.Displacement(top, 1, slope("down", -1.0))),
        outputs=(hhr.ContactForce("force", 0, (0.0, 1.0)),),
    )


def stacked(
    dim,
    simplices=False,
    pairing="node to node",
    bodies=((3.0, 0.3), (5.0, 0.2)),
    *,
    alike=True,
    **others,
):
    """Two blocks of edge 1, one pressed on the other by the pressure ``p``: the stress is uniform.

    With "obstacle" the lower one rests on a rigid floor; ``alike`` if nodes face each other.
    """
    side, (below, on_top) = two_blocks.side, (two_blocks.FIRST, two_blocks.SECOND)
    last = dim - 1
    lower, upper = np.zeros(dim), np.ones(dim)
    above = np.eye(dim)[last]
    normal = tuple(above)
    first = lower, upper, (3,) * dim
    second = lower + above, upper + above, (3 if alike else 4,) * dim
    faces = side(below, last, True), side(on_top, last, False)
    contact = {
        "node to node": lambda: hhr.NodeToNode(*faces, normal),
        "node to surface": lambda: hhr.NodeToSurface(*faces),
        "double pass": lambda: hhr.DoublePass(*faces),
        "mortar": lambda: hhr.Mortar(*faces),
        "obstacle": lambda: hhr.Obstacle(side(below, last, False), tuple(-above), 0.0),
    }[pairing]()
    resting = pairing == "obstacle"
    held = () if resting else (hhr.Displacement(side(below, last, False), last),)
    sides = (
        hhr.Displacement(side(body, axis, False), axis)
        for body in (below, on_top)
        for axis in range(last)
    )
    given = {
        "hypothesis": "plane_strain" if dim == 2 else "solid",
        "contacts": (contact, *((hhr.NodeToNode(*faces, normal),) if resting else ())),
        "displacements": (*held, *sides),
        "loads": (hhr.Pressure(side(on_top, last, True), slope("p")),),
        "simplices": simplices,
    }
    return pair_scene("stacked", {"p": (0.1, 1.0)}, first, second, bodies, **given | others)


def lying(*, bulge=0.05, cells=(8, 4), tilt=0.0, sideways=0.0, young=1000.0, **changes):
    """A block that lies on another one, held by contact alone, and is pressed down by a force."""
    under, over = stacked_blocks.LOWER_BLOCK, stacked_blocks.UPPER_BLOCK
    pressed = hhr.Traction(stacked_blocks.outer_end(over, 2), (sideways, -1.0), slope("p"))
    surfaces = (stacked_blocks.interface(body, 2) for body in (under, over))
    given = {
        "name": "floating",
        "geometry": lambda comm: stacked_blocks.stacked_blocks(
            comm, lower=cells, upper=cells, bulge=bulge
        ),
        "hypothesis": "plane_strain",
        "bodies": (hhr.Body(under, 2000.0, 0.3), hhr.Body(over, young, 0.3)),
        "contacts": (hhr.NodeToNode(*surfaces, (0.0, 1.0)),),
        "displacements": hhr.Displacement.clamp(stacked_blocks.outer_end(under, 2), 2),
        "loads": (pressed, hhr.Traction(two_blocks.side(over, 0, False), (0.0, -1.0), tilt)),
        "parameters": space(p=(1.0, 10.0)),
    }
    return hhr.Scene(**(given | changes))


def references_at(points, full, training):
    """Full answers at test points, see ``References.at`` of the plug-in of studies."""
    from hhr_dolfinx.plugins.studies.measure import References

    return References.at(points, full, training)


def meshed(scene, point):
    """The scene on a mesh that has the shape of a point already."""

    def moved(comm):
        mesh, cells, facets = scene.geometry(comm)
        dim, before = mesh.geometry.dim, mesh.geometry.x.copy()
        values = dict(zip(scene.parameters.names, point, strict=True))
        for shape in scene.shapes:
            nodes = np.unique(mesh.geometry.dofmap[cells.find(shape.tag)])
            mesh.geometry.x[nodes, :dim] = shape.moved(before[nodes, :dim], names, values)
        return mesh, cells, facets

    names = coordinate_names(scene.hypothesis)
    # that move nothing, so that both have one rule of integration
    still = tuple(hhr.Shape(shape.tag, names) for shape in scene.shapes)
    return dataclasses.replace(scene, geometry=moved, shapes=still)


@dataclasses.dataclass(frozen=True)
class Twice:
    """A pairing that makes its rows twice, which the scene cannot see."""

    once: hhr.Obstacle

    @property
    def tags(self):
        return self.once.tags

    def rows(self, surfaces, dofs):
        return joined([self.once.rows(surfaces, dofs)] * 2)


def kkt(full, mu, rounding=1e-10):
    """The conditions of the quadratic program, which is convex: whoever satisfies them has solved
    it.
    """
    problem, answer = full.problem.at(mu), full.solve(mu)
    theta, forces, moved = (
        problem.amplitudes(answer.parameter),
        answer.forces(),
        answer.displacement(),
    )
    acting, given = problem.contact.T @ forces, problem.external @ theta
    left = (problem.stiffness @ moved + acting - given)[problem.free]
    size = max(np.abs(acting).max(), np.abs(given).max())
    slack = problem.gaps @ theta - problem.contact @ (moved - problem.lifts @ theta)
    assert np.abs(left).max() < rounding * size
    assert forces.min() > -1e-12 * size and slack.min() > -1e-6 * np.abs(moved).max()
    assert np.abs(forces * slack).max() < 1e-6 * size * np.abs(moved).max()
    return answer
