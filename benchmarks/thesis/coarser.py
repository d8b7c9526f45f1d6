"""A coarser mesh as a baseline: solved exactly, then carried over to the nodes of the fine mesh."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import LinearNDInterpolator, RBFInterpolator
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from hhr_dolfinx.contact.problem import ContactProblem
from hhr_dolfinx.full_order.full import FullOrderModel
from hhr_dolfinx.models.answer import Answer, ElasticFields, ModelFields
from hhr_dolfinx.reduction.exact import exact_condensation
from hhr_dolfinx.snapshots.records import compute_snapshots


class CoarserMesh:
    """Answers on a coarser mesh by exact condensation, carried over to the fine one where fields
    are asked for.

    Args:
        coarse: full model of the same scene on a coarser mesh, on one rank.
        fine: problem whose nodes the fields are carried to.
        points: parameters whose statuses are known beforehand, (S, P).
    """

    def __init__(self, coarse: FullOrderModel, fine: ContactProblem, points: np.ndarray):
        condensed = exact_condensation(coarse, compute_snapshots(coarse, points).known_statuses())
        fields = _CarriedOver(
            coarse.problem, fine, _matching_bodies(coarse.problem, fine), condensed.fields
        )
        self._online = condensed.changed(fields=fields)
        self.solve, self.march = self._online.solve, self._online.march


@dataclass(frozen=True)
class _CarriedOver(ElasticFields):
    """ModelFields of a coarse mesh on a fine one, see
    :class:`hhr_dolfinx.models.answer.ModelFields`.
    """

    coarse: ContactProblem
    fine: ContactProblem
    bodies: list[tuple[np.ndarray, np.ndarray]]
    fields: ModelFields

    def displacement(self, answer: Answer) -> np.ndarray:
        """Interpolated linearly in each body, (N,)."""
        coarse, fine = self.coarse, self.fine
        field = self.fields.displacement(answer).reshape(-1, coarse.block_size)
        displacement = np.zeros((len(fine.points), fine.block_size))
        for here, there in self.bodies:
            displacement[there] = _interpolate(coarse.points[here], field[here], fine.points[there])
        return displacement.ravel()

    def forces(self, answer: Answer) -> np.ndarray:
        """Interpolated as pressures along each contact pair, (N_lambda,)."""
        coarse, fine = self.coarse, self.fine
        forces = np.zeros(len(fine.contact_pairs))
        for pair in np.unique(fine.contact_pairs):
            here, there = coarse.contact_pairs == pair, fine.contact_pairs == pair
            pressure = RBFInterpolator(
                coarse.contact_points[here],
                (answer.multipliers / coarse.contact_areas)[here],
                kernel="linear",
                degree=0,
            )
            forces[there] = (
                np.maximum(pressure(fine.contact_points[there]), 0.0) * fine.contact_areas[there]
            )
        return forces

    def stress(self, answer: Answer) -> np.ndarray:
        """Stress of the coarse mesh."""
        return self.fields.stress(answer)


def _matching_bodies(coarse, fine):
    """Pairs of node sets of the same body on both meshes, matched by their centres."""
    candidates = _bodies(coarse)
    centres = np.array([coarse.points[nodes].mean(axis=0) for nodes in candidates])

    def match(nodes: np.ndarray) -> int:
        return int(np.linalg.norm(centres - fine.points[nodes].mean(axis=0), axis=1).argmin())

    return [(candidates[match(nodes)], nodes) for nodes in _bodies(fine)]


def _bodies(problem):
    """Nodes of each connected body."""
    cells, per_cell = problem.cell_nodes.shape
    data = np.ones(cells * per_cell)
    incidence = csr_matrix(
        (data, problem.cell_nodes.ravel(), np.arange(0, data.size + 1, per_cell))
    )
    count, label = connected_components(incidence.T @ incidence, directed=False)
    return [np.flatnonzero(label == k) for k in range(count)]


def _interpolate(points, values, targets):
    """Linear interpolation, and the nearest node's value outside the hull of a curved boundary."""
    result = LinearNDInterpolator(points, values)(targets)
    outside = np.isnan(result[:, 0])
    if outside.any():
        result[outside] = values[cKDTree(points).query(targets[outside])[1]]
    return result
