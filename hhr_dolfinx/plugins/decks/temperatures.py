"""Fields of temperature as a deck has them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from dolfinx import fem
from dolfinx.mesh import Mesh
from scipy.spatial import cKDTree
from ufl.domain import extract_unique_domain

from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.parameters import Tag

if TYPE_CHECKING:
    from ufl.core.expr import Expr

SAME_MIDPOINT = 1e-6
"""Distance over the size of the body up to which middles of cells of the mesh and of the deck are
the same.
"""


@dataclass(frozen=True)
class DeckTemperatures:
    """Distribution of the temperature of a body in a deck, the ``field`` of a ThermalExpansion.

    It is the change from ``*INITIAL CONDITIONS`` to the end of the last step, divided by the
    largest change of any node of the deck, which is the ``temperature`` of the load: linear in
    cells of second order, nearest to the values at all nodes, and the mean of the corners in those
    of first order, as in CalculiX.

    Attributes:
        path: the deck.
        tag: the body.
        scale: factor of the coordinates, that of the
            :class:`~hhr_dolfinx.geometries.mesh_file.MeshFile`.
    """

    path: Path | str
    tag: Tag
    scale: float = 1.0

    def __call__(self, x: Expr) -> fem.Function:
        """Field at the UFL coordinates ``x``, a function of the mesh that is 0 in other bodies.

        Raises:
            FileContentError: for a file that is no deck.
            SceneError: for a deck without such a body.
        """
        from hhr_dolfinx.plugins.decks.inp_temperatures import distribution

        corners, values = distribution(Path(self.path), self.tag)
        if not len(corners):
            raise SceneError(
                f"deck {self.path} has no body '{self.tag}', whose temperatures are a field"
            )
        domain = extract_unique_domain(x)
        mesh = Mesh(domain.ufl_cargo(), domain)
        space = fem.functionspace(mesh, ("Discontinuous Lagrange", 1))
        cells = space.dofmap.list
        coordinates = space.tabulate_dof_coordinates()[cells] / self.scale  # (cells, corners, 3)
        # by cells, as nodes of several bodies, or at a crack, may coincide
        distance, matched = cKDTree(corners.mean(axis=1)).query(coordinates.mean(axis=1))
        nearest = np.linalg.norm(
            coordinates[:, :, None] - corners[matched][:, None], axis=3
        ).argmin(axis=2)
        field_values = np.where(
            (distance <= SAME_MIDPOINT * np.ptp(corners, axis=(0, 1)).max())[:, None],
            values[matched[:, None], nearest],
            0.0,
        )
        if domain.ufl_coordinate_element().degree == 1:
            space = fem.functionspace(mesh, ("Discontinuous Lagrange", 0))
            cells = space.dofmap.list
            field_values = field_values.mean(axis=1, keepdims=True)
        field = fem.Function(space)
        field.x.array[cells] = field_values
        return field
