"""Two half-discs pressed together: hyper-reduced contact with one parameter.

Two elastic half-discs of radius 1 m face each other across a gap of 0.1 m. Their flat edges are moved
towards each other by mu in [0.15, 0.45] m (thesis sections 1.5.1, 2.6.2 and 3.5.1; after Benaceur, Ern and
Ehrlacher 2020). The model is trained on 31 values of mu and compared with the full order on 101.

What to see: nine modes and eight contact nodes answer what 1356 unknowns and 55 contact pairs did, in
a tenth of the time of the best full-order solver, with errors below one in a thousand.

    python demos/hertz_half_discs.py [--out DIR] [--quick] [--seed N]
"""

import time

import numpy as np
from rich.console import Console

import hhr_dolfinx as hhr
from hhr_dolfinx.geometries import hertz_half_discs as geometry
from hhr_dolfinx.study.cli import demo_parser, progress_bars

RECIPE = hhr.ReductionSettings.thesis(pod_tolerance=1e-8)
"""The thesis' own recipe: it needs no enrichment here."""


def scene(**mesh_options) -> hhr.Scene:
    """The scene; ``mesh_options`` go to :func:`geometry.half_discs`. Units: m, Pa."""
    towards = {geometry.LOWER_FLAT: 0.5, geometry.UPPER_FLAT: -0.5}
    return hhr.Scene(
        name="hertz_half_discs",
        geometry=lambda comm: geometry.half_discs(comm, **mesh_options),
        hypothesis="plane_strain",
        bodies=tuple(hhr.Body(tag, young=15.0, poisson=0.35) for tag in (geometry.LOWER, geometry.UPPER)),
        contacts=(hhr.NodeToNode(geometry.LOWER_ARC, geometry.UPPER_ARC, normal=(0.0, 1.0)),),
        parameters=hhr.ParameterSpace(("mu",), (0.15,), (0.45,)),
        displacements=tuple(
            hhr.Displacement(tag, component, amplitude)
            for tag, slope in towards.items()
            for component, amplitude in ((0, hhr.Amplitude()), (1, hhr.Amplitude(slopes={"mu": slope})))
        ),
    )


def main() -> None:
    """Train, validate, time, and write everything to the output folder."""
    options = demo_parser("hertz_half_discs", __doc__.splitlines()[0]).parse_args()
    stages, start = {}, time.perf_counter()
    full_order = hhr.FullOrderModel(scene())
    console = Console(quiet=full_order.comm.rank > 0)
    stages["full_order"], start = time.perf_counter() - start, time.perf_counter()
    space = full_order.problem.parameters
    snapshots = hhr.compute_snapshots(full_order, space.grid([31]), progress_bars(console)("snapshots"))
    stages["snapshots"] = time.perf_counter() - start
    points = space.grid([11 if options.quick else 101])
    sizes = [(f"eps {eps:.0e}", hhr.ReductionSettings.thesis(eps)) for eps in (1e-4, 1e-5, 1e-6, 1e-7, 1e-9, 1e-10)]
    settings = hhr.StudySettings(
        RECIPE, [*sizes, ("default", hhr.ReductionSettings())], 20 if options.quick else 400, options.seed
    )
    result = hhr.run_study(full_order, snapshots, points, settings, progress=progress_bars(console))
    report = hhr.make_report(full_order, snapshots, result, seed=options.seed, stages=stages)
    shown = [(mu, full_order.solve(mu)) for mu in (0.168, 0.255, 0.345, 0.435)]  # none is a training value
    if full_order.comm.rank > 0:
        return
    hhr.write_report(report, options.out)
    hhr.print_report(report, console)
    hhr.save_model(options.out / "model.npz", result.hyper.model, result.hyper.reconstruction)
    pictures(full_order.problem, result, report, shown, options.out)
    console.print(f"report, pictures, fields and model are in {options.out}")


def pictures(problem, result, report, shown, folder) -> None:
    """Deformed meshes with the RID, multipliers, errors over mu, error against run time."""
    from hhr_dolfinx.study import plots

    hyper, x = result.hyper, problem.contact_points[:, 0]
    forces, labels = [solution.forces for _, solution in shown], [f"mu = {mu} m" for mu, _ in shown]
    answers = [(x[hyper.sets.A_lambda], hyper.model.solve(mu).forces) for mu, _ in shown]
    plots.plot_multipliers(x, forces, answers, labels, folder / "multipliers.png", "x [m]")
    names = ("primal_euclid", "primal_energy", "dual_rid", "energy_minimum")
    errors = {name: result.errors.values[name] for name in names}
    plots.plot_errors(np.ravel(result.points), errors, "mu [m]", folder / "errors.png")
    plots.plot_work_precision(report["work_precision"], folder / "work_precision.png")
    mu, solution = shown[2]
    fields = {"full_order": solution.primal, "hhr": hyper.solve_everywhere(mu)[0]}
    grid = plots.field_grid(problem, hyper, **fields)
    grid.save(folder / "fields.vtu")
    plots.plot_deformed(grid, list(fields), folder / "deformed.png")


if __name__ == "__main__":
    main()
