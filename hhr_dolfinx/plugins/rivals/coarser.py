"""The oldest rival: the same problem on a coarser mesh, its answer carried to the mesh compared."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from scipy.interpolate import griddata

from hhr_dolfinx.contact.active_set import Status, Statuses
from hhr_dolfinx.errors import NotOfferedError
from hhr_dolfinx.full_order.full import FullOrderModel
from hhr_dolfinx.models.answer import Answer, ElasticFields, found_as
from hhr_dolfinx.plugins.rivals.projection import RivalModel, check_elastic

if TYPE_CHECKING:
    from hhr_dolfinx.models.answer import Meshed
    from hhr_dolfinx.scene import Scene


class CoarserMesh(RivalModel):
    """The full order of the same scene on a coarser mesh, as an approximation of a finer one.

    Displacements are interpolated by the functions of the coarse mesh. Contact pressures are
    interpolated along the surface of each pair, by the two coordinates in which it is widest, and
    become forces by the areas of the fine conditions.

    Args:
        full: full model of the scene on the mesh compared.
        scene: the scene on a coarser mesh: its bodies, contacts, loads and parameters are the same.

    Raises:
        NotOfferedError: for other parameters, pairs or directions, and see
            :func:`~hhr_dolfinx.plugins.rivals.projection.check_elastic`.
    """

    def __init__(self, full: FullOrderModel, scene: Scene):
        check_elastic(full, "a coarser mesh")
        self.coarse = FullOrderModel(scene, full.comm)
        check_elastic(self.coarse, "a coarser mesh")
        self.parameters = full.parameters
        if self.coarse.parameters != full.parameters:
            raise NotOfferedError("a coarser mesh answers other parameters: give it the same box")
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


def _spread(coarse: FullOrderModel, fine: FullOrderModel) -> np.ndarray:
    """Forces on fine conditions of those on coarse ones, (fine conditions, coarse conditions)."""
    one = coarse.problem
    other = fine.problem
    spread = np.zeros((len(other.gaps), len(one.gaps)))
    if set(one.contact_pairs) != set(other.contact_pairs):
        raise NotOfferedError("a coarser mesh has other contact pairs: give it the same contacts")
    for pair in set(other.contact_pairs):
        given = np.flatnonzero(one.contact_pairs == pair)
        asked = np.flatnonzero(other.contact_pairs == pair)
        areas = one.contact_areas[given]
        # a node on the axis has no area, and its force no pressure
        pressures = np.diag(np.divide(1.0, areas, out=np.zeros(len(areas)), where=areas > 0))
        between = _along(one.contact_points[given], pressures, other.contact_points[asked])
        spread[np.ix_(asked, given)] = other.contact_areas[asked, None] * between
    return spread


def _along(points: np.ndarray, values: np.ndarray, asked: np.ndarray) -> np.ndarray:
    """Values at points, (n, k), interpolated along their surface to others, (q, k)."""
    middle = points.mean(axis=0)
    axes = np.linalg.svd(points - middle)[2][: points.shape[1] - 1]
    flat = (points - middle) @ axes.T
    at = (asked - middle) @ axes.T
    linear = griddata(flat, values, at, method="linear")
    nearest = griddata(flat, values, at, method="nearest")
    found: np.ndarray = np.where(np.isnan(linear), nearest, linear).reshape(len(at), -1)
    return found


@dataclass(frozen=True)
class CoarseFields(ElasticFields):
    """Fields of a coarse answer on the fine mesh, see
    :class:`~hhr_dolfinx.models.answer.ModelFields`.
    """

    order: FullOrderModel
    coarse: FullOrderModel

    @property
    def full(self) -> Meshed:
        """The full model of the fine mesh."""
        return self.order

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

        given = fem.Function(self.coarse.discretisation.space)
        problem = self.coarse.problem
        given.x.array[:] = answer.unknown + problem.lifts @ problem.amplitudes(answer.parameter)
        points = self.order.discretisation.space.tabulate_dof_coordinates()
        found = np.zeros((len(points), self.order.discretisation.mesh.geometry.dim))
        for nodes, cells in self._cells:
            found[nodes] = given.eval(points[nodes], cells)
        return found.ravel()

    def stress(self, answer: Answer) -> np.ndarray:
        """Stress of the displacement in the middle of each fine cell, (cells, components)."""
        return self.order.stress_of(self.displacement(answer), answer.parameter)
