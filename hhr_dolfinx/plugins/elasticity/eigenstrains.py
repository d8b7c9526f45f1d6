"""Eigenstrains ε0, such as thermal ones: strains that are subtracted, σ = C (ε - ε0).

F is ∫ C ε0 : ε(v), and stresses exclude ε0. Laws of bodies use ε - ε0 at Gauss points, so that
internal forces contain a part that otherwise belongs to F.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import ufl
from dolfinx import fem
from ufl.core.expr import Expr

from hhr_dolfinx import compat
from hhr_dolfinx.amplitudes import Amplitude
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.forms import elasticity, volume
from hhr_dolfinx.formulas import Formula, Scalar
from hhr_dolfinx.full_order.discrete_space import DiscreteSpace
from hhr_dolfinx.parameters import Tag
from hhr_dolfinx.plugins.elasticity.gauss_points import degree_of
from hhr_dolfinx.plugins.elasticity.parts import grading_of, parts_of


def eigenstress(
    discretisation: DiscreteSpace, tag: Tag, strain: Expr, vector: Callable[[ufl.Form], np.ndarray]
) -> list[tuple[Formula, np.ndarray]]:
    """Nodal forces that produce an eigenstrain of a free body.

    Each part of its stiffness gives its modulus, an expression of the parameters, and forces for
    the modulus 1, (N,). For bodies with laws these are zero: a single zero vector makes the
    amplitude of the strain a term of θ.

    Args:
        discretisation: functions on the mesh of the scene.
        tag: cell tag of the body.
        strain: the eigenstrain, 3x3, in UFL.
        vector: assembles a form that is linear in v, (N,).

    Raises:
        SceneError: if no body has the tag.
    """
    scene = discretisation.scene
    tags = [body.tag for body in scene.bodies]
    if tag not in tags:
        raise SceneError(
            f"an eigenstrain is that of cell tag {tag}, and the bodies of scene '{scene.name}' "
            f"have the tags {tags}"
        )
    index = tags.index(tag)
    body = scene.bodies[index]
    if scene.reader:
        return [(Formula("1"), np.zeros(discretisation.size))]
    hypothesis = scene.hypothesis
    dx = discretisation.cells(tag)
    if (stress_of := scene.own_stress(body, discretisation.mesh)) is not None:
        work = ufl.inner(
            stress_of(strain), elasticity.strain(discretisation.arguments[1], hypothesis)
        )
        return [
            (
                Formula("1"),
                vector(elasticity.volume_weight(discretisation.mesh, hypothesis) * work * dx),
            )
        ]
    if discretisation.mean_dilatation[
        index
    ]:  # the strain at the points at which the body evaluates its strain
        dx = dx(degree=degree_of(discretisation))
    measured = elasticity.in_plane(
        elasticity.strain(discretisation.arguments[1], hypothesis), hypothesis
    )
    weight = elasticity.volume_weight(discretisation.mesh, hypothesis)
    # the product of two means is not the mean of the product, which the form needs
    graded = averaged(discretisation, index, _graded(discretisation, index, strain))
    stresses = elasticity.isotropic_parts(graded, hypothesis)
    terms = []
    for stiffness_part in parts_of(body, hypothesis):
        moduli = map(discretisation.constant, stiffness_part.moduli)
        stress = sum(
            modulus * stress_part
            for modulus, stress_part in zip(moduli, stresses, strict=True)
            if float(modulus.value)
        )
        forces = vector(weight * ufl.inner(stress, measured) * dx)
        terms.append((Formula(stiffness_part.factor).times(Formula(stiffness_part.rest)), forces))
    return terms


def eigenstrain_at(discretisation: DiscreteSpace, place: int, point: np.ndarray) -> Expr | None:
    """Eigenstrain of a body times its grading; None without eigenstrains.

    Args:
        discretisation: functions on the mesh of the scene.
        place: index of the body in the scene.
        point: parameters, (P,).
    """
    scene = discretisation.scene
    tag = scene.bodies[place].tag
    total = None
    for load in scene.loads:
        if (
            hasattr(load, "eigenstrain_of")
            and (eigenstrain := load.eigenstrain_of(tag, discretisation.mesh)) is not None
        ):
            amplitude, strain = eigenstrain
            names = scene.parameters.names
            if isinstance(amplitude, Amplitude):
                slopes = (
                    slope * point[names.index(name)] for name, slope in amplitude.slopes.items()
                )
                value = discretisation.constant(amplitude.constant + sum(slopes))
            else:
                value = discretisation.constant(Scalar(amplitude.text, names).value(point))
            total = value * strain if total is None else total + value * strain
    return None if total is None else _graded(discretisation, place, total)


def _graded(discretisation: DiscreteSpace, place: int, strain: Expr) -> Expr:
    """A strain of a body times its grading."""
    return grading_of(discretisation, discretisation.scene.bodies[place]) * averaged(
        discretisation, place, strain
    )


def averaged(discretisation: DiscreteSpace, place: int, strain: Expr) -> Expr:
    """Strain with the mean change of volume of each cell, if the body uses the mean dilatation.

    Args:
        discretisation: functions on the mesh of the scene.
        place: index of the body in the scene.
        strain: the strain, 3x3, in UFL.
    """
    if not discretisation.mean_dilatation[place]:
        return strain
    return volume.with_mean(strain, cell_means(discretisation, ufl.tr(strain)))


def cell_means(space: DiscreteSpace, field: Expr) -> fem.Function:
    """Mean of a UFL scalar over each cell's volume, by the rule of the stiffness.

    On the cells of this rank.

    Args:
        space: functions on the mesh of the scene.
        field: the scalar, in UFL.
    """
    means = fem.Function(fem.functionspace(space.mesh, ("Discontinuous Lagrange", 0)))
    dx = ufl.dx(space.mesh, metadata={"quadrature_degree": degree_of(space)})
    volume = elasticity.volume_weight(space.mesh, space.scene.hypothesis) * ufl.TestFunction(
        means.function_space
    )
    change, size = (
        fem.assemble_vector(compat.jitted(fem.form, form * dx)).array
        for form in (field * volume, volume)
    )
    owned = means.function_space.dofmap.index_map.size_local
    means.x.array[:owned] = change[:owned] / size[:owned]
    return means
