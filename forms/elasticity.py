"""Small-strain isotropic elasticity in 2D and 3D from one source, thesis (1.1), (1.6), (1.9).

Every hypothesis uses the full 3x3 strain, so that all have the same form ``a(u, v) = ∫ σ(u) : ε(v)
w dx``:

* ``plane_strain``: ε_zz = 0, weight w = 1 (per unit depth);
* ``plane_stress``: ε_zz = -ν/(1-ν) (ε_xx + ε_yy), which makes σ_zz = 0, weight 1;
* ``axisymmetric``: coordinates (r, z), ε_θθ = u_r / r, weight w = 2πr (the whole turn);
* ``solid``: three dimensions, weight 1.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import ufl
from ufl.core.expr import Expr

from hhr_dolfinx.errors import SceneError
from hhr_dolfinx.materials.elasticity import lame_parameters

HYPOTHESES = ("plane_strain", "plane_stress", "axisymmetric", "solid")
SHEARS_ACROSS = (0, 2), (1, 2)
"""Components of a tensor that shear across the plane."""


def strain(u: Expr, hypothesis: str, poisson: float | Expr = 0.0) -> Expr:
    """Strain ε(u), a 3x3 tensor whose third axis is z in the plane and θ in axisymmetry.

    Args:
        u: displacement, a trial function or a field.
        hypothesis: see :mod:`hhr_dolfinx.forms.elasticity`.
        poisson: Poisson's ratio ν, a number or a symbol.

    Raises:
        SceneError: for an unknown hypothesis.
    """
    e = ufl.sym(ufl.grad(u))
    if hypothesis == "solid":
        return e
    if hypothesis == "plane_strain":
        third = 0.0
    elif hypothesis == "plane_stress":
        third = -poisson / (1 - poisson) * (e[0, 0] + e[1, 1])
    elif hypothesis == "axisymmetric":
        third = u[0] / ufl.SpatialCoordinate(ufl.domain.extract_unique_domain(u))[0]
    else:
        raise SceneError(f"unknown hypothesis '{hypothesis}', one of {', '.join(HYPOTHESES)}")
    return ufl.as_tensor([[e[0, 0], e[0, 1], 0], [e[1, 0], e[1, 1], 0], [0, 0, third]])


def strain_vector(u: Expr, hypothesis: str) -> Expr:
    """Strain in Kelvin's notation: 4 components, or 6 in space.

    Args:
        u: displacement, a trial function or a field.
        hypothesis: see :mod:`hhr_dolfinx.forms.elasticity`.
    """
    return kelvin(strain(u, hypothesis), hypothesis)


def kelvin(e: Expr, hypothesis: str) -> Expr:
    """A symmetric 3x3 tensor in Kelvin's notation: 4 components, or 6 in space.

    Args:
        e: symmetric tensor.
        hypothesis: see :mod:`hhr_dolfinx.forms.elasticity`.
    """
    plane = [e[0, 0], e[1, 1], e[2, 2], 2**0.5 * e[0, 1]]
    return ufl.as_vector(
        [*plane, 2**0.5 * e[0, 2], 2**0.5 * e[1, 2]] if hypothesis == "solid" else plane
    )


def of_kelvin(vector: Expr) -> Expr:
    """The symmetric 3x3 tensor of 4 or 6 components in Kelvin's notation."""
    xx, yy, zz, *shears = vector
    xy, xz, yz = [shear / 2**0.5 for shear in shears] + [0.0] * (6 - len(vector))
    return ufl.as_tensor([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def lame_of(young: float | Expr, poisson: float | Expr) -> tuple[Expr, Expr]:
    """Lamé parameters (λ, μ) of symbols.

    Args:
        young: Young's modulus E, a number or a symbol.
        poisson: Poisson's ratio ν, a number or a symbol.
    """
    return young * poisson / ((1 + poisson) * (1 - 2 * poisson)), young / (2 * (1 + poisson))


def stress(u: Expr, young: float | Expr, poisson: float | Expr, hypothesis: str) -> Expr:
    """Stress σ(u) = λ tr(ε) I + 2μ ε, thesis (1.6), a 3x3 tensor in the unit of E.

    Moduli may be constants of a form: their values are not compiled in, so that new values need no
    compilation.

    Args:
        u: displacement, a trial function or a field.
        young: Young's modulus E, a number or a symbol.
        poisson: Poisson's ratio ν, a number or a symbol.
        hypothesis: see :mod:`hhr_dolfinx.forms.elasticity`.
    """
    if isinstance(young, Expr) or isinstance(poisson, Expr):
        lam, mu = lame_of(young, poisson)
    else:
        lam, mu = lame_parameters(young, poisson)
    e = strain(u, hypothesis, poisson)
    return lam * ufl.tr(e) * ufl.Identity(3) + 2 * mu * e


def volume_weight(mesh: ufl.Mesh, hypothesis: str) -> Expr:
    """Weight of the volume and surface measures: 2πr in axisymmetry, 1 elsewhere.

    Args:
        mesh: mesh of the coordinates.
        hypothesis: see :mod:`hhr_dolfinx.forms.elasticity`.
    """
    return weight_at(ufl.SpatialCoordinate(mesh)[0], hypothesis)


def weight_at(radius: Expr | np.ndarray, hypothesis: str) -> Expr | np.ndarray:
    """Weight of the measures at given first coordinates, symbolic or numbers.

    Args:
        radius: first coordinates.
        hypothesis: see :mod:`hhr_dolfinx.forms.elasticity`.
    """
    return 2 * ufl.pi * radius if hypothesis == "axisymmetric" else 1.0 + 0 * radius


def stiffness(
    u: Expr, v: Expr, young: float | Expr, poisson: float | Expr, hypothesis: str, dx: ufl.Measure
) -> ufl.Form:
    """Bilinear form a(u, v) = ∫ σ(u) : ε(v) w dx of thesis (1.9) on the measure ``dx``.

    Args:
        u: displacement, a trial function or a field.
        v: test function.
        young: Young's modulus E, a number or a symbol.
        poisson: Poisson's ratio ν, a number or a symbol.
        hypothesis: see :mod:`hhr_dolfinx.forms.elasticity`.
        dx: volume measure.
    """
    weight = volume_weight(dx.ufl_domain(), hypothesis)
    return (
        weight
        * ufl.inner(stress(u, young, poisson, hypothesis), strain(v, hypothesis, poisson))
        * dx
    )


def stiffness_of_law(
    u: Expr, v: Expr, stress_of: Callable[[Expr], Expr], hypothesis: str, dx: ufl.Measure
) -> ufl.Form:
    """Bilinear form as :func:`stiffness`, with a linear stress of the strain.

    Args:
        u: displacement, a trial function or a field.
        v: test function.
        stress_of: linear stress of the strain, see :func:`law_in`.
        hypothesis: see :mod:`hhr_dolfinx.forms.elasticity`.
        dx: volume measure.
    """
    weight = volume_weight(dx.ufl_domain(), hypothesis)
    return weight * ufl.inner(stress_of(strain(u, hypothesis)), strain(v, hypothesis)) * dx


def law_in(stress_of: Callable[[Expr], Expr], hypothesis: str) -> Callable[[Expr], Expr]:
    """A user-defined linear stress under a hypothesis.

    In plane stress the strains across the plane, ε_zz, ε_xz and ε_yz, are those that make σ_zz,
    σ_xz and σ_yz zero.

    Args:
        stress_of: linear stress as a function of the strain, both 3x3.
        hypothesis: see :mod:`hhr_dolfinx.forms.elasticity`.
    """
    return (
        without_stress(stress_of, ((2, 2), *SHEARS_ACROSS))
        if hypothesis == "plane_stress"
        else stress_of
    )


def graded(
    stress_of: Callable[[Expr], Expr], grading: Callable[[Expr], Expr], mesh: ufl.Mesh
) -> Callable[[Expr], Expr]:
    """A stress, a function of the strain, times a function of the coordinates of a mesh.

    Args:
        stress_of: stress as a function of the strain, both 3x3.
        grading: function of the UFL coordinates.
        mesh: mesh of the coordinates.
    """
    factor = grading(ufl.SpatialCoordinate(mesh))
    return lambda strain: factor * stress_of(strain)


def without_stress(
    stress_of: Callable[[Expr], Expr], free: Sequence[tuple[int, int]]
) -> Callable[[Expr], Expr]:
    """Linear stress with components of zero: the strains of the same names make them so.

    Args:
        stress_of: stress as a function of the strain, both 3x3.
        free: components that are zero, as pairs of indices.
    """
    units = [
        ufl.as_tensor([[float({i, j} == {*pair}) for j in range(3)] for i in range(3)])
        for pair in free
    ]
    stresses = [stress_of(unit) for unit in units]
    stiffness = ufl.as_matrix([[stress[pair] for stress in stresses] for pair in free])

    def relieved(e: Expr) -> Expr:
        held = stress_of(e - sum(e[pair] * unit for pair, unit in zip(free, units, strict=True)))
        amounts = -ufl.inv(stiffness) * ufl.as_vector([held[pair] for pair in free])
        return held + sum(amounts[k] * stress for k, stress in enumerate(stresses))

    return relieved


def isotropic_parts(strain_of_u: Expr, hypothesis: str) -> tuple[Expr, Expr]:
    """Parts of the stress, (tr ε) I and 2 ε, weighted by :func:`unit_moduli`.

    σ = λ' (tr ε) I + μ' 2 ε, 3x3. In plane stress ε_zz is eliminated: the tensors are those of the
    plane.

    Args:
        strain_of_u: 3x3 strain.
        hypothesis: see :mod:`hhr_dolfinx.forms.elasticity`.
    """
    e = in_plane(strain_of_u, hypothesis)
    identity = in_plane(ufl.Identity(3), hypothesis)
    return ufl.tr(e) * identity, 2 * e


def in_plane(tensor: Expr, hypothesis: str) -> Expr:
    """The in-plane components of a 3x3 tensor in plane stress; otherwise the tensor itself.

    Args:
        tensor: 3x3 tensor.
        hypothesis: see :mod:`hhr_dolfinx.forms.elasticity`.
    """
    if hypothesis != "plane_stress":
        return tensor
    return ufl.as_tensor(
        [[tensor[0, 0], tensor[0, 1], 0], [tensor[1, 0], tensor[1, 1], 0], [0, 0, 0]]
    )


def unit_moduli(poisson: str, hypothesis: str) -> tuple[str, str]:
    """Weights λ' and μ' of :func:`isotropic_parts` for E = 1, as formulas.

    Args:
        poisson: formula of Poisson's ratio.
        hypothesis: see :mod:`hhr_dolfinx.forms.elasticity`.
    """
    nu = f"({poisson})"
    if hypothesis == "plane_stress":
        return f"{nu} / (1 - {nu}**2)", f"0.5 / (1 + {nu})"
    return f"{nu} / ((1 + {nu}) * (1 - 2 * {nu}))", f"0.5 / (1 + {nu})"


def mass(u: Expr, v: Expr, hypothesis: str, dx: ufl.Measure) -> ufl.Form:
    """L2 product ∫ u·v w dx, the Gram matrix of the L2 errors.

    Args:
        u: displacement, a trial function or a field.
        v: test function.
        hypothesis: see :mod:`hhr_dolfinx.forms.elasticity`.
        dx: volume measure.
    """
    return volume_weight(dx.ufl_domain(), hypothesis) * ufl.inner(u, v) * dx


def traction(v: Expr, direction: Sequence[float], hypothesis: str, ds: ufl.Measure) -> ufl.Form:
    """Surface load ∫ t·v w ds of thesis (1.9) for the constant traction vector t.

    Args:
        v: test function.
        direction: traction t, (dim,).
        hypothesis: see :mod:`hhr_dolfinx.forms.elasticity`.
        ds: surface measure.
    """
    return volume_weight(ds.ufl_domain(), hypothesis) * ufl.inner(ufl.as_vector(direction), v) * ds


def pressure(v: Expr, hypothesis: str, ds: ufl.Measure) -> ufl.Form:
    """Surface load -∫ n·v w ds of a unit pressure, which pushes against the outer normal n.

    Args:
        v: test function.
        hypothesis: see :mod:`hhr_dolfinx.forms.elasticity`.
        ds: surface measure.
    """
    n = ufl.FacetNormal(ds.ufl_domain())
    return -volume_weight(ds.ufl_domain(), hypothesis) * ufl.inner(n, v) * ds
