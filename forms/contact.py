"""Trace forms on a contact surface.

The contact matrix B of thesis (1.27) is nodal, without weights: a row is ∫ λ n·v over the tributary
area of its multiplier. This area also converts a nodal force to a pressure. It is read from the
first component of a vector test function.
"""

from __future__ import annotations

import ufl
from ufl.core.expr import Expr

from hhr_dolfinx.forms.elasticity import volume_weight


def tributary_area(v: Expr, hypothesis: str, ds: ufl.Measure) -> ufl.Form:
    """Form ∫ v_0 w ds: the area that belongs to each node of the surface.

    Args:
        v: vector test function.
        hypothesis: see :mod:`hhr_dolfinx.forms.elasticity`.
        ds: surface measure.
    """
    return volume_weight(ds.ufl_domain(), hypothesis) * v[0] * ds


def coupling(v: Expr, multiplier: Expr, hypothesis: str, ds: ufl.Measure) -> ufl.Form:
    """Slave side of the contact coupling, b(v, λ) = ∫ λ n·v w ds.

    n is the outer normal of the surface.

    Args:
        v: vector test function.
        multiplier: multiplier λ.
        hypothesis: see :mod:`hhr_dolfinx.forms.elasticity`.
        ds: surface measure.
    """
    weight = volume_weight(ds.ufl_domain(), hypothesis)
    return weight * multiplier * ufl.dot(ufl.FacetNormal(ds.ufl_domain()), v) * ds
