"""What a reduced model needs to answer with whole fields, thesis section 1.4.6."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy import linalg
from scipy.optimize import nnls
from scipy.sparse import csr_matrix

from hhr_dolfinx.contact.problem import ContactProblem, IndexSets
from hhr_dolfinx.models.reconstruct import FlowFields, GappyField, Reconstruction
from hhr_dolfinx.reduction.pod import pod
from hhr_dolfinx.snapshots.records import SnapshotSet

if TYPE_CHECKING:
    from hhr_dolfinx.models.reduced_flow import ReducedFlow

STRESS, PLASTIC_STRAIN = 1e-9, 1e-6
"""Part of the squared training fields that the modes for stress and for cumulated plastic strain leave out."""
IN_THE_CONE = 1e-3
"""Relative distance from the cone of the other snapshots below which a force snapshot is left out: the fraction of the
largest force below which a relative force error means nothing."""


def prepare_reconstruction(
    problem: ContactProblem,
    basis: np.ndarray,
    sets: IndexSets,
    snapshots: SnapshotSet,
    flow: ReducedFlow | None = None,
) -> Reconstruction:
    """Collect what :class:`Reconstruction` needs; snapshots inside the cone of the others are left out, see (1.70)."""
    return Reconstruction(
        amplitudes=problem.amplitudes,
        basis=basis,
        lifts=problem.lifts,
        contact_basis=csr_matrix(problem.contact) @ basis,
        gaps=problem.gaps,
        A_lambda=sets.A_lambda,
        force_snapshots=spanning_rays(snapshots.forces, IN_THE_CONE),
        gap_scale=_gap_scale(problem, snapshots),
        dimension=problem.block_size,
        flow=None if flow is None else _flow_fields(flow, snapshots),
    )


def _flow_fields(flow: ReducedFlow, snapshots: SnapshotSet) -> FlowFields:
    """How stress and cumulated plastic strain are completed, from POD modes of training states (section 6.2.3)."""
    components, points = flow.material.components, flow.points
    stresses, cumulated_strains = snapshots.fields_of_flow()
    values = (points[:, None] * components + np.arange(components)).ravel()
    stress = GappyField.fitted(pod(stresses, STRESS)[0], values)
    cumulated = None
    if np.any(cumulated_strains):
        cumulated = GappyField.fitted(pod(cumulated_strains, PLASTIC_STRAIN)[0], points)
    return FlowFields(points, stress, cumulated, len(cumulated_strains))


def spanning_rays(columns: np.ndarray, tolerance: float) -> np.ndarray:
    """Some of non-negative columns, (m, S), whose non-negative combinations reach all of them, (m, S').

    Linear independence is not enough for (1.70): a snapshot that is a difference of others lies outside their cone.
    The most independent columns come first; what lies outside their cone joins them, half at a time. A distance from
    the cone up to ``tolerance``, relative to the length of a column, counts as inside.
    """
    lengths = np.linalg.norm(columns, axis=0)
    left = np.flatnonzero(lengths > 0)
    if left.size == 0:
        return np.zeros((columns.shape[0], 0))
    rays = columns / np.where(lengths > 0, lengths, 1.0)
    _, triangle, order = linalg.qr(rays[:, left], mode="economic", pivoting=True)
    sizes = np.abs(np.diag(triangle))
    kept = left[order[: int((sizes > tolerance * sizes[0]).sum())]]
    left = np.setdiff1d(left, kept)
    while left.size:
        distances = np.array([nnls(rays[:, kept], rays[:, k])[1] for k in left])
        left, distances = left[distances > tolerance], distances[distances > tolerance]
        farthest = np.argsort(-distances)[: (left.size + 1) // 2]
        kept = np.append(kept, left[farthest])
        left = np.delete(left, farthest)
    return np.ascontiguousarray(columns[:, np.sort(kept)])


def _gap_scale(problem, snapshots) -> np.ndarray:
    """Length by which gaps of each contact pair are measured, (N_lambda,).

    The largest gap or relative motion of its bodies, not the largest slack: where contact never opens in training the
    slack is round-off, and gaps measured by it would all count as open.
    """
    gaps = problem.amplitudes.sum_columns(problem.gaps, snapshots.points)
    sizes = np.maximum(np.abs(gaps), np.abs(problem.contact @ snapshots.displacements)).max(axis=1)
    scale = np.ones(sizes.size)
    for pair in np.unique(problem.contact_pairs):
        inside = problem.contact_pairs == pair
        scale[inside] = sizes[inside].max() or 1.0
    return scale
