"""From the reduced answer to fields everywhere, thesis section 1.4.6."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import linalg
from scipy.optimize import nnls
from scipy.sparse import csr_matrix

from hhr_dolfinx.contact.problem import ContactProblem, ContactSolution
from hhr_dolfinx.errors import ConvergenceError
from hhr_dolfinx.reduction.rid import IndexSets
from hhr_dolfinx.snapshots.solutions import SnapshotSet


@dataclass(frozen=True)
class Reconstruction:
    """Displacement on the whole mesh and contact forces on the whole contact surface.

    Attributes:
        basis: V, (N, ell).
        lifts: imposed displacements, (N, 1 + T).
        contact_basis: B V, (N_lambda, ell).
        gaps: D as terms of θ, (N_lambda, 1 + T).
        A_lambda: contact conditions of the RID.
        force_snapshots: independent columns of S_lambda, (N_lambda, S').
        gap_scale: length that makes a gap open, so that (1.70) does not depend on units.
    """

    basis: np.ndarray
    lifts: np.ndarray
    contact_basis: np.ndarray
    gaps: np.ndarray
    A_lambda: np.ndarray
    force_snapshots: np.ndarray
    gap_scale: float

    def displacement(self, gamma: np.ndarray, theta: np.ndarray) -> np.ndarray:
        """Displacement V gamma + lift, thesis (1.69), (N,)."""
        return self.basis @ gamma + self.lifts @ theta

    def forces(self, solution: ContactSolution, theta: np.ndarray) -> np.ndarray:
        """Contact forces on all conditions, (N_lambda,): the model's own inside the RID, (1.70)-(1.71) outside.

        Non-negative combinations of training forces are fitted to the forces inside the RID, and
        penalised where the reconstructed gap is open.

        Raises:
            ConvergenceError: if the fit does not end.
        """
        open_gap = np.maximum(self.gaps @ theta - self.contact_basis @ solution.primal, 0.0) / self.gap_scale
        matrix = np.vstack([self.force_snapshots[self.A_lambda], open_gap[:, None] * self.force_snapshots])
        target = np.concatenate([solution.forces, np.zeros(open_gap.size)])
        try:
            weights, _ = nnls(matrix, target)
        except RuntimeError as error:  # scipy's iteration limit
            raise ConvergenceError(f"the forces outside the RID could not be fitted: {error}") from error
        forces = self.force_snapshots @ weights
        forces[self.A_lambda] = solution.forces
        return forces


def prepare_reconstruction(
    problem: ContactProblem, basis: np.ndarray, sets: IndexSets, snapshots: SnapshotSet
) -> Reconstruction:
    """Collect what :class:`Reconstruction` needs; dependent force snapshots are left out, see (1.70)."""
    gaps = problem.amplitudes.sum_columns(problem.gaps, snapshots.points)
    slack = gaps - problem.contact @ snapshots.displacements
    scale = float(np.maximum(slack, 0.0).max())
    return Reconstruction(
        basis=basis,
        lifts=problem.lifts,
        contact_basis=csr_matrix(problem.contact) @ basis,
        gaps=problem.gaps,
        A_lambda=sets.A_lambda,
        force_snapshots=_independent(snapshots.forces, most=problem.contact.shape[0] + len(sets.A_lambda)),
        gap_scale=scale if scale > 0 else 1.0,
    )


def _independent(columns, most):
    """The most independent columns, by pivoted QR, in their order."""
    _, triangle, order = linalg.qr(columns, mode="economic", pivoting=True)
    size = np.abs(np.diag(triangle))
    rank = min(int((size > 1e-10 * size[0]).sum()) if size[0] > 0 else 0, most)
    return np.ascontiguousarray(columns[:, np.sort(order[:rank])])
