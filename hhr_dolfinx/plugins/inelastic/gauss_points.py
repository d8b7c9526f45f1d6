"""Gauss points of inelastic bodies from UFL: strain, laws, parts of the elastic stiffness, and eigenstrains."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from scipy.sparse import csc_matrix, csr_matrix

from hhr_dolfinx import compat
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.forms.elasticity import kelvin
from hhr_dolfinx.formulas import Modulus, coordinate_names
from hhr_dolfinx.full_order.discrete_space import DiscreteSpace
from hhr_dolfinx.full_order.gauss_points import averaged, tabulated
from hhr_dolfinx.loads import checked_terms
from hhr_dolfinx.plugins.inelastic.constants import check_law_over_box, parameters_of
from hhr_dolfinx.plugins.inelastic.laws import Elasticity, LinearStress
from hhr_dolfinx.plugins.inelastic.strain import SparsePattern, StrainOperator
from hhr_dolfinx.plugins.inelastic.update import Group, Material


def strain_operator(discretisation: DiscreteSpace) -> StrainOperator:
    """Strain at the Gauss points of all cells, for inelastic bodies, of which each rank has the whole mesh."""
    return StrainOperator(*tabulated(discretisation, np.arange(discretisation.cell_bodies().size)), discretisation.size)


def places_of(discretisation: DiscreteSpace) -> np.ndarray:
    """Coordinates of all Gauss points, (points, d)."""
    mesh = discretisation.mesh
    cells = np.arange(discretisation.cell_bodies().size, dtype=np.int32)
    points, _ = compat.quadrature(mesh.topology.cell_name(), discretisation.gauss_degree)
    place = compat.jitted(fem.Expression, ufl.SpatialCoordinate(mesh), points).eval(mesh, cells)
    return np.reshape(place, (-1, mesh.geometry.dim))


def material_at(discretisation: DiscreteSpace, bodies: np.ndarray, operator: StrainOperator) -> Material:
    """Laws at the Gauss points of the cells of an operator, with bodies as indices in the scene, (cells,)."""
    scene = discretisation.scene
    of_point = np.repeat(bodies, operator.per_cell)
    groups = []
    for place, body in enumerate(scene.bodies):
        young = body.young if isinstance(body.young, str) else float(body.young)
        flat = scene.hypothesis == "plane_stress"
        stated = Elasticity() if body.law is None and flat else body.law
        if body.stress is not None:
            stated = LinearStress(body.stress)
        law = None if stated is None else stated.at_points(operator.components, plane_stress=flat)
        if law is not None and law.elastic and isinstance(young, str):
            raise SceneError(f"body {body.tag} has elasticity of its own, {law.name}: its young must be a number")
        numbers = np.flatnonzero(of_point == place)
        given = Group(numbers, young, float(body.poisson), law)
        names = coordinate_names(scene.hypothesis)
        if parameters_of(law) & (set(names) - set(scene.parameters.names)):
            given = replace(given, coordinates=names, places=places_of(discretisation)[numbers])
            check_law_over_box(law, scene.parameters, f"body {body.tag} of scene '{scene.name}'", names, given.places)
        groups.append(given)
    return Material(groups, operator.components, scene.parameters.names)


def stiffness_parts(
    material: Material, operator: StrainOperator, pattern: SparsePattern
) -> tuple[tuple[csr_matrix, ...], tuple[Modulus, ...]]:
    """Parts of the elastic stiffness, (N, N) each, one for each formula and one for numbers, and their moduli.

    Constant elasticity has one part and no modulus.
    """
    formulas = dict.fromkeys(group.young for group in material.groups if isinstance(group.young, str))
    if not formulas:
        return (operator.stiffness(material.elastic, pattern),), ()
    parts = []
    moduli = []
    for text in (*formulas, None):
        elastic = np.zeros((material.gauss_points, material.components, material.components))
        acting = False
        for group in material.groups:
            if group.young == text or (text is None and not isinstance(group.young, str)):
                young = 1.0 if text is not None else float(group.young)
                elastic[group.indices] = replace(group, young=young).elasticity(material.components)[0]
                acting = True
        if acting:
            parts.append(operator.stiffness(elastic, pattern))
            moduli.append(Modulus("1" if text is None else text, "1", material.names))
    return tuple(parts), tuple(moduli)


def at_gauss_points(discretisation: DiscreteSpace, operator: StrainOperator) -> csc_matrix:
    """Eigenstrains at the Gauss points of inelastic bodies, for each term of θ, (points * components, 1 + T).

    SceneError for a user-defined load whose ``eigenstrain_of`` lacks the one term of the assembler's ``eigenstress``.
    """
    loads = discretisation.scene.loads
    points = operator.gauss_points * operator.components
    blocks = []
    seen = []
    pairs = [(load, term) for load in loads for term in checked_terms(load, discretisation.assembler(load))]
    for load, term in pairs:
        width = term.columns.shape[1]
        if hasattr(load, "eigenstrain_of") and csc_matrix(term.columns).nnz == 0 and width == 1:
            seen.append(load)
            blocks.append(csc_matrix(_tabulated(discretisation, load, operator)[:, None]))
        else:
            blocks.append(csc_matrix((points, width)))
    strained = [load for load in loads if hasattr(load, "eigenstrain_of")]
    if sorted(map(id, seen)) != sorted(map(id, strained)):
        raise SceneError(
            f"of the loads {strained} each is a strain of one inelastic body or one beside it, and must have the "
            "one term that its assembler's eigenstress gives"
        )
    return discretisation.terms.columns("loads", points, blocks)


def _tabulated(discretisation: DiscreteSpace, load: Any, operator: StrainOperator) -> np.ndarray:
    """A strain for the amplitude 1 at all Gauss points, Kelvin's notation, (points * components,)."""
    mesh = discretisation.mesh
    bodies = discretisation.cell_bodies()
    points, _ = compat.quadrature(mesh.topology.cell_name(), discretisation.gauss_degree)
    found = np.zeros((bodies.size, operator.per_cell, operator.components))
    for place, body in enumerate(discretisation.scene.bodies):
        given = load.eigenstrain_of(body.tag, mesh)
        cells = np.flatnonzero(bodies == place)
        if given is not None:
            # a constant strain has no mesh
            one = fem.Constant(mesh, 1.0)
            vector = kelvin(averaged(discretisation, place, given[1]), discretisation.scene.hypothesis)
            values = compat.jitted(fem.Expression, one * vector, points).eval(mesh, cells.astype(np.int32))
            found[cells] = values.reshape(len(cells), operator.per_cell, operator.components)
    if discretisation.scene.hypothesis == "plane_stress":  # nothing holds what strains across
        found[:, :, 2] = 0.0
    return found.ravel()
