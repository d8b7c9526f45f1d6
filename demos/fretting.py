"""Fretting: what sticks, what slips, what wears
=============================================

A cylinder on a block is pressed down and rubbed to and fro, with Coulomb's friction. Both are of
one material, in plane strain, and contact is node to node. Parameters are the approach, the shear
and the coefficient of friction. An increment depends on the path before it, since slip is memory.

.. image:: /pictures/fretting.png
   :alt: What sticks and slips, tractions on closed forms, and the loop of a cycle

Tractions lie on the closed forms, on the way in and on the way back. The loop of tangential force
over shear closes after the first cycle, and its area is the work that friction dissipates. Wear is
largest where slip begins; where it sticks there is none.

You learn that friction needs no training: the contact is condensed exactly, and a path of
increments costs no finite elements. ``model.march`` takes the path, answers have slips and
statuses, and outputs such as wear and dissipated work are read off at any of its steps.

.. code-block:: text

    λ >= 0,  |τ| <= f λ,  τ opposed to what slips in an increment
    slack = s(μ) + S (λ, τ),    S = B K^-1 B^T
    Cattaneo, Mindlin:          sticks within c = a (1 - Q / f P)^(1/2)
                                q = f p0 [(1 - x²/a²)^(1/2) - c/a (1 - x²/c²)^(1/2)]
    back, Mindlin, Deresiewicz: what slips back takes twice f off
                                c' = a (1 - (Q* - Q) / 2 f P)^(1/2)

.. code-block:: sh

    python demos/fretting.py [--out DIR] [--quick] [--seed N]
"""

# sphinx_gallery_thumbnail_path = "pictures/fretting.png"

from collections.abc import Callable
from typing import Any

import numpy as np

import hhr_dolfinx as hhr
from hhr_dolfinx.geometries.two_blocks import FIRST, SECOND, side, two_blocks

YOUNG, POISSON, RADIUS, SIZE = 1000.0, 0.3, 1000.0, 40.0
"""MPa and mm; radius and blocks are far larger than the contact, whose surfaces are those of
half-planes.
"""
ARCHARD = 1e-4
"""Depth of wear in mm per MPa and mm."""
PUSH, SHEAR, FRICTION = 0.004, 0.00135, 0.3
OUTPUTS = (
    hhr.LargestWear("wear", 0, ARCHARD, unit="mm"), hhr.DissipatedWork("dissipated", 0, unit="N"),
    hhr.LargestSlip("slip", 0, unit="mm"), hhr.StickArea("sticks", 0, unit="mm"),
)  # fmt: skip


def cylinder(x: np.ndarray) -> np.ndarray:
    """Height of its lower side."""
    return x**2 / (2 * RADIUS)


def even_within(position: np.ndarray, part: float) -> np.ndarray:
    """Map [-1, 1] onto itself: two thirds evenly onto the inner part, the rest ever coarser."""
    share = 2 / 3
    slope = part / share
    beyond = np.maximum(np.abs(position) - share, 0.0) / (1 - share)
    outer = slope * (1 - share) * beyond + (1 - part - slope * (1 - share)) * beyond**3
    return np.sign(position) * (slope * np.minimum(np.abs(position), share) + outer)


def scene(
    cells: int = 240,
    profile: Callable[[np.ndarray], np.ndarray] = cylinder,
    friction: Any = "friction",
) -> hhr.Scene:
    """Two square blocks, the upper one with a profile, with so many cells along the contact."""

    def warp(points: np.ndarray, tag: int) -> np.ndarray:
        x, y = (SIZE * even_within(column, 3.0 / SIZE) for column in points.T)
        bulge = profile(np.clip(x, -5.0, 5.0)) * (1 - points[:, 1]) if tag == SECOND else 0.0
        return np.column_stack([x, y + bulge])

    lower = (-1.0, -1.0), (1.0, 0.0), (cells, cells // 2)
    upper = (-1.0, 0.0), (1.0, 1.0), (cells, cells // 2)
    top, face = side(SECOND, 1, True), (side(FIRST, 1, True), side(SECOND, 1, False))
    box = {"push": (0.0, 0.01), "shear": (-0.01, 0.01)}
    box |= {"friction": (0.0, 1.0)} if friction == "friction" else {}
    return hhr.Scene(
        name="fretting",
        geometry=lambda comm: two_blocks(comm, first=lower, second=upper, warp=warp),
        hypothesis="plane_strain",
        bodies=tuple(hhr.Body(tag, YOUNG, POISSON) for tag in (FIRST, SECOND)),
        contacts=(hhr.NodeToNode(*face, (0.0, 1.0), friction=friction),),
        displacements=(
            *hhr.Displacement.clamp(side(FIRST, 1, False), 2),
            hhr.Displacement(top, 0, hhr.Amplitude(slopes={"shear": 1.0})),
            hhr.Displacement(top, 1, hhr.Amplitude(slopes={"push": -1.0})),
        ),
        parameters=hhr.ParameterSpace(tuple(box), *zip(*box.values(), strict=True)),
        outputs=OUTPUTS if friction is not None else (),
        units=hhr.Units("mm", "MPa"),
    )


def main() -> None:
    """Rub, compare with the full order and with closed forms, draw."""
    from parts import cli

    from hhr_dolfinx.plugins.studies import report

    options = cli.parse_on_first_rank(cli.demo_parser("fretting", __doc__))
    from parts import fretting_study

    found = fretting_study.study(scene(120 if options.quick else 240), options)
    report.write_report(
        {"scene": "fretting", "seed": options.seed, **found, **report.environment()}, options.out
    )
    cli.print_rows("fretting", found["friction"]["reference"], options.console)


if __name__ == "__main__":
    main()
