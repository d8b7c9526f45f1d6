"""Volume loads in UFL: forces per volume, rotating bodies, eigenstrains."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import ufl
from ufl.core.expr import Expr

from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.forms.elasticity import in_plane, volume_weight


def body_force(v: Expr, direction: Sequence[float], hypothesis: str, dx: ufl.Measure) -> ufl.Form:
    """Volume load ∫ f·v w dx for the constant force f per volume.

    Args:
        v: test function.
        direction: force f per volume, (dim,).
        hypothesis: see :mod:`hhr_dolfinx.forms.elasticity`.
        dx: volume measure.
    """
    return volume_weight(dx.ufl_domain(), hypothesis) * ufl.inner(ufl.as_vector(direction), v) * dx


def centrifugal(
    v: Expr, point: Sequence[float], axis: Sequence[float], hypothesis: str, dx: ufl.Measure
) -> ufl.Form:
    """Volume load ∫ d·v w dx, where d is the vector to x from the axis through a point.

    Args:
        v: test function.
        point: a point of the axis, (dim,).
        axis: unit vector of the axis, (dim,): (0, 0) in the plane, for the axis normal to it; (0,
            1) in axisymmetry.
        hypothesis: see :mod:`hhr_dolfinx.forms.elasticity`.
        dx: measure.
    """
    mesh = dx.ufl_domain()
    away = ufl.SpatialCoordinate(mesh) - ufl.as_vector(point)
    along = ufl.as_vector(axis)
    return (
        volume_weight(mesh, hypothesis) * ufl.inner(away - ufl.inner(away, along) * along, v) * dx
    )


def eigenstrain(
    strain: Sequence[Sequence[float]], field: Callable[[Expr], Expr | float] | None, mesh: ufl.Mesh
) -> Expr:
    """A constant 3x3 strain times a function of the coordinates, None for 1.

    Args:
        strain: 3x3 strain.
        field: function of the UFL coordinates; None for 1.
        mesh: mesh of the coordinates.

    Raises:
        SceneError: if the function does not return a scalar.
    """
    tensor = ufl.as_tensor(np.asarray(strain, dtype=float).tolist())
    if field is None:
        return tensor
    value = field(ufl.SpatialCoordinate(mesh))
    try:
        value = ufl.as_ufl(value)
    except ValueError:
        value = None
    if value is None or value.ufl_shape != () or value.ufl_free_indices:
        raise SceneError(
            f"the field {field!r} of an eigenstrain must map UFL coordinates to a UFL scalar or a "
            "number"
        )
    return value * tensor


def with_mean(strain: Expr, trace: Expr) -> Expr:
    """A strain with its trace replaced by another, a third of it on each axis."""
    return strain + (trace - ufl.tr(strain)) / 3 * ufl.Identity(3)


def without_third_stress(strain: Expr, poisson: Expr | float) -> Expr:
    """A strain whose third normal component gives σ_zz = 0 in plane stress.

    Args:
        strain: 3x3 strain.
        poisson: Poisson's ratio ν.
    """
    plane = in_plane(strain, "plane_stress")
    third = -poisson / (1 - poisson) * ufl.tr(plane)
    return plane + third * ufl.as_tensor([[0, 0, 0], [0, 0, 0], [0, 0, 1]])
