"""From UFL to arrays at Gauss points: the strain, tabulated once, of bodies that flow or are nearly incompressible."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np
import ufl
from dolfinx import fem
from petsc4py import PETSc
from scipy.sparse import csr_matrix

from hhr_dolfinx import compat
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.forms.elasticity import volume_weight
from hhr_dolfinx.forms.return_mapping import strain_vector
from hhr_dolfinx.full_order.locking import QUADRATURE
from hhr_dolfinx.materials.strain import SparsePattern, StrainOperator
from hhr_dolfinx.materials.update import Group, Material
from hhr_dolfinx.scene import Scene

if TYPE_CHECKING:
    from hhr_dolfinx.formulas import Modulus
    from hhr_dolfinx.full_order.discretisation import Discretisation


def strain_operator(discretisation: Discretisation) -> StrainOperator:
    """Strain at the Gauss points of all cells, for bodies that flow; serial."""
    if discretisation.comm.size > 1:
        raise SceneError(
            f"the mesh of scene '{discretisation.scene.name}' is spread over {discretisation.comm.size} ranks, and "
            "bodies that flow are solved on one: give each rank a model on MPI.COMM_SELF, and share the histories out"
        )
    return tabulated(discretisation, np.arange(discretisation.cell_bodies().size))


def material_at(scene: Scene, bodies: np.ndarray, operator: StrainOperator) -> Material:
    """Laws at the Gauss points of the cells of an operator, whose bodies are given as places in the scene, (cells,)."""
    of_point = np.repeat(bodies, operator.per_cell)
    groups = [
        Group(np.flatnonzero(of_point == place), _plain(body.young), float(body.poisson), body.law)
        for place, body in enumerate(scene.bodies)
    ]
    return Material(groups, operator.components, scene.parameters.names)


def _plain(young: float | str) -> float | str:
    return young if isinstance(young, str) else float(young)


def stiffness_parts(
    material: Material, operator: StrainOperator, pattern: SparsePattern
) -> tuple[tuple[csr_matrix, ...], tuple[Modulus, ...]]:
    """Parts of the elastic stiffness, (N, N) each, and their moduli; one part and no modulus where it is constant.

    Bodies with the same formula make one part, those with numbers another.
    """
    formulas = dict.fromkeys(group.young for group in material.groups if isinstance(group.young, str))
    if not formulas:
        return (operator.stiffness(material.elastic, pattern),), ()
    from hhr_dolfinx.formulas import Modulus

    parts, moduli = [], []
    for text in (*formulas, None):
        elastic, acting = np.zeros((material.gauss_points, material.components, material.components)), False
        for group in material.groups:
            if group.young == text or (text is None and not isinstance(group.young, str)):
                young = 1.0 if text is not None else float(group.young)
                alone = Group(np.arange(1), young, group.poisson, None)
                elastic[group.indices] = Material([alone], material.components).elastic[0]
                acting = True
        if acting:
            parts.append(operator.stiffness(elastic, pattern))
            moduli.append(Modulus("1" if text is None else text, "1", material.names))
    return tuple(parts), tuple(moduli)


def add_stiffness(discretisation: Discretisation, matrix: PETSc.Mat) -> None:
    """Add the elastic stiffness of the bodies with a mean dilatation to a matrix, each rank that of its own cells."""
    bodies = discretisation.cell_bodies()
    cells = np.flatnonzero(np.array(discretisation.mean_dilatation)[bodies])
    operator = tabulated(discretisation, cells)
    elastic = material_at(discretisation.scene, bodies[cells], operator).elastic
    dofs = operator.dofs.astype(PETSc.IntType)
    elements = operator.element_stiffness(elastic).reshape(len(cells), dofs.shape[1] ** 2)
    matrix.setValuesLocalRCV(dofs, dofs, elements, addv=PETSc.InsertMode.ADD)


def add_parts(discretisation: Discretisation, matrix: PETSc.Mat, moduli: dict[int, tuple[float, float]]) -> None:
    """Add parts of the stiffness of bodies with a mean dilatation: weights λ' and 2 μ' of each body by its place."""
    bodies = discretisation.cell_bodies()
    cells = np.flatnonzero(np.isin(bodies, list(moduli)))
    operator = tabulated(discretisation, cells)
    unit, identity = np.zeros(operator.components), np.eye(operator.components)
    unit[:3] = 1.0
    tangents = {
        place: volume * np.outer(unit, unit) + 2 * shape * identity for place, (volume, shape) in moduli.items()
    }
    of_point = np.repeat(bodies[cells], operator.per_cell)
    elastic = np.array([tangents[place] for place in of_point]).reshape(-1, *identity.shape)
    elastic *= _gradings(discretisation, moduli, cells).reshape(-1, 1, 1)
    dofs = operator.dofs.astype(PETSc.IntType)
    elements = operator.element_stiffness(elastic).reshape(len(cells), dofs.shape[1] ** 2)
    matrix.setValuesLocalRCV(dofs, dofs, elements, addv=PETSc.InsertMode.ADD)


def _gradings(discretisation: Discretisation, places: Iterable[int], cells: np.ndarray) -> np.ndarray:
    """What the moduli of bodies, by their places, are multiplied by at the Gauss points of cells, (cells, per_cell)."""
    mesh, bodies = discretisation.mesh, discretisation.cell_bodies()[cells]
    points, weights = compat.quadrature(mesh.topology.cell_name(), QUADRATURE)
    found = np.ones((len(cells), len(weights)))
    for place in places:
        grading, own = discretisation.scene.bodies[place].grading, np.flatnonzero(bodies == place)
        if grading is not None:
            # a grading that is a number has no mesh of its own
            plain = abs(ufl.JacobianDeterminant(mesh))
            parts = (grading(ufl.SpatialCoordinate(mesh)) * plain, plain)
            graded, size = (fem.Expression(part, points).eval(mesh, cells[own].astype(np.int32)) for part in parts)
            found[own] = (graded / size).reshape(len(own), len(weights))
    return found


def tabulated(discretisation: Discretisation, cells: np.ndarray) -> StrainOperator:
    """Strain at the Gauss points of some cells of this rank, in its own numbers of the dofs; collective."""
    mesh, space, hypothesis = discretisation.mesh, discretisation.space, discretisation.scene.hypothesis
    cells = cells.astype(np.int32)
    points, weights = compat.quadrature(mesh.topology.cell_name(), QUADRATURE)
    table = fem.Expression(strain_vector(ufl.TrialFunction(space), hypothesis), points).eval(mesh, cells)
    measure = volume_weight(mesh, hypothesis) * abs(ufl.JacobianDeterminant(mesh))
    volumes = weights * fem.Expression(measure, points).eval(mesh, cells).reshape(len(cells), len(weights))
    dim, blocks = mesh.geometry.dim, space.dofmap.list[cells]
    # lengths are given, none left to be found: a rank may have no such cell
    of_cell, components = dim * blocks.shape[1], 6 if hypothesis == "solid" else 4
    dofs = (dim * blocks[:, :, None] + np.arange(dim)).reshape(len(cells), of_cell).astype(np.int64)
    gradients = np.ascontiguousarray(table.reshape(len(cells), len(weights), components, of_cell))
    mean = np.flatnonzero(np.array(discretisation.mean_dilatation)[discretisation.cell_bodies()[cells]])
    gradients[mean] = _with_mean_dilatation(gradients[mean], volumes[mean])
    return StrainOperator(gradients, volumes, dofs, discretisation.size)


def _with_mean_dilatation(gradients: np.ndarray, volumes: np.ndarray) -> np.ndarray:
    """B-bar: the trace of the strain at each point gives way to its mean over the volume of the cell.

    ``gradients`` are those of each cell's dofs, (cells, per_cell, components, dofs), ``volumes`` (cells, per_cell).
    """
    trace = gradients[:, :, :3].sum(axis=2)
    shares = volumes / volumes.sum(axis=1, keepdims=True)
    mean = np.einsum("cq,cqk->ck", shares, trace)
    changed = gradients.copy()
    changed[:, :, :3] += (mean[:, None] - trace)[:, :, None] / 3
    return changed
