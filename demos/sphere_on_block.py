"""Sphere on block: contact in space on meshes that do not match
=============================================================

A steel sphere is pressed on an aluminium block. One quarter of a sphere of radius 10 mm is pushed
by 0.05 to 0.25 mm on a block that is squeezed from the side by up to 200 MPa. Contact has 625
mortar conditions, since the nodes of both surfaces do not face each other.

.. image:: /pictures/sphere_on_block.png
   :alt: A quarter of a sphere on a block: von Mises stress below the surface, and contact pressure

Mortar meets contact radius and peak pressure of Hertz (1882) within a few per cent;
node-to-surface misses the pressure at the pole by a quarter. The reduced model answers a thousand
times faster than the full order. Exact condensation gives forces alone as fast, but has to solve
for and keep a displacement field for each of its conditions; with fields HHR is several times
faster.

You learn when hyper-reduction pays: with hundreds of contact conditions, and where fields are
asked for. You also see how a closed form checks a scene: ``beside_hertz`` compares under the force
that the model found, so that the stiffness of the finite block does not enter.

.. code-block:: text

    Hertz:    a = (3 F R / (4 E*))^(1/3),    p_0 = 3 F / (2 π a²)
              1/E* = (1 - ν_1²)/E_1 + (1 - ν_2²)/E_2
    mortar:   ∫ ψ_j (u_s - u_m)·n <= ∫ ψ_j g    for each function ψ_j on the slave surface

.. code-block:: sh

    python demos/sphere_on_block.py [--out DIR] [--quick] [--seed N]
"""

# sphinx_gallery_thumbnail_path = "pictures/sphere_on_block.png"

from collections.abc import Callable
from typing import Any

import numpy as np
from mpi4py import MPI

import hhr_dolfinx as hhr
from hhr_dolfinx.geometries import sphere_on_block as geometry

RADIUS, YOUNG, POISSON = 10.0, {geometry.SPHERE: 210e3, geometry.BLOCK: 70e3}, 0.3
MESH = {"sphere_cells": (24, 10), "block_cells": (18, 8)}
QUICK_MESH = {"sphere_cells": (10, 5), "block_cells": (8, 4), "grading": 2.5}
# the points of the primal DEIM are enough for one compact zone
COMPACT = {"nodes": (hhr.Deim(), hhr.LoadNodes()), "domain": hhr.Rid(layers=0)}
SMALLER = [
    (f"eps {eps:.0e}", hhr.Recipe(hhr.Pod(eps, relative=True), **COMPACT)) for eps in (1e-8, 1e-9)
]
VARIANTS = [("two layers", hhr.Recipe()), *SMALLER]
TRAINING = [25, 5]


def SETTINGS() -> "hhr.StudySettings":
    """Training and measurements of a study."""
    return hhr.StudySettings(TRAINING, hhr.Recipe(**COMPACT), VARIANTS, naive=False)


def VIEW() -> "hhr.View":
    """Pictures of a study."""
    return hhr.View(((0.21, 60.0),), from_pole, "distance from the pole [mm]", stress="MPa",
                    closed_form=lambda r, quarter: hertz(4 * quarter)[2](r))  # fmt: skip


def from_pole(places: np.ndarray) -> np.ndarray:
    """Distances from the pole, (m,)."""
    return np.hypot(places[:, 0], places[:, 1])


def scene(pairing: Callable[..., Any] | None = None, **mesh_options: Any) -> hhr.Scene:
    """The scene in mm and MPa, of mortar by default.

    ``mesh_options`` go to :func:`geometry.sphere_on_block`.
    """
    held = [hhr.Displacement(tag, axis) for axis, tags in geometry.SYMMETRY.items() for tag in tags]
    push = hhr.Displacement(geometry.SPHERE_TOP, 2, hhr.Amplitude(slopes={"push": -1.0}))
    return hhr.Scene(
        name="sphere_on_block",
        geometry=lambda comm: geometry.sphere_on_block(comm, radius=RADIUS, **mesh_options),
        hypothesis="solid",
        bodies=tuple(hhr.Body(tag, young, POISSON) for tag, young in YOUNG.items()),
        contacts=(
            (pairing or hhr.Mortar)(
                geometry.SPHERE_BOTTOM, geometry.BLOCK_TOP, normal=(0.0, 0.0, -1.0)
            ),
        ),
        parameters=hhr.ParameterSpace(("push", "squeeze"), (0.05, 0.0), (0.25, 200.0)),
        parameter_units={"push": "mm", "squeeze": "MPa"},
        displacements=(*held, hhr.Displacement(geometry.BLOCK_BOTTOM, 2), push),
        loads=(hhr.Pressure(geometry.BLOCK_SIDE, hhr.Amplitude(slopes={"squeeze": 1.0})),),
    )


def hertz(load: float) -> tuple[float, float, Callable[[np.ndarray], np.ndarray]]:
    """Hertz (1882): radius a^3 = 3 P R / (4 E*), peak p0 = 3 P / (2 pi a^2), and the pressure over
    the distance.
    """
    modulus = 1 / sum((1 - POISSON**2) / young for young in YOUNG.values())
    radius = (3 * load * RADIUS / (4 * modulus)) ** (1 / 3)
    peak = 3 * load / (2 * np.pi * radius**2)
    return radius, peak, lambda r: peak * np.sqrt(np.maximum(1 - (r / radius) ** 2, 0.0))


def beside_hertz(full: hhr.FullOrderModel, push: float) -> dict[str, float]:
    """Radius, by the second moment 2 a^2 P / 5 of the pressure, and pressures relative to Hertz
    under the same load.
    """
    problem, forces = full.problem, full.solve([push, 0.0]).forces()
    r, pressure = from_pole(problem.contact_points), forces / problem.contact_areas
    radius, peak, _ = hertz(4 * forces.sum())
    ours = (
        np.sqrt(2.5 * forces @ r**2 / forces.sum()) / radius,
        pressure.max() / peak,
        pressure[r.argmin()] / peak,
    )
    return {
        "push": push,
        **dict(zip(("radius", "peak", "pole"), (float(x - 1) for x in ours), strict=True)),
    }


def main() -> None:
    """Train, study, compare with Hertz, report."""
    from parts import cli

    options = cli.parse(cli.demo_parser("sphere_on_block", __doc__))
    mesh, settings = (
        QUICK_MESH if options.quick else MESH,
        SETTINGS().adapted(seed=options.seed, quick=options.quick),
    )
    study = hhr.study_scene(scene(**mesh), settings, options.out, progress=options.progress)
    if study is not None:  # ranks but the first have only trained
        nodal = hhr.FullOrderModel(scene(hhr.NodeToSurface, **mesh), MPI.COMM_SELF)
        models = {"mortar": study.training.full_order, "node_to_surface": nodal}
        study.report["hertz"] = [
            {"pairing": name, **beside_hertz(model, push)}
            for name, model in models.items()
            for push in (0.1, 0.15, 0.25)
        ]
        study.write(options.out, options.console, VIEW())
        cli.print_rows("relative to Hertz", study.report["hertz"], options.console)


if __name__ == "__main__":
    main()
