"""Gauss points of inelastic bodies from UFL: strain, laws, parts of the elastic stiffness, and
eigenstrains.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from scipy.sparse import csc_matrix, csr_matrix

from hhr_dolfinx import compat
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.forms.elasticity import kelvin, unit_moduli
from hhr_dolfinx.formulas import Modulus, coordinate_names
from hhr_dolfinx.full_order.discrete_space import DiscreteSpace
from hhr_dolfinx.loads import checked_terms
from hhr_dolfinx.plugins.elasticity.eigenstrains import averaged
from hhr_dolfinx.plugins.elasticity.gauss_points import degree_of, gradings, tabulated
from hhr_dolfinx.plugins.inelastic.constants import check_law_over_box, parameters_of
from hhr_dolfinx.plugins.inelastic.law import UNGRADED, Graded
from hhr_dolfinx.plugins.inelastic.laws import Elasticity, LinearStress
from hhr_dolfinx.plugins.inelastic.strain import SparsePattern, StrainOperator
from hhr_dolfinx.plugins.inelastic.update import Group, Material


def strain_operator(discretisation: DiscreteSpace) -> StrainOperator:
    """Strain at the Gauss points of all cells, for inelastic bodies, of which each rank has the
    whole mesh.
    """
    return StrainOperator(
        *tabulated(discretisation, np.arange(discretisation.cell_bodies().size)),
        discretisation.size,
    )


def places_of(discretisation: DiscreteSpace) -> np.ndarray:
    """Coordinates of all Gauss points, (points, d)."""
    mesh = discretisation.mesh
    cells = np.arange(discretisation.cell_bodies().size, dtype=np.int32)
    points, _ = compat.quadrature(mesh.topology.cell_name(), degree_of(discretisation))
    coordinates = compat.jitted(fem.Expression, ufl.SpatialCoordinate(mesh), points).eval(
        mesh, cells
    )
    return np.reshape(coordinates, (-1, mesh.geometry.dim))


def grading_at(discretisation: DiscreteSpace, place: int) -> np.ndarray:
    """Grading of a body at its Gauss points, (n,); empty without one.

    Args:
        discretisation: discrete space of the scene.
        place: index of the body in the scene.

    Raises:
        SceneError: if it is not positive and finite.
    """
    body = discretisation.scene.bodies[place]
    if body.grading is None:
        return UNGRADED
    cells = np.flatnonzero(discretisation.cell_bodies() == place)
    factors = gradings(discretisation, [place], cells).ravel()
    if not (np.isfinite(factors) & (factors > 0)).all():
        raise SceneError(
            f"the grading of body {body.tag} is {factors[int(np.argmin(factors > 0))]:g} at a "
            "Gauss point: it must be positive and finite on the body"
        )
    return factors


def material_at(
    discretisation: DiscreteSpace,
    bodies: np.ndarray,
    operator: StrainOperator,
    *,
    flat: bool | None = None,
) -> Material:
    """Laws at the Gauss points of the cells of an operator.

    Args:
        discretisation: discrete space of the scene.
        bodies: body of each cell as its index in the scene, (cells,).
        operator: strain at the Gauss points.
        flat: state laws for plane stress; None does in scenes of plane stress.
    """
    scene = discretisation.scene
    flat = scene.hypothesis == "plane_stress" if flat is None else flat
    of_point = np.repeat(bodies, operator.per_cell)
    groups = []
    for index, body in enumerate(scene.bodies):
        young, ratio = (
            text if isinstance(text, str) else float(text) for text in (body.young, body.poisson)
        )
        grading = grading_at(discretisation, index)
        stated = Elasticity() if body.law is None and flat else body.law
        if body.stress is not None:
            stated = LinearStress(body.stress)
        if grading.size and stated is not None and stated.elastic:
            stated = Graded(stated, float(young))
        law = None if stated is None else stated.at_points(operator.components, plane_stress=flat)
        numbers = np.flatnonzero(of_point == index)
        points_of_body = Group(numbers, young, ratio, law, grading=grading)
        names = coordinate_names(scene.hypothesis)
        if parameters_of(law) & (set(names) - set(scene.parameters.names)):
            points_of_body = replace(
                points_of_body, coordinates=names, places=places_of(discretisation)[numbers]
            )
            check_law_over_box(
                law,
                scene.parameters,
                f"body {body.tag} of scene '{scene.name}'",
                names,
                points_of_body.places,
            )
        groups.append(points_of_body)
    return Material(groups, operator.components, scene.parameters.names)


def stiffness_parts(
    material: Material, operator: StrainOperator, pattern: SparsePattern
) -> tuple[tuple[csr_matrix, ...], tuple[Modulus, ...]]:
    """Parts of the elastic stiffness, (N, N) each, and their moduli.

    A formula of E has a part, one of ν a part for the change of volume and one for that of shape,
    and all numbers have one part. Constant elasticity has one part and no modulus.

    Args:
        material: laws at the Gauss points.
        operator: strain at the Gauss points.
        pattern: sparsity of the stiffness.
    """
    if not any(group.texts for group in material.groups):
        return (operator.stiffness(material.elastic, pattern),), ()
    shares: dict[tuple[str, str], list[tuple[Group, np.ndarray]]] = {}
    for group in sorted(material.groups, key=lambda group: not group.texts):
        for *key, elastic in _parts_of(group, material.components):
            shares.setdefault((key[0], key[1]), []).append((group, elastic))
    terms = []
    for members in shares.values():
        elastic = np.zeros((material.gauss_points, material.components, material.components))
        for group, moduli in members:
            graded = group.grading[:, None, None] if group.grading.size else 1.0
            elastic[group.indices] = moduli * graded
        terms.append(operator.stiffness(elastic, pattern))
    return tuple(terms), tuple(Modulus(*key, material.names) for key in shares)


def _parts_of(group: Group, components: int) -> Iterator[tuple[str, str, np.ndarray]]:
    """Parts of C of a group for the grading 1: two factors as formulas, and what they multiply, (c,
    c).
    """
    if isinstance(group.poisson, str):
        flat = group.law is not None and group.law.plane_stress
        unit = np.where(np.arange(components) < (2 if flat else 3), 1.0, 0.0)
        rests = unit_moduli(group.poisson, "plane_stress" if flat else "")
        factor = group.young if isinstance(group.young, str) else repr(group.young)
        yield factor, rests[0], np.outer(unit, unit)
        yield factor, rests[1], 2 * np.eye(components)
    elif isinstance(group.young, str):
        yield group.young, "1", replace(group, young=1.0).elasticity(components)[0]
    else:
        yield "1", "1", group.elasticity(components)[0]


def at_gauss_points(discretisation: DiscreteSpace, operator: StrainOperator) -> csc_matrix:
    """Eigenstrains at Gauss points for each term of θ, (points * components, 1 + T).

    Args:
        discretisation: discrete space of the scene.
        operator: strain at the Gauss points.

    Raises:
        SceneError: for a user-defined load whose ``eigenstrain_of`` lacks the one term of the
            assembler's ``eigenstress``.
    """
    loads = discretisation.scene.loads
    points = operator.gauss_points * operator.components
    blocks = []
    seen = []
    pairs = [
        (load, term)
        for load in loads
        for term in checked_terms(load, discretisation.assembler(load))
    ]
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
            f"of the loads {strained} each is a strain of one inelastic body or one beside it, "
            "and must have the one term that its assembler's eigenstress gives"
        )
    return discretisation.terms.columns("loads", points, blocks)


def _tabulated(discretisation: DiscreteSpace, load: Any, operator: StrainOperator) -> np.ndarray:
    """A strain for the amplitude 1 at all Gauss points, Kelvin's notation, (points *
    components,).
    """
    mesh = discretisation.mesh
    bodies = discretisation.cell_bodies()
    points, _ = compat.quadrature(mesh.topology.cell_name(), degree_of(discretisation))
    strains = np.zeros((bodies.size, operator.per_cell, operator.components))
    for index, body in enumerate(discretisation.scene.bodies):
        eigenstrain = load.eigenstrain_of(body.tag, mesh)
        cells = np.flatnonzero(bodies == index)
        if eigenstrain is not None:
            # a constant strain has no mesh
            unit = fem.Constant(mesh, 1.0)
            vector = kelvin(
                averaged(discretisation, index, eigenstrain[1]), discretisation.scene.hypothesis
            )
            values = compat.jitted(fem.Expression, unit * vector, points).eval(
                mesh, cells.astype(np.int32)
            )
            strains[cells] = values.reshape(len(cells), operator.per_cell, operator.components)
    if discretisation.scene.hypothesis == "plane_stress":  # nothing holds what strains across
        strains[:, :, 2] = 0.0
    return strains.ravel()
