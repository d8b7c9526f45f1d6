"""A block that lies on another one or on a floor, held by contact alone: bodies that
flow, and load paths.
"""

from dataclasses import replace

import numpy as np
from mpi4py import MPI
from scenes import lying, slope, space

import hhr_dolfinx as hhr
from hhr_dolfinx.geometries import stacked_blocks as blocks

TIGHT = hhr.MarchSettings("tangent", relative_stress=1e-10, relative_force=1e-10, floor_stress=1e-8)
PATH = [
    (0.0, np.array([1.0])),
    (1.0, np.array([4.0])),
    (2.0, np.array([9.0])),
    (3.0, np.array([6.0])),
]
LAWS = {
    "plasticity": lambda: hhr.Plasticity(6.0, 100.0),
    "creep": lambda: hhr.Norton(300.0, 3.0),
}
HELD, LOOSE, BOTH = (True, False), (False, True), (True, True)


def flowing(law, which, **changes):
    """The block that lies on another one; the laws of the lower one, of the loose one, or of
    both.
    """
    made = lying(tilt=0.2, cells=(6, 3), **({"parameters": space(p=(0.5, 12.0))} | changes))
    bodies = zip(made.bodies, which, strict=True)
    return replace(
        made, bodies=tuple(replace(body, law=LAWS[law]()) if own else body for body, own in bodies)
    )


def block_on_a_floor(law, *, held):
    """A block under a pressure on a floor: alone, or with displacements in the place of the floor,
    which is far off.
    """
    over, bottom = blocks.UPPER_BLOCK, blocks.interface(blocks.UPPER_BLOCK, 2)
    made = lying(bulge=0.0, cells=(4, 4))
    lower, upper = made.bodies
    # on the axis of symmetry; both blocks have a node at its foot
    clamp = hhr.Displacement(bottom, 1), hhr.Displacement(hhr.Nodes.near((0.5, 2.0)), 0)
    top = blocks.outer_end(over, 2)
    return replace(
        made,
        bodies=(lower, replace(upper, law=law)),
        contacts=(
            hhr.Obstacle(blocks.interface(blocks.LOWER_BLOCK, 2), (0.0, 1.0), 10.0)
            if held
            else hhr.Obstacle(bottom, (0.0, -1.0), -_height()),
        ),
        displacements=(*made.displacements, *(clamp if held else ())),
        loads=(hhr.Pressure(top, slope("p")),),
    )


def _height():
    """Height of the interface of the blocks."""
    mesh = lying(bulge=0.0, cells=(4, 4))
    full = hhr.FullOrderModel(mesh, MPI.COMM_SELF)
    return float(full.problem.contact_points[:, 1].mean())
