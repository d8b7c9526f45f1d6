"""What the demo of the torque of a press fit measures: designs beside the full order, a thousand of
them, pictures.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import press_fit_torque as demo
from matplotlib.figure import Figure
from mpi4py import MPI
from scipy.stats import qmc

import hhr_dolfinx as hhr
from hhr_dolfinx.timing import timed
from parts.friction_report import differences, errors_of, sizes_and_times

STEPS = 10
"""Increments of the turn."""
SHOWN = (1, 2, 3, 4)
"""Increments of the turn whose slip is drawn."""


def designs(count: int, seed: int) -> np.ndarray:
    """Points of the box without the turn, (count, 5)."""
    space = qmc.Sobol(len(demo.NAMES) - 1, rng=np.random.default_rng(seed))
    points = space.random_base2(int(np.ceil(np.log2(max(count, 1)))))[:count]
    return qmc.scale(points, demo.LOWER[1:], demo.UPPER[1:])


def path(design: np.ndarray) -> list:
    """Shrunk from the least interference and heated, then turned."""
    interference, friction, warmer, *fixed = design
    free = (0.0, demo.LOWER[1], friction, demo.LOWER[3], *fixed)
    turns = np.linspace(0.0, demo.UPPER[0], STEPS + 1)
    return [
        (0.0, free),
        *(
            (1.0 + k, (turn, interference, friction, warmer, *fixed))
            for k, turn in enumerate(turns)
        ),
    ]


def torques(history: hhr.History) -> np.ndarray:
    """Torque on the hub at each increment of the turn, (STEPS + 1,)."""
    return np.array([answer.outputs()["torque"] for answer in history.answers])


def lame(design: np.ndarray) -> float:
    """Torque of long rings that slip as a whole, with Lame's pressure of plane stress."""
    interference, friction, warmer, young, wall = design
    outer, radius, bore = demo.RADIUS + wall, demo.RADIUS, demo.BORE
    hub = ((outer**2 + radius**2) / (outer**2 - radius**2) + demo.POISSON) / young
    shaft = ((radius**2 + bore**2) / (radius**2 - bore**2) - demo.POISSON) / demo.SHAFT_E
    pressure = max(interference - demo.EXPANSION * warmer * radius, 0.0) / (radius * (hub + shaft))
    return 2 * np.pi * radius**2 * demo.LENGTH * friction * pressure


def compared(
    full: Any, model: Any, some: np.ndarray, progress: Any
) -> tuple[dict[str, Any], dict[str, list[float]]]:
    """Errors of some designs for the report, and seconds of an increment of each design."""
    errors, off, iterations, rows = [], [], [], []
    seconds: dict[str, list[float]] = {"fom_best": [], "online": []}
    fallbacks = 0
    for number, design in enumerate(progress(some)):
        steps = path(design)
        exact, slow = timed(partial(full.march, steps))
        found, fast = timed(partial(model.march, steps))
        wanted, ours = torques(exact), torques(found)
        off.append(np.abs(ours - wanted).max() / wanted.max())
        errors.append(differences(full, found, exact))
        for name, taken in (("fom_best", slow), ("online", fast)):
            seconds[name].append(taken / (len(steps) - 1))
        iterations += found.iterations
        fallbacks += sum(answer.cycled for answer in found.answers)
        rows.append(
            {
                "case": f"design {number + 1}",
                "quantity": "torque at slip",
                "reference": float(wanted.max()),
                "ours": float(ours.max()),
                "error": float(abs(ours.max() / wanted.max() - 1)),
            }
        )
    return {
        "increments": len(iterations),
        "iterations": {"mean": float(np.mean(iterations)), "max": max(iterations)},
        "fallbacks": fallbacks,
        "errors": errors_of(errors),
        "reference": rows,
        "torque": {"designs": len(some), "mean": float(np.mean(off)), "max": float(np.max(off))},
    }, seconds


def study(scene: hhr.Scene, options: Any) -> dict[str, Any]:
    """Entries of the report; the picture goes to its folder."""
    full = hhr.FullOrderModel(scene, MPI.COMM_SELF)
    model, offline = timed(lambda: hhr.condense(full))
    options.out.mkdir(parents=True, exist_ok=True)
    hhr.save_model(options.out / "model.npz", model)
    found, seconds = compared(
        full, model, designs(options.designs, options.seed + 1), options.progress("designs")
    )
    cases = designs(options.cases, options.seed)
    histories = (model.march(path(design)) for design in options.progress("cases")(cases))
    curves = np.array([torques(history) for history in histories])
    draw(full, model, cases, curves, options.out / "press_fit_torque.png")
    peaks, long = curves.max(axis=1), np.array([lame(design) for design in cases])
    pressed = long > 0
    return sizes_and_times(full, seconds, offline) | {"friction": found | {
        "mu_kappa": model.coupling(path(cases[0])[-1][1]),
        "cases": len(cases),
        "torque over Lame's": {name: float(np.quantile(peaks[pressed] / long[pressed], share))
                               for name, share in (("5 %", 0.05), ("median", 0.5), ("95 %", 0.95))},
    }}  # fmt: skip


def draw(full: Any, model: Any, cases: np.ndarray, curves: np.ndarray, file: Path) -> None:
    """Torque over the turn, slip on the unrolled surface of one design, torque at slip beside
    Lame's.
    """
    figure = Figure(figsize=(13, 7), layout="constrained")
    top, bottom = figure.subfigures(2, 1, height_ratios=(1.2, 1))
    turning, scatter = top.subplots(1, 2)
    turns = np.linspace(0.0, demo.UPPER[0], STEPS + 1) * 1e3
    for curve in curves[:40]:
        turning.plot(turns, curve / 1e3, color="#2b6cb0", alpha=0.4, linewidth=1)
    turning.set(
        xlabel="turn of the shaft [mrad]", ylabel="torque [N m]", title="torque, 40 designs"
    )
    long = np.array([lame(design) for design in cases])
    points = scatter.scatter(
        long / 1e3, curves.max(axis=1) / 1e3, c=cases[:, 1], s=8, cmap="viridis"
    )
    top.colorbar(points, ax=scatter, label="coefficient of friction")
    scatter.plot(*[[0, long.max() / 1e3]] * 2, color="#444444", linewidth=1)
    scatter.set(
        xlabel="Lame, long rings [N m]",
        ylabel="torque at slip [N m]",
        title=f"{len(cases)} designs beside Lame",
    )
    middle = np.array([*(0.5 * (np.array(demo.LOWER) + demo.UPPER))[1:]])
    answers = model.march(path(middle)).answers
    places = full.problem.contact_points[model.law.normal]
    angle, height = np.degrees(np.arctan2(places[:, 1], places[:, 0])), places[:, 2]
    for axis, number in zip(bottom.subplots(1, len(SHOWN), sharey=True), SHOWN, strict=True):
        slipped = answers[number].slip.path - answers[0].slip.path
        shades = axis.scatter(angle, height, c=slipped * 1e3, s=14, cmap="magma_r", vmin=0.0)
        bottom.colorbar(shades, ax=axis, label="slip since it turns [µm]")
        if number == SHOWN[0]:
            axis.set_ylabel("z [mm]")  # the others share it
        stuck = answers[number].slip.statuses == 1
        axis.scatter(angle[stuck], height[stuck], s=3, c="k")
        axis.set(
            xlabel="angle [°]", title=f"turned by {1e3 * demo.UPPER[0] * number / STEPS:.1f} mrad"
        )
    figure.savefig(file, dpi=200)
