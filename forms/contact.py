"""Trace forms on a contact surface.

The contact matrix B of thesis (1.27) is nodal, without weights. Surface integrals are
needed for two things only: the tributary area of a node, which turns a nodal force into
a pressure, and the mean outer normal at a node, which tells where a surface looks.
Both are read from the first component of a vector test function.
"""

from __future__ import annotations

import ufl

from hhr_dolfinx.forms.elasticity import volume_weight


def tributary_area(v, hypothesis: str, ds):
    """Form ∫ v_0 w ds: the area that belongs to each node of the surface."""
    return volume_weight(ds.ufl_domain(), hypothesis) * v[0] * ds


def facing(v, direction, ds):
    """Form ∫ (n·e) v_0 ds: positive at nodes whose outer normal n looks along the direction e."""
    return ufl.inner(ufl.FacetNormal(ds.ufl_domain()), ufl.as_vector(direction)) * v[0] * ds
