"""Indentation: a steel sphere pressed into a block that yields, in space, loaded and unloaded.

One quarter of a sphere of radius 10 mm is pushed up to 0.03 mm into a block and drawn off again; mortar contact. Depth,
yield stress, hardening and Young's modulus of the block are parameters. What is read off is the curve of force over
depth, the imprint that stays, and how the surface rises beside it.

What to see: condensed flow answers a history in some hundredths of the time of the full order, which makes histories
cheap enough to find yield stress and hardening in curves with noise, by gradients and by a random walk. Small loads are
Hertz's (1882), the deepest are fully plastic, where the mean pressure tends to three times the yield stress (Tabor
1951; K. L. Johnson, Contact Mechanics, 1985, section 6.3).

    python demos/indentation.py [--out DIR] [--quick] [--seed N] [--cells 10 14] [--hhr]
"""

import resource
from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
from scipy.optimize import least_squares

import hhr_dolfinx as hhr
from hhr_dolfinx.certify.compare import largest_errors
from hhr_dolfinx.geometries import sphere_on_block as geometry
from hhr_dolfinx.models.answer import History, Path
from hhr_dolfinx.reduction.condense_flow import CorrectionSettings
from hhr_dolfinx.study import cli, report
from hhr_dolfinx.timing import timed

RADIUS, WIDTH, SPHERE_E, BLOCK_E, POISSON = 10.0, 0.4, 210e3, 70e3, 0.3
BOX = {"depth": (0.0, 0.03), "sy": (100.0, 300.0), "H": (0.0, 10e3), "E": (60e3, 80e3)}
"""Ranges of the parameters, in mm and MPa; the last is one only where a scene asks for it."""
RINGS = (0.5, 0.8, 1.1)
"""Distances from the pole in mm at which the rise of the surface is read off."""
TRAINED = hhr.ParameterSpace(("depth", "sy", "H", "E"), (0.015, 100.0, 1e3, 60e3), (0.03, 300.0, 10e3, 80e3))
"""What is varied from path to path: the largest depth, and constants of the block."""
CELLS, QUICK_CELLS, DEPTH, REPETITIONS = (10, 14, 19, 25), (10,), 0.03, 3
NOISE, LEAST, CURVES, TRUE = 0.01, 0.02, 16, np.array([150.0, 6e3])
"""Readings of a curve are off by a hundredth of each, or of a fiftieth of the largest; sixteen curves are measured."""
# the elastic operator has its factors and all columns of the contact already, and takes few more iterations than
# tangents, which in space cost as much as ten iterations each
MARCH = hhr.MarchSettings(search="elastic")
# forces are wished at p95 of histories; at any step of any of them they are up to half as far off again
CORRECTION = CorrectionSettings(modes=8e-3, cubature=4e-3, dual=0.1)


def scene(cells: int = CELLS[2], young: float | str = BLOCK_E) -> hhr.Scene:
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
            *(hhr.DisplacementAt(f"rise at {r}", (r, 0.0, 0.0), 2, geometry.BLOCK, unit="mm") for r in RINGS),
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


def pressures(full: hhr.FullOrderModel, history: History) -> list[dict[str, float]]:
    """Radius and mean pressure of a history of a block with the usual E, by Tabor's numbers.

    The radius is that of an even pressure with the second moment of the one found, 2 F = a^2 / integral of p r^2:
    E* a / (sy R) is 2.5 where the block begins to yield, and from 30 on the mean pressure is some 2.8 to 3 sy.
    """
    distance = np.hypot(*full.problem.contact_points[:, :2].T)
    modulus = 1 / sum((1 - POISSON**2) / young for young in (SPHERE_E, BLOCK_E))
    rows = []
    for answer in history.answers:
        forces, (depth, yield_stress, hardening, *_) = answer.forces(), answer.parameter
        if forces.sum() > 0:
            radius = np.sqrt(2 * forces @ distance**2 / forces.sum())
            rows.append({"depth": depth, "sy": yield_stress, "H": hardening, "force": 4 * forces.sum(),
                         "E* a / (sy R)": modulus * radius / (yield_stress * RADIUS),
                         "mean pressure / sy": 4 * forces.sum() / (np.pi * radius**2 * yield_stress)})  # fmt: skip
    return rows


def training() -> list[Path]:
    """Sixteen paths drawn from the box of their parameters, and four of its corners, where most flows."""
    corners = [[0.03, 100.0, 1e3, 60e3], [0.03, 100.0, 1e3, 80e3], [0.03, 100.0, 10e3, 70e3], [0.03, 300.0, 1e3, 70e3]]
    return [path(*values) for values in [*hhr.Sobol(16).points(TRAINED), *corners]]


def tests(count: int = 8) -> list[Path]:
    """Other paths from the same box."""
    return [path(*values) for values in hhr.Sobol(8, seed=2).points(TRAINED)[:count]]


def errors(full: hhr.FullOrderModel, exact: History, found: History) -> dict[str, float]:
    """Largest errors along a history: displacement and forces over their largest, resultant, imprint, stress."""
    outputs = [[answer.outputs().values for answer in history.answers] for history in (exact, found)]
    force, pole = (np.array([[step[name] for step in steps] for steps in outputs]) for name in ("force", "pole"))
    displacement, forces = largest_errors(full, found, exact, 0.0)
    stress = [history.answers[-1].stress()[:, 2] for history in (exact, found)]
    return {
        "displacement": displacement,
        "forces": forces,
        "resultant": float(np.abs(force[1] - force[0]).max() / force[0].max()),
        "imprint": float(abs(pole[1, -1] / pole[0, -1] - 1)),
        "stress": float(np.linalg.norm(stress[1] - stress[0]) / np.linalg.norm(stress[0])),
    }


def compared(full: hhr.FullOrderModel, model: Any, known: Sequence[History]) -> dict[str, Any]:
    """Errors of a model, forces at 95 % of the paths too, and seconds of its histories and of the full order."""
    paths = [history.path for history in known]
    found, seconds = zip(*(timed(partial(model.march, item), REPETITIONS) for item in paths), strict=True)
    rows = [errors(full, exact, history) for exact, history in zip(known, found, strict=True)]
    exact = float(np.median([timed(partial(full.march, item, MARCH))[1] for item in paths[:2]]))
    online = float(np.median(seconds))
    worst = {name: max(row[name] for row in rows) for name in rows[0]}
    forces = {"forces": float(np.percentile([row["forces"] for row in rows], 95)), "forces_max": worst["forces"]}
    return {"fom_best": exact, "online": online, "ratio": exact / online} | worst | forces


def measured_on(cells: int, options: Any) -> tuple[hhr.FullOrderModel, Any, dict[str, dict[str, Any]]]:
    """Full order and condensed flow on one mesh, and a row of the table for each small model."""
    drawn = tests(4 if options.quick else 8)
    trained = hhr.train(scene(cells, "E"), training(), held_out=drawn, march=MARCH, progress=options.progress,
                        folder=options.out / f"snapshots_{cells}")  # fmt: skip
    full, model, known = trained.full_order, trained.condense(CORRECTION), trained.held_out.histories
    sizes = {"N": full.problem.free.size, "N_lambda": len(full.problem.gaps)}
    record = model.offline
    own = {"modes": record.modes, "gauss_points": record.points}
    offline = {**trained.log.times, **record.log.times}
    rows = {"condensed": {**sizes, **own, **compared(full, model, known), "offline": offline}}
    if options.hhr:
        reduced = trained.build(checked=False)
        own = {"modes": reduced.fields.basis.shape[1], "gauss_points": reduced.flow.points.size}
        offline = {**trained.log.times, **reduced.offline.log.times}
        rows["hhr"] = {**sizes, **own, **compared(full, reduced, known), "offline": offline}
    for row in rows.values():
        row["memory_gb"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    return full, model, rows


def curve(model: Any, constants: np.ndarray, depth: float = DEPTH, gradient: bool = False) -> tuple[np.ndarray, ...]:
    """Forces along the path in N, (24,), and with ``gradient`` their derivatives by (sy, H), (24, 2)."""
    settings = hhr.MarchSettings(search=MARCH.search, gradient=gradient)
    known = (BLOCK_E,) if "E" in model.parameters.names else ()
    found = [answer.outputs() for answer in model.march(path(depth, *constants, *known), settings).answers]
    forces = np.array([item.values["force"] for item in found])
    return (forces, np.array([item.gradient["force"][1:3] for item in found])) if gradient else (forces,)


def measured(model: Any, constants: np.ndarray, seed: int, depth: float = DEPTH) -> tuple[np.ndarray, np.ndarray]:
    """The mean of some curves, each reading with noise of a hundredth of it, (24,), and its deviation, (24,)."""
    (forces,) = curve(model, constants, depth)
    size = NOISE * np.maximum(forces, LEAST * forces.max())
    readings = forces + size * np.random.default_rng(seed).standard_normal((CURVES, forces.size))
    return readings.mean(axis=0), size / np.sqrt(CURVES)


def fitted(model: Any, data: np.ndarray, size: np.ndarray, start: np.ndarray, depth: float = DEPTH) -> np.ndarray:
    """Constants by least squares with the gradients of histories, each in parts of its range."""
    lower, upper = (np.array(item)[1:3] for item in (model.parameters.lower, model.parameters.upper))
    sides = upper - lower
    found = least_squares(
        lambda x: (curve(model, lower + x * sides, depth)[0] - data) / size,
        (start - lower) / sides,
        jac=lambda x: curve(model, lower + x * sides, depth, gradient=True)[1] * sides / size[:, None],
        bounds=(0.0, 1.0),
        xtol=1e-6,
    )
    return lower + found.x * sides


def posterior(
    model: Any, data: np.ndarray, size: np.ndarray, start: np.ndarray, count: int, seed: int, depth: float = DEPTH
) -> np.ndarray:
    """Samples of a random walk (Metropolis) with even priors in the box, one history each, (count, 2)."""
    lower, upper = (np.array(item)[1:3] for item in (model.parameters.lower, model.parameters.upper))
    random = np.random.default_rng(seed)
    forces, slopes = curve(model, start, depth, gradient=True)
    scaled = slopes / size[:, None]
    # steps as the posterior would be if the model were linear (Roberts, Gelman and Gilks 1997), and no prior wider
    # than the box
    precision = scaled.T @ scaled + np.diag(12 / (upper - lower) ** 2)
    steps = 2.4 / np.sqrt(start.size) * np.linalg.cholesky(np.linalg.inv(precision))
    here, value, samples = start, 0.5 * np.sum(((forces - data) / size) ** 2), np.empty((count, start.size))
    for k in range(count):
        there = here + steps @ random.standard_normal(start.size)
        if (lower < there).all() and (there < upper).all():
            other = 0.5 * np.sum(((curve(model, there, depth)[0] - data) / size) ** 2)
            if np.log(random.uniform()) < value - other:
                here, value = there, other
        samples[k] = here
    return samples


def calibrated(full: hhr.FullOrderModel, model: Any, samples: int, seed: int) -> dict[str, Any]:
    """Yield stress and hardening from curves of the full order, by the model; and what the walk says of them."""
    data, size = measured(full, TRUE, seed)
    start = np.array([200.0, 4e3])
    found, fitting = timed(lambda: fitted(model, data, size, start))
    walk, walking = timed(lambda: posterior(model, data, size, found, samples, seed))
    late = walk[samples // 10 :]
    rows = zip(("sy", "H"), TRUE, found, late.mean(axis=0), late.std(axis=0), strict=True)
    values = {name: {"true": true, "found": best, "off": best / true - 1, "mean": mean, "deviation": spread}
              for name, true, best, mean, spread in rows}  # fmt: skip
    return {**values, "samples": samples, "seconds": fitting + walking, "noise": NOISE, "curves": CURVES}


def tabor(full: hhr.FullOrderModel) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Soft and hard blocks in full, beside Tabor, and what is left of them after unloading."""
    rows, imprints = [], []
    for constants in ((100.0, 0.0), (300.0, 0.0), (100.0, 3000.0)):
        history = full.march(path(DEPTH, *constants, BLOCK_E), MARCH)
        rows += pressures(full, history)[3:16:4]
        values = history.answers[-1].outputs().values
        imprints.append({"sy": constants[0], "H": constants[1], **values, "iterations": sum(history.iterations)})
    return rows, imprints


def main() -> None:
    """Train on meshes of growing fineness, compare with the full order; on the last calibrate, and look at Tabor."""
    parser = cli.demo_parser("indentation", __doc__)
    parser.add_argument("--cells", type=int, nargs="+", help="cells of the block along a side: 10 14 19 25, quick 10")
    parser.add_argument("--hhr", action="store_true", help="build and time the hyper-reduced model too")
    options = cli.parse_on_first_rank(parser)
    scaling: dict[str, list[dict[str, Any]]] = {}
    for cells in options.cells or (QUICK_CELLS if options.quick else CELLS):
        full, model, found = measured_on(cells, options)
        for name, row in found.items():
            scaling.setdefault(name, []).append(row)
    rows, imprints = tabor(full)
    calibration = calibrated(full, model, 50 if options.quick else 500, options.seed)
    report.write_report({"scene": "indentation", **report.environment(), "calibration": calibration, "tabor": rows,
                         "models": {name: {"scaling": table} for name, table in scaling.items()},
                         "imprints": imprints}, options.out)  # fmt: skip
    for name, table in scaling.items():
        shown = [{key: value for key, value in row.items() if key != "offline"} for row in table]
        report.print_rows(name, shown, options.console)
        report.print_rows(f"seconds offline, {name}", [row["offline"] for row in table], options.console)
    report.print_rows("from curves with noise", [{"constant": name, **calibration[name]} for name in ("sy", "H")],
                      options.console)  # fmt: skip
    options.console.print(f"{calibration['samples']} histories and the fit took {calibration['seconds']:.0f} s")
    report.print_rows("beside Tabor", rows, options.console)
    report.print_rows("after unloading", imprints, options.console)


if __name__ == "__main__":
    main()
