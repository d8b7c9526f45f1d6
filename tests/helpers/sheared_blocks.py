"""A block pressed on another one and sheared, with friction between them."""

from __future__ import annotations

import dataclasses

import numpy as np
from scenes import pair_scene, slope

import hhr_dolfinx as hhr
from hhr_dolfinx.geometries.two_blocks import FIRST, SECOND, side, two_blocks

PATH = [
    (0.0, (0.0, 0.0)),
    (1.0, (0.03, 0.0)),
    *((2.0 + k, (0.03, s)) for k, s in enumerate((0.02, 0.06, 0.0, -0.06))),
]


def rubbing(friction=0.3, cells=8, pairing=None, dimension=2, **others) -> hhr.Scene:
    """A block pressed on another one and sheared; in space aside too if the box has ``aside``."""
    last = dimension - 1
    first, second = (
        (np.zeros(dimension), np.ones(dimension)),
        (np.zeros(dimension), np.ones(dimension)),
    )
    second[0][last], second[1][last] = 1.0, 2.0
    faces = side(FIRST, last, True), side(SECOND, last, False)
    top = side(SECOND, last, True)
    normal = tuple(np.eye(dimension)[last])
    box = {"push": (0.0, 0.05), "shear": (-0.1, 0.1), **others.pop("box", {})}
    aside = {1: slope("aside") if "aside" in box else hhr.Amplitude()}
    moved = {0: slope("shear")} | aside | {last: slope("push", -1.0)}
    n = (cells,) * dimension
    given = {
        "hypothesis": "plane_strain" if dimension == 2 else "solid",
        "bodies": ((3.0, 0.3), (5.0, 0.2)),
        "contacts": (pairing or hhr.NodeToNode(*faces, normal, friction=friction),),
        "displacements": (
            *hhr.Displacement.clamp(side(FIRST, last, False), dimension),
            *(hhr.Displacement(top, axis, amplitude) for axis, amplitude in moved.items()),
        ),
    }
    return pair_scene("rubbing", box, (*first, n), (*second, n), **given | others)


def lifted(comm, lift, cells):
    """The same blocks, of which the upper one is lifted by a function of the place."""
    low, up = np.zeros(len(cells)), np.eye(len(cells))[-1]

    def warp(points, tag):
        return points + np.outer(lift(*points.T) * (tag == SECOND), up)

    return two_blocks(comm, warp=warp, first=(low, low + 1, cells), second=(up, up + 1, cells))


def round_block(comm):
    """Of which the upper one touches with a round side."""
    return lifted(comm, lambda x, y: 0.2 * (x - 0.5) ** 2 * (2 - y), (24, 24))


def leaning(comm):
    """Of which the upper one is lifted at its right side."""
    return lifted(comm, lambda x, y: 0.03 * x, (8, 8))


def driven(dimension=2, **others) -> hhr.Scene:
    """The same blocks with sides that are held below and moved above: of contacts there both sides
    are imposed.
    """
    scene = rubbing(dimension=dimension, cells=8 if dimension == 2 else 3, **others)
    sides = (
        hhr.Displacement(side(FIRST, 0, False), 0),
        hhr.Displacement(side(SECOND, 0, False), 0, slope("shear")),
    )
    return dataclasses.replace(scene, displacements=(*scene.displacements, *sides))
