"""Indentation: a steel sphere pressed into a block that yields, in space, loaded and unloaded.

One quarter of a sphere of radius 10 mm is pushed up to 0.025 mm into a block of aluminium and drawn off again. Yield
stress and hardening of the block are parameters; what is read off is the curve of force over depth, the imprint that
stays, and how the surface rises beside it. Small loads are Hertz's (1882), the deepest are fully plastic, where the
mean pressure is three times the yield stress (Tabor 1951).

    python demos/indentation.py [--out DIR] [--quick] [--seed N]
"""

from typing import Any

import numpy as np

import hhr_dolfinx as hhr
from hhr_dolfinx.geometries import sphere_on_block as geometry
from hhr_dolfinx.models.answer import Path

RADIUS, WIDTH, SPHERE_E, BLOCK_E, POISSON = 10.0, 0.4, 210e3, 70e3, 0.3
NAMES, LOWER, UPPER = ("depth", "sy", "H"), (0.0, 100.0, 0.0), (0.03, 300.0, 3000.0)
RINGS = (0.5, 0.8, 1.1)
"""Distances from the pole in mm at which the rise of the surface is read off."""
CELLS, QUICK_CELLS = 19, 10


def scene(cells: int = CELLS, young: float | str = BLOCK_E) -> hhr.Scene:
    """The scene in mm, MPa and N.

    Args:
        cells: of the block along a side, see :func:`geometry.indentation_cells`.
        young: Young's modulus of the block.
    """
    held = [hhr.Displacement(tag, axis) for axis, tags in geometry.SYMMETRY.items() for tag in tags]
    push = hhr.Displacement(geometry.SPHERE_TOP, 2, hhr.Amplitude(slopes={"depth": -1.0}))
    return hhr.Scene(
        name="indentation",
        geometry=lambda comm: geometry.sphere_on_block(
            comm, radius=RADIUS, width=WIDTH, depth=WIDTH, **geometry.indentation_cells(cells)
        ),
        hypothesis="solid",
        bodies=(
            hhr.Body(geometry.SPHERE, SPHERE_E, POISSON),
            hhr.Body(geometry.BLOCK, young, POISSON, hhr.Plasticity("sy", hardening="H")),
        ),
        contacts=(hhr.Mortar(geometry.BLOCK_TOP, geometry.SPHERE_BOTTOM, normal=(0.0, 0.0, 1.0)),),
        parameters=hhr.ParameterSpace(NAMES, LOWER, UPPER),
        displacements=(*held, hhr.Displacement(geometry.BLOCK_BOTTOM, 2), push),
        outputs=(
            hhr.ContactForce("force", 0, direction=(0.0, 0.0, -4.0), unit="N"),
            hhr.DisplacementAt("pole", (0.0, 0.0, 0.0), 2, geometry.BLOCK, unit="mm"),
            *(hhr.DisplacementAt(f"rise at {r}", (r, 0.0, 0.0), 2, geometry.BLOCK, unit="mm") for r in RINGS),
        ),
    )


def path(depth: float, *constants: float, loading: int = 16, unloading: int = 8) -> Path:
    """Down to a depth in mm and back, with constants (sy, H, ...) in MPa; steps are small where contact changes fast."""
    down = (np.arange(loading + 1) / loading) ** 1.5
    up = 1 - (np.arange(1, unloading + 1) / unloading) ** 1.5
    times = np.arange(loading + unloading + 1) / loading
    return [
        (float(time), np.array([depth * share, *constants])) for time, share in zip(times, [*down, *up], strict=True)
    ]
