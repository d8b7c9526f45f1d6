"""Trace forms on a contact surface.

The contact matrix B of thesis (1.27) is nodal, without weights. Surface integrals are
needed for the tributary area of a node only, which turns a nodal force into a pressure;
it is read from the first component of a vector test function.
"""

from __future__ import annotations

from hhr_dolfinx.forms.elasticity import volume_weight


def tributary_area(v, hypothesis: str, ds):
    """Form ∫ v_0 w ds: the area that belongs to each node of the surface."""
    return volume_weight(ds.ufl_domain(), hypothesis) * v[0] * ds
