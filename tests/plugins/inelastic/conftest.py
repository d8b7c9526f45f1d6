"""Models of the tests of inelastic bodies, each made once."""

import condensing
import flowing
import pellet_cladding_plastic as demo
import pytest
from scenes import block_scene, slope

import hhr_dolfinx as hhr
from hhr_dolfinx.geometries import block


@pytest.fixture(scope="session")
def tubes():
    return condensing.tubes()


@pytest.fixture(scope="session")
def pellet():
    return condensing.pellet()


@pytest.fixture(scope="session")
def demo_pellet():
    """The demo's scene on a coarse mesh, and histories at both ends of its gap."""
    full = hhr.FullOrderModel(demo.scene(**flowing.DEMO_MESH))
    return full, [full.march(demo.path(gap, 20)) for gap in (5.0, 15.0)]


@pytest.fixture(scope="session")
def cantilever():
    """A block held on its left over a floor, pressed on its lid by A and pulled to its right by
    B.
    """
    left, right = block.side(0, False), block.side(0, True)
    return hhr.FullOrderModel(
        block_scene(
            "cantilever",
            {"A": (0.0, 2.0), "B": (-1.0, 1.0)},
            upper=(3, 2),
            cells=(15, 6),
            bodies=(hhr.Body(block.SOLID, 200.0, 0.3, hhr.Plasticity(1.0, 5.0)),),
            contacts=(hhr.Obstacle(block.side(1, False), (0, -1), 0.002),),
            displacements=hhr.Displacement.clamp(left, 2),
            loads=(
                hhr.Pressure(block.side(1, True), slope("A")),
                hhr.Traction(right, (0.0, 1.0), slope("B")),
            ),
        )
    )
