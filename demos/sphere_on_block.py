"""A steel sphere pressed on an aluminium block: contact in space on meshes that do not match.

One quarter of a sphere of radius 10 mm is pushed by 0.05 to 0.25 mm on a block that is squeezed from the side by up
to 200 MPa. 625 mortar conditions; contact radius and peak pressure are compared with Hertz (1882).

What to see: mortar meets Hertz within a few per cent, node-to-surface misses the pressure at the pole by a quarter. The
reduced model answers some hundred times faster than the full order. Exact condensation gives forces alone as fast, but
has to solve for and keep a displacement field for each of its conditions; with fields HHR is several times faster.

    python demos/sphere_on_block.py [--out DIR] [--quick] [--seed N]
"""

import numpy as np
from mpi4py import MPI
from rich.console import Console
from rich.table import Table

import hhr_dolfinx as hhr
from hhr_dolfinx.geometries import sphere_on_block as geometry
from hhr_dolfinx.study.cli import demo_parser, progress_bars

RADIUS, YOUNG, POISSON = 10.0, {geometry.SPHERE: 210e3, geometry.BLOCK: 70e3}, 0.3
MESH = {"sphere_cells": (24, 10), "block_cells": (18, 8)}
QUICK_MESH = {"sphere_cells": (10, 5), "block_cells": (8, 4), "grading": 2.5}
RECIPE = hhr.ReductionSettings(dual_pod_tolerance=None, layers=0)
"""Three components at each node and a compact contact zone: the points of the primal DEIM are enough."""


def scene(pairing=hhr.Mortar, **mesh_options) -> hhr.Scene:
    """The scene in mm and MPa; ``mesh_options`` go to :func:`geometry.sphere_on_block`."""
    symmetry = [hhr.Displacement(tag, axis) for axis, tags in geometry.SYMMETRY.items() for tag in tags]
    push = hhr.Displacement(geometry.SPHERE_TOP, 2, hhr.Amplitude(slopes={"push": -1.0}))
    return hhr.Scene(
        name="sphere_on_block",
        geometry=lambda comm: geometry.sphere_on_block(comm, radius=RADIUS, **mesh_options),
        hypothesis="solid",
        bodies=tuple(hhr.Body(tag, young, POISSON) for tag, young in YOUNG.items()),
        contacts=(pairing(geometry.SPHERE_BOTTOM, geometry.BLOCK_TOP, normal=(0.0, 0.0, -1.0)),),
        parameters=hhr.ParameterSpace(("push", "squeeze"), (0.05, 0.0), (0.25, 200.0)),
        displacements=(*symmetry, hhr.Displacement(geometry.BLOCK_BOTTOM, 2), push),
        loads=(hhr.Pressure(geometry.BLOCK_SIDE, hhr.Amplitude(slopes={"squeeze": 1.0})),),
    )


def hertz(load):
    """Contact radius and peak pressure of Hertz under a load: a^3 = 3 P R / (4 E*), p0 = 3 P / (2 pi a^2)."""
    modulus = 1 / sum((1 - POISSON**2) / young for young in YOUNG.values())
    radius = (3 * load * RADIUS / (4 * modulus)) ** (1 / 3)
    return radius, 3 * load / (2 * np.pi * radius**2)


def beside_hertz(full_order, push) -> dict:
    """Contact radius and pressures of the full order, relative to Hertz under the load it computes.

    The radius is that of the elliptic pressure with the same second moment, sum(f r^2) / P = 2 a^2 / 5.
    """
    problem, forces = full_order.problem, full_order.solve([push, 0.0]).forces
    distance = np.linalg.norm(problem.contact_points[:, :2], axis=1)
    pressure, load = forces / problem.contact_areas, forces.sum()
    radius, peak = hertz(4 * load)
    return {
        "push": push,
        "radius": float(np.sqrt(2.5 * forces @ distance**2 / load) / radius - 1),
        "peak": float(pressure.max() / peak - 1),
        "pole": float(pressure[distance.argmin()] / peak - 1),
    }


def main() -> None:
    """Compare with Hertz, train, study, report."""
    options = demo_parser("sphere_on_block", __doc__.splitlines()[0]).parse_args()
    console = Console(quiet=MPI.COMM_WORLD.rank > 0)
    bars, mesh = progress_bars(console), QUICK_MESH if options.quick else MESH
    built = scene(**mesh)
    folder = options.out / "snapshots"
    training = hhr.train(built, [25, 5], held_out=20, seed=options.seed, folder=folder, progress=bars)
    if MPI.COMM_WORLD.rank > 0:
        return
    full_order, snapshots = training.full_order, training.snapshots
    variants = [("two layers", hhr.ReductionSettings())]
    variants += [
        (f"eps {eps:.0e}", hhr.ReductionSettings(eps, dual_pod_tolerance=None, layers=0)) for eps in (1e-8, 1e-9)
    ]
    queries = 15 if options.quick else 200
    settings = hhr.StudySettings(RECIPE, variants, queries=queries, seed=options.seed, naive=False)
    points = built.parameters.random(20 if options.quick else 200, options.seed)
    result = hhr.run_study(full_order, snapshots, points, settings, held_out=training.held_out, progress=bars)
    report = hhr.make_report(full_order, snapshots, result, seed=options.seed, stages=training.stages)
    nodal = hhr.FullOrderModel(scene(hhr.NodeToSurface, **mesh), MPI.COMM_SELF)
    models = {"mortar": full_order, "node_to_surface": nodal}
    report["hertz"] = {
        name: [beside_hertz(model, push) for push in (0.1, 0.15, 0.25)] for name, model in models.items()
    }
    hhr.write_report(report, options.out)
    hhr.print_report(report, console)
    table = Table(
        "pairing", "push [mm]", "contact radius", "peak pressure", "pressure at the pole", title="beside Hertz"
    )
    for name, rows in report["hertz"].items():
        for row in rows:
            table.add_row(name, f"{row['push']:g}", *(f"{row[key]:+.1%}" for key in ("radius", "peak", "pole")))
    console.print(table)
    hhr.save_model(options.out / "model.npz", result.hyper.model, result.hyper.reconstruction)
    pictures(training, result, report, options.out)
    console.print(f"report, pictures, fields and model are in {options.out}")


def pictures(training, result, report, folder) -> None:
    """Contact pressure beside Hertz, the RID and stresses, error against run time."""
    from hhr_dolfinx.study import plots

    full_order, hyper, mu = training.full_order, result.hyper, (0.21, 60.0)
    problem, exact, (displacement, forces) = full_order.problem, full_order.solve(mu), hyper.solve_everywhere(mu)
    distance = np.linalg.norm(problem.contact_points[:, :2], axis=1)
    order = np.argsort(distance)[: int((exact.forces > 0).sum() * 1.3)]
    r, pressures = distance[order], [(f / problem.contact_areas)[order] for f in (exact.forces, forces)]
    radius, peak = hertz(4 * exact.forces.sum())
    curve = peak * np.sqrt(np.maximum(1 - (r / radius) ** 2, 0.0))
    plots.plot_multipliers(
        r, [pressures[0], curve], [(r, pressures[1]), (r[:0], r[:0])], ["push 0.21 mm", "Hertz"],
        folder / "pressure.png", "distance from the pole [mm]", "contact pressure [MPa]",
    )  # fmt: skip
    grid = plots.field_grid(problem, hyper, full_order=exact.primal, hhr=displacement)
    grid.cell_data["von Mises HHR [MPa]"] = full_order.discretisation.von_mises(displacement)
    grid.cell_data["von Mises full order [MPa]"] = full_order.discretisation.von_mises(exact.primal)
    grid.save(folder / "fields.vtu")
    plots.plot_fields(grid, ["rid", "von Mises full order [MPa]", "von Mises HHR [MPa]"], folder / "fields.png")
    plots.plot_work_precision(report["work_precision"], folder / "work_precision.png")


if __name__ == "__main__":
    main()
