"""Stress of elastic bodies on their mesh."""

from __future__ import annotations

from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from ufl.core.expr import Expr

from hhr_dolfinx import compat
from hhr_dolfinx.forms import elasticity, volume
from hhr_dolfinx.full_order.discrete_space import DiscreteSpace


def stress_in_cells(discretisation: DiscreteSpace, displacement: np.ndarray, point: np.ndarray) -> np.ndarray:
    """Stress of a displacement, (N,), in the middle of each cell, Kelvin's notation, (cells, 4), in space 6.

    Cells are in the order of ``ContactProblem.cell_nodes``. Bodies with a mean dilatation have its pressure, and loads
    that are strains give no stress. Moduli are those of a point, (P,); the mesh has its current shape.
    """
    scene = discretisation.scene
    mesh = discretisation.mesh
    field = field_of(discretisation, displacement)
    constants = fem.functionspace(mesh, ("Discontinuous Lagrange", 0, (3, 3)))
    points = compat.interpolation_points(constants.element)
    stress = fem.Function(constants)
    for place, body in enumerate(scene.bodies):
        sigma = stress_in_body(discretisation, place, field, point)
        stress.interpolate(compat.jitted(fem.Expression, sigma, points), discretisation.cells_of(body.tag))
    owned = mesh.topology.index_map(mesh.topology.dim).size_local
    values = stress.x.array.reshape(-1, 3, 3)[constants.dofmap.list[:owned].ravel()]
    return _kelvin(discretisation.group.joined(values), mesh.geometry.dim)


def field_of(discretisation: DiscreteSpace, displacement: np.ndarray) -> fem.Function:
    """A displacement, (N,), as a function on the mesh."""
    field = fem.Function(discretisation.space)
    field.x.petsc_vec.array[:] = displacement[discretisation.rows]
    field.x.scatter_forward()
    return field


def stress_in_body(discretisation: DiscreteSpace, place: int, field: fem.Function, point: np.ndarray) -> Expr:
    """Stress of a body, by its index, in UFL, at a point of the parameters, (P,); its constants are not compiled.

    A strain that is a load, times the grading, is subtracted from the graded strain.
    """
    scene = discretisation.scene
    hypothesis = scene.hypothesis
    body = scene.bodies[place]
    eigenstrain = None
    if any(hasattr(load, "eigenstrain_of") for load in scene.loads):
        from hhr_dolfinx.full_order.gauss_points import eigenstrain_at

        eigenstrain = eigenstrain_at(discretisation, place, point)
    if body.stress is not None:
        strain = elasticity.strain(field, hypothesis)
        return elasticity.law_in(body.stress, hypothesis)(strain if eigenstrain is None else strain - eigenstrain)
    moduli: list[Any] = [body.young, body.poisson]
    if body.varies:
        from hhr_dolfinx.formulas import Scalar

        moduli = [Scalar(str(text), scene.parameters.names).value(point) for text in moduli]
    young, poisson = map(discretisation.constant, moduli)
    strain = elasticity.strain(field, hypothesis, poisson)
    if discretisation.mean_dilatation[place]:
        dilatation = discretisation.cell_means(ufl.tr(elasticity.strain(field, hypothesis)))
        strain = volume.with_mean(strain, dilatation)
    if body.grading is not None:
        strain = body.grading(ufl.SpatialCoordinate(discretisation.mesh)) * strain
    if eigenstrain is not None:
        strain = strain - eigenstrain
        if hypothesis == "plane_stress":
            strain = volume.without_third_stress(strain, poisson)
    shear = young / (2 * (1 + poisson))
    lam = young * poisson / ((1 + poisson) * (1 - 2 * poisson))
    return lam * ufl.tr(strain) * ufl.Identity(3) + 2 * shear * strain


def _kelvin(tensors: np.ndarray, dim: int) -> np.ndarray:
    """Symmetric tensors (n, 3, 3) as vectors with the same scalar product, (n, 4), in space (n, 6)."""
    pairs = [(0, 1)] if dim == 2 else [(0, 1), (0, 2), (1, 2)]
    shear = [np.sqrt(2) * tensors[:, i, j] for i, j in pairs]
    return np.stack([*(tensors[:, k, k] for k in range(3)), *shear], axis=1)
