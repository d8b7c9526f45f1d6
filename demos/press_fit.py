"""Hub pressed on a hollow shaft, in space: the shape of the hub is a parameter.

A quarter of both, mortar contact, N = 26,000. Parameters are the interference, the wall thickness of the hub and the
crowning of its bore (both change the mesh), its Young's modulus, and the speed of rotation, by which the hub loosens.

What to see: everything that contact needs is interpolated between a few shapes, and a new shape is answered in
milliseconds where the full order assembles, pairs and factors anew.

    python demos/press_fit.py [--out DIR] [--quick] [--seed N]
"""

from typing import Any

import hhr_dolfinx as hhr
from hhr_dolfinx.geometries import press_fit as geometry

RADIUS, WALL, LENGTH = 20.0, 10.0, 15.0
QUICK_MESH = {"around": 6, "hub_cells": (3, 8), "shaft_cells": (3, 10)}
RHO = "sqrt(x**2 + y**2)"
INSIDE = f"(({RHO} - {RADIUS}) / {WALL})"  # 0 at the bore, 1 outside
NEW_RHO = f"({RADIUS} + {INSIDE} * wall + (1 - {INSIDE}) * crown * (z / {LENGTH})**2)"
HUB_SHAPE = (f"x * {NEW_RHO} / {RHO}", f"y * {NEW_RHO} / {RHO}", "z")


def scene(**mesh_options: Any) -> hhr.Scene:
    """The scene in mm, MPa and tonnes."""
    names = ("interference", "wall", "crown", "E_hub")
    return hhr.Scene(
        name="press_fit",
        geometry=lambda comm: geometry.press_fit(comm, radius=RADIUS, wall=WALL, half_length=LENGTH, **mesh_options),
        hypothesis="solid",
        bodies=(hhr.Body(geometry.HUB, "E_hub", 0.3), hhr.Body(geometry.SHAFT, 210e3, 0.3)),
        contacts=(hhr.Mortar(geometry.HUB_BORE, geometry.SHAFT_OUTSIDE),),
        parameters=hhr.ParameterSpace(names, (0.01, 8.0, 0.0, 70e3), (0.03, 14.0, 0.03, 210e3)),
        displacements=tuple(hhr.Displacement(tag, axis) for axis, tags in geometry.PLANES.items() for tag in tags),
        openings=(hhr.Opening(0, hhr.Amplitude(slopes={"interference": -1.0})),),
        shapes=(hhr.Shape(geometry.HUB, HUB_SHAPE),),
    )
