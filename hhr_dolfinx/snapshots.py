"""Snapshots: full-order solutions at the training parameters, thesis section 1.4.2."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from hhr_dolfinx.condensed import KnownStatuses


@dataclass(frozen=True)
class SnapshotSet:
    """Solutions of the full model, one column per training parameter.

    Attributes:
        points: training parameters, (S, P).
        displacements: homogeneous parts U0, that is displacements less their lift, (N, S).
        forces: contact forces, (N_lambda, S).
        active: statuses, (N_lambda, S) bool.
    """

    points: np.ndarray
    displacements: np.ndarray
    forces: np.ndarray
    active: np.ndarray

    @property
    def known_statuses(self) -> KnownStatuses:
        """The statuses as starting points for further queries."""
        return KnownStatuses(self.points, np.ascontiguousarray(self.active.T))


def compute_snapshots(full_order, points: np.ndarray, progress: Callable[[Iterable], Iterable] = iter) -> SnapshotSet:
    """Solve the full model at every point, each from the statuses of the one before.

    Args:
        full_order: :class:`hhr_dolfinx.full_order.FullOrderModel`.
        points: training parameters, (S, P).
        progress: wraps the iteration, for a progress bar.

    Raises:
        ConvergenceError: if a training point does not converge.
    """
    problem = full_order.problem
    columns, start = [], None
    for point in progress(points):
        solution = full_order.solve(point, start=start)
        start = solution.active
        columns.append((solution.primal, solution.forces, solution.active))
    displacements, forces, active = (np.stack(items, axis=1) for items in zip(*columns, strict=True))
    lifts = problem.amplitudes.sum_columns(problem.lifts, points)
    return SnapshotSet(np.array(points), displacements - lifts, forces, active)
