"""Extreme cases of meshes that do not match, for ``extreme_cases.py``."""

import dataclasses
from collections.abc import Iterator

import contact_patch_test as patch
import numpy as np
import pellet_cladding_nonmatching as demo
from mpi4py.MPI import Comm
from pellet_cladding import QUICK_MESH as MESH
from verify import Case

import hhr_dolfinx as hhr
from hhr_dolfinx.geometries import pellet_cladding as geometry


def non_matching_cases() -> Iterator[Case]:
    """Ratios of meshes, swapped and curved surfaces, turned scenes, double passes, one slave
    node.
    """
    for pairing in ("node_to_surface", "mortar"):
        coarse = demo.scene(pairing, **MESH, cladding_axial_cells=1)
        yield Case(f"mesh ratio 20:1, slave finer, {pairing}", coarse)
        side = getattr(hhr, demo.PAIRINGS[pairing])(
            geometry.CLADDING_INNER, geometry.PELLET_SIDE, normal=(-1.0, 0.0)
        )
        swapped = dataclasses.replace(coarse, contacts=(side, *coarse.contacts[1:]))
        yield Case(f"mesh ratio 1:20, slave coarser, {pairing}", swapped)
        yield Case(f"curved gap, {pairing}", barrelled(pairing))
    for angle in (0.0, 2**0.5):
        blocks = patch.scene(
            hhr.NodeToSurface, (8, 4), (11, 4), poisson=0.3, angle=angle, bulge=0.02
        )
        yield Case(f"blocks turned by {angle:.4g} rad", blocks)
    yield Case(
        "double pass, 20 on 15 cells", demo.scene("double_pass", **MESH, cladding_axial_cells=15)
    )
    yield Case(
        "double pass, all rows twice", demo.scene("double_pass", **MESH, cladding_axial_cells=20)
    )
    yield Case(
        "double pass, 30 on 31 cells", patch.scene(hhr.DoublePass, (30, 4), (31, 4), poisson=0.3)
    )
    yield Case(
        "one slave node", patch.scene(hhr.NodeToSurface, (3, 3), (1, 1), poisson=0.3, shift=0.9)
    )


def barrelled(pairing: str) -> hhr.Scene:
    """The gap between pellet and cladding wider by 1 to 4 um towards both ends.

    Normals found by the pairing.
    """
    base = demo.scene(pairing, **MESH, cladding_axial_cells=15)

    def bent(comm: Comm) -> tuple:
        mesh, *tags = base.geometry(comm)
        x = mesh.geometry.x
        # nothing moves at the outer radius, which stays a straight line
        through = np.clip((4.672 - x[:, 0]) / 0.57, 0.0, 1.0) * (x[:, 0] > 4.101)
        x[:, 0] += through * (1e-3 + 3e-3 * (x[:, 1] / 3.5 - 1) ** 2)
        return mesh, *tags

    side = getattr(hhr, demo.PAIRINGS[pairing])(geometry.PELLET_SIDE, geometry.CLADDING_INNER)
    return dataclasses.replace(base, geometry=bent, contacts=(side, *base.contacts[1:]))
