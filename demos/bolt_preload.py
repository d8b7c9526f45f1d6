"""Preload of a hot bolt over years of creep
=========================================

A bolt of steel clamps two flanges of another steel; half of the joint is modelled, axisymmetric,
up to its plane of symmetry. The nut is turned, the joint is heated, held for months, cooled for a
shutdown, and heated again. The bolt creeps by Arrhenius' law and loses stiffness as it gets hot,
the flange grows more than the bolt, and the head slips on it with friction.

.. image:: /pictures/bolt_preload.png
   :alt: Clamp force over six years for three turns of the nut, with a shutdown after three years

The tighter the bolt, the faster its preload goes. A shutdown takes some of it for a while, as the
flange shrinks more than the bolt, and heating brings it back. The small model follows years of
this in about a second, with all contact forces and slips, and its clamp force is right to some
newtons of twenty thousand.

You learn how to train on a family of histories instead of on points: ``life`` states what all of
them have in common, and twelve of them are enough for durations, temperatures and turns that were
not trained. Laws with numbers that depend on temperature are given as formulas, as here for creep
and for Young's modulus.

.. code-block:: text

    dp/dt = (q / K)^n exp(-A (1/T - 1/T0)),    E(T) = E0 (1 - c (T - T_room))
    ε = ε_e + ε_p + α (T - T_room) I
    B u <= g,  λ >= 0,  λ·(B u - g) = 0,    |λ_t| <= f λ_n    under the head

.. code-block:: sh

    python demos/bolt_preload.py [--out DIR] [--quick] [--seed N]
"""

# sphinx_gallery_thumbnail_path = "pictures/bolt_preload.png"

from pathlib import Path
from typing import Any

import gmsh
import numpy as np
from bolted_joint import named_lines

import hhr_dolfinx as hhr
from hhr_dolfinx.timing import timed

SHANK, HEAD, RIM, GRIP, TOP = 5.0, 9.0, 20.0, 15.0, 22.0
"""Radii of shank and hole, head and flange, and heights of flange and head over the middle plane,
in mm.
"""
LINES = {  # body, and box (r, z, r, z) of the lines of its section
    "axis": ("bolt", (0, 0, 0, TOP)),
    "middle": ("bolt", (0, 0, SHANK, 0)),
    "head": ("bolt", (SHANK, GRIP, HEAD, GRIP)),
    "top": ("flange", (SHANK, GRIP, RIM, GRIP)),
    "foot": ("flange", (SHANK, 0, RIM, 0)),
}
ROOM, HOUR, YEAR = 293.0, 3600.0, 8760 * 3600.0
BOX = {"turn": (0.0, 0.05), "warmer": (0.0, 500.0)}
"""Shortening of half the bolt in mm, and temperature above that of the room in K."""
CREEP = hhr.Arrhenius(2e4, 5.0, 3e4, f"{ROOM} + warmer", 773.0)
BOLT = hhr.ChangingStiffness(CREEP, "210e3 * (1 - 3e-4 * warmer)")


def mesh(file: Path, size: float) -> Path:
    """Quadrilaterals of the section, by gmsh."""
    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    occ = gmsh.model.occ
    shank, head = (
        occ.addRectangle(0, 0, 0, SHANK, GRIP),
        occ.addRectangle(0, GRIP, 0, HEAD, TOP - GRIP),
    )
    sections = {"bolt": occ.fuse([(2, shank)], [(2, head)])[0]}
    sections["flange"] = [(2, occ.addRectangle(SHANK, 0, 0, RIM - SHANK, GRIP))]
    occ.synchronize()
    named_lines(sections, LINES)
    for option, value in {
        "MeshSizeMax": 2 * size,
        "Algorithm": 8,
        "RecombineAll": 1,
        "SubdivisionAlgorithm": 1,
    }.items():
        gmsh.option.setNumber(f"Mesh.{option}", value)
    gmsh.model.mesh.generate(2)
    gmsh.write(str(file))
    gmsh.finalize()
    return file


def scene(file: Path) -> hhr.Scene:
    """The scene on a mesh file, in mm, MPa, K and s."""
    return hhr.Scene(
        name="bolt_preload",
        geometry=hhr.MeshFile(file),
        hypothesis="axisymmetric",
        units=hhr.Units("mm", "MPa"),
        bodies=(hhr.Body("bolt", 210e3, 0.3, BOLT), hhr.Body("flange", 200e3, 0.3)),
        contacts=(hhr.Mortar("head", "top", friction=0.15),),
        displacements=(
            hhr.Displacement("axis", 0),
            hhr.Displacement("foot", 1),
            hhr.Displacement("middle", 1, hhr.Amplitude(slopes={"turn": -1.0})),
        ),
        loads=(
            hhr.ThermalExpansion("bolt", 1.25e-5, "warmer"),
            hhr.ThermalExpansion("flange", 1.35e-5, "warmer"),
        ),
        parameters=hhr.ParameterSpace(tuple(BOX), *zip(*BOX.values(), strict=True)),
        parameter_units={"turn": "mm", "warmer": "K"},
        outputs=(hhr.ContactForce("clamp force", 0, (0.0, 1.0), unit="N"),),
    )


def life(space: hhr.ParameterSpace) -> hhr.PathFamily:
    """The nut is turned, then twice: heated, held for a year and more in ever longer steps,
    cooled.
    """
    own = hhr.ParameterSpace(("turn", "hot", "years"), (0.02, 350.0, 0.5), (0.04, 430.0, 3.0))
    held = [
        hhr.Leg({}, share, 6)
        for share in (
            f"{HOUR}",
            f"{9 * HOUR}",
            f"{90 * HOUR}",
            f"{0.1 * YEAR}",
            f"{YEAR} * (years - 0.1)",
        )
    ]
    cycle = [hhr.Leg({"warmer": "hot"}, 4 * HOUR, 8), *held, hhr.Leg({"warmer": 0.0}, 4 * HOUR, 8)]
    legs = (hhr.Leg({"turn": "turn"}, 60.0, 6), *cycle, *cycle)
    return hhr.PathFamily("two campaigns", space, own, {"turn": 0.0, "warmer": 0.0}, legs)


def forces_of(history: Any) -> np.ndarray:
    """Clamp force along a history, in N."""
    return np.array([answer.outputs()["clamp force"] for answer in history.answers])


def drawn(model: Any, family: hhr.PathFamily, file: Path) -> None:
    """Clamp force over the years for three turns of the nut."""
    from hhr_dolfinx.plugins.studies.plots import plot_curves

    lines = {}
    for turn in (0.02, 0.03, 0.04):
        history = model.march(family.path((turn, 400.0, 3.0)))
        times = np.array([answer.time for answer in history.answers]) / YEAR
        lines[f"nut turned by {turn:g} mm"] = times, forces_of(history) / 1e3
    plot_curves(
        lines,
        file,
        ("years, with a shutdown after three", "clamp force [kN], 400 K above the room"),
    )


def main() -> None:
    """Train on few lives, compare with the full order on another, draw."""
    from parts import cli

    options = cli.parse_on_first_rank(cli.demo_parser("bolt_preload", __doc__))
    made = scene(mesh(options.out / "joint.msh", 2.0 if options.quick else 0.75))
    family = life(made.parameters)
    (path, *held_out) = family.paths(hhr.Sobol(2 if options.quick else 5, seed=options.seed + 1))
    training = hhr.train(
        made,
        family.training(4 if options.quick else 12),
        held_out=held_out,
        progress=options.progress,
    )
    model, condensing = timed(training.condense)
    hhr.save_model(options.out / "model.npz", model)
    model.march(path)  # the first march of an installation compiles
    full, seconds = timed(lambda: training.full_order.march(path))
    small, quick = timed(lambda: model.march(path))
    forces = [forces_of(history) for history in (full, small)]
    rows = {
        "path": path.name,
        "preload, cold [N]": forces[0][5],  # the nut is turned in six steps
        "after two campaigns, cold [N]": forces[0][-1],
        "largest error of the small model [N]": np.abs(forces[1] - forces[0]).max(),
        "full order [s]": seconds,
        "small model [s]": quick,
    }
    drawn(model, family, options.out / "preload.png")
    cli.report_of_histories(made.name, "preload", rows, condensing, options)


if __name__ == "__main__":
    main()
