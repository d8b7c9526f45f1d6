"""Models of blocks that rub, elastic or flowing, on pages and in C: made once, and their paths."""

import dataclasses
from functools import cache

import numpy as np
from condensing import TIGHT, condensed
from mpi4py import MPI
from page_scenes import in_space
from scenes import slope, space
from sheared_blocks import FIRST, SECOND, round_block, rubbing

import hhr_dolfinx as hhr
from hhr_dolfinx.geometries.two_blocks import side

EXACT = hhr.MarchSettings(relative_force=1e-11, iterations=200)


def held_by_friction(dimension):
    """The upper block is pressed and pushed aside by tractions, which friction alone bears."""
    scene = in_space(0.3, cells=3) if dimension == 3 else rubbing(geometry=round_block)
    last = dimension - 1
    top = side(SECOND, last, True)
    loads = {"push": -np.eye(dimension)[last], "shear": np.eye(dimension)[0]}
    loads |= {"aside": np.eye(dimension)[1]} if dimension == 3 else {}
    outputs = (hhr.ContactForce("pull", 0, tuple(np.eye(dimension)[0])),)
    corner = (0.0,) * last + (2.0,)
    outputs += (hhr.DisplacementAt("sinks", corner, last, SECOND),)
    return dataclasses.replace(
        scene,
        displacements=hhr.Displacement.clamp(side(FIRST, last, False), dimension),
        loads=tuple(hhr.Traction(top, tuple(way), slope(name)) for name, way in loads.items()),
        outputs=outputs,
        parameters=space(
            push=(0.0, 0.05),
            shear=(-0.01, 0.01),
            **({"aside": (-0.01, 0.01)} if dimension == 3 else {}),
        ),
    )


LOADS = [
    (0.0, 0.0),
    (0.01, 0.0),
    (0.04, 0.002),
    (0.04, 0.009),
    (0.03, 0.0),
    (0.03, -0.007),
    (0.02, 0.003),
    (0.04, 0.0),
]
"""Pressed, pushed to and fro with up to two thirds of what friction bears, and pressed again."""


def loads_of(model):
    """These loads; in space aside too, and to and fro.

    There they are smaller: where tractions turn round at half of them, Newton's statuses cycle or
    not by round-off, and where they cycle one search cuts the increment and another does not.
    """
    if model.dimension == 2:
        return [np.array(point) for point in LOADS]
    return [
        np.array([push, 0.3 * shear, 0.03 * push * np.sin(k)])
        for k, (push, shear) in enumerate(LOADS)
    ]


@cache
def held(dimension):
    """Model, scenery."""
    full = hhr.FullOrderModel(held_by_friction(dimension), MPI.COMM_SELF)
    return hhr.condense(full, fields=True), hhr.scenery_of(full)


def flowing_scene(name):
    """Blocks of which the upper one flows.

    The coefficient of friction is a parameter, or in space it has a limit.
    """
    laws = hhr.Plasticity(0.06, 0.5), hhr.Norton(0.5, 4.0)
    bodies = hhr.Body(FIRST, 3.0, 0.3), hhr.Body(SECOND, 5.0, 0.2, laws[name == "creep"])
    if name == "in space":
        outputs = (hhr.ContactForce("pull", 0, (1.0, 0.0, 0.0)),)
        return dataclasses.replace(
            in_space(hhr.Coulomb(0.6, limit=0.1), cells=2), bodies=bodies, outputs=outputs
        )
    outputs = (
        hhr.ContactForce("pull", 0, (1.0, 0.0)),
        hhr.DisplacementAt("bulges", (1.0, 1.5), 0, SECOND),
    )
    return rubbing("f", bodies=bodies, box={"f": (0.1, 0.6)}, outputs=outputs)


PUSHED = 0.0, 0.02, 0.03, 0.03, 0.02, 0.002, 0.03, 0.03
SHEARED = 0.0, 0.0, 0.02, 0.05, 0.0, -0.03, -0.02, 0.06
"""Pressed, sheared, turned round, let go, and pressed again."""


def tour(model, share=1.0, friction=0.3):
    last = [friction] if "f" in model.parameters.names else []
    rest = [[0.03 * np.sin(k)] if model.dimension == 3 else last for k in range(len(PUSHED))]
    loads = zip(PUSHED, SHEARED, rest, strict=True)
    return [np.array([share * push, share * shear, *others]) for push, shear, others in loads]


@cache
def rubbing_flow(name):
    """Condensed flow with friction, scenery."""
    full = hhr.FullOrderModel(flowing_scene(name), MPI.COMM_SELF)
    tours = tour(full), tour(full, 0.8, 0.5)
    histories = [full.march(list(enumerate(points)), TIGHT) for points in tours]
    return condensed(full, histories), hhr.scenery_of(full)
