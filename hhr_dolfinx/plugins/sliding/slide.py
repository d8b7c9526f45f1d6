"""Models of scenes whose surfaces slide past the mesh on which they were paired."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any

import numpy as np
from mpi4py import MPI

from hhr_dolfinx import registry
from hhr_dolfinx.contact.rows import normals_of
from hhr_dolfinx.errors import SceneError, SceneWarning
from hhr_dolfinx.full_order.checks import warn_of_idle_parameters
from hhr_dolfinx.full_order.full import FullOrderModel
from hhr_dolfinx.models.starts import KnownStatuses
from hhr_dolfinx.outputs import ContactForce, DisplacementAt, LinearForm
from hhr_dolfinx.pairings.surface import CREASE
from hhr_dolfinx.plugins.friction.laws import FrictionLaw
from hhr_dolfinx.plugins.friction.pair_laws import Coulomb, Tresca
from hhr_dolfinx.plugins.mortar.pairing import Mortar
from hhr_dolfinx.plugins.nonmatching.node_to_surface import NodeToSurface
from hhr_dolfinx.plugins.sliding.model import SlidingModel
from hhr_dolfinx.plugins.sliding.repairing import SlidingPair, SurfaceDofs, layout, nodes_of, renumbered
from hhr_dolfinx.reduction.exact import exact_condensation
from hhr_dolfinx.scene import Scene
from hhr_dolfinx.warn import ignored

REPEATED = NodeToSurface, Mortar
"""Pairings that can be computed again as bodies slide."""
OUTPUTS = (ContactForce, DisplacementAt, LinearForm)
"""Outputs that do not depend on the position of the surfaces, as stresses do not."""


def slide(scene: Scene, *, condensed: bool = True) -> SlidingModel:
    """Build a model of a scene whose surfaces are paired again in every increment of a path.

    Strains and rotations must be small, sliding need not be. If nothing slides by more than a facet, ``hhr.condense``
    is the cheaper model.

    Args:
        scene: with contact pairs that are ``NodeToSurface`` or ``Mortar``, of bodies held by imposed displacements
            alone.
        condensed: whether the compliance of the surfaces is computed once; else the full model does so for each path.

    Raises:
        SceneError: for an unsuitable scene, with the part that is unsuitable.
    """
    _check(scene)
    pairs = tuple(SurfaceDofs(*item.tags) for item in scene.contacts)
    # rows of dofs have no law of friction, whose parameters the scene names
    with ignored(SceneWarning, about=" have no effect"):
        full = FullOrderModel(dataclasses.replace(scene, contacts=pairs), MPI.COMM_SELF)
    problem = full.problem
    warn_of_idle_parameters(scene, problem.amplitudes)
    if problem.held_by_contact:
        raise SceneError(f"contact alone holds bodies of scene '{scene.name}', which slide: hold them")
    if condensed:
        problem.require_parts("condensation")
    if problem.varies and condensed:
        raise SceneError(
            f"moduli or shapes of scene '{scene.name}' depend on parameters: condensed models of bodies that slide are "
            "of constant ones. Give numbers, or take condensed=False"
        )
    found = tuple(_pairs(full, scene))
    if sum(pair.nodes for pair in found) * problem.block_size != len(problem.gaps):
        raise SceneError(
            f"surfaces of scene '{scene.name}' that slide have nodes whose displacement is imposed: end either before "
            "the other"
        )
    laws = [
        FrictionLaw.of(law if isinstance(law, Coulomb | Tresca) else Coulomb(0.0), scene.parameters, f"contact {place}")
        for place, law in enumerate(scene.laws)
    ]
    base: Any = full
    if condensed:
        nothing = KnownStatuses(problem.middle[None], np.zeros((1, len(problem.gaps)), dtype=bool))
        base = exact_condensation(full, nothing, field=False)
    fixed = np.array([k for k, name in enumerate(scene.parameters.names) if name in scene.named], dtype=np.int64)
    return SlidingModel(base, found, layout(found, laws, fixed, problem.block_size))


def _check(scene: Scene) -> None:
    if not isinstance(scene, Scene):
        raise SceneError(
            f"{type(scene).__name__} is no Scene: hhr.slide takes the scene itself, and makes what it needs"
        )
    for place, item in enumerate(scene.contacts):
        if not isinstance(item, REPEATED) or getattr(item, "multipliers", "dual") != "dual":
            names = " and ".join(kind.__name__ for kind in REPEATED)
            raise SceneError(
                f"contact {place} of scene '{scene.name}' is a {type(item).__name__}: {names} with dual multipliers "
                "can be made anew as bodies slide"
            )
    for place, law in enumerate(scene.laws):
        if not (law is None or isinstance(law, Coulomb | Tresca)):
            raise SceneError(
                f"contact {place} of scene '{scene.name}' has a law, {law.words}, that is not built in where surfaces "
                "slide past their mesh: friction is"
            )
    if scene.openings or scene.shapes or any(body.law is not None for body in scene.bodies):
        raise SceneError(
            f"scene '{scene.name}' has openings, shapes, or bodies that flow: they are not built in where surfaces "
            "slide past their mesh"
        )
    places = registry.named("public")
    kinds = (*OUTPUTS, *(registry.load(places[name]) for name in ("VonMises", "ElasticEnergy") if name in places))
    for output in scene.outputs:
        if not isinstance(output, kinds):
            names = ", ".join(kind.__name__ for kind in kinds)
            raise SceneError(
                f"output '{output.name}' is not built in where surfaces slide past their mesh: {names} are; pressures, "
                "slip and wear are in an answer's slip"
            )


def _pairs(full: FullOrderModel, scene: Scene) -> Iterator[SlidingPair]:
    """The surfaces of each pair; errors and warnings of the pairing if they do not face each other as meshed."""
    first = 0
    known: dict[int, tuple[int, np.ndarray]] = {}
    for place, item in enumerate(scene.contacts):
        assert isinstance(item, REPEATED)
        pairing = dataclasses.replace(item, friction=None, law=None)  # the model has the law, not the rows
        surfaces = [full.discretisation.surface(tag) for tag in item.tags]
        nodes, points = nodes_of(surfaces)
        slave, master = (renumbered(surface, nodes) for surface in surfaces)
        rows = pairing.rows((slave, master), points.size)
        normals = normals_of(rows.matrix, rows.slaves, points.shape[1])
        for node, normal in zip(nodes[rows.slaves].tolist(), normals, strict=True):
            other, before = known.setdefault(node, (place, normal))
            if scene.contacts[other].tags[0] != item.tags[0] and before @ normal > CREASE:
                raise SceneError(
                    f"the slaves of contacts {other} and {place} of scene '{scene.name}' share nodes, which is not "
                    "built in where surfaces slide past their mesh: make one contact of both, of one tag"
                )
        yield SlidingPair(pairing, slave, master, first, nodes.size)
        first += points.size
