"""What a reduced model needs to answer with whole fields, thesis section 1.4.6."""

from __future__ import annotations

import numpy as np
from scipy import linalg
from scipy.sparse import csr_matrix

from hhr_dolfinx.contact.problem import ContactProblem
from hhr_dolfinx.online.reconstruct import Reconstruction
from hhr_dolfinx.reduction.rid import IndexSets
from hhr_dolfinx.snapshots.solutions import SnapshotSet


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
