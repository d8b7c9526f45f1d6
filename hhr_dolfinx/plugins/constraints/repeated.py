"""Contact conditions that constraints make the same: one of them bears the force of all."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix, diags
from scipy.sparse.csgraph import connected_components

from hhr_dolfinx.contact.prolongation import Prolongation
from hhr_dolfinx.contact.rows import ContactRows
from hhr_dolfinx.full_order.eliminated import Conditions

REPEATED_CONDITION = 1e-6
"""Distance of gaps over the size of the mesh, and of rows of B T over theirs, up to which
conditions are the same.
"""


def without_repeated(
    middle: csr_matrix | None,
    prolongation: Prolongation,
    rows: ContactRows,
    pairs: np.ndarray,
    gaps: np.ndarray,
) -> Conditions:
    """Conditions with one instead of several that are the same for V.

    Such are those at both edges of a periodic surface: one bears the force of all, at their mean by
    areas.

    Args:
        middle: positive shares of dofs whose conditions are parts of those at other nodes, (N, N);
            None without any.
        prolongation: prolongation of the constraints.
        rows: the conditions.
        pairs: their contact pairs, (m,).
        gaps: their gaps by term, (m, 1 + T).

    Returns:
        Conditions, their pairs, and their gaps.
    """
    if middle is not None:
        rows, pairs, gaps = _without_middles(middle, rows, pairs, gaps)
    acting = csr_matrix(prolongation.rows(rows.matrix) @ diags(prolongation.free.astype(float)))
    squares = np.asarray(acting.multiply(acting).sum(axis=1)).ravel()
    touched = np.flatnonzero(abs(rows.matrix) @ prolongation.dependent.astype(float) > 0)
    beside = coo_matrix(acting[touched] @ acting.T)
    first_index = touched[beside.row]
    second_index = beside.col
    size = max(np.ptp(rows.points, axis=0).max(initial=0.0), np.abs(gaps).max(initial=0.0))
    same = (
        squares[first_index] + squares[second_index] - 2 * beside.data
        <= REPEATED_CONDITION**2 * squares[first_index]
    )
    same &= (pairs[first_index] == pairs[second_index]) & (
        np.abs(gaps[first_index] - gaps[second_index]).max(axis=1) <= REPEATED_CONDITION * size
    )
    m = pairs.size
    graph = csr_matrix(
        (np.ones(int(same.sum())), (first_index[same], second_index[same])), shape=(m, m)
    )
    count, label = connected_components(graph, directed=False)
    if count == m:
        return rows, pairs, gaps
    _, first, label = np.unique(label, return_index=True, return_inverse=True)
    areas = np.bincount(label, rows.areas)
    mean = csr_matrix((rows.areas / areas[label], (label, np.arange(m))), shape=(count, m))
    merged = replace(
        rows.take(first), matrix=csr_matrix(mean @ rows.matrix), gap=mean @ rows.gap, areas=areas
    )
    return merged, pairs[first], mean @ gaps


def _without_middles(
    of_middles: csr_matrix, rows: ContactRows, pairs: np.ndarray, gaps: np.ndarray
) -> Conditions:
    """Conditions without those at nodes in the middle of faces, which the others of a facet would
    imply.

    Nodes of edges take them over by areas: functions psi of a pair then still have the sum 1.
    """
    dim = rows.points.shape[1]
    shares = of_middles[dim * rows.slaves]
    middle = np.flatnonzero(np.diff(shares.indptr))
    if not middle.size:
        return rows, pairs, gaps
    entries = shares[middle].tocoo()
    count = pairs.size
    keys = pairs * (of_middles.shape[0] + 1) + dim * rows.slaves
    wanted = pairs[middle[entries.row]] * (of_middles.shape[0] + 1) + entries.col
    order = np.argsort(keys)
    position = order[np.minimum(np.searchsorted(keys[order], wanted), count - 1)]
    matches = keys[position] == wanted
    shares = csr_matrix(
        (entries.data[matches], (position[matches], middle[entries.row[matches]])),
        shape=(count, count),
    )
    sums = np.asarray(shares.sum(axis=0)).ravel()
    remaining = np.flatnonzero(sums == 0)
    weights = csr_matrix(
        shares @ diags(1 / np.where(sums > 0, sums, 1.0)) + diags((sums == 0).astype(float))
    )[remaining]
    areas = weights @ rows.areas
    mean = diags(1 / areas) @ weights @ diags(rows.areas)
    edge_rows = replace(
        rows.take(remaining),
        matrix=csr_matrix(mean @ rows.matrix),
        gap=mean @ rows.gap,
        areas=areas,
    )
    return edge_rows, pairs[remaining], mean @ gaps
