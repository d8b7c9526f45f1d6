"""Rows of a foreign K on nodes with three dofs each: displacements, then rotations, then dofs
without a place.

A problem has three dofs at each node. Rotations of a node are three dofs of another node. Dofs of
the other code alone, such as incompatible modes, are eliminated exactly if few of them are coupled
(those of an element are); others become nodes too. Nodes of both kinds lie far away from the block.
Dofs that K lacks are not free.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components

from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.plugins.foreign.faces import Faces
from hhr_dolfinx.plugins.foreign.matrix import ForeignMatrix
from hhr_dolfinx.plugins.foreign.nodes import ForeignNodes

AWAY = 100.0
"""Distance of nodes without a place over the size of their block: no output that names a place
finds them.
"""
MOST_ELIMINATED = 60
"""Number of coupled dofs without a place up to which they are eliminated: an element has up to
39.
"""


@dataclass(frozen=True, eq=False)
class Placed:
    """A block on nodes with three dofs each.

    Attributes:
        matrix: K of all dofs, (3 n, 3 n), zero in rows that the other code left out.
        known: dofs that K has, (3 n,) bool.
        nodes: nodes with places, the first ones.
        points: coordinates of all nodes, (n, 3); of those without a place far away.
        turning: node whose dofs are the rotations of each node with a place, -1 without, (p,).
        source: name of the file of K.
    """

    matrix: csr_matrix
    known: np.ndarray
    nodes: ForeignNodes
    points: np.ndarray
    turning: np.ndarray
    source: str

    @property
    def motions(self) -> np.ndarray:
        """Rigid motions of all dofs, (6, 3 n): translations and rotations about the origin of
        coordinates.

        Dofs without a place follow the others without force.
        """
        count = len(self.points)
        by_node = np.zeros((6, count, 3))
        placed = len(self.nodes.labels)
        turned = np.flatnonzero(self.turning >= 0)
        for axis in range(3):
            by_node[axis, :placed, axis] = 1.0
            way = np.eye(3)[axis]
            by_node[3 + axis, :placed] = np.cross(way, self.points[:placed])
            by_node[3 + axis, self.turning[turned]] = way
        motions = by_node.reshape(6, -1)
        hidden = np.zeros(3 * count, dtype=bool)
        hidden[3 * (placed + turned.size) :] = True
        hidden &= self.known
        if hidden.any():
            motions[:, hidden] = self._followed(motions, hidden)
        return motions

    def _followed(self, motions: np.ndarray, hidden: np.ndarray) -> np.ndarray:
        """Values of dofs without a place for motions of the others, (6, h)."""
        from scipy.sparse.linalg import splu

        rows = self.matrix[hidden]
        pull = rows[:, ~hidden] @ motions[:, ~hidden].T
        return -splu(rows[:, hidden].tocsc()).solve(np.asarray(pull)).T


def placed(given: ForeignMatrix, nodes: ForeignNodes) -> Placed:
    """Rows of a matrix on the nodes of its block.

    Args:
        given: checked matrix.
        nodes: nodes beside it; of a superelement those without rows are left out.

    Raises:
        SceneError: if no row is a displacement of a node.
    """
    nodes = _retained(nodes, given) if given.superelement else nodes
    dofs = _places(given, nodes)
    if not (dofs >= 0).any():
        raise SceneError(
            f"no row of {given.source} is a dof of the {len(nodes.labels)} nodes beside it: rows "
            "are of nodes "
            f"{given.nodes.min()} to {given.nodes.max()}, and these have labels "
            f"{nodes.labels.min()} to "
            f"{nodes.labels.max()}. Give the nodes of the same run"
        )
    matrix, dofs = _without_inner(given.matrix, dofs)
    count = len(nodes.labels)
    turned = np.unique(dofs[dofs >= 3 * count] // 3) - count
    turning = np.full(count, -1)
    turning[turned] = count + np.arange(turned.size)
    rotation = dofs >= 3 * count
    where = np.where(
        rotation, 3 * turning[np.where(rotation, dofs // 3 - count, 0)] + dofs % 3, dofs
    )
    unplaced = np.flatnonzero(dofs < 0)
    where[unplaced] = 3 * (count + turned.size) + np.arange(unplaced.size)
    total = count + turned.size + -(-unplaced.size // 3)
    entries = matrix.tocoo()
    expanded = csr_matrix(
        (entries.data, (where[entries.row], where[entries.col])), shape=(3 * total, 3 * total)
    )
    has_row = np.zeros(3 * total, dtype=bool)
    has_row[where] = True
    away = np.full(
        (total - count, 3),
        nodes.points.mean(axis=0) + AWAY * (np.ptp(nodes.points, axis=0).max() or 1.0),
    )
    return Placed(expanded, has_row, nodes, np.vstack([nodes.points, away]), turning, given.source)


def _places(given: ForeignMatrix, nodes: ForeignNodes) -> np.ndarray:
    """Dof of each row: 3 n + direction for displacements of node n, 3 (p + n) + direction for
    rotations, else -1.
    """
    count = len(nodes.labels)
    direction = given.directions - 1
    dofs = np.full(len(given.nodes), -1, dtype=np.int64)
    if given.sequence and nodes.original is not None:
        index = _in_sequence(given, nodes)
    else:
        order = np.argsort(nodes.labels)
        at = np.searchsorted(nodes.labels, given.nodes, sorter=order)
        at = order[np.minimum(at, count - 1)]
        index = np.where(nodes.labels[at] == given.nodes, at, -1)
    valid = (index >= 0) & (direction >= 0)
    turn = direction >= 3
    dofs[valid] = 3 * (index + count * turn)[valid] + (direction - 3 * turn)[valid]
    return dofs


def _in_sequence(given: ForeignMatrix, nodes: ForeignNodes) -> np.ndarray:
    """Node of each row, (rows,), where a label stands for several nodes in ascending order; -1 if
    that is ambiguous.

    Of a label with a row for each of its nodes in some direction the rows are theirs in turn. Where
    an MPC or a support has removed some of them, nobody says which ones are left: these have no
    place.
    """
    index = np.full(len(given.nodes), -1)
    nodes_by_label: dict[int, list[int]] = {}
    for k in np.argsort(nodes.labels, kind="stable"):
        nodes_by_label.setdefault(int(nodes.decks[k]), []).append(int(k))
    rows: dict[tuple[int, int], list[int]] = {}
    for row, key in enumerate(zip(given.nodes.tolist(), given.directions.tolist(), strict=True)):
        rows.setdefault(key, []).append(row)
    for (label, direction), rows_of_dof in rows.items():
        nodes_of = nodes_by_label.get(label, [])
        if direction <= 3 and len(rows_of_dof) == len(nodes_of):
            index[rows_of_dof] = nodes_of
    return index


def _retained(nodes: ForeignNodes, given: ForeignMatrix) -> ForeignNodes:
    """Nodes that have rows, with the faces and sets that they make."""
    retained = np.flatnonzero(np.isin(nodes.labels, given.nodes))
    number = np.full(len(nodes.labels), -1)
    number[retained] = np.arange(retained.size)

    def of(faces: Faces) -> Faces | None:
        held = [(number[group] >= 0).all(axis=1) for group in faces.nodes]
        pairs = [
            (number[group[complete]], inner_points[complete])
            for group, inner_points, complete in zip(faces.nodes, faces.inner, held, strict=True)
            if complete.any()
        ]
        return (
            Faces(
                tuple(group for group, _ in pairs), tuple(inner_points for _, inner_points in pairs)
            )
            if pairs
            else None
        )

    surfaces = {
        name: restricted
        for name, faces in nodes.surfaces.items()
        if (restricted := of(faces)) is not None
    }
    sets = {name: number[members][number[members] >= 0] for name, members in nodes.sets.items()}
    outer = None if nodes.outer is None else of(nodes.outer)
    labels = nodes.labels[retained]
    points = nodes.points[retained]
    return ForeignNodes(
        labels,
        points,
        surfaces,
        {name: members for name, members in sets.items() if members.size},
        outer=outer,
    )


def _without_inner(matrix: csr_matrix, place: np.ndarray) -> tuple[csr_matrix, np.ndarray]:
    """K and places without small groups of coupled dofs that have no place: K_oo - K_oi K_ii^-1
    K_io.
    """
    inner = np.flatnonzero(place < 0)
    if not inner.size:
        return matrix, place
    inner_stiffness = matrix[inner][:, inner]
    _, label = connected_components(inner_stiffness, directed=False)
    sizes = np.bincount(label)
    gone = inner[sizes[label] <= MOST_ELIMINATED]
    if not gone.size:
        return matrix, place
    remaining = np.setdiff1d(np.arange(len(place)), gone)
    inverse = _inverse_of_blocks(matrix[gone][:, gone].tocsr())
    coupling = matrix[gone][:, remaining].tocsr()
    outer = matrix[remaining][:, remaining] - coupling.T @ (inverse @ coupling)
    return csr_matrix((outer + outer.T) / 2), place[remaining]


def _inverse_of_blocks(matrix: csr_matrix) -> csr_matrix:
    """Inverse of a symmetric matrix of small blocks, sparse."""
    count, label = connected_components(matrix, directed=False)
    order = np.argsort(label, kind="stable")
    starts = np.concatenate([[0], np.cumsum(np.bincount(label, minlength=count))])
    rows = []
    columns = []
    values = []
    for first, last in pairwise(starts.tolist()):
        members = order[first:last]
        block = np.linalg.inv(matrix[members][:, members].toarray())
        rows.append(np.repeat(members, members.size))
        columns.append(np.tile(members, members.size))
        values.append(block.ravel())
    entries = np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))
    return csr_matrix(entries, shape=matrix.shape)
