"""Strains without stress, such as thermal ones: σ = C (ε - ε0), and F is ∫ C ε0 : ε(v), and stresses leave ε0 out."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
import ufl
from dolfinx import fem
from ufl.core.expr import Expr

from hhr_dolfinx.amplitudes import Amplitude
from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.forms import elasticity, volume
from hhr_dolfinx.formulas import Formula, Scalar
from hhr_dolfinx.full_order.locking import QUADRATURE
from hhr_dolfinx.full_order.varying import grading_of, parts_of

if TYPE_CHECKING:
    from hhr_dolfinx.full_order.discretisation import Discretisation


def eigenstress(
    discretisation: Discretisation, tag: int, strain: Expr, vector: Callable[[ufl.Form], np.ndarray]
) -> list[tuple[Formula, np.ndarray]]:
    """Nodal forces by which a strain of a body, 3x3, strains it where nothing holds it.

    Each part of its stiffness gives its modulus, a formula of the parameters, and forces for the modulus 1, (N,).

    Raises:
        SceneError: if no body has the tag, or if a body of the scene flows.
    """
    scene = discretisation.scene
    places = [place for place, body in enumerate(scene.bodies) if body.tag == tag]
    if not places:
        raise SceneError(
            f"an eigenstrain is that of cell tag {tag}, and the bodies of scene '{scene.name}' have the tags "
            f"{[body.tag for body in scene.bodies]}"
        )
    if any(body.law is not None for body in scene.bodies):
        raise SceneError(
            f"bodies of scene '{scene.name}' flow, and body {tag} has an eigenstrain: a law of flow sees the whole "
            "strain. Take elastic bodies, or impose displacements and pressures in its place"
        )
    body, hypothesis, mean = scene.bodies[places[0]], scene.hypothesis, discretisation.mean_dilatation[places[0]]
    # bodies with a mean dilatation meet the strain at the points where they meet their own
    dx = discretisation.cells(tag)(degree=QUADRATURE) if mean else discretisation.cells(tag)
    measured = elasticity.in_plane(elasticity.strain(discretisation.arguments[1], hypothesis), hypothesis)
    weight = elasticity.volume_weight(discretisation.mesh, hypothesis)
    # the product of two means is not the mean of the product, which the test function meets
    graded = _averaged(discretisation, places[0], _graded(discretisation, places[0], strain))
    stresses = elasticity.isotropic_parts(graded, hypothesis)
    found = []
    for part in parts_of(body, places[0], hypothesis):
        # constants of the form: their values are not compiled in
        moduli = [fem.Constant(discretisation.mesh, float(value)) for value in part.moduli]
        stress = sum(modulus * item for modulus, item in zip(moduli, stresses, strict=True) if float(modulus.value))
        forces = vector(weight * ufl.inner(stress, measured) * dx)
        found.append((Formula(part.factor).times(Formula(part.rest)), forces))
    return found


def eigenstrain_at(discretisation: Discretisation, place: int, point: np.ndarray) -> Expr | None:
    """What stresses leave out of the graded strain of a body at a point of the parameters, (P,); None for nothing."""
    scene, total = discretisation.scene, None
    for load in scene.loads:
        found = (
            load.eigenstrain_of(scene.bodies[place].tag, discretisation.mesh)
            if hasattr(load, "eigenstrain_of")
            else None
        )
        if found is not None:
            amplitude, strain = found
            value = fem.Constant(discretisation.mesh, _value(amplitude, scene.parameters.names, point))
            total = value * strain if total is None else total + value * strain
    return None if total is None else _graded(discretisation, place, total)


def _graded(discretisation: Discretisation, place: int, strain: Expr) -> Expr:
    """A strain of a body times its grading."""
    return grading_of(discretisation, discretisation.scene.bodies[place]) * _averaged(discretisation, place, strain)


def _averaged(discretisation: Discretisation, place: int, strain: Expr) -> Expr:
    """A strain whose change of volume is the mean over each cell, where that of the body is."""
    if not discretisation.mean_dilatation[place]:
        return strain
    return volume.with_mean(strain, discretisation.cell_means(ufl.tr(strain)))


def _value(amplitude: Amplitude | Formula, names: tuple[str, ...], point: np.ndarray) -> float:
    """An amplitude at a point."""
    if isinstance(amplitude, Amplitude):
        return amplitude.constant + sum(slope * point[names.index(name)] for name, slope in amplitude.slopes.items())
    return Scalar(amplitude.text, names).value(point)
