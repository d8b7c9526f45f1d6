"""Stress at nodes: means over the cells of a body around each node, weighted by their volumes.

Stress of cells jumps between them, so that pictures of it look chequered. The means are the lumped
L2 projection on continuous functions, body by body: bodies in contact keep their jump.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, cast

import numpy as np

from hhr_dolfinx.errors import NotOfferedError
from hhr_dolfinx.models.answer import Answer, Meshed
from hhr_dolfinx.models.answer_mesh import AnswerMesh
from hhr_dolfinx.plugins.plots.cell_kinds import (
    CORNERS_OF_KIND,
    HEXAHEDRON_KINDS,
    TETRAHEDRON_KINDS,
)
from hhr_dolfinx.plugins.plots.contact_fields import is_full
from hhr_dolfinx.plugins.plots.surface_fields import SurfaceFields, displacement_seen

if TYPE_CHECKING:
    from hhr_dolfinx.plugins.pages.beside import MeshBeside

_AXES_OF_HEXAHEDRON = np.array(
    [
        [-1, 1, 1, -1, -1, 1, 1, -1],
        [-1, -1, 1, 1, -1, -1, 1, 1],
        [-1, -1, -1, -1, 1, 1, 1, 1],
    ]
)
"""Signs of the corners of a hexahedron along its three axes, in the order of VTK."""


def cell_volumes(mesh: AnswerMesh) -> np.ndarray:
    """Volumes of the cells, (c,), areas in the plane; those of hexahedra by their mean edges.

    >>> import numpy as np
    >>> points = np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 1.0], [0.0, 1.0]])
    >>> one = (np.zeros(0, dtype=int),)
    >>> mesh = AnswerMesh(points, np.array([[0, 1, 2, 3]]), 9, np.zeros(1, dtype=int), points[:0],
    ...                   one[0], one, "square", False, ())
    >>> cell_volumes(mesh)
    array([2.])
    """
    corners = mesh.points[mesh.cells[:, : CORNERS_OF_KIND[mesh.kind]]]
    if mesh.kind in HEXAHEDRON_KINDS:
        edges = np.einsum("ak,ckd->cad", _AXES_OF_HEXAHEDRON, corners) / 4
        return np.abs(np.linalg.det(edges))
    if mesh.kind in TETRAHEDRON_KINDS:
        return np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])) / 6
    x, y = np.moveaxis(corners, 2, 0)
    areas = (x * np.roll(y, -1, axis=1) - np.roll(x, -1, axis=1) * y).sum(axis=1) / 2
    return np.abs(areas)


@dataclass(frozen=True, eq=False)
class StressSamples:
    """Stress of cells, or of the triangles of the surface of bodies in space.

    Attributes:
        elements: nodes of each sample, (e, k).
        weights: their volumes, areas of triangles, (e,).
        bodies: body of each, as its index in the scene, (e,).
        stress: stress in Kelvin's notation in the unit of stress, (e, 4), in space (e, 6).
        deviators: True if only deviators are known, from which von Mises' stress follows.
    """

    elements: np.ndarray
    weights: np.ndarray
    bodies: np.ndarray
    stress: np.ndarray
    deviators: bool = False

    def at_nodes(self, body: int, size: int) -> np.ndarray:
        """Weighted means at the nodes of a body.

        Args:
            body: index of the body in the scene.
            size: number of all nodes.

        Returns:
            Stress, (size, components); NaN at nodes without a sample of the body.
        """
        of_body = self.bodies == body
        weights = np.zeros(size)
        sums = np.zeros((size, self.stress.shape[1]))
        weighted = self.weights[of_body, None] * self.stress[of_body]
        for column in self.elements[of_body].T:
            np.add.at(weights, column, self.weights[of_body])
            np.add.at(sums, column, weighted)
        with np.errstate(invalid="ignore"):
            return sums / weights[:, None]


def stress_of_cells(meshed: Meshed, answer: Answer) -> np.ndarray | None:
    """Mean stress of each cell, Kelvin's notation, (cells, components); None without strains.

    K of another code and a model from a file know none.

    Args:
        meshed: the full model, or the mesh beside a model file.
        answer: answer of any model of the scene.
    """
    full = meshed if is_full(meshed) else None
    if full is not None and not full.discretisation.has_mesh:
        return None
    if full is not None and full.equilibrium is None:
        if isinstance(answer.fields, SurfaceFields):
            return None
        stress = full.stress_of(answer.displacement(), answer.parameter)
    else:
        try:
            stress = answer.stress()
        except NotOfferedError:
            if full is not None:
                raise
            return None
    count = len(meshed.answer_mesh().cells)
    mean: np.ndarray = stress.reshape(count, -1, stress.shape[-1]).mean(axis=1)
    return mean


def stress_samples(meshed: Meshed, answer: Answer) -> StressSamples | None:
    """Stress of an answer on its mesh; None if neither the model nor the file beside it has it.

    Args:
        meshed: the full model, or the mesh beside a model file.
        answer: answer of any model of the scene.
    """
    mesh = meshed.answer_mesh()
    stress = stress_of_cells(meshed, answer)
    if stress is not None:
        return StressSamples(mesh.cells, cell_volumes(mesh), mesh.bodies, stress)
    if is_full(meshed):
        return None
    beside = cast("MeshBeside", meshed)
    arrays = beside.deviators(displacement_seen(answer), answer.parameter)
    if arrays is None:
        return None
    elements, areas, bodies, tensors = arrays
    weights = cell_volumes(mesh) if areas is None else areas
    return StressSamples(elements, weights, bodies, tensors, deviators=True)
