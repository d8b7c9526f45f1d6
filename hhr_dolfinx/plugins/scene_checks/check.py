"""Checks of a scene before anything is solved: mesh, pairing, supports and loads, parts without
effect.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from mpi4py import MPI
from scipy.sparse import csc_matrix

from hhr_dolfinx import registry
from hhr_dolfinx.amplitudes import Amplitude
from hhr_dolfinx.contact.problem import ContactProblem
from hhr_dolfinx.full_order.discretisation import Discretisation, as_it_is, discretised
from hhr_dolfinx.full_order.with_laws import BodiesWithLaws, with_laws
from hhr_dolfinx.loads import Load, Terms, checked_terms
from hhr_dolfinx.pairings.surface import Surface
from hhr_dolfinx.parameters import Place, PointLike, Tag
from hhr_dolfinx.plugins.scene_checks.findings import MISTAKE, SceneCheck
from hhr_dolfinx.plugins.scene_checks.mesh import (
    depth_inside,
    look_at_common_nodes,
    look_at_joints,
    look_at_mesh,
)
from hhr_dolfinx.scene import Scene

if TYPE_CHECKING:
    from hhr_dolfinx.plugins.constraints.elimination import Constraint

TOUCHING_AS_DRAWN = 1e-6
"""Gaps below so many times the sag of facets count as zero: the bodies touch as drawn."""
SMALL_GAP = 2.0
"""Gaps below so many times the sag of facets come from the mesh rather than from the bodies: a
round side that touches between two of its nodes is off by the sag.
"""
LARGE_IN_SPACE = 20_000
"""Number of dofs above which the expected time of a full model in space is reported."""
MOST_LEFT_OUT = 5
"""Most left-out names of a mesh file that are listed."""
OVERLAP = 2.0
"""Overlaps beyond so many times the sag of facets come from the bodies rather than from the
mesh.
"""


def check_scene(scene: Scene, point: PointLike | None = None) -> SceneCheck:
    """Check a scene at a parameter, or in the middle of its box; nothing is factored or solved.

    Raises:
        ParameterError: for a point outside the box.
    """
    check = SceneCheck(scene)
    space = scene.parameters
    middle = space.middle if point is None else space.point(point)
    with check.heard():
        check.discretisation = discretised(scene, MPI.COMM_SELF)
    if check.discretisation is None:
        return check
    has_mesh = check.discretisation.has_mesh  # a system of other codes has none
    if has_mesh:
        look_at_mesh(check)
        _names(check)
    _units(check)
    for contact in scene.contacts:  # separately, so that all of them are reported
        surfaces: list[Surface] = []
        rows = None
        with check.heard():
            surfaces = [check.discretisation.surface(tag) for tag in contact.tags]
            rows = contact.rows(surfaces, check.discretisation.size)
        check.pairs.append((surfaces, rows))
    if has_mesh:
        look_at_joints(check)
    look_at_common_nodes(check)
    if check.mistakes:
        return check
    problem = None
    laws = None
    with check.heard():
        problem, laws = _problem(check.discretisation)
    if problem is not None:
        _size(check, problem)
        _gaps(check, problem, middle)
        _supports(check, problem)
        for load in scene.loads if has_mesh else ():
            with check.heard():
                _load(check, load, middle)
        _outputs(check, problem, laws)
    return check


def _units(check: SceneCheck) -> None:
    """Parameters whose unit is another one than that of the scene: labels convert nothing."""
    units = check.scene.units
    labels = check.scene.parameter_units
    if units is None:
        return
    for name in check.scene.parameters.names:
        expected = units.conflict(labels.get(name, ""))
        if expected is not None:
            check.note(
                f"parameter {name} is said to be in {labels[name]}, and numbers of the scene are "
                f"in {expected}: a label converts nothing. Give its box in that unit, unless its "
                "formulas convert it"
            )


def _problem(discretisation: Discretisation) -> tuple[ContactProblem, BodiesWithLaws | None]:
    laws = with_laws(discretisation.scene, as_it_is) if discretisation.scene.reader else None
    terms = discretisation.stiffness_terms() if laws is None else (laws.stiffness, laws.moduli)
    problem = discretisation.contact_problem(*terms)
    return discretisation.checked(problem), laws


def _size(check: SceneCheck, problem: ContactProblem) -> None:
    dofs = problem.free.size
    conditions = len(problem.gaps)
    size = f"{dofs} dofs and {conditions} conditions of contact"
    expected = registry.offered("expected_in_space")
    if problem.block_size == 2 or dofs < LARGE_IN_SPACE or expected is None:
        check.say(size)
        return
    memory, seconds, keeps = expected(problem.contact)
    extra = "" if keeps else ", and a displacement one more solution"
    time = f"{seconds:.0f} s" if seconds < 120 else f"{seconds / 60:.0f} minutes"
    check.say(f"{size}: a full model takes about {memory:.2g} GB and {time} on one core{extra}")


def _tags_of(constraint: Constraint) -> list[Tag | Place | None]:
    """Surfaces, sets and places that a constraint names."""
    tags = [
        getattr(constraint, name, None)
        for name in ("place", "slave", "master", "follower", "leader", "section")
    ]
    return tags + [tag for tag, *_ in getattr(constraint, "terms", ())]


def _names(check: SceneCheck) -> None:
    scene = check.scene
    discretisation = check.meshed
    used: set[Any] = {displacement.tag for displacement in scene.displacements} | {
        tag for contact in scene.contacts for tag in contact.tags
    }
    used |= {getattr(load, "tag", getattr(load, "place", None)) for load in scene.loads}
    used |= {tag for constraint in scene.constraints for tag in _tags_of(constraint)}
    # the other side of a cut has the name of the section with an ending
    cuts = [cut.section for cut in scene.constraints if hasattr(cut, "section")]
    facets = discretisation.names.facets
    # a set of all nodes has the facets of all surfaces
    named = {
        number for tag in used if isinstance(tag, int | str) for number in facets.get(tag, (tag,))
    }
    idle = sorted(
        name
        for name, numbers in facets.items()
        if isinstance(name, str) and not named & set(numbers)
    )
    idle = [name for name in idle if not any(name.startswith(f"{cut}_") for cut in cuts)]
    if idle:
        check.note(f"the mesh has surfaces that nothing names: {', '.join(idle)}")
    left_out = [
        f"{name}: {reason}" for name, reason in discretisation.names.summary.left_out.items()
    ]
    if left_out:
        more = (
            f"; and {len(left_out) - MOST_LEFT_OUT} more" if len(left_out) > MOST_LEFT_OUT else ""
        )
        listed = "; ".join(left_out[:MOST_LEFT_OUT])
        check.note(
            f"the mesh file has what is left out: {listed}{more}. `hhr check` of the file itself "
            "lists all"
        )


def _gaps(check: SceneCheck, problem: ContactProblem, point: np.ndarray) -> None:
    """Compare distances of the surfaces with the sag of their facets."""
    theta = problem.amplitudes(point)
    gaps = problem.gaps @ theta
    # before imposed displacements close them
    still = (
        gaps
        if problem.whole_contact is None
        else gaps + problem.whole_contact @ (problem.lifts @ theta)
    )
    unit = check.length
    for contact, (surfaces, contact_rows) in enumerate(check.pairs):
        rows = problem.pressing_of(contact)
        names = " and ".join(repr(surface.tag) for surface in surfaces)
        if not rows.size:
            check.note(
                f"contact {contact} of {names}: displacements are imposed on all of its nodes, and "
                "it does nothing. Leave it out, or hold other surfaces"
            )
            continue
        sag = max(sag_of(surface) for surface in surfaces)
        values = still[rows]
        closed = ""
        law = check.scene.laws[contact]
        by_law = "" if law is None else f", {law.words}"
        first = surfaces[0]
        idle = 0 if contact_rows is None else np.setdiff1d(first.nodes, contact_rows.slaves).size
        left_out = (
            f", {idle} of {first.nodes.size} nodes of {first.tag!r} face nothing" if idle else ""
        )
        if not np.allclose(values, gaps[rows], rtol=1e-9, atol=1e-9 * np.abs(values).max()):
            low = gaps[rows].min()
            high = gaps[rows].max()
            closed = (
                f" as drawn, which imposed displacements bring to {low:.3g} to {high:.3g}{unit} at "
                f"{check.scene.parameters.described(point)}"
            )
        check.say(
            f"contact {contact} of {names}: {values.size} conditions, gaps from "
            f"{values.min():.3g} to {values.max():.3g}{unit}{closed}, "
            f"{f'facets sag by {sag:.2g}{unit}' if sag else 'facets are flat'}{by_law}{left_out}"
        )
        _overlap(check, contact, -float(still[rows].min()), sag, point)
        small = [
            float(values.min()),
            float(problem.amplitudes.least(problem.gaps[rows], problem.parameters)[0].min()),
        ]
        small = [gap for gap in small if TOUCHING_AS_DRAWN * sag < gap < SMALL_GAP * sag]
        if small:
            check.note(
                f"contact {contact} of {names}: the smallest gap, {small[0]:.3g}{unit}, is below "
                f"twice the sag of facets, {sag:.2g}{unit}: which nodes touch first is made by "
                "the mesh. Refine the curved surfaces"
            )


def _overlap(check: SceneCheck, contact: int, depth: float, sag: float, point: np.ndarray) -> None:
    """Report bodies that overlap by their gaps, (m,), or as drawn; pairings miss deep overlaps."""
    scene = check.scene
    surfaces = check.pairs[contact][0]
    names = " and ".join(repr(surface.tag) for surface in surfaces)
    reason = ""
    opened = scene.opened(contact, point)
    drawn = len(surfaces) == 2 and not scene.overwritten(contact)
    for first, second in (surfaces, surfaces[::-1]) if drawn else ():
        count, deep = depth_inside(check, first, second)
        if deep - opened > max(depth, OVERLAP * sag):
            depth = deep - opened
            message = f", and {count} nodes of {first.tag!r} lie inside the body of {second.tag!r}"
            reason = message if count else ", by its opening"
    if depth > OVERLAP * max(sag, 1e-12):
        check.note(
            f"contact {contact} of {names}: bodies overlap by {depth:.3g}{check.length} "
            f"before anything moves{reason}. Move them apart in the mesh, or by an Opening; leave "
            "it where a press fit is meant"
        )


def sag_of(surface: Surface) -> float:
    """Largest distance of the facets of a surface from the arcs that they approximate, by their
    neighbours.

    An arc that turns by 2 a along a facet of length h is h a / 4 away from it; a is the angle from
    the normal of the facet to that at its corners, which is averaged except at edges of the body.
    """
    if not surface.facets.size:
        return 0.0
    cosines = np.einsum("fd,fkd->fk", surface.outward, surface.corner_normals).min(axis=1)
    # near 1 the cosines are round-off
    angles = np.where(cosines > 1.0 - 1e-12, 0.0, np.arccos(np.clip(cosines, -1.0, 1.0)))
    lengths = np.linalg.norm(np.ptp(surface.corners, axis=1), axis=1)
    return float((lengths * angles * surface.sag_shares()).max() / 4)


def _supports(check: SceneCheck, problem: ContactProblem) -> None:
    free = check.meshed.free_bodies(problem)
    for body in free:
        check.note(
            f"{body.name} is held by contact alone: without contact it "
            f"{body.described(body.left)}. If that is not meant, hold it by a Displacement"
        )
    if not free:
        check.say(
            "displacements and constraints hold every body"
            if check.scene.constraints
            else "displacements hold every body"
        )


def _load(check: SceneCheck, load: Load, point: np.ndarray) -> None:
    """Report the resultant of a load for the amplitude 1, or a load without effect."""
    discretisation = check.meshed
    dim = discretisation.mesh.geometry.dim
    terms = checked_terms(load, discretisation.assembler(load))
    name = f"{type(load).__name__} on {getattr(load, 'tag', getattr(load, 'place', 'the scene'))!r}"
    columns = [csc_matrix(term.columns) for term in terms]
    if not any(block.nnz for block in columns):
        check.say(
            f"{name} reaches nothing: its nodal forces are zero. Name another tag, or leave it out",
            MISTAKE,
        )
        return
    amplitudes = [term.amplitude for term in terms]
    listed = Terms(check.scene.parameters, loads=terms)
    forces = listed.columns("loads", discretisation.size) @ listed.amplitudes()(point)
    check.forces.append((name, forces.reshape(-1, dim)))
    still = all(
        isinstance(amplitude, Amplitude)
        and not amplitude.constant
        and not any(amplitude.slopes.values())
        for amplitude in amplitudes
    )
    if still and hasattr(load, "stiffness"):
        check.say(f"{name}: a spring to a ground that does not move")
        return
    if still:
        check.note(
            f"{name} has the amplitude 0 for all parameters, and does nothing: give it another, "
            "or leave it out"
        )
        return
    if all(block.shape[1] == 1 for block in columns):
        total = np.sum([block.toarray().reshape(-1, dim).sum(axis=0) for block in columns], axis=0)
        # balanced forces leave round-off
        total[np.abs(total) < 1e-12 * sum(abs(block).sum() for block in columns)] = 0.0
        check.say(
            f"{name}: resultant [{', '.join(f'{value:.6g}' for value in total)}] for the "
            "amplitude 1"
        )
    else:
        check.say(
            f"{name}: {sum(block.shape[1] for block in columns)} columns that depend on parameters"
        )


def _outputs(check: SceneCheck, problem: ContactProblem, laws: BodiesWithLaws | None) -> None:
    from hhr_dolfinx.full_order.outputs import probe_of

    read = []
    for output in check.scene.outputs:
        with check.heard():
            output.prepared(probe_of(output, check.meshed, problem, laws))
            read.append(repr(output.name))
    if read:
        check.say(f"outputs: {', '.join(read)}")
