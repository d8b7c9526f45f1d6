"""From UFL to arrays at Gauss points: the strain of bodies with a mean dilatation, or of bodies
with laws.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
import ufl
from dolfinx import fem
from petsc4py import PETSc

from hhr_dolfinx import compat
from hhr_dolfinx.forms.elasticity import strain_vector, volume_weight
from hhr_dolfinx.full_order.discrete_space import DiscreteSpace
from hhr_dolfinx.plugins.elasticity.locking import gauss_degree


class CellStrains(NamedTuple):
    """Strain ε = G u at the Gauss points of some cells, Kelvin's notation."""

    gradients: np.ndarray  #: matrix G of each cell, (cells, per_cell, components, dofs of a cell)
    weights: np.ndarray  #: quadrature weight times volume of each Gauss point, (cells, per_cell)
    dofs: np.ndarray  #: local number of each dof of a cell, (cells, dofs of a cell)

    @property
    def per_cell(self) -> int:
        """Gauss points of a cell."""
        return self.weights.shape[1]

    @property
    def components(self) -> int:
        """Components of a strain."""
        return self.gradients.shape[2]

    def element_stiffness(self, tangents: np.ndarray) -> np.ndarray:
        """Element stiffness matrices, (cells, d, d), for tangents H, (gauss_points, components,
        components).
        """
        cells, per_cell, components, d = self.gradients.shape
        moduli = tangents.reshape(cells, per_cell, components, components)
        flux = moduli @ (self.weights[:, :, None, None] * self.gradients)
        rows = per_cell * components
        return self.gradients.reshape(cells, rows, d).transpose(0, 2, 1) @ flux.reshape(
            cells, rows, d
        )


def degree_of(space: DiscreteSpace) -> int:
    """Degree of the rule for strains of bodies that have laws or use a mean dilatation."""
    return gauss_degree(*space.cells_and_order)


def add_stiffness(
    discretisation: DiscreteSpace, matrix: PETSc.Mat, moduli: dict[int, tuple[float, float]]
) -> None:
    """Add the stiffness of bodies with a mean dilatation.

    Each rank adds that of its cells.

    Args:
        discretisation: functions on the mesh of the scene.
        matrix: stiffness to add to.
        moduli: λ and μ of each body by its index.
    """
    bodies = discretisation.cell_bodies()
    cells = np.flatnonzero(np.isin(bodies, list(moduli)))
    operator = tabulated(discretisation, cells)
    of_point = np.repeat(bodies[cells], operator.per_cell)
    identity = np.eye(operator.components)
    unit = np.zeros(operator.components)
    unit[:3] = 1.0
    elastic = np.empty((of_point.size, *identity.shape))
    for index, (lam, mu) in moduli.items():
        elastic[of_point == index] = lam * np.outer(unit, unit) + 2 * mu * identity
    elastic *= gradings(discretisation, moduli, cells).reshape(-1, 1, 1)
    dofs = operator.dofs.astype(PETSc.IntType)
    elements = operator.element_stiffness(elastic).reshape(len(cells), dofs.shape[1] ** 2)
    matrix.setValuesLocalRCV(dofs, dofs, elements, addv=PETSc.InsertMode.ADD)


def gradings(discretisation: DiscreteSpace, places: Iterable[int], cells: np.ndarray) -> np.ndarray:
    """Grading of the moduli of bodies at the Gauss points of cells, (cells, per_cell).

    Args:
        discretisation: functions on the mesh of the scene.
        places: indices of the bodies.
        cells: numbers of the cells on this rank, (cells,).
    """
    mesh = discretisation.mesh
    bodies = discretisation.cell_bodies()[cells]
    points, weights = compat.quadrature(mesh.topology.cell_name(), degree_of(discretisation))
    values = np.ones((len(cells), len(weights)))
    for index in places:
        grading = discretisation.scene.bodies[index].grading
        of_body = np.flatnonzero(bodies == index)
        if grading is not None:
            # a grading that is a number has no mesh
            plain = abs(ufl.JacobianDeterminant(mesh))
            integrands = (grading(ufl.SpatialCoordinate(mesh)) * plain, plain)
            graded, size = (
                compat.jitted(fem.Expression, integrand, points).eval(
                    mesh, cells[of_body].astype(np.int32)
                )
                for integrand in integrands
            )
            values[of_body] = (graded / size).reshape(len(of_body), len(weights))
    return values


def tabulated(discretisation: DiscreteSpace, cells: np.ndarray) -> CellStrains:
    """Strain at the Gauss points of some cells, with local numbers of the dofs. Collective.

    Args:
        discretisation: functions on the mesh of the scene.
        cells: numbers of the cells on this rank, (cells,).
    """
    compat.require_numba()
    mesh = discretisation.mesh
    space = discretisation.space
    hypothesis = discretisation.scene.hypothesis
    cells = cells.astype(np.int32)
    points, weights = compat.quadrature(mesh.topology.cell_name(), degree_of(discretisation))
    table = compat.jitted(
        fem.Expression, strain_vector(ufl.TrialFunction(space), hypothesis), points
    ).eval(mesh, cells)
    measure = volume_weight(mesh, hypothesis) * abs(ufl.JacobianDeterminant(mesh))
    volumes = weights * compat.jitted(fem.Expression, measure, points).eval(mesh, cells).reshape(
        len(cells), len(weights)
    )
    dim = mesh.geometry.dim
    blocks = space.dofmap.list[cells]
    # all sizes are given, since a rank may have no such cell
    of_cell = dim * blocks.shape[1]
    components = 6 if hypothesis == "solid" else 4
    dofs = (dim * blocks[:, :, None] + np.arange(dim)).reshape(len(cells), of_cell).astype(np.int64)
    gradients = np.ascontiguousarray(table.reshape(len(cells), len(weights), components, of_cell))
    mean = np.flatnonzero(
        np.array(discretisation.mean_dilatation)[discretisation.cell_bodies()[cells]]
    )
    gradients[mean] = _with_mean_dilatation(gradients[mean], volumes[mean])
    return CellStrains(gradients, volumes, dofs)


def _with_mean_dilatation(gradients: np.ndarray, volumes: np.ndarray) -> np.ndarray:
    """B-bar: replace the trace of the strain, see :class:`CellStrains`, by its mean over the volume
    of the cell.
    """
    trace = gradients[:, :, :3].sum(axis=2)
    shares = volumes / volumes.sum(axis=1, keepdims=True)
    mean = np.einsum("cq,cqk->ck", shares, trace)
    changed = gradients.copy()
    changed[:, :, :3] += (mean[:, None] - trace)[:, :, None] / 3
    return changed
