"""Our own stiffness as blocks beside those of other codes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from mpi4py import MPI
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import splu

from hhr_dolfinx.errors import NotOfferedError
from hhr_dolfinx.full_order.discretisation import Discretisation
from hhr_dolfinx.parameters import Tag
from hhr_dolfinx.plugins.foreign.block import ForeignBlock
from hhr_dolfinx.plugins.foreign.case import SolvedCase
from hhr_dolfinx.plugins.foreign.faces import Faces
from hhr_dolfinx.plugins.foreign.matrix import ForeignMatrix
from hhr_dolfinx.plugins.foreign.nodes import ForeignNodes
from hhr_dolfinx.scene import Scene

CIRCULAR = [0, 1, 3, 2]
"""Corners of a quadrilateral in circular order."""


NAMING = "tag", "place", "slave", "master", "follower", "leader"
"""Fields of displacements, loads and constraints that name surfaces."""


def blocks_of_scene(scene: Scene) -> tuple[ForeignBlock, ...]:
    """The bodies of a scene in space as blocks: K with all of its dofs, and the surfaces that the
    scene names.

    Args:
        scene: scene with elastic bodies of first order and constant moduli; its contacts, loads and
            displacements give names of surfaces alone.

    Returns:
        A block for each body, ``body_TAG``, with a load case that our factors have solved; nodes
        have the numbers of our dofs, from 1 on.

    Raises:
        NotOfferedError: for scenes in the plane, of second order, or with laws or moduli that vary.
    """
    varies = any(body.varies or body.law is not None for body in scene.bodies)
    if scene.hypothesis != "solid" or varies or scene.shapes or scene.system is not None:
        raise NotOfferedError(
            f"scene '{scene.name}' makes no blocks: a block is a constant K in space, of elastic "
            "bodies; laws, moduli and "
            "shapes that vary act in elements, which K no longer has"
        )
    discretisation = Discretisation(
        replace(scene, loads=(), constraints=(), openings=(), outputs=()), MPI.COMM_SELF
    )
    if discretisation.order > 1:
        raise NotOfferedError(
            f"scene '{scene.name}' has cells of second order, whose faces no block of ours has yet"
        )
    stiffness = discretisation.stiffness_terms()[0][0]
    bodies = discretisation.cell_bodies()
    cells = discretisation._cell_nodes()
    surfaces = {str(tag): _faces(discretisation, tag) for tag in dict.fromkeys(_tags(scene))}
    return tuple(
        _block(
            stiffness,
            discretisation._points(),
            np.unique(cells[bodies == number]),
            surfaces,
            f"body_{body.tag}",
        )
        for number, body in enumerate(scene.bodies)
    )


def _block(
    stiffness: csr_matrix,
    points: np.ndarray,
    nodes: np.ndarray,
    surfaces: dict[str, Faces],
    name: str,
) -> ForeignBlock:
    """The block of some nodes."""
    numbers = np.full(len(points), -1)
    numbers[nodes] = np.arange(nodes.size)
    dofs = (3 * nodes[:, None] + np.arange(3)).ravel()
    labels = np.repeat(nodes + 1, 3)
    matrix = ForeignMatrix(
        csr_matrix(stiffness[dofs][:, dofs]), labels, np.tile([1, 2, 3], nodes.size), name
    )
    faces_of_block = {
        tag: Faces(tuple(numbers[group] for group in faces.nodes), faces.inner)
        for tag, faces in surfaces.items()
        if (numbers[faces.members] >= 0).all()
    }
    where = ForeignNodes(nodes + 1, points[nodes], faces_of_block)
    return ForeignBlock(matrix, where, case=_case(matrix, where), name=name)


def _tags(scene: Scene) -> Iterator[Tag]:
    """Tags of surfaces that a scene names."""
    for contact in scene.contacts:
        yield from contact.tags
    for item in (*scene.displacements, *scene.loads, *scene.constraints):
        tags = [getattr(item, name, None) for name in NAMING]
        yield from (tag for tag in tags if isinstance(tag, int | str))
        if isinstance(section := getattr(item, "section", None), str):
            yield from (section, f"{section}_other")


def _faces(made: Discretisation, tag: Tag) -> Faces:
    """Faces of a surface, in circular order."""
    surface = made.surface(tag)
    facets = surface.nodes[surface.facets]
    facets = facets[:, CIRCULAR] if facets.shape[1] == 4 else facets
    inner = surface.corners.mean(axis=1) - surface.depths[:, None] * surface.outward
    return Faces((facets.astype(np.int64),), (inner,))


def _case(matrix: ForeignMatrix, nodes: ForeignNodes) -> SolvedCase:
    """Displacements by a force on a node of each connected part, which three of its nodes hold."""
    points = nodes.points
    _, of_dofs = connected_components(matrix.matrix, directed=False)
    held: set[int] = set()
    loaded = []
    for part in np.unique(of_dofs):
        members = np.unique(np.flatnonzero(of_dofs == part) // 3)
        ends, node = _ends(points, members)
        held |= ends
        loaded.append(node)
    free = np.setdiff1d(np.arange(len(points)), sorted(held))
    dofs = (3 * free[:, None] + np.arange(3)).ravel()
    forces = np.zeros((len(points), 3))
    forces[loaded] = 1.0
    displacement = np.zeros(3 * len(points))
    displacement[dofs] = splu(matrix.matrix[dofs][:, dofs].tocsc()).solve(forces.ravel()[dofs])
    labels = nodes.labels.tolist()
    return SolvedCase(
        {labels[node]: (1.0, 1.0, 1.0) for node in loaded},
        {
            label: (x, y, z)
            for label, (x, y, z) in zip(labels, displacement.reshape(-1, 3).tolist(), strict=True)
        },
        frozenset((labels[k], direction) for k in held for direction in (1, 2, 3)),
        tolerance=1e-8,
    )


def _ends(points: np.ndarray, members: np.ndarray) -> tuple[set[int], int]:
    """Three nodes of a part that hold it, and one far from them.

    They are a corner, the node farthest from it, and that farthest from the line of both: no turn
    about a line is left.
    """
    own = points[members]
    corner = int(own.sum(axis=1).argmin())
    lengths = np.linalg.norm(own - own[corner], axis=1)
    opposite = int(lengths.argmax())
    line = (own[opposite] - own[corner]) / lengths[opposite]
    off_line = np.linalg.norm(np.cross(own - own[corner], line), axis=1)
    ends = sorted({corner, opposite, int(off_line.argmax())})
    away = np.linalg.norm(own[:, None] - own[ends], axis=2).min(axis=1)
    return {int(members[k]) for k in ends}, int(members[away.argmax()])
