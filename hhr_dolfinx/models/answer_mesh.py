"""Mesh and contact surface of a scene as plain arrays, for figures and files of fields."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hhr_dolfinx.errors import NotOfferedError


@dataclass(frozen=True, eq=False)
class AnswerMesh:
    """Mesh, contact conditions and names of a scene, as figures and files of fields need them.

    Attributes:
        points: coordinates of the nodes in the order of the dofs, (n, dim).
        cells: their nodes in the order of VTK, (c, k).
        kind: VTK's number of the kind of cell.
        bodies: body of each cell, as its index in the scene, (c,).
        contact_points: points of the contact conditions, (m, dim).
        slaves: node that carries each condition, (m,).
        contacts: numbers of the conditions of pressures of each contact.
        name: of the scene.
        axisymmetric: True if coordinates are r and z.
        parameters: their names.
        length: unit of lengths, or "".
        stress: unit of stresses, or "".
        von_mises: von Mises' stress of each cell, (c,), of a displacement, (N,), at a point, (P,);
            None if unknown.
    """

    points: np.ndarray
    cells: np.ndarray
    kind: int
    bodies: np.ndarray
    contact_points: np.ndarray
    slaves: np.ndarray
    contacts: tuple[np.ndarray, ...]
    name: str
    axisymmetric: bool
    parameters: tuple[str, ...]
    length: str = ""
    stress: str = ""
    von_mises: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None

    def nodal(self, displacement: np.ndarray) -> np.ndarray:
        """A displacement, (N,), node by node, (n, dim).

        Raises:
            NotOfferedError: for a displacement on another mesh.
        """
        if displacement.size != self.points.size:
            raise NotOfferedError(
                f"the displacement has {displacement.size} dofs and the mesh of '{self.name}' "
                f"{self.points.size}: they are of two scenes or meshes"
            )
        return displacement.reshape(self.points.shape)

    @property
    def pressing(self) -> np.ndarray:
        """Numbers of all conditions of pressures, each once."""
        return np.unique(np.concatenate(self.contacts))
