"""Fuel rod at power, over eight parameters
========================================

A hot pellet grows into its cladding. Linear power q heats it by a parabola over its radius, above
the temperature of its surface; the coolant presses on the cladding from outside. Young's modulus
and Poisson's ratio of both bodies vary, and power, pressure, the gap as built, and the expansion
of the pellet. Axisymmetric; half a pellet, whose middle is a plane of symmetry.

.. image:: /pictures/fuel_rod.png
   :alt: Section of pellet and cladding with their stress, and the contact pressure

The pellet takes the shape of an hourglass and touches the cladding with its end first, where the
pressure is several times that of the middle. Interpolated condensation solves each body at six
points of its Poisson's ratio, and gives contact forces right to five digits at all others.

You learn how far parameters reach: stiffness and thermal forces, which are products of moduli and
temperatures, change with every query, and the small model still keeps all contact conditions.
Loads are formulas of parameters, such as ``320 + 3 * q``, and fields of the place, such as the
parabola.

.. code-block:: text

    ∫ C(E, ν) (ε(u) - ε_0) : ε(v) r = l(v),    ε_0 = α q (1 - r²/R²) t_0 I
    heat by a parabola over the radius; the rod as a whole is free to grow in length

.. code-block:: sh

    python demos/fuel_rod.py [--out DIR] [--quick] [--seed N]
"""

# sphinx_gallery_thumbnail_path = "pictures/fuel_rod.png"

import math
from typing import Any

import hhr_dolfinx as hhr
from hhr_dolfinx.geometries import pellet_cladding as geometry

QUICK_MESH = {"radial_cells": 12, "axial_cells": 20, "cladding_radial_cells": 2}
RADIUS, CONDUCTIVITY, CLADDING_EXPANSION = 4.1, 3.0, 6e-6
SURFACE, CLADDING_HEAT = "320 + 3 * q", 300.0
"""Pellet's surface and cladding above the temperature at which both are free of stress, in K.

q in kW/m.
"""
BOX = {
    "E1": (150e3, 220e3),
    "nu1": (0.25, 0.35),
    "E2": (70e3, 100e3),
    "nu2": (0.3, 0.4),
    "q": (10.0, 40.0),
    "P": (5.0, 16.0),
    "gap": (0.0, 0.03),
    "alpha": (9e-6, 12e-6),
}
MIDDLE = (185e3, 0.3, 85e3, 0.35)
POINTS = (*MIDDLE, 20.0, 15.0, 0.0, 1e-5), (*MIDDLE, 35.0, 15.0, 0.01, 1.1e-5)


def VIEW() -> "hhr.View":
    """Pictures of a study."""
    return hhr.View(POINTS, lambda places: places[:, 1], "z [mm]", (0, "u_r [mm]"), "MPa")


def scene(**mesh_options: Any) -> hhr.Scene:
    """The scene in mm, MPa, K and kW/m; ``mesh_options`` go to :func:`geometry.pellet_cladding`."""
    across = ((1.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    held = (geometry.PELLET_BOTTOM, geometry.CLADDING_BOTTOM, geometry.CLADDING_TOP)
    return hhr.Scene(
        name="fuel_rod",
        geometry=lambda comm: geometry.pellet_cladding(comm, radius=RADIUS, **mesh_options),
        hypothesis="axisymmetric",
        bodies=(hhr.Body(geometry.PELLET, "E1", "nu1"), hhr.Body(geometry.CLADDING, "E2", "nu2")),
        contacts=(
            hhr.NodeToNode(geometry.PELLET_SIDE, geometry.CLADDING_INNER, normal=(1.0, 0.0)),
        ),
        parameters=hhr.ParameterSpace(tuple(BOX), *zip(*BOX.values(), strict=True)),
        displacements=(
            hhr.Displacement(geometry.PELLET_AXIS, component=0),
            *(hhr.Displacement(tag, component=1) for tag in held),
        ),
        loads=(
            hhr.ThermalExpansion(geometry.PELLET, "alpha", SURFACE),
            hhr.ThermalExpansion(
                geometry.PELLET,
                "alpha",
                f"1e3 * q / (4 * pi * {CONDUCTIVITY})",
                field=lambda x: 1 - (x[0] / RADIUS) ** 2,
            ),
            hhr.Eigenstrain(geometry.CLADDING, CLADDING_EXPANSION * CLADDING_HEAT, across),
            hhr.Pressure(geometry.CLADDING_OUTER, "P"),
        ),
        openings=(hhr.Opening(0, hhr.Amplitude(slopes={"gap": 1.0})),),
    )


def free_growth(power: float, expansion: float) -> float:
    """Radial displacement of the side of a pellet that touches nothing, its mean over the height,
    in mm.

    Mean stresses of a free body vanish, so that its mean strain is that of its mean temperature.
    """
    return expansion * RADIUS * (320 + 3 * power + 1e3 * power / (8 * math.pi * CONDUCTIVITY))


def main() -> None:
    """Train, study, report."""
    from parts import cli

    options = cli.parse(cli.demo_parser("fuel_rod", __doc__))
    mesh, training = (QUICK_MESH, hhr.Sobol(64)) if options.quick else ({}, hhr.Sobol(512))
    settings = hhr.StudySettings(training).adapted(seed=options.seed, quick=options.quick)
    study = hhr.study_scene(scene(**mesh), settings, options.out, progress=options.progress)
    if study is not None:  # ranks but the first have only trained
        study.write(options.out, options.console, VIEW())


if __name__ == "__main__":
    main()
