"""Fuel pellet and cladding: contact that varies in strength and size over two parameters.

A pressure P1 in [5, 200] MPa acts on the outside of a tube up to the height h1 in [0.6, 6] mm and
presses it on the pellet inside, across a gap of 2 micrometres (thesis sections 1.5.2 and 3.5.2;
axisymmetric). The bottom of the pellet may lift off: it is a second contact pair. Trained on 25 x
20 parameters, compared on 200 random ones.

    ∫ σ(u) : ε(v) r + λ·B v = -∫_{z < h1} P1 v_r r,    B u <= g,  λ >= 0,  λ·(B u - g) = 0
    The load on {z < h1} is no affine function of h1: on each edge it is a quadratic one
    (``amplitudes.Coverage``).

What to see: where contact grazes, plain snapshots give force errors of 100 %; snapshots divided by
their norm, a RID with two more layers of cells and FE functions on the contact nodes bring them to
about 1 %.

    python benchmarks/thesis/pellet_cladding.py [--out DIR] [--quick] [--seed N] [--study thesis]
    mpirun -n 2 python benchmarks/thesis/pellet_cladding.py --batch points.csv    # header: P1,h1
"""

import sys
from pathlib import Path
from typing import Any

import hhr_dolfinx as hhr
from hhr_dolfinx.geometries import pellet_cladding as geometry

GRID, QUICK_MESH = (25, 20), {"radial_cells": 12, "axial_cells": 20, "cladding_radial_cells": 2}


def VIEW(points: tuple = ((30.0, 5.25), (170.0, 3.2))) -> "hhr.View":
    """Pictures of a study."""
    return hhr.View(points, lambda places: places[:, 1], "z [mm]", (0, "u_r [mm]"), "MPa")


def scene(bottom: str = "obstacle", **mesh_options: Any) -> hhr.Scene:
    """The scene in mm and MPa.

    Args:
        bottom: ``obstacle`` lets the pellet lift off its support, ``held`` does not.
        mesh_options: arguments of :func:`geometry.pellet_cladding`.
    """
    side = hhr.NodeToNode(geometry.PELLET_SIDE, geometry.CLADDING_INNER, normal=(1.0, 0.0))
    support = hhr.Obstacle(geometry.PELLET_BOTTOM, normal=(0.0, -1.0), offset=0.0)
    held = [geometry.PELLET_TOP, geometry.CLADDING_TOP, geometry.CLADDING_BOTTOM]
    if bottom == "held":
        held.append(geometry.PELLET_BOTTOM)
    return hhr.Scene(
        name="pellet_cladding",
        geometry=lambda comm: geometry.pellet_cladding(comm, **mesh_options),
        hypothesis="axisymmetric",
        bodies=(hhr.Body(geometry.PELLET, 190e3, 0.3), hhr.Body(geometry.CLADDING, 78e3, 0.34)),
        contacts=(side, support) if bottom == "obstacle" else (side,),
        parameters=hhr.ParameterSpace(("P1", "h1"), (5.0, 0.6), (200.0, 6.0)),
        parameter_units={"P1": "MPa", "h1": "mm"},
        displacements=(
            hhr.Displacement(geometry.PELLET_AXIS, component=0),
            *(hhr.Displacement(tag, component=1) for tag in held),
        ),
        loads=(
            hhr.PartialPressure(
                geometry.CLADDING_OUTER, hhr.Amplitude(slopes={"P1": 1.0}), extent="h1"
            ),
        ),
    )


def main() -> None:
    """Train, then study or answer a table of parameters."""
    sys.path.append(str(Path(__file__).parents[2] / "demos"))
    from parts import cli

    parser = cli.demo_parser("pellet_cladding", __doc__)
    parser.add_argument(
        "--batch", type=Path, help="CSV file of parameters to answer, spread over the ranks"
    )
    parser.add_argument(
        "--study", choices=["thesis"], help="rows of the thesis' tables 3.1 to 3.3 beside ours"
    )
    options = cli.parse(parser)
    built, folder = scene(**(QUICK_MESH if options.quick else {})), options.out
    rows = cli.points_or_exit(parser, options.batch, built.parameters)
    training = hhr.train(
        built, GRID, seed=options.seed, folder=folder / "snapshots", progress=options.progress
    )
    if rows is not None:
        cli.answer_and_exit(training.build(), rows, options)
    elif options.first_rank:
        import pellet_cladding_study as comparison

        settings = hhr.StudySettings(GRID, variants=comparison.VARIANTS, queries=100)
        settings = settings.adapted(seed=options.seed, quick=options.quick)
        rivals = list(comparison.rivals(training, scene, options.quick))
        study = hhr.run_study(training, settings, rivals=rivals, progress=options.progress)
        study.report["thesis_size"] = comparison.thesis_size(study)
        study.write(folder, options.console, VIEW())
        comparison.draw_maps(study, folder, options.quick)
        if options.study == "thesis":
            from pellet_cladding_tables import thesis_tables

            thesis_tables(training, folder, options.console)


if __name__ == "__main__":
    main()
