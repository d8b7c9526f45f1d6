"""Pellet and cladding with friction on their sides: unseen paths that load, unload and turn round.

The scene of ``pellet_materials.py`` with a coefficient in [0, .8] as its seventh parameter: pressure and its height
vary along a path, moduli, Poisson's ratios and the coefficient from path to path. The full order at its best makes S
once for a path and has the same solver of increments; the condensed model interpolates S between Poisson's ratios. Then
random jumps, each from one corner of the box to another, for as long as it takes to meet what does not settle.

    python benchmarks/friction_pellet.py [--out DIR] [--quick] [--seed N]
"""

from __future__ import annotations

import dataclasses
from functools import partial
from typing import Any

import _demos  # noqa: F401 (before the scenes)
import numpy as np
import pellet_materials
from mpi4py import MPI

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import ConvergenceError, NotSolvableError
from hhr_dolfinx.study import cli
from hhr_dolfinx.study.report import report
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
    """Through some pressures and heights, (k, 2), with random materials and friction, from the least load."""
    low, high = np.array(space.lower), np.array(space.upper)
    fixed = low[2:] + rng.random(low.size - 2) * (high - low)[2:]
    loads = np.vstack([low[:2], low[:2] + points * (high - low)[:2]])
    return [(float(k), np.concatenate([load, fixed])) for k, load in enumerate(loads)]


def legs(rng: np.random.Generator) -> np.ndarray:
    """Straight legs between random corners of a path, (increments, 2)."""
    corners = rng.random((LEGS + 1, 2))
    shares = np.linspace(0, LEGS, LEGS * STEPS + 1)
    return np.column_stack([np.interp(shares, np.arange(LEGS + 1), column) for column in corners.T])


def differences(model: Any, found: hhr.History, exact: hhr.History) -> dict[str, np.ndarray]:
    """Relative errors of each increment in the Euclidean norm; below a thousandth of the largest they are by that."""
    rows = {"normal": np.setdiff1d(np.arange(model.conditions), model.friction.tangential)}
    rows["tangential"] = model.friction.tangential
    values = {name: [np.array([answer.multipliers[own] for answer in history.answers]) for history in (found, exact)]
              for name, own in rows.items()}  # fmt: skip
    values["slip"] = [np.array([answer.slip.path for answer in history.answers]) for history in (found, exact)]
    errors = {}
    for name, (one, two) in values.items():
        sizes = np.linalg.norm(two, axis=1)
        errors[name] = np.linalg.norm(one - two, axis=1) / np.maximum(sizes, 1e-3 * sizes.max() or 1.0)
    return errors


def unseen(full: Any, model: Any, count: int, rng: np.random.Generator) -> dict[str, Any]:
    """Errors and times of both along paths that nobody has seen."""
    errors: dict[str, list[np.ndarray]] = {}
    seconds: dict[str, list[float]] = {"full order": [], "condensed": []}
    iterations: list[int] = []
    fallbacks = 0
    couplings = []
    for _ in range(count):
        steps = path(model.parameters, rng, legs(rng))
        exact, taken = timed(partial(full.march, steps))
        seconds["full order"].append(taken / (len(steps) - 1))
        found, taken = timed(partial(model.march, steps))
        seconds["condensed"].append(taken / (len(steps) - 1))
        for name, values in differences(model, found, exact).items():
            errors.setdefault(name, []).append(values)
        iterations += found.iterations
        fallbacks += sum(answer.cycled for answer in found.answers)
        couplings.append(model.coupling(steps[-1][1]))
    joined = {name: np.concatenate(values) for name, values in errors.items()}
    return {
        "increments": len(iterations),
        "iterations": {"mean": float(np.mean(iterations)), "max": max(iterations)},
        "fallbacks": fallbacks,
        "mu_kappa": float(np.median(couplings)),
        "errors": {
            name: {"p95": float(np.quantile(item, 0.95)), "max": float(item.max())} for name, item in joined.items()
        },
        "times": {name: float(np.median(values)) for name, values in seconds.items()},
        "ratio": float(np.median(np.array(seconds["full order"]) / seconds["condensed"])),
    }


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
    return {"asked": count, "answered": answered, "iterations": told, "fallbacks": fallbacks, "cuts": cuts,
            "refused": refused}  # fmt: skip


def main() -> None:
    """Condense, follow unseen paths, jump, report."""
    options = cli.parse_on_first_rank(cli.demo_parser("friction_pellet", __doc__))
    rng = np.random.default_rng(options.seed)
    mesh = pellet_materials.base.QUICK_MESH if options.quick else {}
    full = hhr.FullOrderModel(scene(**mesh), MPI.COMM_SELF)
    model, offline = timed(lambda: hhr.condense(full))
    found = unseen(full, model, 5 if options.quick else 40, rng)
    found["times"]["offline"] = offline
    found["jumps"] = jumps(model, 1000 if options.quick else 10_000, rng)
    report.write_report({"scene": "friction_pellet", "friction": found, **report.environment()}, options.out)
    lines = [
        {"of": name, "95 %": f"{item['p95']:.1e}", "worst": f"{item['max']:.1e}"}
        for name, item in found["errors"].items()
    ]
    report.print_rows("errors along unseen paths", lines, options.console)
    times = found["times"]
    options.console.print(
        f"an increment: full order {1e3 * times['full order']:.2f} ms, condensed {1e3 * times['condensed']:.2f} ms, "
        f"{found['ratio']:.1f} times; jumps: {found['jumps']['answered']} of {found['jumps']['asked']} answered"
    )


if __name__ == "__main__":
    main()
