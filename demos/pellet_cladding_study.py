"""The study behind ``pellet_cladding.py``: figures, pictures, and the thesis' tables beside ours."""

from __future__ import annotations

import json

import numpy as np
import pellet_cladding as demo
from mpi4py import MPI
from rich.table import Table

import hhr_dolfinx as hhr
from hhr_dolfinx.baselines.coarser import CoarserMesh
from hhr_dolfinx.baselines.peers import DualBasisModel, cone_projected_greedy, nonnegative_factors
from hhr_dolfinx.errors import HHRError
from hhr_dolfinx.study.study import measure_errors, solve_references, time_queries

POINTS = np.array([[170.0, 3.2], [30.0, 5.25]])
"""The two points of table 3.1."""

THESIS_ROWS = [  # modes added, epsilon 2, final size, errors in %: primal and dual at both points
    (0, None, 70, 1.0, 2.5, 2.9, 21),
    (3, 7.5e-7, 73, 2.5, 1.8, 0.5, 26),
    (6, 5e-7, 76, 0.5, 1.6, 1.6, 16),
    (9, 3.5e-7, 79, 0.1, 1.3, 3.5, 5.6),
    (12, 2.7e-7, 82, 1.4, 1.7, 2.5, 6.7),
    (15, 2.2e-7, 85, 1.9, 1.7, 1.3, 5.8),
    (18, 1.7e-7, 88, 1.1, 1.4, 0.2, 5.3),
    (21, 1.3e-7, 91, 7.8, 1.8, 13.4, 9.3),
    (23, 1.1e-7, 93, 0.8, 1.3, 16, 9.9),
    (26, 0.9e-7, 96, 12, 1.3, 1.5, 9.5),
]
THESIS_TIMES = [  # table, label, dual epsilon, epsilon 2, size, milliseconds; full order 704 (native) and 4829
    ("3.2", "EF", 4e-4, None, 55, 220),
    ("3.2", "POD+EF", 4e-4, 3.5e-7, 62, 270),
    ("3.3", "EF", 1e-4, None, 83, 919),
    ("3.3", "POD+EF", 1e-4, 3.5e-7, 91, 1092),
]


def variants():
    """Recipes of growing size, the thesis' own among them."""
    return [
        ("thesis size", demo.THESIS_SIZE),
        ("plain 1e-8", hhr.ReductionSettings(1e-8, relative=False)),
        ("plain 1e-10", hhr.ReductionSettings(1e-10, relative=False)),
        ("relative 1e-9", hhr.ReductionSettings(1e-9)),
        ("relative 1e-10", hhr.ReductionSettings(1e-10)),
        ("all functions", hhr.ReductionSettings(kappa_max=1.0)),
    ]


def rivals(full_order, snapshots, quick):
    """Peers with 30 primal modes, and coarser meshes."""
    fine = full_order.problem
    for count in (10,) if quick else (20, 40):
        cone = cone_projected_greedy(snapshots.forces, count)
        yield hhr.Rival("cone-projected greedy", f"{count}", DualBasisModel(full_order, snapshots, cone, 30))
    factors = nonnegative_factors(snapshots.forces, 10 if quick else 40)
    yield hhr.Rival("NNMF", f"{factors.shape[1]}", DualBasisModel(full_order, snapshots, factors, 30))
    for part in (2,) if quick else (4, 2):
        mesh = {"radial_cells": 60 // part, "axial_cells": 100 // part, "cladding_radial_cells": 8 // part}
        if quick:
            mesh = {"radial_cells": 6, "axial_cells": 10, "cladding_radial_cells": 2}
        coarse = hhr.FullOrderModel(demo.scene(**mesh), MPI.COMM_SELF)
        yield hhr.Rival("coarser mesh", f"1/{part}", CoarserMesh(coarse, fine, fine.parameters.grid([12, 10])))


def run(training, options, console) -> None:
    """Measure everything, print it, and write report, model, fields and pictures."""
    full_order, snapshots = training.full_order, training.snapshots
    space = full_order.problem.parameters
    points = space.random(20 if options.quick else 200, options.seed)
    settings = hhr.StudySettings(variants=variants(), queries=15 if options.quick else 100, seed=options.seed)
    result = hhr.run_study(
        full_order,
        snapshots,
        points,
        settings,
        held_out=training.held_out,
        rivals=list(rivals(full_order, snapshots, options.quick)),
        progress=demo.progress_bars(console),
    )
    report = hhr.make_report(full_order, snapshots, result, seed=options.seed, stages=training.stages)
    report["thesis_size"] = thesis_size(training, report, options)
    hhr.write_report(report, options.out)
    hhr.print_report(report, console)
    hhr.save_model(options.out / "model.npz", result.hyper.model, result.hyper.reconstruction)
    pictures(training, result, report, options)
    console.print(f"report, pictures, fields and model are in {options.out}")


def thesis_size(training, report, options) -> dict:
    """Errors of the thesis-size recipe at the points of table 3.1, and its time beside the full order's."""
    full_order, reduction = training.full_order, training.build(demo.THESIS_SIZE, checked=False)
    inside = reduction.sets.A_lambda
    points = full_order.problem.parameters.random(205 if not options.quick else 20, options.seed + 3000)
    seconds = float(np.median(time_queries({"online": reduction.model.solve}, points)["online"]))
    errors = {}
    for point in POINTS:
        exact = full_order.solve(point).forces[inside]
        error = np.linalg.norm(reduction.model.solve(point).forces - exact) / np.linalg.norm(exact)
        errors[f"dual_rid at {point.tolist()}"] = float(error)
    return {
        "ell_bar": int(reduction.basis.shape[1]),
        "N_lambda_C": len(inside),
        **errors,
        "online_s": seconds,
        "fom_best/online": report["times"]["fom_best"]["median"] / seconds,
        "fom_naive/online": report["times"]["fom_naive"]["median"] / seconds,
    }


def thesis_tables(training, folder, console) -> None:
    """Rows of tables 3.1, 3.2 and 3.3 of the thesis beside ours, printed and written to a file."""
    full_order, snapshots = training.full_order, training.snapshots
    references = solve_references(full_order, snapshots, POINTS)
    table = Table("eps 2", "size", "errors % at (170, 3.2)", "at (30, 5.25)", title="table 3.1: thesis | here")
    rows = []
    for _, epsilon, size, *theirs in THESIS_ROWS:
        recipe = hhr.ReductionSettings.thesis(
            1e-6, extended_pod_tolerance=epsilon, dual_pod_tolerance=4e-4, kappa_max=1.0
        )
        try:
            reduction = training.build(recipe, checked=False)
            values = measure_errors(full_order.problem, reduction, references).values
            ours = [100 * values[name][k] for k in (0, 1) for name in ("primal_euclid", "dual_rid")]
            mine = str(reduction.basis.shape[1])
        except HHRError as error:
            ours, mine = [float("inf")] * 4, f"refused: {error}"
        rows.append({"epsilon": epsilon, "thesis_size": size, "size": mine, "thesis": theirs, "here": ours})
        cells = [f"{theirs[k]:g}, {theirs[k + 1]:g} | {ours[k]:.2g}, {ours[k + 1]:.2g}" for k in (0, 2)]
        table.add_row("-" if epsilon is None else f"{epsilon:.1e}", f"{size} | {mine}", *cells)
    console.print(table)
    times = Table("table", "recipe", "size: thesis | here", "time: thesis | here", "x full order: thesis | here")
    fresh = full_order.problem.parameters.random(105, 5)
    full = float(np.median(time_queries({"fom": full_order.solve}, fresh)["fom"]))
    for number, label, dual, epsilon, size, milliseconds in THESIS_TIMES:
        recipe = hhr.ReductionSettings.thesis(1e-6, extended_pod_tolerance=epsilon, dual_pod_tolerance=dual)
        reduction = training.build(recipe, checked=False)
        online = float(np.median(time_queries({"online": reduction.model.solve}, fresh)["online"]))
        rows.append({"table": number, "recipe": label, "size": reduction.basis.shape[1], "online_s": online})
        times.add_row(
            number, label, f"{size} | {reduction.basis.shape[1]}",
            f"{milliseconds} ms | {online * 1e6:.0f} us", f"{704 / milliseconds:.1f} | {full / online:.0f} (best)",
        )  # fmt: skip
    console.print(times)
    (folder / "thesis_tables.json").write_text(json.dumps(rows, indent=2))


def pictures(training, result, report, options) -> None:
    """Work-precision, error maps, RID and fields at (170 MPa, 3.2 mm), contact forces."""
    from hhr_dolfinx.study import plots

    full_order, snapshots = training.full_order, training.snapshots
    problem, hyper, folder = full_order.problem, result.hyper, options.out
    plots.plot_work_precision(report["work_precision"], folder / "work_precision.png")
    thesis = hhr.ReductionSettings.thesis(1e-6, dual_pod_tolerance=4e-4)
    models = {
        "thesis, EF": training.build(thesis, checked=False),
        "thesis size, POD+EF": training.build(demo.THESIS_SIZE, checked=False),
        "default": hyper,
    }
    references = solve_references(
        full_order, snapshots, problem.parameters.grid([12, 10] if options.quick else [40, 30])
    )
    maps = {name: measure_errors(problem, model, references).values for name, model in models.items()}
    for error in ("dual_rid_floored", "dual_full_floored"):
        shown = {name: values[error] for name, values in maps.items()}
        plots.plot_maps(references.points, shown, ("P1 [MPa]", "h1 [mm]"), folder / f"map_{error}.png")
    point = POINTS[0]
    exact, (displacement, forces) = full_order.solve(point), hyper.solve_everywhere(point)
    grid = plots.field_grid(problem, hyper, full_order=exact.primal, hhr=displacement)
    for name, field in (("full order", exact.primal), ("HHR", displacement)):
        grid.point_data[f"u_r {name} [mm]"] = field[::2]
        grid.cell_data[f"von Mises {name} [MPa]"] = full_order.discretisation.von_mises(field)
    names = [f"{quantity} {model} {unit}" for quantity, unit in (("u_r", "[mm]"), ("von Mises", "[MPa]"))
             for model in ("full order", "HHR")]  # fmt: skip
    plots.plot_fields(grid, ["rid", *names], folder / "fields.png")
    grid.save(folder / "fields.vtu")
    side = problem.contact_pairs == 0
    z = problem.contact_points[side, 1]
    answers = [(z, forces[side])]
    plots.plot_multipliers(z, [exact.forces[side]], answers, ["170 MPa, 3.2 mm"], folder / "multipliers.png", "z [mm]")
