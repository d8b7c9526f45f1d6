"""Indentation on meshes of growing fineness, calibration from noisy curves, and Tabor's rule."""

import resource
from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
from indentation import (
    BLOCK_E,
    CORRECTION,
    CURVES,
    DEPTH,
    LEAST,
    MARCH,
    NOISE,
    POISSON,
    RADIUS,
    REPETITIONS,
    SPHERE_E,
    TRUE,
    path,
    scene,
    tests,
    training,
)
from scipy.optimize import least_squares

import hhr_dolfinx as hhr
from hhr_dolfinx.models.answer import History
from hhr_dolfinx.plugins.paths.compared import largest_errors
from hhr_dolfinx.timing import timed


def pressures(full: hhr.FullOrderModel, history: History) -> list[dict[str, float]]:
    """Radius and mean pressure of a history of a block with the usual E, by Tabor's numbers.

    The radius is that of an even pressure with the second moment of the one found, 2 F = a^2 /
    integral of p r^2: E* a / (sy R) is 2.5 where the block begins to yield, and from 30 on the mean
    pressure is some 2.8 to 3 sy.
    """
    distance = np.hypot(*full.problem.contact_points[:, :2].T)
    modulus = 1 / sum((1 - POISSON**2) / young for young in (SPHERE_E, BLOCK_E))
    rows = []
    for answer in history.answers:
        forces, (depth, yield_stress, hardening, *_) = answer.forces(), answer.parameter
        if forces.sum() > 0:
            radius = np.sqrt(2 * forces @ distance**2 / forces.sum())
            rows.append(
                {
                    "depth": depth,
                    "sy": yield_stress,
                    "H": hardening,
                    "force": 4 * forces.sum(),
                    "E* a / (sy R)": modulus * radius / (yield_stress * RADIUS),
                    "mean pressure / sy": 4 * forces.sum() / (np.pi * radius**2 * yield_stress),
                }
            )
    return rows


def errors(full: hhr.FullOrderModel, exact: History, found: History) -> dict[str, float]:
    """Largest errors along a history: displacement and forces over their largest, resultant,
    imprint, stress.
    """
    outputs = [
        [answer.outputs().values for answer in history.answers] for history in (exact, found)
    ]
    force, pole = (
        np.array([[step[name] for step in steps] for steps in outputs])
        for name in ("force", "pole")
    )
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
    """Errors of a model, forces at 95 % of the paths too, and seconds of its histories and of the
    full order.
    """
    paths = [history.path for history in known]
    found, seconds = zip(
        *(timed(partial(model.march, item), REPETITIONS) for item in paths), strict=True
    )
    rows = [errors(full, exact, history) for exact, history in zip(known, found, strict=True)]
    exact = float(np.median([timed(partial(full.march, item, MARCH))[1] for item in paths[:2]]))
    online = float(np.median(seconds))
    worst = {name: max(row[name] for row in rows) for name in rows[0]}
    forces = {
        "forces": float(np.percentile([row["forces"] for row in rows], 95)),
        "forces_max": worst["forces"],
    }
    return {"fom_best": exact, "online": online, "ratio": exact / online} | worst | forces


def measured_on(
    cells: int, options: Any
) -> tuple[hhr.FullOrderModel, Any, dict[str, dict[str, Any]]]:
    """Full order and condensed flow on one mesh, and a row of the table for each small model."""
    drawn = tests(4 if options.quick else 8)
    trained = hhr.train(
        scene(cells, "E"),
        training(),
        held_out=drawn,
        march=MARCH,
        progress=options.progress,
        folder=options.out / f"snapshots_{cells}",
    )
    full, model, known = (
        trained.full_order,
        trained.condense(CORRECTION),
        trained.held_out.histories,
    )
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


def curve(
    model: Any, constants: np.ndarray, depth: float = DEPTH, gradient: bool = False
) -> tuple[np.ndarray, ...]:
    """Forces along the path in N, (24,), and with ``gradient`` their derivatives by (sy, H), (24,
    2).
    """
    settings = hhr.MarchSettings(search=MARCH.search, gradient=gradient)
    known = (BLOCK_E,) if "E" in model.parameters.names else ()
    found = [
        answer.outputs()
        for answer in model.march(path(depth, *constants, *known), settings).answers
    ]
    forces = np.array([item.values["force"] for item in found])
    return (
        (forces, np.array([item.gradient["force"][1:3] for item in found]))
        if gradient
        else (forces,)
    )


def measured(
    model: Any, constants: np.ndarray, seed: int, depth: float = DEPTH
) -> tuple[np.ndarray, np.ndarray]:
    """The mean of some curves, each reading with noise of a hundredth of it, (24,), and its
    deviation, (24,).
    """
    (forces,) = curve(model, constants, depth)
    size = NOISE * np.maximum(forces, LEAST * forces.max())
    readings = forces + size * np.random.default_rng(seed).standard_normal((CURVES, forces.size))
    return readings.mean(axis=0), size / np.sqrt(CURVES)


def fitted(
    model: Any, data: np.ndarray, size: np.ndarray, start: np.ndarray, depth: float = DEPTH
) -> np.ndarray:
    """Constants by least squares with the gradients of histories, each in parts of its range."""
    lower, upper = (
        np.array(item)[1:3] for item in (model.parameters.lower, model.parameters.upper)
    )
    sides = upper - lower
    found = least_squares(
        lambda x: (curve(model, lower + x * sides, depth)[0] - data) / size,
        (start - lower) / sides,
        jac=lambda x: (
            curve(model, lower + x * sides, depth, gradient=True)[1] * sides / size[:, None]
        ),
        bounds=(0.0, 1.0),
        xtol=1e-6,
    )
    return lower + found.x * sides


def posterior(
    model: Any,
    data: np.ndarray,
    size: np.ndarray,
    start: np.ndarray,
    count: int,
    seed: int,
    depth: float = DEPTH,
) -> np.ndarray:
    """Samples of a random walk (Metropolis) with even priors in the box, one history each, (count,
    2).
    """
    lower, upper = (
        np.array(item)[1:3] for item in (model.parameters.lower, model.parameters.upper)
    )
    random = np.random.default_rng(seed)
    forces, slopes = curve(model, start, depth, gradient=True)
    scaled = slopes / size[:, None]
    # steps as the posterior would be if the model were linear (Roberts, Gelman and Gilks 1997), and
    # no prior wider than the box
    precision = scaled.T @ scaled + np.diag(12 / (upper - lower) ** 2)
    steps = 2.4 / np.sqrt(start.size) * np.linalg.cholesky(np.linalg.inv(precision))
    here, value, samples = (
        start,
        0.5 * np.sum(((forces - data) / size) ** 2),
        np.empty((count, start.size)),
    )
    for k in range(count):
        there = here + steps @ random.standard_normal(start.size)
        if (lower < there).all() and (there < upper).all():
            other = 0.5 * np.sum(((curve(model, there, depth)[0] - data) / size) ** 2)
            if np.log(random.uniform()) < value - other:
                here, value = there, other
        samples[k] = here
    return samples


def calibrated(full: hhr.FullOrderModel, model: Any, samples: int, seed: int) -> dict[str, Any]:
    """Yield stress and hardening from curves of the full order, by the model.

    And what the walk says of them.
    """
    data, size = measured(full, TRUE, seed)
    start = np.array([200.0, 4e3])
    found, fitting = timed(lambda: fitted(model, data, size, start))
    walk, walking = timed(lambda: posterior(model, data, size, found, samples, seed))
    late = walk[samples // 10 :]
    rows = zip(("sy", "H"), TRUE, found, late.mean(axis=0), late.std(axis=0), strict=True)
    values = {
        name: {
            "true": true,
            "found": best,
            "off": best / true - 1,
            "mean": mean,
            "deviation": spread,
        }
        for name, true, best, mean, spread in rows
    }
    return {
        **values,
        "samples": samples,
        "seconds": fitting + walking,
        "noise": NOISE,
        "curves": CURVES,
    }


def tabor(full: hhr.FullOrderModel) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Soft and hard blocks in full, beside Tabor, and what is left of them after unloading."""
    rows, imprints = [], []
    for constants in ((100.0, 0.0), (300.0, 0.0), (100.0, 3000.0)):
        history = full.march(path(DEPTH, *constants, BLOCK_E), MARCH)
        rows += pressures(full, history)[3:16:4]
        values = history.answers[-1].outputs().values
        imprints.append(
            {"sy": constants[0], "H": constants[1], **values, "iterations": sum(history.iterations)}
        )
    return rows, imprints


def told(
    scaling: dict[str, list], rows: list, imprints: list, calibration: dict[str, Any], options: Any
) -> None:
    """Write ``report.json`` and print its tables."""
    from hhr_dolfinx.plugins.studies import report
    from parts import cli

    report.write_report({"scene": "indentation", "seed": options.seed, **report.environment(),
                         "calibration": calibration, "tabor": rows,
                         "models": {name: {"scaling": table} for name, table in scaling.items()},
                         "imprints": imprints}, options.out)  # fmt: skip
    for name, table in scaling.items():
        shown = [{key: value for key, value in row.items() if key != "offline"} for row in table]
        cli.print_rows(name, shown, options.console)
        cli.print_rows(
            f"seconds offline, {name}", [row["offline"] for row in table], options.console
        )
    cli.print_rows(
        "from curves with noise",
        [{"constant": name, **calibration[name]} for name in ("sy", "H")],
        options.console,
    )
    options.console.print(
        f"{calibration['samples']} histories and the fit took {calibration['seconds']:.0f} s"
    )
    cli.print_rows("beside Tabor", rows, options.console)
    cli.print_rows("after unloading", imprints, options.console)
