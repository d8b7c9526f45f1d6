"""Scenes whose surfaces slide: images that face each other whatever acts, a block on a table."""

import numpy as np
from scenes import pair_scene, slope

import hhr_dolfinx as hhr
from hhr_dolfinx.geometries.two_blocks import FIRST, SECOND, side

UPPER, LOWER = side(SECOND, 1, False), side(FIRST, 1, True)
DOWN = (0.0, -1.0)


def mirrored(pairing, **others) -> hhr.Scene:
    """Two blocks, each the image of the other: nodes of their round sides face each other whatever
    symmetric acts.

    The left flanks are imposed down to the surfaces in contact, and draw both blocks onto tools on
    their right.
    """

    def warp(points, tag):
        x, y = points.T
        return np.column_stack(
            [x, y + (-0.02 if tag == FIRST else 0.02) * (x - 1) ** 2 * (1 - abs(y))]
        )

    sides = [(body, 1, upper) for body, upper in ((FIRST, False), (SECOND, True))]
    pushed = [
        hhr.Displacement(side(*one), 1, slope("push", sign))
        for one, sign in zip(sides, (1.0, -1.0), strict=True)
    ]
    drawn = [hhr.Displacement(side(body, 0, False), 0, slope("drag")) for body in (FIRST, SECOND)]
    tools = [
        hhr.Circle(side(body, 0, True), center=(3.01, 0.0), radius=1.0, friction=0.5)
        for body in (FIRST, SECOND)
    ]
    outputs = (
        hhr.ContactForce("between", 0, (0.0, 1.0)),
        hhr.ContactForce("tool", 1, (1.0, 0.0)),
        hhr.ContactForce("rubs", 2, (0.0, 1.0)),
        hhr.LargestPressure("peak", 1),
        hhr.LargestPressure("peak between", 0),
        hhr.ContactWidth("width", 0),
        hhr.LostContact("lost", 0),
        hhr.DisplacementAt("moved", (2.0, 0.67), 1),
        hhr.ElasticEnergy("energy"),
    )
    return pair_scene(
        "mirrored",
        {"push": (-0.1, 0.1), "drag": (0.0, 0.2), "gap": (-0.1, 0.1)},
        ((0.0, -1.0), (2.0, 0.0), (6, 3)),
        ((0.0, 0.0), (2.0, 1.0), (6, 3)),
        ((100.0, 0.3),) * 2,
        warp=warp,
        contacts=(pairing(UPPER, LOWER, DOWN), *tools),
        displacements=(*pushed, *drawn),
        outputs=outputs,
        **others,
    )


ROUND_TRIP = [
    (0.0, (0.0, 0.0, 0.0)),
    (1.0, (0.03, 0.0, 0.0)),
    (2.0, (0.03, 0.05, 0.01)),
    (3.0, (0.05, 0.04, -0.01)),
    (4.0, (-0.02, 0.06, 0.0)),
    (5.0, (0.02, 0.07, 0.0)),
    (6.0, (0.0199, 0.07, 0.0)),
]
"""Times, and push, drag and gap: contacts close and open, and tools press, slip and stick."""
OPENINGS = {
    "of the tools": tuple(hhr.Opening(place, slope("gap", 0.5)) for place in (1, 2)),
    "added": (
        hhr.Opening(0, hhr.Amplitude(0.002, slopes={"gap": 1.0})),
        hhr.Opening(0, hhr.Amplitude(0.001)),
    ),
    "overwritten": (
        hhr.Opening(0, slope("gap"), overwrites=True),
        hhr.Opening(0, hhr.Amplitude(0.001)),
    ),
}

YOUNG, HEIGHT, PUSH = 1000.0, 2.0, 0.02
"""Of the drawn block, without Poisson's ratio, on one a million times as stiff."""


def drawn(law, pairing=hhr.NodeToSurface) -> hhr.Scene:
    """A block pressed on a table, and drawn over 16 of its cells."""
    top = side(SECOND, 1, True)
    return pair_scene(
        "drawn",
        {"push": (0.0, 0.1), "way": (0.0, 12.0)},
        ((-6.0, -1.0), (6.0, 0.0), (25, 2)),
        ((-5.0, 0.0), (-3.0, HEIGHT), (4, 4)),
        ((1e6 * YOUNG, 0.0), (YOUNG, 0.0)),
        contacts=(pairing(side(SECOND, 1, False), side(FIRST, 1, True), law=law),),
        displacements=(
            *hhr.Displacement.clamp(side(FIRST, 1, False), 2),
            hhr.Displacement(top, 0, slope("way")),
            hhr.Displacement(top, 1, slope("push", -1.0)),
        ),
        outputs=(hhr.ContactForce("bears", 0, (0.0, 1.0)),),
    )


PATH = [(0.0, (0.0, 0.0)), *((1.0 + k, (PUSH, 1.1 * k)) for k in range(7))]
SOFT, WEARS = hhr.SoftContact(stiffness=60.0), hhr.ArchardWear(constant=0.05)
