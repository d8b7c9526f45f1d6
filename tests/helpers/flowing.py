"""Small models of bodies that flow: coarse, quick, and as they are, where only arrays and bits
count.
"""

import dataclasses

import numpy as np
import pellet_cladding_plastic as demo

import hhr_dolfinx as hhr

SMALL_MESH = {
    "radial_cells": 4,
    "axial_cells": 6,
    "cladding_radial_cells": 2,
    "cladding_axial_cells": 5,
}
DEMO_MESH = {
    "radial_cells": 12,
    "axial_cells": 20,
    "cladding_radial_cells": 3,
    "cladding_axial_cells": 15,
}
"""On which the errors of the demo hold."""
STEPS = 6
TRAINING = (5.0, 12.0)
"""Gaps in um."""
PELLET_SPACE = hhr.ParameterSpace(
    ("P1", "h1", "gap", "E", "w"), (0.0, 0.5, 4e-3, 150e3, 0.8), (460.0, 1.5, 16e-3, 230e3, 1.2)
)


def flowing_full():
    """Plasticity against creep in a second or two."""
    return hhr.FullOrderModel(demo.scene(**SMALL_MESH))


def flowing_reduction(full):
    """Its reduced model."""
    histories = [full.march(demo.path(gap, STEPS)) for gap in TRAINING]
    return hhr.build(full, hhr.SnapshotSet.of_histories(histories), hhr.Recipe.flowing().as_it_is())


def pellet_of_moduli(**others):
    """The small flowing scene with moduli of parameters."""
    base = demo.scene(**SMALL_MESH)
    moduli = zip(base.bodies, ("E", "78e3 * w"), strict=True)
    bodies = tuple(dataclasses.replace(body, young=young) for body, young in moduli)
    return dataclasses.replace(base, **({"bodies": bodies, "parameters": PELLET_SPACE} | others))


def pellet_path(gap=10.0, young=200e3, w=1.1, steps=STEPS):
    """A path of that scene."""
    return [(time, np.append(point, (young, w))) for time, point in demo.path(gap, steps)]
