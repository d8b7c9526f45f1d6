"""Fuel pellet and cladding: contact that varies in strength and size over two parameters.

A pressure P1 in [5, 200] MPa acts on the outside of a tube up to the height h1 in [0.6, 6] mm and presses it
on the pellet inside, across a gap of 2 micrometres (thesis sections 1.5.2 and 3.5.2; axisymmetric). The bottom of the
pellet may lift off: it is a second contact pair. Trained on 25 x 20 parameters, compared on 200 random ones.

What to see: where contact grazes, plain snapshots give force errors of 100 %; snapshots divided by their norm,
a RID with two more layers of cells and FE functions on the contact nodes bring them to about 1 %.

    python demos/pellet_cladding.py [--out DIR] [--quick] [--seed N] [--study thesis]
    mpirun -n 2 python demos/pellet_cladding.py --batch points.csv    # header: P1,h1
"""

import time
from pathlib import Path

from mpi4py import MPI
from rich.console import Console

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import ParameterError
from hhr_dolfinx.geometries import pellet_cladding as geometry
from hhr_dolfinx.study.cli import demo_parser, progress_bars

THESIS_SIZE = hhr.ReductionSettings.thesis(1e-6, extended_pod_tolerance=3e-7, dual_pod_tolerance=1e-3, kappa_max=3.0)
"""POD + FE enrichment on a small RID: 60 functions and 26 contacts."""

QUICK_MESH = {"radial_cells": 12, "axial_cells": 20, "cladding_radial_cells": 2}


def scene(bottom: str = "obstacle", **mesh_options) -> hhr.Scene:
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
        displacements=(
            hhr.Displacement(geometry.PELLET_AXIS, component=0),
            *(hhr.Displacement(tag, component=1) for tag in held),
        ),
        loads=(hhr.PartialPressure(geometry.CLADDING_OUTER, hhr.Amplitude(slopes={"P1": 1.0}), extent="h1"),),
    )


def main() -> None:
    """Train, then study or answer a batch."""
    parser = demo_parser("pellet_cladding", __doc__.splitlines()[0])
    parser.add_argument("--batch", type=Path, help="CSV file of parameters to answer, spread over the ranks")
    parser.add_argument(
        "--study", choices=["thesis"], help="print the rows of the thesis' tables 3.1 to 3.3 beside ours"
    )
    options = parser.parse_args()
    try:
        rows = hhr.read_points(options.batch, scene().parameters) if options.batch else None
    except ParameterError as error:
        parser.error(str(error))
    comm = MPI.COMM_WORLD
    console = Console(quiet=comm.rank > 0)
    bars = progress_bars(console)
    mesh = QUICK_MESH if options.quick else {}
    training = hhr.train(
        scene(**mesh), [25, 20], seed=options.seed, folder=options.out / "snapshots", comm=comm, progress=bars
    )
    if rows is not None:
        batch(training, rows, options, comm, console)
    elif comm.rank == 0:
        import pellet_cladding_study as study

        study.run(training, options, console)
        if options.study == "thesis":
            study.thesis_tables(training, options.out, console)


def batch(training, rows, options, comm, console) -> None:
    """Answer the rows of a table on all ranks."""
    reduction = training.build()
    start = time.perf_counter()
    answers = hhr.answer_rows(reduction, rows, comm, progress_bars(console)("answers"))
    if comm.rank == 0:
        path = options.out / "answers.csv"
        bad = hhr.write_answers(path, training.full_order.problem.parameters, answers)
        seconds = time.perf_counter() - start
        console.print(f"{len(rows) - bad} answers and {bad} bad rows on {comm.size} ranks in {seconds:.1f} s: {path}")
        for number, row in enumerate(answers, start=1):
            if row[2] != "ok":
                console.print(f"row {number} ({', '.join(row[:2])}): {row[2]}", highlight=False)


if __name__ == "__main__":
    main()
