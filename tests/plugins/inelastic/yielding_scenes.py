"""Bars and blocks that yield: scenes and their load paths."""

import numpy as np
from dolfinx.mesh import compute_midpoints, meshtags
from scenes import block_scene, pressed_pair, slope
from tubes import POISSON, YOUNG

import hhr_dolfinx as hhr
from hhr_dolfinx.geometries import block, two_blocks


def bar(law, reach=0.1, young=YOUNG, loads=(), **space):
    """A cylinder pulled and pushed along its axis, free at its side: uniaxial stress."""
    up, box = block.side(1, upper=True), {"pull": (-reach, reach)} | space
    held = (hhr.Displacement(block.side(axis, upper=False), axis) for axis in (0, 1))
    return block_scene(
        "bar",
        box,
        upper=(1, 2),
        cells=(2, 2),
        hypothesis="axisymmetric",
        bodies=(hhr.Body(block.SOLID, young, POISSON, law),),
        contacts=(hhr.Obstacle(block.side(0, upper=True), (1, 0), 2.0),),  # far away
        displacements=(*held, hhr.Displacement(up, 1, slope("pull", 2.0))),
        loads=loads,
    )


def axial(history):
    """The stress along the bar, the same everywhere."""
    stresses = np.array([answer.stress()[:, 1] for answer in history.answers])
    assert np.ptp(stresses, axis=1).max() < 1e-6
    return stresses[:, 0]


MATERIALS = {"E1": (2.0, 4.0), "E2": (2.0, 9.0)}
"""Of two blocks on each other, by their bounds."""


def blocks(first, second, hypothesis="solid", materials=MATERIALS, cells=2, **others):
    """The lower one yields; imposed displacements move the upper one."""
    yields = hhr.Plasticity(0.05, 0.2)
    bodies = (
        hhr.Body(two_blocks.FIRST, first, 0.3, yields),
        hhr.Body(two_blocks.SECOND, second, 0.35),
    )
    return pressed_pair(hypothesis, bodies, materials, cells=cells, **others)


def push(*moduli, steps=4):
    shares = np.arange(steps + 1) / steps
    return [
        (float(s), np.array([0.005 + 0.045 * s, 0.01 * s, 0.05 * s, 0.001, *moduli]))
        for s in shares
    ]


def glued(first, second, materials):
    """One column of two layers that hang together, on a rigid floor: both moduli act on the nodes
    between.
    """

    def geometry(comm):
        mesh, _, facets = block.block(comm, lower=(0, 0), upper=(1, 2), cells=(3, 4))
        cells = np.arange(mesh.topology.index_map(2).size_local, dtype=np.int32)
        upper = compute_midpoints(mesh, 2, cells)[:, 1] > 1
        return mesh, meshtags(mesh, 2, cells, np.where(upper, 2, 1).astype(np.int32)), facets

    lid = block.side(1, upper=True)
    return block_scene(
        "glued",
        {"push": (0.0, 0.1)} | materials,
        geometry=geometry,
        bodies=(hhr.Body(1, first, 0.3, hhr.Plasticity(0.05, 0.2)), hhr.Body(2, second, 0.3)),
        contacts=(hhr.Obstacle(block.side(1, upper=False), (0, -1), 0.005),),
        displacements=(hhr.Displacement(lid, 0), hhr.Displacement(lid, 1, slope("push", -1.0))),
    )


def pressed(*moduli):
    return [(float(k), np.array([0.02 * k, *moduli])) for k in range(5)]
