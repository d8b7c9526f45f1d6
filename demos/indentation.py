"""Indentation: a steel sphere pressed into a block that yields, in space, loaded and unloaded.

One quarter of a sphere of radius 10 mm is pushed up to 0.03 mm into a block and drawn off again;
mortar contact. Depth, yield stress, hardening and Young's modulus of the block are parameters. What
is read off is the curve of force over depth, the imprint that stays, and how the surface rises
beside it.

    F(d) of loading and unloading;  min over (σ_y, H) of Σ_k (F(d_k) - F_k)² / s_k²;  Tabor: F / (π
    a²) ≈ 3 σ_y

What to see: condensed flow answers a history in some hundredths of the time of the full order,
which makes histories cheap enough to find yield stress and hardening in curves with noise, by
gradients and by a random walk. Small loads are Hertz's (1882), the deepest are fully plastic, where
the mean pressure tends to three times the yield stress (Tabor 1951; K. L. Johnson, Contact
Mechanics, 1985, section 6.3).

    python demos/indentation.py [--out DIR] [--quick] [--seed N] [--cells 10 14 19 25] [--hhr]

Finer meshes than the usual ones, 19 and 25 cells along a side, take half an hour and 15 GB.
"""

from typing import Any

import numpy as np

import hhr_dolfinx as hhr
from hhr_dolfinx.geometries import sphere_on_block as geometry
from hhr_dolfinx.models.answer import Path
from hhr_dolfinx.plugins.inelastic.condense_flow import CorrectionSettings

RADIUS, WIDTH, SPHERE_E, BLOCK_E, POISSON = 10.0, 0.4, 210e3, 70e3, 0.3
BOX = {"depth": (0.0, 0.03), "sy": (100.0, 300.0), "H": (0.0, 10e3), "E": (60e3, 80e3)}
"""Ranges of the parameters, in mm and MPa; the last is one only where a scene asks for it."""
RINGS = (0.5, 0.8, 1.1)
"""Distances from the pole in mm at which the rise of the surface is read off."""
TRAINED = hhr.ParameterSpace(
    ("depth", "sy", "H", "E"), (0.015, 100.0, 1e3, 60e3), (0.03, 300.0, 10e3, 80e3)
)
"""What is varied from path to path: the largest depth, and constants of the block."""
CELLS, QUICK_CELLS, DEPTH, REPETITIONS = (10, 14), (10,), 0.03, 3
NOISE, LEAST, CURVES, TRUE = 0.01, 0.02, 16, np.array([150.0, 6e3])
"""Readings of a curve are off by a hundredth of each, or of a fiftieth of the largest.

Sixteen curves are measured.
"""
# the elastic operator has its factors and all columns of the contact already, and takes few more
# iterations than tangents, which in space cost as much as ten iterations each
MARCH = hhr.MarchSettings(search="elastic")
# forces are wished at p95 of histories; at any step of any of them they are up to half as far off
# again
CORRECTION = CorrectionSettings(modes=8e-3, cubature=4e-3, dual=0.1)


def scene(cells: int = 19, young: float | str = BLOCK_E) -> hhr.Scene:
    """The scene in mm, MPa and N.

    Args:
        cells: of the block along a side, see :func:`geometry.indentation_cells`.
        young: Young's modulus of the block, a number or "E" for one more parameter.
    """
    names = [name for name in BOX if name == young or name != "E"]
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
        parameters=hhr.ParameterSpace(names, *zip(*(BOX[name] for name in names), strict=True)),
        displacements=(*held, hhr.Displacement(geometry.BLOCK_BOTTOM, 2), push),
        outputs=(
            hhr.ContactForce("force", 0, direction=(0.0, 0.0, -1.0), unit="N"),
            hhr.DisplacementAt("pole", (0.0, 0.0, 0.0), 2, geometry.BLOCK, unit="mm"),
            *(
                hhr.DisplacementAt(f"rise at {r}", (r, 0.0, 0.0), 2, geometry.BLOCK, unit="mm")
                for r in RINGS
            ),
        ),
    )


def path(depth: float, *constants: float, loading: int = 16, unloading: int = 8) -> Path:
    """Down to a depth in mm and back, in small steps where contact changes fast.

    Args:
        depth: the largest.
        constants: (sy, H), and E where it is a parameter, in MPa.
        loading, unloading: steps.
    """
    down = (np.arange(loading + 1) / loading) ** 1.5
    up = 1 - (np.arange(1, unloading + 1) / unloading) ** 1.5
    shares = np.concatenate([down, up])
    return [(k / loading, np.array([depth * share, *constants])) for k, share in enumerate(shares)]


def training() -> list[Path]:
    """Sixteen paths drawn from the box of their parameters, and four of its corners, where most
    flows.
    """
    corners = [
        [0.03, 100.0, 1e3, 60e3],
        [0.03, 100.0, 1e3, 80e3],
        [0.03, 100.0, 10e3, 70e3],
        [0.03, 300.0, 1e3, 70e3],
    ]
    return [path(*values) for values in [*hhr.Sobol(16).points(TRAINED), *corners]]


def tests(count: int = 8) -> list[Path]:
    """Other paths from the same box."""
    return [path(*values) for values in hhr.Sobol(8, seed=2).points(TRAINED)[:count]]


def main() -> None:
    """Train on meshes of growing fineness, compare with the full order.

    On the last calibrate, and look at Tabor.
    """
    from parts import cli

    parser = cli.demo_parser("indentation", __doc__)
    parser.add_argument(
        "--cells", type=int, nargs="+", help="cells of the block along a side: 10 14, quick 10"
    )
    parser.add_argument(
        "--hhr", action="store_true", help="build and time the hyper-reduced model too"
    )
    options = cli.parse_on_first_rank(parser)
    from parts.indentation_study import calibrated, measured_on, tabor, told

    scaling: dict[str, list[dict[str, Any]]] = {}
    for cells in options.cells or (QUICK_CELLS if options.quick else CELLS):
        full, model, found = measured_on(cells, options)
        for name, row in found.items():
            scaling.setdefault(name, []).append(row)
    rows, imprints = tabor(full)
    calibration = calibrated(full, model, 50 if options.quick else 500, options.seed)
    told(scaling, rows, imprints, calibration, options)


if __name__ == "__main__":
    main()
