"""Bodies that imposed displacements do not hold."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components

from hhr_dolfinx import registry
from hhr_dolfinx.errors import rounded

if TYPE_CHECKING:
    from hhr_dolfinx.contact.problem import ContactProblem
    from hhr_dolfinx.scene import Scene

ALMOST_NONE = 1e-9
"""Part of the largest effect of a motion, or of a load, up to which it is round-off."""


@dataclass(frozen=True)
class FreeBody:
    """A connected component with rigid-body motions."""

    name: str  #: of its bodies, for messages
    nodes: np.ndarray
    motions: np.ndarray  #: all of its rigid motions, (k, nodes, dim), see :func:`rigid_motions`
    #: motions that supports and constraints leave: orthonormal combinations of all of them, (l, k)
    left: np.ndarray

    def columns(self, count: int) -> np.ndarray:
        """The remaining motions on all nodes, (nodes dim, l)."""
        fields = np.zeros((len(self.left), count, self.motions.shape[2]))
        fields[:, self.nodes] = np.tensordot(self.left, self.motions, 1)
        return fields.reshape(len(self.left), -1).T

    def described(self, ways: np.ndarray) -> str:
        """Description of combinations of its motions, (n, k): along axes, along directions, or
        rotations.
        """
        shifts = self.motions.shape[2]
        if len(self.motions) == 1:
            return "moves along axis 1"
        along = [axis for axis in range(shifts) if np.linalg.norm(ways[:, axis]) > 1 - 1e-6]
        phrases = [f"moves along axis {axis}" for axis in along]
        if len(ways) > len(along):
            turning = np.linalg.norm(ways[:, shifts:]) > 1e-6 * np.linalg.norm(ways)
            phrases.append(
                "turns" if turning else f"moves along {rounded(np.round(ways[0, :shifts], 3))}"
            )
        return ", ".join(phrases)


def free_bodies(
    scene: Scene, problem: ContactProblem, bodies: np.ndarray, springs: np.ndarray | None = None
) -> list[FreeBody]:
    """Bodies with rigid motions that vanish on their imposed dofs and break no constraint.

    Bodies that constraints join are found by the plug-in of constraints, its tool
    ``joined_bodies``: a function ``(components, prolongation, points, imposed, hypothesis)`` of all
    components with all of their motions, and a mask of imposed dofs, (nodes, dim), which returns
    the joined ones with the motions that are left.

    Args:
        scene: the scene.
        problem: its contact problem.
        bodies: body of each cell as its index in the scene, (cells,).
        springs: stiffness to ground of each dof, (N,); None without springs.

    Raises:
        NotOfferedError: if constraints join bodies, and no installed plug-in reads them.
    """
    points = problem.points
    cell_nodes = problem.cell_nodes
    prolongation = problem.prolongation
    free = prolongation.movable if springs is None else prolongation.movable & (springs == 0)
    label = components_of_nodes(len(points), cell_nodes)
    imposed = ~free.reshape(points.shape)
    components = []
    for number in np.unique(label[cell_nodes[:, 0]]):
        nodes = np.flatnonzero(label == number)
        motions = rigid_motions(points[nodes], scene.hypothesis)
        tags = sorted({str(scene.bodies[k].tag) for k in bodies[label[cell_nodes[:, 0]] == number]})
        name = (
            f"body {', '.join(tags)} of scene '{scene.name}', around "
            f"{rounded(points[nodes].mean(axis=0))},"
        )
        components.append(FreeBody(name, nodes, motions, np.eye(len(motions))))
    if prolongation.map is None:
        remaining = [
            replace(component, left=vanishing(component.motions[:, imposed[component.nodes]].T))
            for component in components
        ]
    else:
        request = f"scene '{scene.name}', whose bodies constraints join,"
        remaining = registry.tool("joined_bodies", request)(
            components, prolongation, points, imposed, scene.hypothesis
        )
    return [component for component in remaining if len(component.left)]


def vanishing(rows: np.ndarray) -> np.ndarray:
    """Orthonormal combinations, (l, k), of columns, (n, k) of size 1, on which rows vanish."""
    # rows of zeros give all of the k singular vectors, also for less than k rows
    _, sizes, ways = np.linalg.svd(
        np.vstack([rows, np.zeros((rows.shape[1],) * 2)]), full_matrices=False
    )
    return ways[sizes <= ALMOST_NONE * np.sqrt(max(len(rows), 1))]


def components_of_nodes(count: int, cell_nodes: np.ndarray) -> np.ndarray:
    """Connected component of each node, by the cells that join nodes, (nodes,).

    Args:
        count: number of nodes.
        cell_nodes: nodes of each cell, (cells, n).
    """
    starts = np.repeat(cell_nodes[:, :1], cell_nodes.shape[1], axis=1)
    graph = csr_matrix(
        (np.ones(cell_nodes.size), (starts.ravel(), cell_nodes.ravel())), shape=(count, count)
    )
    return connected_components(graph, directed=False)[1]


def rigid_motions(points: np.ndarray, hypothesis: str) -> np.ndarray:
    """Motions without strain, (motions, nodes, dim).

    Translations come first, then rotations scaled by the size of the body.

    Args:
        points: coordinates of the nodes, (nodes, dim).
        hypothesis: hypothesis of the scene.
    """
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
