"""Two blocks on meshes that do not match: a shrink fit, and contact between all sides of both."""

import numpy as np
from dolfinx import mesh as dmesh
from scenes import pair_scene, slope

import hhr_dolfinx as hhr
from hhr_dolfinx.geometries import two_blocks


def shrink_fit(pairing, cells, interference=1e-6, simplices=False):
    """Cylinder 1 <= r <= 2 in a cylinder 2 <= r <= 3, too large by ``interference``, held
    axially.
    """
    inner, outer = two_blocks.FIRST, two_blocks.SECOND
    axial = [
        hhr.Displacement(two_blocks.side(body, 1, upper), 1)
        for body in (inner, outer)
        for upper in (False, True)
    ]
    return pair_scene(
        "shrink_fit",
        {"p": (0.0, 1.0)},
        ((1.0, 0.0), (2.0, 0.5), (cells, cells // 2)),
        ((2.0 - interference, 0.0), (3.0, 0.5), (cells, 3 * cells // 4)),
        ((10.0, 0.3), (4.0, 0.2)),
        simplices=simplices,
        hypothesis="axisymmetric",
        contacts=(
            pairing(two_blocks.side(outer, 0, False), two_blocks.side(inner, 0, True), (-1.0, 0.0)),
        ),
        displacements=tuple(axial),
        loads=(hhr.Pressure(two_blocks.side(outer, 0, True), slope("p")),),
    )


def outsides(first, second, kept, simplices=False):
    """Blocks whose surfaces 1 and 2 are all sides of each that are not among those ``kept``."""

    def geometry(comm):
        mesh, bodies, sides = two_blocks.two_blocks(
            comm, first=first, second=second, simplices=simplices
        )
        values = np.where(np.isin(sides.values, kept), sides.values, sides.values // 100)
        return mesh, bodies, dmesh.meshtags(mesh, sides.dim, sides.indices, values.astype(np.int32))

    return geometry
