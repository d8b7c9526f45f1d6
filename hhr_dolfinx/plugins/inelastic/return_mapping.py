"""Return mapping of von Mises type in UFL, thesis section 6.2: the reference for :mod:`plugins.inelastic.laws`.

Tensors are vectors in Kelvin's notation, (xx, yy, zz, √2 xy[, √2 xz, √2 yz]), so that products of tensors are products
of vectors; zz is θθ in axisymmetry. The plastic strain of a step is Δp along the trial stress. Each law is a residual
of Δp, so that consistent tangents follow by differentiation of stress and residual.
"""

from __future__ import annotations

import ufl
from ufl.core.expr import Expr

from hhr_dolfinx.materials.elasticity import lame_parameters
from hhr_dolfinx.plugins.inelastic.laws import Norton, Plasticity


def trial_deviator(total: Expr, plastic: Expr, shear: float) -> Expr:
    """Trial deviator 2 mu dev(ε - εp) of the stress, from Kelvin vectors of ε and of εp before the step."""
    return 2 * shear * (total - plastic - _trace(total) / 3 * _unit(total))


def equivalent(deviator: Expr) -> Expr:
    """Von Mises equivalent stress of a deviator."""
    return ufl.sqrt(1.5 * ufl.dot(deviator, deviator))


def stress_after(total: Expr, plastic: Expr, flow: Expr, young: float, poisson: float) -> Expr:
    """Stress after a step with flow Δp: the trial stress, with its equivalent stress reduced by 3 mu Δp."""
    lam, mu = lame_parameters(young, poisson)
    deviator = trial_deviator(total, plastic, mu)
    share = 1 - 3 * mu * flow / equivalent(deviator)
    return (lam + 2 * mu / 3) * _trace(total) * _unit(total) + share * deviator


def plasticity(flow: Expr, trial: Expr, plastic_strain: Expr, shear: float, law: Plasticity) -> Expr:
    """Yield function (6.23)-(6.26), σ_eq - σ0 - H p at the end of a step: zero if the point yields, else negative.

    ``trial`` is the equivalent trial stress, ``plastic_strain`` p before the step.
    """
    return trial - 3 * shear * flow - law.yield_stress - law.hardening * (plastic_strain + flow)


def norton(flow: Expr, trial: Expr, shear: float, dt: float, law: Norton) -> Expr:
    """Residual of implicit Euler for (6.28): Δp = dt (x / K)^m with the stress x = q_tr - 3 mu Δp.

    Multiplied by 3 mu this is x + 3 mu dt (x / K)^m = q_tr.
    """
    return flow - dt * ((trial - 3 * shear * flow) / law.resistance) ** law.exponent


def _unit(vector: Expr) -> Expr:
    """Kelvin vector of the unit tensor, of the length of another vector."""
    return ufl.as_vector([1.0, 1.0, 1.0] + [0.0] * (len(vector) - 3))


def _trace(vector: Expr) -> Expr:
    return vector[0] + vector[1] + vector[2]
