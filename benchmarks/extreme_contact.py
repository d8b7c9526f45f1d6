"""Extreme contact, for ``extreme_cases.py``: press fits, half-discs by poor recipes, pairs of
unlike forces.
"""

import dataclasses
from collections.abc import Iterator

import contact_patch_test as patch
import hertz_half_discs as discs
import numpy as np
import pellet_cladding as demo
from three_rings import three_rings
from verify import Case, Known

import hhr_dolfinx as hhr
from hhr_dolfinx.geometries import pellet_cladding, two_blocks

MESH = demo.QUICK_MESH


def contact_cases() -> Iterator[Case]:
    """Contact that never opens, forces outside the RID, contact that counts as round-off, unlike
    pairs.
    """
    # so small a RID leaves most forces to be completed
    small, tall = hhr.Recipe(domain=hhr.Rid(layers=0)), {**MESH, "axial_cells": 40}
    yield Case("press fit, contact never opens", demo.scene("held", **tall, gap=-0.01), small)
    fitted = demo.scene("held", **tall, gap=0.0)
    space = hhr.ParameterSpace(("P1", "h1", "gap"), (5.0, 0.6, -0.01), (200.0, 6.0, 0.0))
    opening = hhr.Opening(0, hhr.Amplitude(slopes={"gap": 1.0}))
    fitted = dataclasses.replace(fitted, parameters=space, openings=(opening,))
    yield Case("opening in [-0.01, 0]", fitted, small, counts=(6, 5, 5))
    yield Case("three shrink-fitted rings", three_rings())
    # contact grows steadily there, and a tenth is wrong; where a single node touches is hit by one
    # point in a hundred
    strict = {"tests": 200, "worst_force": 0.1}
    yield Case("half-discs, thesis recipe", discs.scene(), discs.THESIS, counts=(31,), **strict)
    bare = hhr.Recipe(
        hhr.Pod(2.1e-6, relative=True), (hhr.Deim(), hhr.LoadNodes()), hhr.Rid(layers=0)
    )
    yield Case("half-discs, few modes, no layers, no dual DEIM", discs.scene(), bare, counts=(31,))
    yield Case("curved block on 21 points", curved_block(), bare, counts=(21,))
    yield Case("half-discs carried by 1e8 m", carried(1e8), counts=(31,))
    yield Case(
        "forces 1e11 apart",
        unlike(),
        counts=(21,),
        known=Known("pressure of a block", off_pressure, 1e-6),
    )
    base = demo.scene(**MESH)
    far = hhr.Obstacle(pellet_cladding.CLADDING_OUTER, (1.0, 0.0), 1e8)
    yield Case("far obstacle at 1e8", dataclasses.replace(base, contacts=(*base.contacts, far)))


def curved_block() -> hhr.Scene:
    """The upper of two blocks, bulged, pushed down from where it does not touch."""
    base = patch.scene(hhr.NodeToSurface, (8, 4), (11, 4), poisson=0.3, bulge=0.02)
    space = hhr.ParameterSpace(("push",), (0.0,), (0.1,))
    return dataclasses.replace(base, parameters=space, loads=())


def carried(length: float) -> hhr.Scene:
    """The half-discs, moved aside by a length as they are pressed."""
    base = discs.scene()
    moved = tuple(
        dataclasses.replace(item, amplitude=hhr.Amplitude(length)) if item.component == 0 else item
        for item in base.displacements
    )
    return dataclasses.replace(base, displacements=moved)


def unlike() -> hhr.Scene:
    """Two blocks of E = 1e11 and 1, each on a floor of its own.

    A side pull lifts a part of the soft one.

    The stiff one is squeezed between its top and its floor, free at its sides: its pressure is
    known.
    """
    shape = {"first": ((0.0, 0.0), (1.0, 1.0), (4, 4)), "second": ((3.0, 0.0), (4.0, 1.0), (6, 4))}
    down = hhr.Amplitude(slopes={"push": -1.0})
    floors = [hhr.Obstacle(two_blocks.side(body, 1, False), (0.0, -1.0), 0.0) for body in (1, 2)]
    return hhr.Scene(
        name="unlike_blocks",
        geometry=lambda comm: two_blocks.two_blocks(comm, **shape),
        hypothesis="plane_strain",
        bodies=(hhr.Body(1, 1e11, 0.3), hhr.Body(2, 1.0, 0.3)),
        contacts=tuple(floors),
        parameters=hhr.ParameterSpace(("push",), (0.01,), (0.05,)),
        displacements=(
            hhr.Displacement(two_blocks.side(1, 0, False), 0),
            *(hhr.Displacement(two_blocks.side(body, 1, True), 1, down) for body in (1, 2)),
            hhr.Displacement(two_blocks.side(2, 1, True), 0),
        ),
        loads=(hhr.Traction(two_blocks.side(2, 0, False), (0.0, 1.0), hhr.Amplitude(0.03)),),
    )


def off_pressure(full: hhr.FullOrderModel) -> float:
    """Relative error of the stiff block's contact force, E push / (1 - nu^2) per unit of length."""
    forces = full.solve(0.03).forces()[full.problem.contact_pairs == 0]
    return float(abs(np.sum(forces) / (1e11 * 0.03 / (1 - 0.3**2)) - 1))
