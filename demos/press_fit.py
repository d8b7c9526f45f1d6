"""Press fit: shape and speed as parameters
========================================

A hub is pressed on a hollow shaft, in space; a quarter of both, mortar contact, 23,000 unknowns.
Parameters are the interference, the wall thickness of the hub and the crowning of its bore, which
both move the mesh, its Young's modulus, and the speed of rotation, at which the hub lifts off.

.. image:: /pictures/press_fit.png
   :alt: A quarter of hub and shaft: von Mises stress, and contact pressure

Outputs are the torque that friction transmits, the largest von Mises stress of the hub, and the
share of the surface that is open. In the middle of the fit the pressure is near Lamé's closed form
of long rings. A new shape is answered in milliseconds, where the full order assembles, pairs and
factors anew.

You learn how to make shape a parameter: ``hhr.Shape`` moves nodes by formulas of their place, and
everything that contact needs is interpolated on a sparse grid of few shapes. Contact itself is
solved exactly, so that loss of contact at high speed comes out right.

.. code-block:: text

    S(μ) = B(μ) K(μ)^-1 B(μ)^T,    shape and moduli in μ
    Lamé, long rings:  p = δ / (R (1/E_h ((b²+R²)/(b²-R²) + ν_h) + 1/E_s ((R²+r²)/(R²-r²) - ν_s)))

.. code-block:: sh

    python demos/press_fit.py [--out DIR] [--quick] [--seed N]
"""

# sphinx_gallery_thumbnail_path = "pictures/press_fit.png"

from typing import Any

import numpy as np

import hhr_dolfinx as hhr
from hhr_dolfinx.geometries import press_fit as geometry

RADIUS, BORE, LENGTH, DENSITY, SHAFT_E, FRICTION = 20.0, 8.0, 15.0, 7.85e-9, 210e3, 0.15
QUICK_MESH = {"around": 6, "hub_cells": (3, 8), "shaft_cells": (3, 10)}
RHO, WALL = "sqrt(x**2 + y**2)", 10.0
INSIDE = f"(({RHO} - {RADIUS}) / {WALL})"  # 0 at the bore, 1 outside
NEW_RHO = f"({RADIUS} + {INSIDE} * wall + (1 - {INSIDE}) * crown * (z / {LENGTH})**2)"
HUB_SHAPE = (f"x * {NEW_RHO} / {RHO}", f"y * {NEW_RHO} / {RHO}", "z")
NAMES = ("interference", "wall", "crown", "E_hub", "speed")
LOWER, UPPER = (0.01, 8.0, 0.0, 70e3, 0.0), (0.03, 14.0, 0.02, 210e3, 2000.0)
UNITS = {"interference": "mm", "wall": "mm", "crown": "mm", "E_hub": "MPa", "speed": "rad/s"}
RECIPE = hhr.Recipe(basis=hhr.Pod(1e-10, relative=True, by_body=True))
POINTS = (0.02, 10.0, 0.0, 210e3, 0.0), (0.02, 10.0, 0.015, 100e3, 1500.0)


def VIEW() -> "hhr.View":
    """Pictures of a study."""
    return hhr.View(POINTS, lambda places: places[:, 2], "z [mm]", (2, "u_z [mm]"), "MPa")


def scene(**mesh_options: Any) -> hhr.Scene:
    """The scene in mm, MPa, tonnes and seconds."""
    turning = f"{DENSITY} * speed**2", (0.0, 0.0, 0.0), (0.0, 0.0, 1.0)
    return hhr.Scene(
        name="press_fit",
        geometry=lambda comm: geometry.press_fit(
            comm, radius=RADIUS, bore=BORE, wall=WALL, half_length=LENGTH, **mesh_options
        ),
        hypothesis="solid",
        bodies=(hhr.Body(geometry.HUB, "E_hub", 0.3), hhr.Body(geometry.SHAFT, SHAFT_E, 0.3)),
        contacts=(hhr.Mortar(geometry.HUB_BORE, geometry.SHAFT_OUTSIDE),),
        parameters=hhr.ParameterSpace(NAMES, LOWER, UPPER),
        parameter_units=UNITS,
        displacements=tuple(
            hhr.Displacement(tag, axis) for axis, tags in geometry.PLANES.items() for tag in tags
        ),
        loads=tuple(hhr.Centrifugal(tag, *turning) for tag in (geometry.HUB, geometry.SHAFT)),
        openings=(hhr.Opening(0, hhr.Amplitude(slopes={"interference": -1.0})),),
        shapes=(hhr.Shape(geometry.HUB, HUB_SHAPE),),
        outputs=(
            hhr.Torque(
                "torque of a quarter",
                0,
                friction=FRICTION,
                origin=(0.0, 0.0, 0.0),
                axis=(0.0, 0.0, 1.0),
                unit="N mm",
            ),
            hhr.VonMises("largest stress", geometry.HUB, unit="MPa"),
            hhr.LostContact("lost contact", 0),
        ),
    )


def lame_pressure(interference: float, wall: float, young: float) -> float:
    """Pressure between long rings without crowning, at rest, plane stress (Lame)."""
    outer, inner = RADIUS + wall, BORE
    hub = ((outer**2 + RADIUS**2) / (outer**2 - RADIUS**2) + 0.3) / young
    shaft = ((RADIUS**2 + inner**2) / (RADIUS**2 - inner**2) - 0.3) / SHAFT_E
    return interference / (RADIUS * (hub + shaft))


def main() -> None:
    """Train on Sobol points, measure, report."""
    from parts import cli

    options = cli.parse(cli.demo_parser("press_fit", __doc__))
    training, tests = (hhr.Sobol(64), 20) if options.quick else (hhr.Sobol(96), 50)
    # a query of the full order takes seconds: a hundred of them would take an hour
    settings = hhr.StudySettings(
        training,
        recipe=RECIPE,
        held_out=20,
        tests=tests,
        queries=12,
        naive=False,
        seed=options.seed,
    )
    built = scene(**(QUICK_MESH if options.quick else {}))
    study = hhr.study_scene(built, settings, options.out, progress=options.progress)
    if study is not None:
        point = np.array(POINTS[0])
        answer, problem = (
            study.training.full_order.solve(point),
            study.training.full_order.problem.at(point),
        )
        middle = problem.contact_points[:, 2] < LENGTH / 4
        pressure = float(answer.forces()[middle].sum() / problem.contact_areas[middle].sum())
        study.report["lame"] = {
            "pressure": pressure,
            "long_rings": lame_pressure(point[0], point[1], point[3]),
        }
        study.write(options.out, options.console, VIEW())


if __name__ == "__main__":
    main()
