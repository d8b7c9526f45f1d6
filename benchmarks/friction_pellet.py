"""Pellet and cladding with friction on their sides: unseen paths that load, unload and turn round.

The scene of ``pellet_materials.py`` with a coefficient in [0, .8] as its seventh parameter:
pressure and its height vary along a path, moduli, Poisson's ratios and the coefficient from path to
path. The full order at its best makes S once for a path and has the same solver of increments; the
condensed model interpolates S between Poisson's ratios; the hyper-reduced one is trained on other
paths. Then random jumps of the condensed one, each from one corner of the box to another, for as
long as it takes to meet what does not settle.

    python benchmarks/friction_pellet.py [--out DIR] [--quick] [--seed N] [--training N]
"""

from __future__ import annotations

import dataclasses
from functools import partial
from typing import Any

import _demos  # noqa: F401 (before the scenes)
import numpy as np
import pellet_materials
from mpi4py import MPI
from parts import cli
from parts.friction_report import differences, errors_of
from scipy.stats import qmc

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import ConvergenceError, NotSolvableError
from hhr_dolfinx.plugins.studies import report
from hhr_dolfinx.timing import timed

LEGS, STEPS = 5, 8
"""Of a path: legs between random pressures and heights, and increments of each."""


def scene(**mesh_options: Any) -> hhr.Scene:
    """The pellet with friction between its side and the cladding."""
    smooth = pellet_materials.scene(**mesh_options)
    side, support = smooth.contacts
    names = (*pellet_materials.NAMES, "friction")
    box = hhr.ParameterSpace(names, (*pellet_materials.LOWER, 0.0), (*pellet_materials.UPPER, 0.8))
    contacts = dataclasses.replace(side, friction="friction"), support
    return dataclasses.replace(smooth, name="pellet_friction", contacts=contacts, parameters=box)


def path(space: hhr.ParameterSpace, rng: np.random.Generator, points: np.ndarray) -> list:
    """Through some pressures and heights, (k, 2), with random materials and friction, from the
    least load.
    """
    low, high = np.array(space.lower), np.array(space.upper)
    fixed = low[2:] + rng.random(low.size - 2) * (high - low)[2:]
    loads = np.vstack([low[:2], low[:2] + points * (high - low)[:2]])
    return [(float(k), np.concatenate([load, fixed])) for k, load in enumerate(loads)]


def legs(rng: np.random.Generator) -> np.ndarray:
    """Straight legs between random corners of a path, (increments, 2)."""
    corners = rng.random((LEGS + 1, 2))
    shares = np.linspace(0, LEGS, LEGS * STEPS + 1)
    return np.column_stack([np.interp(shares, np.arange(LEGS + 1), column) for column in corners.T])


def training_paths(space: hhr.ParameterSpace, count: int, rng: np.random.Generator) -> list:
    """Paths whose materials and friction are spread over the box."""
    low, high = np.array(space.lower), np.array(space.upper)
    drawn = qmc.Sobol(low.size - 2, rng=rng).random_base2(int(np.ceil(np.log2(count))))[:count]
    found = []
    for fixed in qmc.scale(drawn, low[2:], high[2:]):
        along = path(space, rng, legs(rng))
        found.append([(time, np.concatenate([point[:2], fixed])) for time, point in along])
    return found


def hyper_reduced(full: Any, count: int, rng: np.random.Generator) -> Any:
    """An HHR model of so many paths, and a twentieth as many held out."""
    paths = training_paths(full.parameters, count, rng)
    apart = training_paths(full.parameters, max(2, count // 20), rng)
    return hhr.train(full.scene, paths, held_out=apart, comm=MPI.COMM_SELF).build()


def unseen(
    full: Any, models: dict[str, Any], count: int, rng: np.random.Generator
) -> dict[str, Any]:
    """Errors and times of some models along paths that nobody has seen."""
    errors: dict[str, list[dict[str, np.ndarray]]] = {name: [] for name in models}
    seconds: dict[str, list[float]] = {name: [] for name in ("full order", *models)}
    iterations: dict[str, list[int]] = {name: [] for name in models}
    fallbacks = dict.fromkeys(models, 0)
    couplings = []
    for _ in range(count):
        steps = path(full.parameters, rng, legs(rng))
        exact, taken = timed(partial(full.march, steps))
        seconds["full order"].append(taken / (len(steps) - 1))
        for kind, model in models.items():
            found, taken = timed(partial(model.march, steps))
            seconds[kind].append(taken / (len(steps) - 1))
            errors[kind].append(differences(full, found, exact))
            iterations[kind] += found.iterations
            fallbacks[kind] += sum(answer.cycled for answer in found.answers)
        couplings.append(models["condensed"].coupling(steps[-1][1]))
    parts = {}
    for kind in models:
        parts[kind] = {
            "increments": len(iterations[kind]),
            "iterations": {"mean": float(np.mean(iterations[kind])), "max": max(iterations[kind])},
            "fallbacks": fallbacks[kind],
            "errors": errors_of(errors[kind]),
            "ratio": float(np.median(np.array(seconds["full order"]) / seconds[kind])),
        }
    return parts.pop("condensed") | parts | {
        "mu_kappa": float(np.median(couplings)),
        "times": {name: float(np.median(values)) for name, values in seconds.items()},
    }  # fmt: skip


def jumps(model: Any, count: int, rng: np.random.Generator) -> dict[str, Any]:
    """Random jumps, a thousand with the same materials: how many are answered, and how."""
    answered = fallbacks = cuts = 0
    iterations: list[int] = []
    refused = []
    for _ in range(count // 1000):
        try:
            history = model.march(path(model.parameters, rng, rng.random((1000, 2))))
        except (ConvergenceError, NotSolvableError) as error:
            history = vars(error)["history"]
            refused.append(str(error))
        answered += len(history.answers)
        iterations += history.iterations
        fallbacks += sum(answer.cycled for answer in history.answers)
        cuts += history.cuts
    told = {"mean": float(np.mean(iterations)), "max": max(iterations)}
    return {
        "asked": count,
        "answered": answered,
        "iterations": told,
        "fallbacks": fallbacks,
        "cuts": cuts,
        "refused": refused,
    }


def main() -> None:
    """Condense and hyper-reduce, follow unseen paths, jump, report."""
    parser = cli.demo_parser("friction_pellet", __doc__)
    parser.add_argument(
        "--training", type=int, default=128, help="training paths of the HHR model (%(default)s)"
    )
    options = cli.parse_on_first_rank(parser)
    rng = np.random.default_rng(options.seed)
    mesh = pellet_materials.base.QUICK_MESH if options.quick else {}
    full = hhr.FullOrderModel(scene(**mesh), MPI.COMM_SELF)
    model, offline = timed(lambda: hhr.condense(full))
    count = 12 if options.quick else options.training
    reduced, trained = timed(
        lambda: hyper_reduced(full, count, np.random.default_rng(options.seed + 1))
    )
    found = unseen(full, {"condensed": model, "hhr": reduced}, 5 if options.quick else 40, rng)
    found["times"] |= {"offline": offline, "offline, hhr": trained}
    found["hhr"] |= {
        "paths": count,
        "modes": len(reduced.problem.stiffness),
        "rows": reduced.own_conditions,
    }
    found["jumps"] = jumps(model, 1000 if options.quick else 10_000, rng)
    report.write_report(
        {"scene": "friction_pellet", "friction": found, **report.environment()}, options.out
    )
    lines = [
        {"model": kind, "of": name, "95 %": f"{item['p95']:.1e}", "worst": f"{item['max']:.1e}"}
        for kind, part in (("condensed", found), ("hhr", found["hhr"]))
        for name, item in part["errors"].items()
    ]
    cli.print_rows("errors along unseen paths", lines, options.console)
    times = found["times"]
    options.console.print(
        f"an increment: full order {1e3 * times['full order']:.2f} ms, condensed "
        f"{1e3 * times['condensed']:.2f} ms, {found['ratio']:.1f} times; HHR "
        f"{1e3 * times['hhr']:.2f} ms, {found['hhr']['ratio']:.1f} times; jumps: "
        f"{found['jumps']['answered']} of {found['jumps']['asked']} answered"
    )


if __name__ == "__main__":
    main()
