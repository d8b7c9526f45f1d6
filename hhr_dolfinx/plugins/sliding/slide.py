"""Models of scenes whose surfaces slide past the mesh on which they were paired."""

from __future__ import annotations

import dataclasses
from typing import Any, TypeGuard

import numpy as np
from mpi4py import MPI

from hhr_dolfinx import registry
from hhr_dolfinx.errors import SceneError, SceneWarning
from hhr_dolfinx.full_order.checks import warn_of_idle_parameters
from hhr_dolfinx.models.starts import KnownStatuses
from hhr_dolfinx.outputs import ContactForce, DisplacementAt, LinearForm, OfContact, Output
from hhr_dolfinx.pairings import Pairing
from hhr_dolfinx.plugins.mortar.pairing import Mortar
from hhr_dolfinx.plugins.nonmatching.double_pass import DoublePass
from hhr_dolfinx.plugins.nonmatching.node_to_surface import NodeToSurface
from hhr_dolfinx.plugins.sliding.model import SlidingModel
from hhr_dolfinx.plugins.sliding.outputs import KINDS, OfSlaves
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
"""Outputs that do not depend on the position of the surfaces; nor do stresses and the energy."""
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
            surface with a rigid obstacle, with friction or laws of pressures, of bodies held by
            imposed displacements alone.
        condensed: whether the compliance of the surfaces is computed once; else the full model does
            so for each path, or for bodies with laws in each linearisation of a step.

    Raises:
        SceneError: for an unsuitable scene, with the part that is unsuitable.
    """
    _check(scene)
    if scene.reader and condensed:
        raise SceneError(
            f"bodies of scene '{scene.name}' have laws, and models of surfaces that slide are "
            "condensed for elastic bodies: take condensed=False"
        )
    contacts = tuple(
        SurfaceDofs(*contact.tags) if _slides(contact) else contact for contact in scene.contacts
    )
    # rows of dofs have no law of friction, whose parameters the scene names
    with ignored(SceneWarning, about=" have no effect"):
        surfaces_alone = dataclasses.replace(scene, contacts=contacts, outputs=_outputs(scene))
        full = FullOrderOfSurfaces(surfaces_alone, MPI.COMM_SELF, scene)
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
    base: Any = full
    if condensed:
        nothing = KnownStatuses(problem.middle[None], np.zeros((1, len(problem.gaps)), dtype=bool))
        base = exact_condensation(full, nothing, field=False)
    surfaces = full.discretisation
    assert isinstance(surfaces, SurfacesThatSlide)
    law = surfaces.sliding
    return SlidingModel(base, law.pairs, base.law if scene.reader else law.friction, law.beside)


def _slides(item: Pairing) -> TypeGuard[NodeToSurface | Mortar]:
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
    _check_shapes(scene)
    for output in scene.outputs:
        _check_output(scene, output)


def _check_shapes(scene: Scene) -> None:
    """Raise SceneError for bodies whose shape depends on parameters."""
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
            f"{names} are; slip is in an answer's slip, and what laws remember in answer.memory"
        )
