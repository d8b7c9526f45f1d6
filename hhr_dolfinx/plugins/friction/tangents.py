"""Tangential rows of B for contacts with friction, for any pairing.

The relative displacement of slave and master has the same weights at the same nodes, with tangents
instead of the normal: B U <= D of thesis (1.27) gains rows whose slack decreases by the relative
displacement along a tangent.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property

import numpy as np
from scipy import linalg
from scipy.sparse import block_diag, csc_matrix, csr_matrix, diags, vstack
from scipy.spatial import cKDTree
from scipy.spatial.distance import pdist

from hhr_dolfinx.contact.law import MeshArrays
from hhr_dolfinx.contact.rows import ContactRows, joined, normals_of
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.full_order.free_bodies import components_of_nodes
from hhr_dolfinx.plugins.friction.laws import Friction, FrictionLaw

NORMAL_DEVIATION = 1e-9
"""Part of a row that may deviate from its normal; with more, the row has no tangents."""
STEEP = 0.9
"""Cosine between a normal and an axis above which tangents along the axis are inaccurate."""
IMMOVABLE_TANGENT = 1e-9
"""Part of a tangential row, relative to its norm, up to which its free dofs count as zero."""


def with_tangents(
    rows: ContactRows,
    pairs: np.ndarray,
    laws: Mapping[int, FrictionLaw],
    free: np.ndarray,
    lifts: csc_matrix,
    fixed: np.ndarray,
    shaped: np.ndarray,
    mesh: Mesh,
) -> tuple[ContactRows, np.ndarray, Friction]:
    """Append the tangential rows of some pairs to the conditions.

    Return all rows, the pair of each, and the friction.

    Tangents along which all displacements are imposed to be the same are left out: nothing slips.
    If imposed displacements slide both sides past each other, friction does no work on unknowns and
    enters resultants as a force.

    Args:
        rows, pairs: conditions of pressures, and the contact pair of each, (n,).
        laws: of the pairs that have friction.
        free: dofs that are not imposed, (N,) bool.
        lifts: imposed displacements, (N, 1 + T).
        fixed, shaped: see :class:`Friction`.
        mesh: nodes and cells.

    Raises:
        SceneError: for rows that are not along a single normal.
    """
    dim = rows.points.shape[1]
    normal = np.flatnonzero(np.isin(pairs, list(laws)))
    pressures = rows.take(normal)
    normals = normals_of(pressures.matrix, pressures.slaves, dim)
    tangents = tangents_of(normals)
    matrix = tangential_rows(pressures.matrix, normals, tangents)
    turns, owner, driven = _movable(matrix, free, lifts, dim)
    matrix = csr_matrix(turns @ matrix)
    matrix = csr_matrix(matrix - diags(driven.astype(float)) @ matrix @ diags(free.astype(float)))
    tangents = turns @ tangents.reshape(-1, dim)
    added = ContactRows(
        matrix,
        np.zeros(owner.size),
        pressures.slaves[owner],
        pressures.points[owner],
        pressures.areas[owner],
    )
    held = csr_matrix(rows.matrix.multiply(free.astype(float)))
    moving = csr_matrix(matrix.multiply(free.astype(float)))
    moving.eliminate_zeros()
    twice = _said_twice(held, moving, normal, owner, dim)
    numbers = np.array(list(laws))
    friction = Friction(
        normal,
        pressures.areas,
        _spacing(pressures, pairs[normal], normals, mesh),
        np.searchsorted(numbers, pairs[normal]),
        len(pairs) + np.arange(owner.size),
        owner,
        tangents,
        tuple(laws.values()),
        fixed,
        shaped,
        len(pairs) + twice,
    )
    return joined([rows, added]), np.concatenate([pairs, pairs[normal][owner]]), friction


def _spacing(rows: ContactRows, pairs: np.ndarray, normals: np.ndarray, mesh: Mesh) -> np.ndarray:
    """Distance of each row to neighbouring nodes, beyond which it has left its partners, (n,).

    0 without partners.

    The minimum of the distance between partners, for a single partner that to the nodes of its
    cells along the surface, and the distance to the nearest slave of another row of the pair,
    unless slaves are partners too, as in a double pass.
    """
    points = mesh.points
    entries = rows.matrix.tocoo()
    shape = len(pairs), len(points)
    nodes = csr_matrix(
        (np.ones(entries.nnz), (entries.row, entries.col // points.shape[1])), shape=shape
    )
    # second-order conditions contain neighbours of their slave too: partners are nodes of another
    # body
    body = (
        components_of_nodes(len(points), mesh.cells) if mesh.order > 1 else np.arange(len(points))
    )
    partners = [
        row.indices[body[row.indices] != body[slave]]
        for row, slave in zip(nodes, rows.slaves, strict=True)
    ]
    spacing = np.full(len(pairs), np.inf)
    for index, indices in enumerate(partners):
        if len(indices) > 1:
            spacing[index] = pdist(points[indices]).min()
        elif len(indices) == 1:
            spacing[index] = mesh.width(indices[0], normals[index])
    for pair in np.unique(pairs):
        indices = np.flatnonzero(pairs == pair)
        both = np.isin(
            rows.slaves[indices], np.concatenate([partners[index] for index in indices])
        ).any()
        if indices.size > 1 and not both:
            slave_points = points[rows.slaves[indices]]
            spacing[indices] = np.minimum(
                spacing[indices], cKDTree(slave_points).query(slave_points, k=2)[0][:, 1]
            )
    return np.where(np.isfinite(spacing) & [len(indices) > 0 for indices in partners], spacing, 0.0)


class Mesh(MeshArrays):
    """Nodes and cells, with their neighbours."""

    @cached_property
    def _around(self) -> csr_matrix:
        """Cells of each node, (nodes, cells)."""
        cells, k = self.cells.shape
        entries = self.cells.ravel(), np.repeat(np.arange(cells), k)
        return csr_matrix((np.ones(cells * k), entries), shape=(len(self.points), cells))

    def width(self, node: int, normal: np.ndarray) -> float:
        """Smallest distance from a node to others of its cells that lie across rather than along a
        normal, (dim,).
        """
        neighbours = np.setdiff1d(self.cells[self._around[node].indices], node)
        ways = self.points[neighbours] - self.points[node]
        lengths = np.linalg.norm(ways, axis=1)
        return float(lengths[np.abs(ways @ normal) < 0.5 * lengths].min(initial=np.inf))


def _movable(
    matrix: csr_matrix, free: np.ndarray, lifts: csc_matrix, dim: int
) -> tuple[csr_matrix, np.ndarray, np.ndarray]:
    """Combinations of the tangential rows of each contact, (T', T), and the contact of each.

    If all of its rows are independent on free dofs they are kept. Otherwise they are rotated, and
    imposed combinations are left out, unless imposed displacements move them: a mask, (T',), is
    True for those without free dofs.
    """
    moving = csr_matrix(matrix.multiply(free.astype(float)))
    imposed = abs(matrix.multiply(~free) @ lifts)
    squares = np.asarray(matrix.multiply(matrix).sum(axis=1)).ravel()
    least = IMMOVABLE_TANGENT * abs(lifts).max() * np.sqrt(squares)
    slipping = np.asarray(imposed.max(axis=1).todense()).ravel() > least
    blocks = []
    driven = []
    for first in range(0, matrix.shape[0], dim - 1):
        span = slice(first, first + dim - 1)
        rows = moving[span]
        sizes, ways = np.linalg.eigh((rows @ rows.T).toarray())
        moves = sizes > IMMOVABLE_TANGENT * squares[span].max()
        movable = moves | slipping[span].any()
        blocks.append(np.eye(dim - 1) if moves.all() else ways[:, movable].T)
        driven.append(~moves[movable])
    turns = csr_matrix(block_diag([csr_matrix(block) for block in blocks]))
    return (
        turns,
        np.repeat(np.arange(len(blocks)), [len(block) for block in blocks]),
        np.concatenate(driven),
    )


def _said_twice(
    pressing: csr_matrix, matrix: csr_matrix, normal: np.ndarray, owner: np.ndarray, dim: int
) -> np.ndarray:
    """Tangential rows that leave a part of their forces undetermined, (k,).

    These are rows without free dofs, and those of contacts on whose nodes other conditions are the
    same. In a corner between two surfaces a tangent of one is the normal of the other: if both are
    closed and stick, the distribution of the force is undetermined. ``pressing`` and ``matrix`` are
    pressures and tangential rows on free dofs.
    """
    undetermined = [np.flatnonzero(np.diff(matrix.indptr) == 0)]
    for contact, conditions in _sharing_nodes(pressing, normal, dim).items():
        neighbours = np.flatnonzero(np.isin(normal[owner], conditions))
        span = vstack([pressing[conditions], matrix[neighbours]])
        own_rows = np.flatnonzero(owner == contact)
        columns = np.unique(np.concatenate([span.indices, matrix[own_rows].indices]))
        basis = linalg.orth(span[:, columns].toarray().T)
        rows = matrix[own_rows][:, columns].toarray()
        residual = rows - (rows @ basis) @ basis.T
        least = np.linalg.svd(residual, compute_uv=False).min(initial=1.0) ** 2
        if least <= IMMOVABLE_TANGENT * (rows**2).sum(axis=1).max(initial=0.0):
            undetermined.append(own_rows)
    return np.unique(np.concatenate(undetermined))


def _sharing_nodes(normals: csr_matrix, normal: np.ndarray, dim: int) -> dict[int, np.ndarray]:
    """Contacts on whose free nodes there are other conditions without further free nodes, and these
    conditions.
    """
    entries = normals.tocoo()
    shape = normals.shape[0], normals.shape[1] // dim
    touches = csr_matrix((np.ones(entries.nnz), (entries.row, entries.col // dim)), shape=shape)
    touches.data[:] = 1.0
    common = (touches[normal] @ touches.T).tocoo()
    included = (common.data == np.diff(touches.indptr)[common.col]) & (
        common.col != normal[common.row]
    )
    sharing: dict[int, list[int]] = {}
    for contact, row in zip(
        common.row[included].tolist(), common.col[included].tolist(), strict=True
    ):
        sharing.setdefault(contact, []).append(row)
    return {contact: np.array(rows) for contact, rows in sharing.items()}


def tangents_of(normals: np.ndarray) -> np.ndarray:
    """Orthonormal tangents of each normal, (m, dim - 1, dim): rotated by 90 degrees, in space along
    two axes.
    """
    m, dim = normals.shape
    if dim == 2:
        return np.stack([-normals[:, 1], normals[:, 0]], axis=1)[:, None, :]
    # one axis for the whole surface if it is nowhere a normal: neighbours agree, and so do changed
    # shapes
    common = np.abs(normals).max(axis=0, initial=0.0)
    axes = np.full(m, common.argmin()) if common.min() < STEEP else np.abs(normals).argmin(axis=1)
    axis = np.zeros((m, 3))
    axis[np.arange(m), axes] = 1.0
    first = axis - (axis * normals).sum(axis=1)[:, None] * normals
    first /= np.linalg.norm(first, axis=1)[:, None]
    return np.stack([first, np.cross(normals, first)], axis=1)


def tangential_rows(matrix: csr_matrix, normals: np.ndarray, tangents: np.ndarray) -> csr_matrix:
    """Rows of B along k tangents instead of their normals, (m k, N).

    Args:
        matrix: rows of B along the normals, (m, N).
        normals: normal of each row, (m, dim).
        tangents: tangents of each row, (m, k, dim).

    Raises:
        SceneError: for rows that are not along a single normal, as sum_j w_j n·u_j is.
    """
    m, dim = normals.shape
    coo = matrix.tocoo()
    node, component = np.divmod(coo.col, dim)
    weights = csr_matrix(
        (coo.data * normals[coo.row, component], (coo.row, node)), shape=(m, matrix.shape[1] // dim)
    )
    weights = weights.tocoo()
    columns = weights.col[:, None] * dim + np.arange(dim)

    def along(vectors: np.ndarray) -> csr_matrix:
        entries = weights.data[:, None] * vectors[weights.row]
        rows = np.repeat(weights.row, dim)
        return csr_matrix((entries.ravel(), (rows, columns.ravel())), shape=matrix.shape)

    off = abs(matrix - along(normals))
    if off.nnz and off.max() > NORMAL_DEVIATION * abs(matrix).max():
        raise SceneError(
            "friction needs rows that are along one normal each: those of this pairing are not. "
            "On curved sides of cells of second order take Mortar"
        )
    k = tangents.shape[1]
    stacked = vstack([along(tangents[:, j]) for j in range(k)])
    return csr_matrix(csr_matrix(stacked)[np.arange(m * k).reshape(k, m).T.ravel()])
