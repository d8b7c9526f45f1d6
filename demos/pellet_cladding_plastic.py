"""Fuel pellet that yields in a cladding that creeps: a history in time, thesis section 6.2.

The pressure on the lowest 0.9 mm of the cladding grows to 450 MPa within a second, in 40 steps. The parameter is the
initial gap in [5, 15] um. Trained on the two ends of it, compared at 10 and 12.5 um and at four random gaps.

What to see: constitutive laws are evaluated on a fifth of the cells, and a history takes a tenth of the time. Too small
a RID converges to a wrong path with the smallest residuals; eigenvalues of the projected tangents tell beforehand.

    python demos/pellet_cladding_plastic.py [--out DIR] [--quick] [--seed N] [--exponent 5]
        [--train 5 7.5 15 --pod 1e-11 --layers 6]
"""

import time

import numpy as np
from pellet_cladding import QUICK_MESH
from rich.console import Console
from rich.table import Table

import hhr_dolfinx as hhr
from hhr_dolfinx.geometries import pellet_cladding as geometry
from hhr_dolfinx.snapshots.accuracy import relative_error, summary
from hhr_dolfinx.study.cli import demo_parser, progress_bars
from hhr_dolfinx.study.report import environment

THESIS = {10.0: (0.0089, 0.067, 0.046, 0.022), 12.5: (0.028, 0.025, 0.025, 0.0061)}
"""Table 6.1 by gap in um: errors of displacement, forces, sigma_rr and cumulated plastic strain."""
HEIGHT, PRESSURE, NOMINAL = 0.9, 450.0, 10e-3


def scene(exponent=4.0, **mesh_options) -> hhr.Scene:
    """The scene in mm, MPa and s; the mesh has the nominal gap, and the parameter opens or closes it."""
    mesh_options = {"cladding_axial_cells": 76, **mesh_options}
    held = (geometry.PELLET_BOTTOM, geometry.CLADDING_BOTTOM, geometry.CLADDING_TOP)
    return hhr.Scene(
        name="pellet_cladding_plastic",
        geometry=lambda comm: geometry.pellet_cladding(comm, gap=NOMINAL, **mesh_options),
        hypothesis="axisymmetric",
        bodies=(
            hhr.Body(geometry.PELLET, 190e3, 0.3, hhr.Plasticity(yield_stress=80.0, hardening=1e3)),
            hhr.Body(geometry.CLADDING, 78e3, 0.34, hhr.Norton(resistance=1e3, exponent=exponent)),
        ),
        contacts=(hhr.NodeToSurface(geometry.PELLET_SIDE, geometry.CLADDING_INNER, normal=(1.0, 0.0)),),
        parameters=hhr.ParameterSpace(("P1", "h1", "gap"), (0.0, 0.5, 4e-3), (PRESSURE, 1.5, 16e-3)),
        displacements=(
            hhr.Displacement(geometry.PELLET_AXIS, component=0),
            *(hhr.Displacement(tag, component=1) for tag in held),
        ),
        loads=(hhr.PartialPressure(geometry.CLADDING_OUTER, hhr.Amplitude(slopes={"P1": 1.0}), extent="h1"),),
        openings=(hhr.Opening(contact=0, amplitude=hhr.Amplitude(-NOMINAL, {"gap": 1.0})),),
    )


def path(gap, steps=40):
    """Times and parameters of the history for a gap in um, the start first."""
    return [(k / steps, np.array([PRESSURE * k / steps, HEIGHT, gap * 1e-3])) for k in range(steps + 1)]


def pressed_nodes(full) -> tuple[int, ...]:
    """Nodes of the cladding under pressure, which are part of the RID (section 6.2.3)."""
    r, z = full.problem.points.T
    return tuple(np.flatnonzero((r > r.max() * (1 - 1e-9)) & (z <= HEIGHT)).tolist())


def errors(full, reduction, history, exact) -> dict:
    """Relative errors at the last step as in table 6.1, and the worst displacement error of the history."""
    model, here, there = reduction.model, history.points[-1], exact.points[-1]
    cumulated = here.state.cumulated, there.state.cumulated[model.points]
    fields = [
        relative_error(reduction.displacement_everywhere(p), full.displacement(q))
        for p, q in zip(history.points, exact.points, strict=True)
    ]
    return {
        "primal_euclid": fields[-1],
        "dual_rid": relative_error(here.forces, there.forces[model.sets.A_lambda]),
        "stress_rr": relative_error(here.stress[:, 0], there.stress[model.points][:, 0]),
        "plastic_strain": relative_error(*cumulated),
        "plastic_strain_everywhere": relative_error(reduction.plastic_strain_everywhere(here), there.state.cumulated),
        "stress_rr_everywhere": relative_error(reduction.stress_everywhere(here)[:, 0], there.stress[:, 0]),
        "dual_full": relative_error(reduction.forces_everywhere(here), there.forces),
        "worst_displacement": max(fields),
    }


def timed(model, gap, steps, settings):
    """A history and its seconds."""
    start = time.perf_counter()
    history = hhr.march(model, path(gap, steps), settings)
    return history, time.perf_counter() - start


def seconds_of_parts(model, point, repetitions=20) -> dict[str, float]:
    """Seconds of each part of an iteration at a state, and of a new tangent."""
    theta = model.amplitudes(point.parameter)
    strain = model.strain(point.unknown, theta)
    update = model.material.update(strain, point.state, 0.025, tangent=True)
    residual, _ = model.residual(update.stress, theta)
    parts = {
        "strain": lambda: model.strain(point.unknown, theta),
        "laws": lambda: model.material.update(strain, point.state, 0.025, tangent=False),
        "residual": lambda: model.residual(update.stress, theta),
        "tangent": lambda: model.linearise(update.tangents),
        "contact": lambda: model.correct(residual, point.unknown, theta, point.active),
    }
    seconds = {}
    for name, part in parts.items():
        start = time.perf_counter()
        for _ in range(repetitions):
            part()
        seconds[name] = (time.perf_counter() - start) / repetitions
    return seconds


def main() -> None:
    """Train, compare, time full and reduced in turns, report."""
    parser = demo_parser("pellet_cladding_plastic", __doc__.splitlines()[0])
    parser.add_argument("--exponent", type=float, default=4.0, help="exponent of Norton's law (%(default)s)")
    parser.add_argument("--pod", type=float, default=1e-9, help="tolerance of the POD of displacements (%(default)s)")
    parser.add_argument("--layers", type=int, default=3, help="layers of cells to begin with (%(default)s)")
    parser.add_argument("--train", type=float, nargs="+", default=[5.0, 15.0], help="gaps to train on in um")
    options = parser.parse_args()
    console = Console()
    bars, steps = progress_bars(console), 10 if options.quick else 40
    start = time.perf_counter()
    mesh = {**QUICK_MESH, "cladding_axial_cells": 15, "cladding_radial_cells": 3} if options.quick else {}
    full = hhr.PlasticFullOrder(scene(options.exponent, **mesh))
    offline = {"full_order": time.perf_counter() - start}
    gaps = [
        10.0,
        12.5,
        *np.sort(np.random.default_rng(options.seed).uniform(5, 15, 1 if options.quick else 4)).round(3),
    ]
    settings = hhr.MarchSettings()
    start = time.perf_counter()
    training = [hhr.march(full, path(gap, steps), settings) for gap in bars("training")(options.train)]
    offline["snapshots"], start = time.perf_counter() - start, time.perf_counter()
    recipe = hhr.PlasticSettings(options.pod, layers=options.layers, zone_nodes=pressed_nodes(full))
    reduction = hhr.build_plastic_reduction(full, training, recipe)
    offline["reduction"] = time.perf_counter() - start
    hhr.march(reduction.model, path(gaps[0], steps)[:3])  # compiles
    rows, full_times, reduced_times = [], [], []
    for gap in bars("test gaps")(gaps):
        exact, full_seconds = timed(full, gap, steps, settings)
        runs = [timed(reduction.model, gap, steps, settings) for _ in range(3)]
        history = runs[0][0]
        full_times.append(full_seconds)
        reduced_times.append(float(np.median([seconds for _, seconds in runs])))
        rows.append({"gap_um": float(gap), **errors(full, reduction, history, exact), "cuts": history.cuts,
                     "iterations": history.iterations, "full_iterations": exact.iterations})  # fmt: skip
    searches = {"frozen": float(np.median(full_times))}
    for search in ("tangent", "elastic"):
        searches[search] = timed(full, gaps[0], steps, hhr.MarchSettings(search, iterations=200))[1]
    parts = [seconds_of_parts(*pair) for pair in ((full, exact.points[-1]), (reduction.model, history.points[-1]))]
    online, fom_best = float(np.median(reduced_times)), float(np.median(full_times))
    measured = [name for name in rows[0] if name not in ("gap_um", "cuts", "iterations", "full_iterations")]
    report = {
        "scene": full.scene.name,
        "seed": options.seed,
        **environment(),
        "sizes": {
            "N": full.size, "N_lambda": full.conditions, "ell_bar": reduction.model.size,
            "ell": reduction.model.size - len(reduction.enrichment.added), "N_lambda_C": reduction.model.conditions,
            "cells": len(full.problem.cell_nodes), "rid_cells": len(reduction.model.cells), "layers": reduction.layers,
            "snapshots": sum(len(history.points) for history in training),
        },
        "stability": {
            "kappa_B": reduction.enrichment.kappas[-1], "tangent": reduction.tangent,
            "enrichment": [{"added": k, "kappa": kappa} for k, kappa in enumerate(reduction.enrichment.kappas)],
        },
        "errors": {name: summary([row[name] for row in rows]) for name in measured},
        "gaps": rows,
        "times": {
            "offline": offline, "fom_best": summary(full_times), "fom_searches": searches, "condensed": None,
            "online": summary(reduced_times), "parts": dict(zip(("fom", "online"), parts, strict=True)),
        },
        "ratios": {"fom_best/online": fom_best / online, "laws": parts[0]["laws"] / parts[1]["laws"]},
        "work_precision": [
            {"method": "HHR", "setting": f"{reduction.layers} layers", "online_s": online,
             "primal_euclid": summary([row["primal_euclid"] for row in rows])["median"]},
            {"method": "fom_best", "setting": "frozen tangent", "online_s": fom_best, "primal_euclid": 0.0},
        ],
        "skipped": [{"stage": "condensed", "why": "the stiffness changes with the flow"}],
        "refused_before": reduction.refused,
    }  # fmt: skip
    hhr.write_report(report, options.out)
    print_report(report, console)
    pictures(full, reduction, exact, history, options.out)
    console.print(f"report, pictures and fields are in {options.out}")


def print_report(report, console) -> None:
    """Sizes, errors beside the thesis', times."""
    sizes = report["sizes"]
    console.print(
        f"{sizes['N']} dofs, {sizes['N_lambda']} contacts -> {sizes['ell_bar']} modes, {sizes['N_lambda_C']} contacts "
        f"on {sizes['rid_cells']} of {sizes['cells']} cells ({sizes['layers']} layers); "
        f"tangents {report['stability']['tangent']:.2f}"
    )
    for item in report["refused_before"]:
        console.print(f"{item['layers']} layers refused: {item['why']}")
    names = list(report["errors"])
    table = Table("gap [um]", *names, title="errors at the last step in %, thesis in brackets")
    for row in report["gaps"]:
        thesis = THESIS.get(row["gap_um"], ())
        cells = [f"{100 * row[name]:.2g}" + (f" ({100 * thesis[k]:.2g})" if k < len(thesis) else "")
                 for k, name in enumerate(names)]  # fmt: skip
        table.add_row(f"{row['gap_um']:g}", *cells)
    console.print(table)
    times, ratios = report["times"], report["ratios"]
    shown = Table("part of an iteration", *times["parts"]["fom"], title="where the time goes, ms")
    for model in ("fom", "online"):
        shown.add_row(model, *(f"{1e3 * seconds:.2f}" for seconds in times["parts"][model].values()))
    console.print(shown)
    searches = times["fom_searches"]
    console.print(
        f"a history takes {times['fom_best']['median']:.2f} s in full ({searches['tangent']:.2f} s by Newton's method,"
        f" {searches['elastic']:.2f} s with the elastic operator) and {times['online']['median']:.3f} s reduced:"
        f" ratio {ratios['fom_best/online']:.1f}; the laws alone {ratios['laws']:.1f}"
    )


def pictures(full, reduction, exact, history, folder) -> None:
    """Fields of the last step, contact forces, and the history of force and plastic strain."""
    from hhr_dolfinx.study import plots

    problem, here, there = full.problem, history.points[-1], exact.points[-1]
    displacement = reduction.displacement_everywhere(here)
    grid = plots.field_grid(problem, reduction.model, full_order=full.displacement(there), hhr=displacement)
    per_cell = full.operator.weights.shape[1]
    for name, field, cumulated in (
        ("full order", full.displacement(there), there.state.cumulated),
        ("HHR", displacement, reduction.plastic_strain_everywhere(here)),
    ):
        grid.point_data[f"u_r {name} [mm]"] = field[::2]
        grid.cell_data[f"plastic strain {name}"] = cumulated.reshape(-1, per_cell).mean(axis=1)
    for name, stress in (("full order", there.stress), ("HHR", reduction.stress_everywhere(here))):
        grid.cell_data[f"sigma_rr {name} [MPa]"] = stress[:, 0].reshape(-1, per_cell).mean(axis=1)
    grid.save(folder / "fields.vtu")
    shown = [f"{field} {name}{unit}" for field, unit in (("plastic strain", ""), ("sigma_rr", " [MPa]"))
             for name in ("full order", "HHR")]  # fmt: skip
    plots.plot_fields(grid, ["rid", *shown], folder / "fields.png")
    order = np.argsort(problem.contact_points[:, 1])
    z, forces = problem.contact_points[order, 1], reduction.forces_everywhere(here)[order]
    plots.plot_multipliers(z, [there.forces[order]], [(z, forces)], ["last step"], folder / "multipliers.png", "z [mm]")
    times = np.array([point.time for point in exact.points])
    curves = {
        "force, full order [kN]": (times, [point.forces.sum() / 1e3 for point in exact.points]),
        "force, HHR [kN]": (times, [reduction.forces_everywhere(point).sum() / 1e3 for point in history.points]),
        "largest plastic strain, full order [%]": (times, [100 * p.state.cumulated.max() for p in exact.points]),
        "largest plastic strain, HHR [%]": (times, [100 * p.state.cumulated.max() for p in history.points]),
    }
    curves = {name: (where, np.array(values)) for name, (where, values) in curves.items()}
    plots.plot_curves(curves, "time [s]", "", folder / "histories.png")
    iterations = {"full order": exact.iterations, "HHR": history.iterations}
    curves = {name: (times, np.array(values)) for name, values in iterations.items()}
    plots.plot_curves(curves, "time [s]", "iterations of a step", folder / "iterations.png")


if __name__ == "__main__":
    main()
