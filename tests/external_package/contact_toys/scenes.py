"""Scenes of these parts."""

from __future__ import annotations

import hhr_dolfinx as hhr
from contact_toys.parts import BOTTOM, LEFT, TOP, Ramp, slab
from hhr_dolfinx.geometries.block import SOLID


def slab_on_ramp(law=None):
    """A slab that is pushed down by ``push`` on a flat ramp 0.01 below it.

    Without the ramp nothing strains it.
    """
    return hhr.Scene(
        name="slab_on_ramp",
        geometry=slab,
        hypothesis="plane_strain",
        bodies=(hhr.Body(SOLID, 3.0, 0.0 if law is None else 0.3, law=law),),
        contacts=(Ramp(BOTTOM, 0.01),),
        displacements=(
            hhr.Displacement(LEFT, 0),
            hhr.Displacement(TOP, 1, hhr.Amplitude(slopes={"push": -1.0})),
        ),
        parameters=hhr.ParameterSpace(("push",), (0.0,), (0.1,)),
    )


def flowing_slab():
    """The same slab, which creeps."""
    from contact_toys.laws import Newtonian

    return slab_on_ramp(Newtonian(viscosity=5.0))
