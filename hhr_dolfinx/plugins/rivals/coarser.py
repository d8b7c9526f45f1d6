"""The oldest rival: the same problem on a coarser mesh, its answer carried to the mesh compared."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from hhr_dolfinx.contact.active_set import Status, Statuses
from hhr_dolfinx.errors import NotOfferedError, rounded
from hhr_dolfinx.full_order.full import FullOrderModel
from hhr_dolfinx.models.answer import Answer, found_as
from hhr_dolfinx.plugins.nonmatching.projection import closest_points
from hhr_dolfinx.plugins.rivals.projection import RivalFields, RivalModel, check_elastic

if TYPE_CHECKING:
    from hhr_dolfinx.pairings.surface import Surface
    from hhr_dolfinx.scene import Scene

OFF_PLACE = 0.05
"""Part of the size of a mesh by which its box may differ from that of a coarser one."""


class CoarserMesh(RivalModel):
    """The full order of the same scene on a coarser mesh, as an approximation of a finer one.

    Displacements are interpolated by the functions of the coarse mesh, body by body. Contact
    pressures are interpolated on the facets of the first surface of each pair, and become forces by
    the areas of the fine conditions.

    Args:
        full: full model of the scene on the mesh compared.
        scene: the scene on a coarser mesh: its bodies, contacts, loads and parameters are the same.

    Raises:
        NotOfferedError: for a scene that differs in bodies, contacts, parameters, hypothesis or
            place, contacts without conditions on the coarse mesh, and see
            :func:`~hhr_dolfinx.plugins.rivals.projection.check_elastic`.
    """

    def __init__(self, full: FullOrderModel, scene: Scene):
        check_elastic(full, "a coarser mesh")
        self.coarse = FullOrderModel(scene, full.comm)
        check_elastic(self.coarse, "a coarser mesh")
        self.parameters = full.parameters
        _check_alike(self.coarse, full)
        self._spread = _spread(self.coarse, full)
        self.fields = CoarseFields(full, self.coarse)
        self.advice: dict[Status, str] = {}

    @property
    def sizes(self) -> tuple[int, int]:
        """Dofs and conditions of the coarse mesh."""
        return self.coarse.sizes

    def answered(self, point: np.ndarray) -> Answer:
        """See :class:`~hhr_dolfinx.plugins.rivals.projection.RivalModel`."""
        coarse = self.coarse.solve(point)
        forces = self._spread @ coarse.multipliers
        outcome = Statuses(forces, forces > 0, coarse.iterations, coarse.status, coarse.cycled)
        return found_as(outcome, point, coarse.unknown, self.fields)


def _check_alike(coarse: FullOrderModel, fine: FullOrderModel) -> None:
    """Refuse scenes that differ in more than their meshes.

    Raises:
        NotOfferedError: for other bodies, contacts, parameters or hypotheses, or another place.
    """
    for name in ("hypothesis", "parameters", "bodies", "contacts"):
        one, other = (getattr(model.scene, name) for model in (coarse, fine))
        if one != other:
            raise NotOfferedError(
                f"a coarser mesh is one of the same scene, and its {name} differ: {one!r} beside "
                f"{other!r}"
            )
    boxes = [
        np.array([model.problem.points.min(axis=0), model.problem.points.max(axis=0)])
        for model in (coarse, fine)
    ]
    size = np.linalg.norm(boxes[1][1] - boxes[1][0])
    if np.abs(boxes[0] - boxes[1]).max() > OFF_PLACE * size:
        raise NotOfferedError(
            f"a coarser mesh lies where the finer one lies, and it reaches from "
            f"{rounded(boxes[0][0])} to {rounded(boxes[0][1])}, not from {rounded(boxes[1][0])} to "
            f"{rounded(boxes[1][1])}"
        )


def _spread(coarse: FullOrderModel, fine: FullOrderModel) -> np.ndarray:
    """Forces on fine conditions of those on coarse ones, (fine conditions, coarse conditions)."""
    spread = np.zeros((fine.conditions, coarse.conditions))
    for pair, contact in enumerate(fine.scene.contacts):
        for tag in contact.tags:
            surface = coarse.discretisation.surface(tag)
            coarse_rows = _carried_by(coarse, pair, surface.nodes)
            fine_rows = _carried_by(fine, pair, fine.discretisation.surface(tag).nodes)
            if not fine_rows.size:
                continue
            if not coarse_rows.size:
                raise NotOfferedError(
                    f"contact {pair} has conditions on surface {tag!r}, and none of them on the "
                    "coarser mesh: take smaller cells there"
                )
            points = fine.problem.contact_points[fine_rows]
            between = _between(surface, coarse.problem.contact_slaves[coarse_rows], points)
            areas = coarse.problem.contact_areas[coarse_rows]
            # a node on the axis has no area, and its force no pressure
            between *= np.divide(1.0, areas, out=np.zeros(len(areas)), where=areas > 0)
            spread[np.ix_(fine_rows, coarse_rows)] = (
                fine.problem.contact_areas[fine_rows, None] * between
            )
    return spread


def _carried_by(full: FullOrderModel, pair: int, nodes: np.ndarray) -> np.ndarray:
    """Conditions of a contact pair that some nodes carry."""
    problem = full.problem
    own = (problem.contact_pairs == pair) & np.isin(problem.contact_slaves, nodes)
    return np.flatnonzero(own)


def _between(surface: Surface, nodes: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Weights of values at nodes, (n,), for their interpolation on the nearest facet of a surface,
    (q, n); where a facet has other nodes too they do not count.
    """
    place = np.full(max(surface.nodes.max(), nodes.max()) + 1, -1)
    place[nodes] = np.arange(len(nodes))
    corners = place[surface.nodes[surface.facets]]
    kept = (corners >= 0).any(axis=1)
    closest = closest_points(points, surface.corners[kept])
    columns = corners[kept][closest.facets]
    weights = np.where(columns >= 0, closest.weights, 0.0)
    found = np.zeros((len(points), len(nodes)))
    rows = np.repeat(np.arange(len(points))[:, None], columns.shape[1], axis=1)
    np.add.at(found, (rows[columns >= 0], columns[columns >= 0]), weights[columns >= 0])
    total = found.sum(axis=1, keepdims=True)
    shared: np.ndarray = np.divide(found, total, out=np.zeros_like(found), where=total > 0)
    return shared


@dataclass(frozen=True)
class CoarseFields(RivalFields):
    """Fields of a coarse answer on the fine mesh, see
    :class:`~hhr_dolfinx.models.answer.ModelFields`.
    """

    coarse: FullOrderModel

    @cached_property
    def _cells(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Nodes of each body of the fine mesh, and the nearest cell of that body of the coarse
        one: where bodies touch, the cells of others hold the same points.
        """
        from dolfinx import geometry

        mesh = self.coarse.discretisation.mesh
        dim = mesh.topology.dim
        points = self.order.discretisation.space.tabulate_dof_coordinates()
        found = []
        for fine, coarse in zip(self.order.scene.bodies, self.coarse.scene.bodies, strict=True):
            own = self.coarse.discretisation.cells_of(coarse.tag)
            tree = geometry.bb_tree(mesh, dim, entities=own)
            middles = geometry.create_midpoint_tree(mesh, dim, own)
            space = self.order.discretisation.space
            nodes = np.unique(space.dofmap.list[self.order.discretisation.cells_of(fine.tag)])
            cells = geometry.compute_closest_entity(tree, middles, mesh, points[nodes])
            found.append((nodes, cells))
        return found

    def displacement(self, answer: Answer) -> np.ndarray:
        """Coarse displacement at the nodes of the fine mesh, (N,)."""
        from dolfinx import fem

        coarse_field = fem.Function(self.coarse.discretisation.space)
        problem = self.coarse.problem
        coarse_field.x.array[:] = answer.unknown + problem.lifts @ problem.amplitudes(
            answer.parameter
        )
        points = self.order.discretisation.space.tabulate_dof_coordinates()
        found = np.zeros((len(points), self.order.discretisation.mesh.geometry.dim))
        for nodes, cells in self._cells:
            found[nodes] = coarse_field.eval(points[nodes], cells)
        return found.ravel()
