"""Small models of bodies that flow: coarse, quick, and as they are, where only arrays and bits count."""

import pellet_cladding_plastic as demo

import hhr_dolfinx as hhr

SMALL_MESH = {"radial_cells": 4, "axial_cells": 6, "cladding_radial_cells": 2, "cladding_axial_cells": 5}
STEPS = 6
TRAINING = (5.0, 12.0)
"""Gaps in um."""


def flowing_full():
    """Plasticity against creep in a second or two."""
    return hhr.FullOrderModel(demo.scene(**SMALL_MESH))


def flowing_reduction(full):
    """Its reduced model."""
    histories = [full.march(demo.path(gap, STEPS)) for gap in TRAINING]
    return hhr.build(full, hhr.SnapshotSet.of_histories(histories), hhr.Recipe.flowing().as_it_is())
