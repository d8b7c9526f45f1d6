"""Bodies that imposed displacements do not hold, and rigid motions of whole bodies as lifts.

A body whose imposed displacements are those of a rigid motion is lifted as a whole, so that its lift has no strain. The
lift of the thesis is nonzero on the imposed dofs alone (section 2.6), and K lift is a load. If K depends on
parameters so does that load, and it is far larger than any force on the body: interpolated between parameters its
terms cancel, and so do the energies in bounds. If the imposed values are those of a rigid motion, as for a block that
is pressed down by its top, that motion of the whole body has these values too, and K is zero along it for any moduli.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.sparse import csc_matrix, csr_matrix, hstack
from scipy.sparse.csgraph import connected_components

from hhr_dolfinx.contact.prolongation import Prolongation
from hhr_dolfinx.errors import rounded

if TYPE_CHECKING:
    from hhr_dolfinx.scene import Scene

if TYPE_CHECKING:
    from hhr_dolfinx.contact.problem import ContactProblem

ALMOST_NONE = 1e-9
"""Part of the largest effect of a motion, or of a load, up to which it is round-off."""
ROUND_OFF_OF_ENERGY = 1e-13
"""Part of the sum of all terms of the energy of a motion up to which it is round-off."""
ALIKE = 1e-10
"""Relative difference from imposed values up to which a rigid motion has the same values."""


@dataclass(frozen=True)
class FreeBody:
    """A connected component with rigid-body motions, or several that constraints join."""

    name: str  # of its bodies, for messages
    nodes: np.ndarray
    motions: np.ndarray  # all of its rigid motions, (k, nodes, dim), see :func:`rigid_motions`
    left: np.ndarray  # motions that supports and constraints leave: orthonormal combinations of all of them, (l, k)
    parts: tuple[FreeBody, ...] = ()  # joined components with all of their motions, in the order of the motions

    def columns(self, count: int) -> np.ndarray:
        """The remaining motions on all nodes, (nodes dim, l)."""
        found = np.zeros((len(self.left), count, self.motions.shape[2]))
        found[:, self.nodes] = np.tensordot(self.left, self.motions, 1)
        return found.reshape(len(self.left), -1).T


def free_bodies(
    scene: Scene, problem: ContactProblem, bodies: np.ndarray, springs: np.ndarray | None = None
) -> list[FreeBody]:
    """Bodies with rigid motions that vanish on their imposed dofs and break no constraint.

    ``bodies`` is the index in the scene of the body of each cell, (cells,), and ``springs`` the stiffness to ground of
    each dof, (N,).
    """
    points = problem.points
    cell_nodes = problem.cell_nodes
    prolongation = problem.prolongation
    free = prolongation.movable if springs is None else prolongation.movable & (springs == 0)
    part = components_of_nodes(len(points), cell_nodes)
    imposed = ~free.reshape(points.shape)
    components = []
    for number in np.unique(part[cell_nodes[:, 0]]):
        nodes = np.flatnonzero(part == number)
        motions = rigid_motions(points[nodes], scene.hypothesis)
        tags = sorted({str(scene.bodies[k].tag) for k in bodies[part[cell_nodes[:, 0]] == number]})
        name = f"body {', '.join(tags)} of scene '{scene.name}', around {rounded(points[nodes].mean(axis=0))},"
        components.append(FreeBody(name, nodes, motions, np.eye(len(motions))))
    if prolongation.map is None:
        left = (replace(one, left=_kernel(one.motions[:, imposed[one.nodes]].T)) for one in components)
        return [one for one in left if len(one.left)]
    groups = _groups(components, prolongation.map, points)
    joined = (_joined(group, prolongation, points, imposed, scene.hypothesis) for group in groups)
    return [one for one in joined if len(one.left)]


def unresisted(bodies: list[FreeBody], problem: ContactProblem, stiffness: csr_matrix) -> list[FreeBody]:
    """Bodies with the motions along which a stiffness, local rows (own, N), does no work."""
    left = []
    for body in bodies:
        columns = body.columns(len(problem.points))
        own = columns[problem.rows]
        sizes = problem.spread.sum(abs(own).T @ (abs(stiffness) @ abs(columns)))
        energies = problem.spread.sum(own.T @ (stiffness @ columns))
        values, ways = np.linalg.eigh((energies + energies.T) / 2)
        ways = ways[:, np.abs(values) <= ROUND_OFF_OF_ENERGY * sizes.max()]
        left.append(replace(body, left=ways.T @ body.left))
    return [body for body in left if len(body.left)]


def _kernel(rows: np.ndarray) -> np.ndarray:
    """Orthonormal combinations, (l, k), of columns, (n, k) of size 1, on which rows vanish."""
    # rows of zeros give all of the k singular vectors, also for less than k rows
    _, sizes, ways = np.linalg.svd(np.vstack([rows, np.zeros((rows.shape[1],) * 2)]), full_matrices=False)
    return ways[sizes <= ALMOST_NONE * np.sqrt(max(len(rows), 1))]


def _groups(components: list[FreeBody], coupling: csr_matrix, points: np.ndarray) -> list[list[FreeBody]]:
    """Components that constraints join."""
    owner = np.full(len(points), -1)
    for number, one in enumerate(components):
        owner[one.nodes] = number
    rows, columns = (owner[dofs // points.shape[1]] for dofs in coupling.nonzero())
    graph = csr_matrix((np.ones(rows.size), (rows, columns)), shape=(len(components),) * 2)
    labels = connected_components(graph, directed=False)[1]
    return [[components[k] for k in np.flatnonzero(labels == label)] for label in np.unique(labels)]


def _joined(
    parts: list[FreeBody], prolongation: Prolongation, points: np.ndarray, imposed: np.ndarray, hypothesis: str
) -> FreeBody:
    """One body of several components, whose motions satisfy the constraints.

    They are those of the body as a whole, unless constraints let its parts move in more ways, as a hinge does.
    """
    nodes = np.sort(np.concatenate([one.nodes for one in parts]))
    motions = rigid_motions(points[nodes], hypothesis)
    body = FreeBody(" with ".join(one.name for one in parts), nodes, motions, np.eye(len(motions)))
    whole, apart = (np.hstack([one.columns(len(points)) for one in group]) for group in ([body], parts))
    # combinations that vanish on imposed dofs and break no constraint
    held = imposed.ravel()
    of_whole, of_parts = (_kernel(np.vstack([one[held], prolongation.broken(one)])) for one in (whole, apart))
    if len(of_parts) > len(of_whole):
        return replace(body, parts=tuple(parts), motions=_at_nodes(apart, points, nodes), left=of_parts)
    return replace(body, motions=_at_nodes(whole, points, nodes), left=of_whole)


def _at_nodes(columns: np.ndarray, points: np.ndarray, nodes: np.ndarray) -> np.ndarray:
    """Motions on all nodes, (nodes dim, k), at some nodes: (k, n, dim)."""
    return columns.T.reshape(-1, *points.shape)[:, nodes]


def components_of_nodes(count: int, cell_nodes: np.ndarray) -> np.ndarray:
    """Connected component of each of so many nodes, by cells, (cells, n): (nodes,)."""
    starts = np.repeat(cell_nodes[:, :1], cell_nodes.shape[1], axis=1)
    graph = csr_matrix((np.ones(cell_nodes.size), (starts.ravel(), cell_nodes.ravel())), shape=(count, count))
    return connected_components(graph, directed=False)[1]


def rigid_motions(points: np.ndarray, hypothesis: str) -> np.ndarray:
    """Motions without strain: translations, then rotations scaled by the size of the body, (motions, nodes, dim)."""
    count, dim = points.shape
    if hypothesis == "axisymmetric":
        return np.broadcast_to(np.array([[[0.0, 1.0]]]), (1, count, 2))
    motions = [np.broadcast_to(axis, (count, dim)) for axis in np.eye(dim)]
    away = (points - points.mean(axis=0)) / (np.ptp(points, axis=0).max() or 1.0)
    for first, second in ((0, 1),) if dim == 2 else ((1, 2), (2, 0), (0, 1)):
        turn = np.zeros((count, dim))
        turn[:, first] = -away[:, second]
        turn[:, second] = away[:, first]
        motions.append(turn)
    return np.array(motions)


def described(body: FreeBody, ways: np.ndarray) -> str:
    """Description of combinations of motions of a body, (n, k): along axes, along directions, or rotations."""
    if body.parts:
        ends = np.cumsum([len(part.motions) for part in body.parts])[:-1]
        texts = []
        for part, own in zip(body.parts, np.split(ways, ends, axis=1), strict=True):
            _, sizes, rows = np.linalg.svd(own, full_matrices=False)
            if len(kept := rows[sizes > ALMOST_NONE]):
                texts.append(f"{part.name} {described(part, kept)}")
        return f"moves in parts: {'; '.join(texts)}"
    shifts = body.motions.shape[2]
    if len(body.motions) == 1:
        return "moves along axis 1"
    along = [axis for axis in range(shifts) if np.linalg.norm(ways[:, axis]) > 1 - 1e-6]
    parts = [f"moves along axis {axis}" for axis in along]
    if len(ways) > len(along):
        turning = np.linalg.norm(ways[:, shifts:]) > 1e-6 * np.linalg.norm(ways)
        parts.append("turns" if turning else f"moves along {rounded(np.round(ways[0, :shifts], 3))}")
    return ", ".join(parts)


def rigid_lifts(
    scene: Scene, lifts: csc_matrix, free: np.ndarray, points: np.ndarray, cell_nodes: np.ndarray
) -> csc_matrix:
    """Replace lifts, (N, 1 + T), by rigid motions of whole bodies if these have the imposed values.

    Each term is checked separately: in a body that it moves, the other imposed dofs stay zero. Inelastic bodies and
    bodies with a variable shape keep their lifts. Given ones are nonzero on imposed dofs alone, those that are not
    ``free``, (N,) bool; ``points``, (nodes, dim), and ``cell_nodes``, (cells, n), are those of the mesh.
    """
    if scene.shapes or scene.reader:
        return lifts
    part = components_of_nodes(len(points), cell_nodes)
    found = [lifts[:, [term]] for term in range(lifts.shape[1])]
    imposed = ~free.reshape(points.shape)
    for term in np.flatnonzero(np.diff(lifts.indptr)):
        values = found[term].toarray().reshape(points.shape)
        moving = values.copy()
        for number in np.unique(part[np.any(values, axis=1)]):
            nodes = np.flatnonzero(part == number)
            motions = rigid_motions(points[nodes], scene.hypothesis)
            held = imposed[nodes]
            wanted = values[nodes]
            ways = np.linalg.lstsq(motions[:, held].T, wanted[held], rcond=ALIKE)[0]
            rigid = np.tensordot(ways, motions, 1)
            if np.abs(rigid - wanted)[held].max() > ALIKE * np.abs(wanted).max():
                continue
            rigid[held] = wanted[held]
            moving[nodes] = np.where(np.abs(rigid) > ALIKE * np.abs(rigid).max(), rigid, 0.0)
        found[term] = csc_matrix(moving.reshape(-1, 1))
    return csc_matrix(hstack(found))
