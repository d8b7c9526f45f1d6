"""Snapshots: full-order solutions at the training parameters, thesis section 1.4.2."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hhr_dolfinx import ranks
from hhr_dolfinx.models.condensed import KnownStatuses

if TYPE_CHECKING:
    from mpi4py.MPI import Comm

    from hhr_dolfinx.contact.problem import Solvable
    from hhr_dolfinx.snapshots.store import SnapshotStore


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

    def take(self, columns) -> SnapshotSet:
        """Some of the solutions, possibly several times."""
        parts = (getattr(self, name)[:, columns] for name in _COLUMNS)
        return SnapshotSet(self.points[columns], *parts)

    def known_statuses(self, conditions=slice(None)) -> KnownStatuses:
        """The statuses of some conditions as starting points for further queries."""
        return KnownStatuses(self.points, np.ascontiguousarray(self.active[conditions].T))


def compute_snapshots(
    full_order: Solvable,
    points: np.ndarray,
    progress: Callable[[Iterable], Iterable] = iter,
    store: SnapshotStore | None = None,
) -> SnapshotSet:
    """Solve the full model at every point, each from the statuses of the one before.

    Args:
        full_order: the full model.
        points: training parameters, (S, P).
        progress: wraps the iteration, for a progress bar.
        store: solutions found there are not computed, the others are added to it.

    Raises:
        ParameterError: if a point is not finite or outside the box.
        ConvergenceError: if a training point does not converge.
    """
    points = full_order.problem.parameters.points(points)
    solutions, start = [], None
    with ranks.together(full_order.comm, "solving for snapshots"):
        for point in progress(points):
            # one rank decides what is known, since solving takes all of them
            first = full_order.comm.rank == 0
            solution = store.load(point) if store is not None and first else None
            if store is not None:
                solution = full_order.comm.bcast(solution)
            if solution is None:
                solution = full_order.solve(point, start=start)
                if store is not None and first:
                    store.save(point, solution)
            start = solution.active
            solutions.append(solution)
    return _collect(full_order.problem, points, solutions)


def spread_snapshots(
    full_order: Solvable,
    points: np.ndarray,
    comm: Comm,
    progress: Callable[[Iterable], Iterable] = iter,
    store: SnapshotStore | None = None,
) -> SnapshotSet:
    """Share the points out over the ranks of ``comm``; every rank gets all snapshots.

    Args:
        full_order: a full model of its own on each rank (communicator of one).
        points: training parameters, the same on all ranks, (S, P).
        comm: communicator over which the points are spread.
        progress: wraps the iteration, for a progress bar.
        store: see :func:`compute_snapshots`; the ranks share its folder.

    Raises:
        ConvergenceError: on all ranks, if a training point does not converge on any.
        RankError: where another rank failed with an error that is none of this package's.
    """
    points = full_order.problem.parameters.points(points)
    own = None
    with ranks.each_for_itself(comm, "solving for snapshots"):
        # neighbours stay together, so that each start is a good one
        mine = np.array_split(np.arange(len(points)), comm.size)[comm.rank]
        if mine.size:
            own = compute_snapshots(full_order, points[mine], progress, store)
    parts = [part for part in comm.allgather(own) if part is not None]
    joined = (np.concatenate([getattr(part, name) for part in parts], axis=1) for name in _COLUMNS)
    return SnapshotSet(points, *joined)


_COLUMNS = ("displacements", "forces", "active")


def _collect(problem, points, solutions) -> SnapshotSet:
    displacements, forces, active = (
        np.stack([getattr(solution, name) for solution in solutions], axis=1) for name in ("primal", "forces", "active")
    )
    lifts = problem.amplitudes.sum_columns(problem.lifts, points)
    return SnapshotSet(np.array(points), displacements - lifts, forces, active)
