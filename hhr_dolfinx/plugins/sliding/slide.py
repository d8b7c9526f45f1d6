"""Models of scenes whose surfaces slide past the mesh on which they were paired."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any, TypeGuard

import numpy as np
from mpi4py import MPI

from hhr_dolfinx import registry
from hhr_dolfinx.contact.law import PairLaw
from hhr_dolfinx.contact.rows import ContactRows, normals_of
from hhr_dolfinx.errors import SceneError, SceneWarning
from hhr_dolfinx.full_order.checks import warn_of_idle_parameters
from hhr_dolfinx.models.starts import KnownStatuses
from hhr_dolfinx.outputs import ContactForce, DisplacementAt, LinearForm, OfContact, Output
from hhr_dolfinx.pairings import Pairing
from hhr_dolfinx.pairings.surface import CREASE, Surface
from hhr_dolfinx.plugins.friction.laws import Friction, FrictionLaw
from hhr_dolfinx.plugins.friction.pair_laws import Coulomb, Tresca
from hhr_dolfinx.plugins.mortar.pairing import Mortar
from hhr_dolfinx.plugins.nonmatching.double_pass import DoublePass
from hhr_dolfinx.plugins.nonmatching.node_to_surface import NodeToSurface
from hhr_dolfinx.plugins.sliding.model import SlidingModel
from hhr_dolfinx.plugins.sliding.outputs import KINDS, OfSlaves
from hhr_dolfinx.plugins.sliding.pressures import beside_laws, on_slaves
from hhr_dolfinx.plugins.sliding.repairing import (
    SlidingPair,
    layout,
    no_friction,
    nodes_of,
    renumbered,
)
from hhr_dolfinx.plugins.sliding.surface_dofs import (
    FullOrderOfSurfaces,
    SurfaceDofs,
    SurfacesThatSlide,
)
from hhr_dolfinx.reduction.exact import exact_condensation
from hhr_dolfinx.scene import Scene
from hhr_dolfinx.warn import ignored

REPEATED = NodeToSurface, Mortar
"""Pairings that can be computed again as bodies slide."""
OUTPUTS = (ContactForce, DisplacementAt, LinearForm)
"""Outputs that do not depend on the position of the surfaces, as stresses and the energy do not."""
TWO_PASSES = (
    ": while surfaces slide, nodes of one pass those of the other, and there the rows of both "
    "passes become dependent, so that pressures, and friction with them, have no single value. "
    "Take NodeToSurface or Mortar, whose rows stay independent"
)
"""Why a pairing in two passes can not slide."""


def slide(scene: Scene, *, condensed: bool = True) -> SlidingModel:
    """Build a model of a scene whose surfaces are paired again in every increment of a path.

    Strains and rotations must be small, sliding need not be. If nothing slides by more than a
    facet, ``hhr.condense`` is the cheaper model. Pairs with a rigid obstacle are not paired again:
    their rows are those of the full order, on the undeformed surface.

    Args:
        scene: with contact pairs that are ``NodeToSurface`` or ``Mortar``, which slide, or of one
            surface with a rigid obstacle, of bodies held by imposed displacements alone.
        condensed: whether the compliance of the surfaces is computed once; else the full model does
            so for each path.

    Raises:
        SceneError: for an unsuitable scene, with the part that is unsuitable.
    """
    _check(scene)
    contacts = tuple(
        SurfaceDofs(*contact.tags) if _slides(contact) else contact for contact in scene.contacts
    )
    # rows of dofs have no law of friction, whose parameters the scene names
    with ignored(SceneWarning, about=" have no effect"):
        surfaces_alone = dataclasses.replace(scene, contacts=contacts, outputs=_outputs(scene))
        full = FullOrderOfSurfaces(surfaces_alone, MPI.COMM_SELF)
    problem = full.problem
    warn_of_idle_parameters(scene, problem.amplitudes)
    if problem.held_by_contact:
        raise SceneError(
            f"contact alone holds bodies of scene '{scene.name}', which slide: hold them"
        )
    if condensed:
        problem.require_parts("condensation")
    if problem.varies and condensed:
        raise SceneError(
            f"moduli of scene '{scene.name}' depend on parameters: condensed models of bodies "
            "that slide are of constant ones. Give numbers, or take condensed=False"
        )
    pairs = dict(_pairs(full, scene))
    laws = [
        FrictionLaw.of(
            law if isinstance(law, Coulomb | Tresca) else Coulomb(0.0),
            scene.parameters,
            f"contact {number}",
        )
        for number, (law, contact) in enumerate(zip(scene.laws, scene.contacts, strict=True))
        if _slides(contact)
    ]
    base: Any = full
    if condensed:
        nothing = KnownStatuses(problem.middle[None], np.zeros((1, len(problem.gaps)), dtype=bool))
        base = exact_condensation(full, nothing, field=False)
    fixed = np.array(
        [k for k, name in enumerate(scene.parameters.names) if name in scene.named], dtype=np.int64
    )
    surfaces = full.discretisation
    assert isinstance(surfaces, SurfacesThatSlide)
    rubs = problem.law.of("friction")
    others = rubs if isinstance(rubs, Friction) else no_friction(problem.block_size)
    sliding = tuple(pairs.values())
    friction = layout(sliding, laws, fixed, problem.block_size, others)
    pressing = {number: law for number, law in enumerate(scene.laws) if _is_of_others(law)}
    of_slaves = {number: law for number, law in pressing.items() if number in pairs}
    ranges = on_slaves(of_slaves, pairs, surfaces) if of_slaves else ()
    law = beside_laws(friction, problem.law, ranges, sliding[0].first)
    return SlidingModel(base, sliding, law, surfaces.beside)


def _is_of_others(law: PairLaw | None) -> TypeGuard[PairLaw]:
    """True for a law that is not friction."""
    return law is not None and law.plugin != Friction.plugin


def _slides(item: Pairing) -> bool:
    """True for a pair that is paired again."""
    return isinstance(item, REPEATED) and getattr(item, "multipliers", "dual") == "dual"


def _check(scene: Scene) -> None:
    """Raise SceneError for the first pair, body, shape or output that is not built in."""
    if not isinstance(scene, Scene):
        raise SceneError(
            f"{type(scene).__name__} is no Scene: hhr.slide takes the scene itself, and makes "
            "what it needs"
        )
    for number, contact in enumerate(scene.contacts):
        if not _slides(contact) and len(contact.tags) > 1:
            names = " and ".join(kind.__name__ for kind in REPEATED)
            raise SceneError(
                f"contact {number} of scene '{scene.name}' is a {type(contact).__name__}: {names} "
                "with dual multipliers can be made anew as bodies "
                f"slide{TWO_PASSES if isinstance(contact, DoublePass) else ''}"
            )
    if not any(map(_slides, scene.contacts)):
        raise SceneError(
            f"no contact of scene '{scene.name}' has two surfaces that slide: take "
            "hhr.condense(scene)"
        )
    _check_bodies(scene)
    for output in scene.outputs:
        _check_output(scene, output)


def _check_bodies(scene: Scene) -> None:
    """Raise SceneError for bodies whose deformation is more than a compliance of their surfaces."""
    for body in scene.bodies:
        if body.reader:
            raise SceneError(
                f"body {body.tag} of scene '{scene.name}' has a law, {body.law!r}, that is not "
                "built in where surfaces slide past their mesh: increments that pair them again "
                "solve for contact forces by a compliance, which plastic strains change. Take an "
                "elastic body"
            )
    for shape in scene.shapes:
        raise SceneError(
            f"the shape of body {shape.tag} of scene '{scene.name}' depends on parameters, which "
            "is not built in where surfaces slide past their mesh: they are paired again from "
            "their places on one mesh. Make a scene for each shape"
        )


def _outputs(scene: Scene) -> tuple[Output, ...]:
    """Outputs of a scene; those of pressures of pairs that slide read the slave nodes."""
    slaves = {k: pair.tags[0] for k, pair in enumerate(scene.contacts) if _slides(pair)}
    return tuple(
        OfSlaves.of(output, slaves)
        if isinstance(output, KINDS) and output.contact in slaves
        else output
        for output in scene.outputs
    )


def _check_output(scene: Scene, output: Output) -> None:
    """Raise SceneError for an output of surfaces that depends on their position."""
    if isinstance(output, OfContact) and output.contact < len(scene.contacts):
        if not _slides(scene.contacts[output.contact]):
            return
    import_paths = registry.named("public")
    kinds = (
        *OUTPUTS,
        *KINDS,
        *(
            registry.load(import_paths[name])
            for name in ("VonMises", "ElasticEnergy")
            if name in import_paths
        ),
    )
    if not isinstance(output, kinds):
        names = ", ".join(kind.__name__ for kind in kinds)
        raise SceneError(
            f"output '{output.name}' is not built in where surfaces slide past their mesh: "
            f"{names} are; slip and wear are in an answer's slip"
        )


def _pairs(full: FullOrderOfSurfaces, scene: Scene) -> Iterator[tuple[int, SlidingPair]]:
    """The surfaces of each pair that slides, by its number.

    Errors of the pairing if they do not face each other as meshed.
    """
    problem = full.problem
    of_dofs = [number for number, contact in enumerate(scene.contacts) if _slides(contact)]
    first = int(np.flatnonzero(np.isin(problem.contact_pairs, of_dofs))[0])
    first_seen: dict[int, tuple[int, np.ndarray]] = {}
    for number in of_dofs:
        contact = scene.contacts[number]
        assert isinstance(contact, REPEATED)
        pairing = dataclasses.replace(
            contact, friction=None, law=None
        )  # the model has the law, not the rows
        surfaces = [full.discretisation.surface(tag) for tag in contact.tags]
        nodes, points = nodes_of(surfaces)
        slave, master = (renumbered(surface, nodes) for surface in surfaces)
        rows = pairing.rows((slave, master), points.size)
        normals = normals_of(rows.matrix, rows.slaves, points.shape[1])
        for node, normal in zip(nodes[rows.slaves].tolist(), normals, strict=True):
            other_number, before = first_seen.setdefault(node, (number, normal))
            if scene.contacts[other_number].tags[0] != contact.tags[0] and before @ normal > CREASE:
                raise SceneError(
                    f"the slaves of contacts {other_number} and {number} of scene '{scene.name}' "
                    "share nodes, which is not built in where surfaces slide past their mesh: make "
                    "one contact of both, of one tag"
                )
        clearance = _clearance(scene, number, slave, rows)
        opening = _opening(scene, number)
        yield number, SlidingPair(pairing, slave, master, first, nodes.size, clearance, opening)
        first += points.size


def _opening(scene: Scene, place: int) -> np.ndarray:
    """Sum of the openings of a contact, a constant and the slope of each parameter, (1 + P,)."""
    amplitudes = [opening.amplitude for opening in scene.openings if opening.contact == place]
    rows = [
        np.array([amplitude.constant, *amplitude.row(scene.parameters)]) for amplitude in amplitudes
    ]
    return np.sum(rows, axis=0) if rows else np.zeros(1 + len(scene.parameters.names))


def _clearance(scene: Scene, place: int, slave: Surface, rows: ContactRows) -> np.ndarray:
    """Gap of each slave node as meshed if an opening overwrites it, else zeros, (n,)."""
    clearance = np.zeros(slave.nodes.size)
    if scene.overwritten(place):
        if rows.gap.size < clearance.size:
            raise SceneError(
                f"an opening overwrites the gaps of contact {place} of scene '{scene.name}', "
                f"which slides, and {clearance.size - rows.gap.size} of its {clearance.size} slave "
                "nodes face nothing as meshed: the gap that they have there is unknown. Swap slave "
                "and master, or leave out overwrites=True"
            )
        clearance[np.searchsorted(slave.nodes, rows.slaves)] = rows.gap
    return clearance
