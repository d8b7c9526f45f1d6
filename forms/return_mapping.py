"""Isotropic flow of von Mises type in UFL, thesis section 6.2: the measure of the laws in ``materials``.

Tensors are vectors in Kelvin's notation, (xx, yy, zz, √2 xy[, √2 xz, √2 yz]), so that products of tensors are products
of vectors; zz is θθ in axisymmetry.
"""

from __future__ import annotations

import ufl

from hhr_dolfinx.forms.elasticity import strain
from hhr_dolfinx.materials.elasticity import lame_parameters
from hhr_dolfinx.materials.laws import Plasticity


def strain_vector(u, hypothesis: str, poisson=0.0):
    """Strain in Kelvin's notation: 4 components, or 6 in space."""
    e = strain(u, hypothesis, poisson)
    plane = [e[0, 0], e[1, 1], e[2, 2], 2**0.5 * e[0, 1]]
    return ufl.as_vector([*plane, 2**0.5 * e[0, 2], 2**0.5 * e[1, 2]] if hypothesis == "solid" else plane)


def return_mapping(total, plastic, plastic_strain, young, poisson, law: Plasticity):
    """Stress after a step of :class:`Plasticity` as a UFL expression, whose derivative is the consistent tangent.

    The same physics as the kernels that the solvers run, kept as their measure.

    Args:
        total: strain at the end of the step, Kelvin vector.
        plastic: plastic strain before the step, Kelvin vector.
        plastic_strain: cumulated plastic strain before the step.
        young, poisson: elastic constants.
        law: the flow.
    """
    lam, mu = lame_parameters(young, poisson)
    size = ufl.shape(total)[0] if hasattr(ufl, "shape") else total.ufl_shape[0]
    unit = ufl.as_vector([1.0, 1.0, 1.0] + [0.0] * (size - 3))
    trace = ufl.dot(unit, total)
    trial = 2 * mu * (total - plastic - trace / 3 * unit)
    q = ufl.sqrt(1.5 * ufl.dot(trial, trial))
    over = q - law.yield_stress - law.hardening * plastic_strain
    flow = ufl.conditional(ufl.gt(over, 0), over, 0) / (3 * mu + law.hardening)
    return (lam + 2 * mu / 3) * trace * unit + (1 - 3 * mu * flow / q) * trial
