"""Contact conditions at nodes that a tie joins to the other surface: their neighbours bear what
they would bear.

Where a tie ends in a contact pair, both share a node. Its gap stays closed, and its multiplier is
one of the tie too. The multiplier functions psi of the nodes beside it are extended, so that those
of the pair still have the sum 1 on the whole surface: a constant pressure passes exactly (B.
Wohlmuth, SIAM J. Numer. Anal. 38, 2000, on cross points).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.sparse import csr_matrix, diags

from hhr_dolfinx.contact.prolongation import Prolongation
from hhr_dolfinx.contact.rows import ContactRows, normals_of
from hhr_dolfinx.errors import SceneWarning
from hhr_dolfinx.full_order.eliminated import Conditions
from hhr_dolfinx.full_order.free_bodies import components_of_nodes
from hhr_dolfinx.scene import Scene
from hhr_dolfinx.warn import warn

TIED_MOTION = 1e-6
"""Largest coefficient of a relative motion that counts as zero; that of free nodes is 1."""


def without_tied(
    scene: Scene,
    cell_nodes: np.ndarray,
    prolongation: Prolongation,
    rows: ContactRows,
    pairs: np.ndarray,
    opened: np.ndarray,
) -> Conditions:
    """Conditions without those at tied nodes.

    Neighbours of these take over their areas. It warns of tied nodes without neighbours in their
    pair.

    Args:
        scene: the scene.
        cell_nodes: nodes of each cell, (cells, n).
        prolongation: prolongation of the constraints.
        rows: the conditions.
        pairs: their contact pairs, (m,).
        opened: their openings, (m, k).

    Returns:
        Conditions, their pairs, and their openings.
    """
    tied = _tied(cell_nodes, prolongation, rows)
    if not tied.size:
        return rows, pairs, opened
    m = pairs.size
    untied = np.setdiff1d(np.arange(m), tied)
    shares = _shares(cell_nodes, rows, pairs, tied)
    lost = tied[np.diff(shares.indptr) == 0]
    for pair in np.unique(pairs[lost]).tolist():
        alone = lost[pairs[lost] == pair]
        warn(
            f"{alone.size} nodes of contact {pair} of {tuple(scene.contacts[pair].tags)} with "
            f"the area {rows.areas[alone].sum():.3g} are tied to its other surface, and their "
            "neighbours too: the tie bears their force, which the forces and areas of the contact "
            "leave out. Give the tie and the contact separate surfaces",
            SceneWarning,
        )
    weights = csr_matrix((np.ones(untied.size), (untied, untied)), shape=(m, m))
    entries = shares.tocoo()
    weights += csr_matrix((entries.data, (entries.col, tied[entries.row])), shape=(m, m))
    weights = csr_matrix(weights[untied])
    areas = weights @ rows.areas
    # a node without an area, as on an axis, takes nothing over
    alone = np.where(areas[:, None] > 0, 0.0, 1.0)
    scaled = diags(1 / np.where(areas > 0, areas, 1.0)) @ weights @ diags(rows.areas)
    mean = csr_matrix(
        scaled
        + csr_matrix((alone.ravel(), (np.arange(untied.size), untied)), shape=(untied.size, m))
    )
    # the gap of a tied node is closed, whatever the mesh has there
    closed = np.ones(m)
    closed[tied] = 0.0
    remaining = replace(
        rows.take(untied),
        matrix=csr_matrix(mean @ rows.matrix),
        gap=mean @ (closed * rows.gap),
        areas=areas,
    )
    return remaining, pairs[untied], mean @ (closed[:, None] * opened)


def _tied(cell_nodes: np.ndarray, prolongation: Prolongation, rows: ContactRows) -> np.ndarray:
    """Conditions of two surfaces, (t,), whose relative motion the constraints take away."""
    touched = abs(rows.matrix) @ prolongation.dependent.astype(float) > 0
    touched = np.flatnonzero(touched & (rows.areas > 0))
    if not touched.size or prolongation.map is None:
        return touched[:0]
    dim = rows.points.shape[1]
    matrix = csr_matrix(rows.matrix[touched])
    normals = normals_of(rows.matrix, rows.slaves, dim)[touched]
    body = components_of_nodes(matrix.shape[1] // dim, cell_nodes)
    before = _sums(matrix, normals, body)
    acting = prolongation.rows(matrix)
    after = _sums(acting, normals, body)
    # a row of an obstacle has the sum 1, one of two surfaces 0
    both = np.abs(np.asarray(before.sum(axis=1)).ravel()) < 0.5
    apart = abs(before).max(axis=1).toarray().ravel() > 0.5
    # a dof that a constraint holds, and that follows no other one, is not tied to anything
    follows = np.asarray((abs(matrix) @ abs(prolongation.map)).sum(axis=1)).ravel() > 0.5
    none = abs(acting).max(axis=1).toarray().ravel() <= TIED_MOTION
    joined = apart & (abs(after).max(axis=1).toarray().ravel() <= TIED_MOTION)
    return touched[both & follows & (joined | none)]


def _sums(matrix: csr_matrix, normals: np.ndarray, body: np.ndarray) -> csr_matrix:
    """Sums of the entries of rows along their normals, (k, dim), over each body, (k, bodies)."""
    entries = matrix.tocoo()
    node, component = np.divmod(entries.col, normals.shape[1])
    positions = entries.row, body[node]
    return csr_matrix(
        (entries.data * normals[entries.row, component], positions),
        shape=(len(normals), body.max() + 1),
    )


def _shares(
    cell_nodes: np.ndarray, rows: ContactRows, pairs: np.ndarray, tied: np.ndarray
) -> csr_matrix:
    """Shares of the conditions that take over those of tied nodes, by areas, (t, m): others of a
    cell and a pair.
    """
    count, width = cell_nodes.shape
    in_cells = csr_matrix(
        (np.ones(cell_nodes.size), cell_nodes.ravel(), np.arange(0, cell_nodes.size + 1, width)),
        shape=(count, int(cell_nodes.max()) + 1),
    ).tocsc()
    beside = (in_cells[:, rows.slaves[tied]].T @ in_cells[:, rows.slaves]).tocoo()
    neighbours = (
        (pairs[tied][beside.row] == pairs[beside.col])
        & ~np.isin(beside.col, tied)
        & (rows.areas[beside.col] > 0)
    )
    row, col = beside.row[neighbours], beside.col[neighbours]
    sums = np.bincount(row, rows.areas[col], tied.size)
    return csr_matrix((rows.areas[col] / sums[row], (row, col)), shape=(tied.size, pairs.size))
