"""Sliding punch: contact that travels
===================================

A round punch is pressed on a block and drawn over it, by many times the width of its contact.
Parameters are how deep the punch is pushed and how far it is drawn. Surfaces that are paired once
would lose each other, so that rows of contact are made anew in every increment.

.. image:: /pictures/sliding_punch.png
   :alt: Pressures where the punch has come to, and the pressing and the drawing force over the way

The same pressure goes along with the punch. The tangential force grows until all of the contact
slips, and stays; towards the end of the block the compliance grows, and the forces fall. Forces of
the condensed model and of the full order agree to round-off, and a mesh that is made at the place
of the punch gives the same force to 0.3 %.

You learn what ``hhr.slide`` is for: the compliance between all dofs of both surfaces is made once,
and pairing is renewed on it. Use it when contact moves by more than a cell. It buys no speed on a
mesh as small as this one, where most of an increment is the search for what touches.

.. code-block:: text

    S = R C R^T,    R = R(u)    rows R where the punch has come to; C of 290 dofs
    P, a, p0                   Hertz, line contact: peak and width go along with the punch

.. code-block:: sh

    python demos/sliding_punch.py [--out DIR] [--quick] [--seed N]
"""

# sphinx_gallery_thumbnail_path = "pictures/sliding_punch.png"

from typing import Any

import numpy as np

import hhr_dolfinx as hhr
from hhr_dolfinx.geometries.two_blocks import FIRST, SECOND, side, two_blocks

RADIUS, START, FRICTION = 4.0, -4.0, 0.3
PUSH, WAY, STEPS = 0.03, 8.0, 80
BLOCK_E, PUNCH_E, POISSON = 1000.0, 3000.0, 0.3


def punch(start: float, height: float = 0.0) -> Any:
    """What makes the lower side of the upper block round, and puts it above ``start``."""

    def warp(points: np.ndarray, tag: int) -> np.ndarray:
        if tag == FIRST:
            return points
        bulge = points[:, 0] ** 2 / (2 * RADIUS) * (1 - points[:, 1])
        return np.column_stack([points[:, 0] + start, points[:, 1] + bulge + height])

    return warp


def geometry(comm: Any, cells: int = 120, start: float = START, height: float = 0.0) -> Any:
    """A block of 12 by 4, and a punch of 2 by 1 above ``start``."""
    lower = (-6.0, -4.0), (6.0, 0.0), (cells, cells // 4)
    upper = (-1.0, 0.0), (1.0, 1.0), (cells // 5, cells // 10)
    return two_blocks(comm, first=lower, second=upper, warp=punch(start, height))


def scene(friction: float | None = FRICTION, **mesh: Any) -> hhr.Scene:
    """The scene in mm and MPa."""
    top = side(SECOND, 1, True)
    moved = {0: hhr.Amplitude(slopes={"way": 1.0}), 1: hhr.Amplitude(slopes={"push": -1.0})}
    return hhr.Scene(
        name="sliding_punch",
        geometry=lambda comm: geometry(comm, **mesh),
        hypothesis="plane_strain",
        bodies=(hhr.Body(FIRST, BLOCK_E, POISSON), hhr.Body(SECOND, PUNCH_E, POISSON)),
        contacts=(
            hhr.NodeToSurface(side(SECOND, 1, False), side(FIRST, 1, True), friction=friction),
        ),
        displacements=(
            *hhr.Displacement.clamp(side(FIRST, 1, False), 2),
            *(hhr.Displacement(top, axis, amplitude) for axis, amplitude in moved.items()),
        ),
        parameters=hhr.ParameterSpace(("push", "way"), (0.0, 0.0), (0.05, WAY)),
        outputs=(
            hhr.ContactForce("pressed", 0, (0.0, 1.0)),
            hhr.ContactForce("drawn", 0, (-1.0, 0.0)),
        ),
    )


def path(steps: int = STEPS) -> list:
    """Pushed, then drawn."""
    return [
        (0.0, (0.0, 0.0)),
        *((1.0 + k, (PUSH, way)) for k, way in enumerate(np.linspace(0.0, WAY, steps + 1))),
    ]


def main() -> None:
    """Condense, draw the punch over the block, compare with the full order, draw the picture."""
    from parts import cli

    from hhr_dolfinx.plugins.studies import report

    options = cli.parse_on_first_rank(cli.demo_parser("sliding_punch", __doc__))
    from parts import sliding_punch_study

    cells = 60 if options.quick else 120
    found = sliding_punch_study.study(scene(cells=cells), cells, options)
    report.write_report(
        {"scene": "sliding_punch", "seed": options.seed, **found, **report.environment()},
        options.out,
    )
    cli.print_rows("a punch drawn over a block", found["friction"]["reference"], options.console)
    times = found["friction"]["times"]
    options.console.print(
        f"drawn by {found['friction']['widths']:.1f} widths of its contact; an increment: "
        f"condensed {1e3 * times['condensed']:.1f} ms, full order {1e3 * times['full order']:.1f} "
        f"ms, forces differ by {found['friction']['errors']['forces']:.1e}"
    )


if __name__ == "__main__":
    main()
