"""Deformed bodies for pictures: magnified displacements, and surfaces closed where contact presses.

Magnified displacements open or overlap surfaces that touch. A surface that presses is therefore
drawn on the other one: its nodes move along their normal, and the body follows smoothly. So
are press fits, whose bodies overlap by an opening, and not in the mesh.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix, diags
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import cg

from hhr_dolfinx.errors import ParameterError
from hhr_dolfinx.models.answer_mesh import AnswerMesh
from hhr_dolfinx.parameters import is_number

SHIFT = 0.1
"""Limit of drawn displacements, over the extent of the mesh."""
VISIBLE = 5e-4
"""Gaps below this part of the extent of the mesh are not closed: they are thinner than a line."""
FLATTENED = 0.01
"""Limit of the magnified gaps that contact has closed, over the extent of the mesh: else round
surfaces would get spikes, as displacements are magnified and the curvature is not."""
RIGID = 1e-6
"""Part of a row below which its coefficients sum to zero: both surfaces are then in the mesh."""
PRECISE = 1e-4
"""Relative residual of the shifts, far below what a picture shows."""


class Deformed(NamedTuple):
    """Positions of nodes in a picture, (n, dim), and the factor of displacements."""

    points: np.ndarray
    factor: float


@dataclass(frozen=True, eq=False)
class DrawnContact:
    """Contact conditions as pictures need them.

    Attributes:
        rows: contact rows B, (m, n dim).
        undeformed: gaps of undeformed bodies with openings, (m,), in the unit of length.
        pressing: numbers of the conditions of pressures.
        closed: those of them that are closed, (m,) bool.
    """

    rows: csr_matrix
    undeformed: np.ndarray
    pressing: np.ndarray
    closed: np.ndarray


def deformed(
    mesh: AnswerMesh,
    displacement: np.ndarray,
    scale: float | None,
    contact: DrawnContact | None,
) -> Deformed:
    """Positions of the nodes of deformed bodies in a picture.

    Args:
        mesh: the mesh.
        displacement: of the nodes, (n, dim), in the unit of length.
        scale: factor of displacements; None chooses a power of ten from 1 on.
        contact: conditions whose surfaces are closed; None leaves surfaces as they are.

    Raises:
        ParameterError: for a scale that is no number from 0 on.
    """
    if scale is not None and not (is_number(scale) and scale >= 0):
        raise ParameterError(f"scale = {scale!r} must be a number from 0 on, or None")
    pairs = [] if contact is None else _pairs_of(mesh, contact)
    factor = factor_of(mesh, displacement, pairs) if scale is None else float(scale)
    points = mesh.points + factor * displacement
    if not pairs or factor == 0:
        return Deformed(points, factor)
    return Deformed(points + _closing(mesh, factor, pairs), factor)


class _Pair(NamedTuple):
    """A condition between two surfaces of the mesh."""

    slave: int
    normal: np.ndarray  #: of the slave in its row, (dim,)
    drawn: float  #: gap between the undeformed bodies in the mesh
    opening: float  #: gap of undeformed bodies less that in the mesh
    closed: bool


def _pairs_of(mesh: AnswerMesh, contact: DrawnContact) -> list[_Pair]:
    """Conditions of which both surfaces are in the mesh: an obstacle is not drawn."""
    dim = mesh.points.shape[1]
    owner = np.zeros(len(mesh.points), dtype=np.int64)
    owner[mesh.cells.ravel()] = np.repeat(mesh.bodies, mesh.cells.shape[1])
    pairs = []
    for condition in contact.pressing.tolist():
        row = contact.rows[[condition]]
        nodes, axes = np.divmod(row.indices, dim)
        slave = int(mesh.slaves[condition])
        normal = np.zeros(dim)
        total = np.zeros(dim)
        of_slave = owner[nodes] == owner[slave]
        np.add.at(normal, axes[of_slave], row.data[of_slave])
        np.add.at(total, axes, row.data)
        size = np.linalg.norm(normal)
        if size == 0 or np.linalg.norm(total) > RIGID * size:
            continue
        drawn = -float(row.data @ mesh.points[nodes, axes])
        opening = float(contact.undeformed[condition]) - drawn
        pairs.append(_Pair(slave, normal, drawn, opening, bool(contact.closed[condition])))
    return pairs


def factor_of(mesh: AnswerMesh, displacement: np.ndarray, pairs: list[_Pair]) -> float:
    """Power of ten, at least 1, by which displacements stay below a tenth of the mesh.

    Motions of whole bodies count by a third: the mean of each body is subtracted.

    Args:
        mesh: the mesh.
        displacement: displacements of the nodes, (n, dim), in the unit of length.
        pairs: contact conditions between two surfaces of the mesh.
    """
    largest = float(np.linalg.norm(displacement, axis=1).max(initial=0.0)) / 3
    for body in np.unique(mesh.bodies):
        nodes = np.unique(mesh.cells[mesh.bodies == body])
        strained = displacement[nodes] - displacement[nodes].mean(axis=0)
        largest = max(largest, float(np.linalg.norm(strained, axis=1).max(initial=0.0)))
    extent = float(np.ptp(mesh.points, axis=0).max())
    flattened = max((abs(pair.drawn) for pair in pairs if pair.closed), default=0.0)
    limits = [SHIFT * extent / largest] if largest > 0 else []
    limits += [FLATTENED * extent / flattened] if flattened > 0 else []
    return float(max(1.0, 10.0 ** np.floor(np.log10(min(limits))))) if limits else 1.0


def _closing(mesh: AnswerMesh, factor: float, pairs: list[_Pair]) -> np.ndarray:
    """Shifts of all nodes, (n, dim), by which closed conditions have no gap in a picture.

    Openings are drawn as magnified as displacements; of open conditions they alone are.
    """
    extent = float(np.ptp(mesh.points, axis=0).max())
    opened = max(abs(factor * pair.opening) for pair in pairs) >= VISIBLE * extent
    conditions: dict[int, list[tuple[np.ndarray, float]]] = {}
    for pair in pairs:
        if pair.closed or opened:
            shift = -factor * pair.opening + (1 - factor) * pair.drawn * pair.closed
            conditions.setdefault(pair.slave, []).append((pair.normal, shift))
    shifts = np.zeros_like(mesh.points)
    largest = max((abs(t) for at_node in conditions.values() for _, t in at_node), default=0.0)
    if largest < VISIBLE * extent:
        return shifts
    nodes = np.array(list(conditions))
    for node, at_node in conditions.items():
        normals = np.array([normal for normal, _ in at_node])
        shifts[node] = np.linalg.lstsq(normals, np.array([t for _, t in at_node]), rcond=None)[0]
    _follow(mesh, shifts, nodes)
    return shifts


def _follow(mesh: AnswerMesh, shifts: np.ndarray, nodes: np.ndarray) -> None:
    """Spread the shifts of some nodes smoothly over the rest of their bodies, in place."""
    width = mesh.cells.shape[1]
    first = np.repeat(mesh.cells, width, axis=1).ravel()
    second = np.tile(mesh.cells, (1, width)).ravel()
    apart = first != second
    size = len(mesh.points)
    entries = np.ones(apart.sum()), (first[apart], second[apart])
    graph = csr_matrix(coo_matrix(entries, shape=(size, size)))
    label = connected_components(graph, directed=False)[1]
    following = np.isin(label, label[nodes])
    following[nodes] = False
    inner = np.flatnonzero(following)
    if not inner.size:
        return
    laplacian = csr_matrix(diags(np.asarray(graph.sum(axis=1)).ravel()) - graph)[inner]
    matrix = laplacian[:, inner]
    preconditioner = diags(1 / matrix.diagonal())
    right = -(laplacian[:, nodes] @ shifts[nodes])
    for axis, column in enumerate(right.T):
        shifts[inner, axis] = cg(matrix, column, rtol=PRECISE, M=preconditioner)[0]
