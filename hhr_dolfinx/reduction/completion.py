"""Reconstruction of whole fields from reduced answers, thesis section 1.4.6.

Bounds of their errors are here too.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import linalg
from scipy.optimize import nnls

from hhr_dolfinx import registry
from hhr_dolfinx.contact.problem import ContactProblem, IndexSets
from hhr_dolfinx.errors import BoundError
from hhr_dolfinx.models.bound import Bounding
from hhr_dolfinx.models.estimates import NOT_ASKED
from hhr_dolfinx.models.reconstruct import Reconstruction
from hhr_dolfinx.reduction.recipe import Recipe
from hhr_dolfinx.reduction.reductor import Task
from hhr_dolfinx.snapshots.records import SnapshotSet

IN_THE_CONE = 1e-3
"""Relative distance from the cone of the other snapshots below which a force snapshot is left out:
the fraction of the largest force below which a relative force error is meaningless.
"""


@dataclass(frozen=True)
class ReconstructionData:
    """Reconstruction data that depend on training alone, computed once for all attempts."""

    forces: np.ndarray  #: of training, (N_lambda, S)
    gap_scale: np.ndarray  #: length scale of gaps, (N_lambda,)

    @classmethod
    def of(cls, problem: ContactProblem, snapshots: SnapshotSet) -> ReconstructionData:
        """Data from training answers.

        Args:
            problem: the contact problem.
            snapshots: training answers.
        """
        # the scale of the gaps of a pair is the largest gap or relative motion of its bodies, not
        # the largest slack: if contact never opens in training the slack is round-off, and relative
        # to it all gaps would count as open
        gaps = problem.amplitudes.sum_columns(problem.gaps, snapshots.points)
        sizes = np.maximum(
            np.abs(gaps), np.abs(problem.contact_rows_times(snapshots.displacements))
        ).max(axis=1)
        scale = np.ones(sizes.size)
        for pair in np.unique(problem.contact_pairs):
            of_pair = problem.contact_pairs == pair
            scale[of_pair] = sizes[of_pair].max() or 1.0
        return cls(snapshots.forces, scale)

    @cached_property
    def rays(self) -> np.ndarray:
        """Training forces whose cone contains all of them, see (1.70), (N_lambda, S')."""
        return spanning_rays(self.forces, IN_THE_CONE)

    def reconstruction(
        self, problem: ContactProblem, basis: np.ndarray, sets: IndexSets, *, cone: bool = True
    ) -> Reconstruction:
        """Fields of one reduced model.

        The result has all rows of the columns, (N, c), on all ranks: each evaluates by itself.

        Args:
            problem: the contact problem.
            basis: columns of the displacement, (own, c).
            sets: index sets of the RID.
            cone: combine training forces by (1.70); otherwise a bound completes forces.
        """
        return Reconstruction(
            amplitudes=problem.amplitudes,
            basis=problem.spread.whole(basis),
            lifts=problem.lifts,
            contact_basis=problem.contact_rows_times(basis),
            gaps=problem.gaps + 0.0,  # files keep the sign of zeros
            A_lambda=sets.A_lambda,
            force_snapshots=self.rays if cone else None,
            gap_scale=self.gap_scale,
            dimension=problem.block_size,
        )


def spanning_rays(columns: np.ndarray, tolerance: float) -> np.ndarray:
    """Select non-negative columns whose non-negative combinations contain all of them.

    Linear independence is not enough for (1.70): a snapshot that is a difference of others lies
    outside their cone. The most independent columns come first; half of the columns outside their
    cone are added at a time.

    Args:
        columns: non-negative columns, (m, S).
        tolerance: distance from the cone, relative to the norm of a column, that counts as inside.

    Returns:
        The selected columns, (m, S').
    """
    lengths = np.linalg.norm(columns, axis=0)
    remaining = np.flatnonzero(lengths > 0)
    if remaining.size == 0:
        return np.zeros((columns.shape[0], 0))
    rays = columns / np.where(lengths > 0, lengths, 1.0)
    _, triangle, order = linalg.qr(rays[:, remaining], mode="economic", pivoting=True)
    sizes = np.abs(np.diag(triangle))
    selected = remaining[order[: int((sizes > tolerance * sizes[0]).sum())]]
    remaining = np.setdiff1d(remaining, selected)
    while remaining.size:
        distances = np.array([_distance(rays[:, selected], rays[:, k]) for k in remaining])
        remaining = remaining[distances > tolerance]
        distances = distances[distances > tolerance]
        farthest = np.argsort(-distances)[: (remaining.size + 1) // 2]
        selected = np.append(selected, remaining[farthest])
        remaining = np.delete(remaining, farthest)
    return np.ascontiguousarray(columns[:, np.sort(selected)])


def _distance(cone: np.ndarray, ray: np.ndarray) -> float:
    """Distance of a ray from a cone.

    Infinite if the search does not converge: the ray is then added to the cone.
    """
    try:
        # scipy's limit of three rounds for each ray is too small for hundreds of nearly parallel
        # rays
        return float(nnls(cone, ray, maxiter=30 * cone.shape[1])[1])
    except RuntimeError:
        return math.inf


def bound_of(task: Task, recipe: Recipe, basis: np.ndarray) -> Bounding:
    """Bounds for a recipe; none if they are not requested or not proved, with a log entry.

    A ``BoundError`` is logged, not raised.

    Args:
        task: input of the reduction.
        recipe: the recipe.
        basis: modes, (own, ell).
    """
    if not recipe.bound or recipe.indicator is not None:
        return Bounding(None, basis, unbounded=NOT_ASKED)
    if reason := task.kind.unbounded:
        return Bounding(None, basis, unbounded=reason)
    full = task.full
    log = task.log
    announce = task.announce
    assert task.snapshots is not None  # checked
    try:
        with log.stage("bound", announce):
            for registered in [
                registered
                for plugin in registry.installed().values()
                for registered in plugin.bounds
            ]:
                if registry.wants(registered, full):
                    prove = registry.load(registered.place)
                    bounding: Bounding = prove(
                        full, basis, task.snapshots.forces, cone=recipe.cone, announce=announce
                    )
                    return bounding
            raise BoundError("no installed plug-in knows the errors of its answers")
    except BoundError as error:
        log.skip("bound", str(error))
        return Bounding(None, basis, unbounded=str(error))
