"""Fuel pellet in its cladding on meshes that do not match, thesis section 5.3.

As ``pellet_cladding.py``, with 76 instead of 100 cells along the cladding: N = 13,708, and 101 conditions on the side
of the pellet, which is the slave surface. The reduced problem is a generalised saddle point (5.27) on a closed RID.

What to see: the thesis' recipe on a small RID is refused, cond(K~) is 1e9 although both inf-sup constants are perfect;
with layers of cells it answers. The default recipe is as good as on matching meshes; mortar costs the same.

    python demos/pellet_cladding_nonmatching.py [--out DIR] [--quick] [--seed N] [--pairing mortar] [--bottom held]
"""

import dataclasses

import numpy as np
from mpi4py import MPI
from pellet_cladding import QUICK_MESH
from pellet_cladding import scene as matching_scene
from rich.console import Console
from rich.table import Table

import hhr_dolfinx as hhr
from hhr_dolfinx.geometries import pellet_cladding as geometry
from hhr_dolfinx.snapshots.accuracy import relative_error
from hhr_dolfinx.study.cli import demo_parser, progress_bars

POINT = (190.0, 5.2)
THESIS = {"primal_l2": 0.021, "dual_rid": 0.039, "von_mises": 0.0076, "sigma_rr": 0.0078}
"""Errors of the thesis at the point, section 5.3.2."""
PAIRINGS = {"node_to_surface": hhr.NodeToSurface, "mortar": hhr.Mortar, "double_pass": hhr.DoublePass}


def scene(pairing="node_to_surface", bottom="obstacle", **mesh_options) -> hhr.Scene:
    """The scene in mm and MPa; the mesh options are those of :func:`geometry.pellet_cladding`."""
    base = matching_scene(bottom, **{"cladding_axial_cells": 76, **mesh_options})
    side = PAIRINGS[pairing](geometry.PELLET_SIDE, geometry.CLADDING_INNER, normal=(1.0, 0.0))
    return dataclasses.replace(base, name="pellet_cladding_nonmatching", contacts=(side, *base.contacts[1:]))


def variants():
    """The thesis' recipe, with layers added, and the default one with fewer modes."""
    thesis = {"dual_pod_tolerance": 1e-3, "kappa_max": 1.0}
    for layers in (0, 1, 2, 4):
        yield f"thesis, {layers} layers", hhr.ReductionSettings.thesis(1e-6, layers=layers, **thesis)
    for tolerance in (1e-9, 1e-10):
        yield f"relative {tolerance:.0e}", hhr.ReductionSettings(tolerance)


def errors_at_point(training, hyper) -> dict:
    """Errors at the point of section 5.3.2 in the norms of the thesis."""
    full_order = training.full_order
    exact, (displacement, forces) = full_order.solve(POINT), hyper.solve_everywhere(POINT)
    inside = hyper.sets.A_lambda
    stresses = [full_order.discretisation.stress(field) for field in (displacement, exact.primal)]
    von_mises = [full_order.discretisation.von_mises(field) for field in (displacement, exact.primal)]
    return {
        "primal_l2": relative_error(displacement, exact.primal, full_order.problem.mass),
        "dual_rid": relative_error(forces[inside], exact.forces[inside]),
        "von_mises": relative_error(*von_mises),
        "sigma_rr": relative_error(*(stress[:, 0, 0] for stress in stresses)),
    }


def main() -> None:
    """Train, study, report."""
    parser = demo_parser("pellet_cladding_nonmatching", __doc__.splitlines()[0])
    parser.add_argument("--pairing", choices=PAIRINGS, default="node_to_surface")
    parser.add_argument("--bottom", choices=("obstacle", "held"), default="obstacle")
    options = parser.parse_args()
    console = Console(quiet=MPI.COMM_WORLD.rank > 0)
    bars = progress_bars(console)
    mesh = {**QUICK_MESH, "cladding_axial_cells": 15} if options.quick else {}
    built = scene(options.pairing, options.bottom, **mesh)
    training = hhr.train(built, [25, 20], seed=options.seed, folder=options.out / "snapshots", progress=bars)
    if MPI.COMM_WORLD.rank > 0:
        return
    points = built.parameters.random(20 if options.quick else 200, options.seed)
    settings = hhr.StudySettings(variants=list(variants()), queries=15 if options.quick else 100, seed=options.seed)
    full_order, snapshots = training.full_order, training.snapshots
    result = hhr.run_study(full_order, snapshots, points, settings, held_out=training.held_out, progress=bars)
    report = hhr.make_report(full_order, snapshots, result, seed=options.seed, stages=training.stages)
    report["point"] = {"P1, h1": POINT, "thesis": THESIS, "here": errors_at_point(training, result.hyper)}
    hhr.write_report(report, options.out)
    hhr.print_report(report, console)
    table = Table("error at (190 MPa, 5.2 mm)", "thesis", "here")
    for name, value in report["point"]["here"].items():
        table.add_row(name, f"{THESIS[name]:.2%}", f"{value:.3%}")
    console.print(table)
    hhr.save_model(options.out / "model.npz", result.hyper.model, result.hyper.reconstruction)
    pictures(training, result, report, options.out)
    console.print(f"report, pictures, fields and model are in {options.out}")


def pictures(training, result, report, folder) -> None:
    """Fields, RID and contact pressure at the point; error against run time."""
    from hhr_dolfinx.study import plots

    full_order, hyper = training.full_order, result.hyper
    problem, exact, (displacement, forces) = full_order.problem, full_order.solve(POINT), hyper.solve_everywhere(POINT)
    grid = plots.field_grid(problem, hyper, full_order=exact.primal, hhr=displacement)
    for name, field in (("full order", exact.primal), ("HHR", displacement)):
        grid.point_data[f"u_r {name} [mm]"] = field[::2]
        grid.cell_data[f"von Mises {name} [MPa]"] = full_order.discretisation.von_mises(field)
    shown = [f"{field} {name} {unit}" for field, unit in (("u_r", "[mm]"), ("von Mises", "[MPa]"))
             for name in ("full order", "HHR")]  # fmt: skip
    plots.plot_fields(grid, ["rid", *shown], folder / "fields.png")
    grid.save(folder / "fields.vtu")
    side = np.flatnonzero(problem.contact_pairs == 0)
    side = side[np.argsort(problem.contact_points[side, 1])]
    z, answers = problem.contact_points[side, 1], [(problem.contact_points[side, 1], forces[side])]
    plots.plot_multipliers(z, [exact.forces[side]], answers, ["190 MPa, 5.2 mm"], folder / "multipliers.png", "z [mm]")
    plots.plot_work_precision(report["work_precision"], folder / "work_precision.png")


if __name__ == "__main__":
    main()
