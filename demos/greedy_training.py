"""Where to train: greedy choices beside a grid and Sobol points, and the indicators of the thesis beside ours.

The pellet in its cladding with two parameters, whose usual training is a grid of 25 x 20 points, and with six, whose
usual training is 512 Sobol points (``pellet_materials.py``). A greedy training adds points where a reduced model of
those before is worst: by its forces beside a condensed model (``ForceError``), or by eta (1.73) and eta_2 (2.124) of
the thesis. Models are compared with the full order at random points that none knows.

What to see: how many answers of the full order it takes for the force error that a grid or a sampling gives.

    python demos/greedy_training.py [--out DIR] [--quick] [--seed N]
"""

from argparse import Namespace
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pellet_cladding
import pellet_materials
from mpi4py import MPI

import hhr_dolfinx as hhr
from hhr_dolfinx.study import cli, report
from hhr_dolfinx.study.references import References
from hhr_dolfinx.study.training import Training
from hhr_dolfinx.timing import timed

NEVER = 1e-9
"""Indicator that no training reaches: it spends its budget."""

LEVELS = (20, 20, 3, 3, 3, 3)
"""Values of each of the six parameters: fields are smooth in the moduli, and have kinks where the pressure ends."""


def plans(quick: bool) -> Iterator[tuple[str, hhr.Scene, hhr.Recipe | None, dict[str, Any]]]:
    """Scenes with a recipe and trainings by name; the first one is the usual one of the scene."""
    mesh: dict[str, Any] = pellet_cladding.QUICK_MESH if quick else {}

    def greedy(budget: int, **others: Any) -> hhr.Greedy:
        return hhr.Greedy(
            tolerance=NEVER, budget=budget, candidates=hhr.Sobol(128 if quick else 1024, seed=5), **others
        )

    few, more = (24, 40) if quick else (100, 150)
    trainings: dict[str, Any] = {
        "grid": (8, 6) if quick else pellet_cladding.GRID,
        f"Sobol {more}": hhr.Sobol(more),
        f"greedy {few}": greedy(few),
        f"greedy {more}": greedy(more),
        f"greedy {more}, eta": greedy(more, indicator=hhr.Eta()),
        f"greedy {more}, eta_2": greedy(more, indicator=hhr.Eta2()),
    }
    yield "pellet", pellet_cladding.scene(**mesh), None, trainings
    if not quick:
        trainings = {"Sobol 512": hhr.Sobol(512), "Sobol 300": hhr.Sobol(300)}
        start, candidates = hhr.Lattice(96, levels=LEVELS, seed=5), hhr.Lattice(1024, levels=LEVELS, seed=5)
        recipe = replace(pellet_materials.RECIPE, basis=hhr.Pod(1e-12, relative=True, by_body=True))
        trainings["greedy 300"] = greedy(300, start=start, candidates=candidates, together=51, recipe=recipe)
        yield "six parameters", pellet_materials.scene(), pellet_materials.RECIPE, trainings


def row_of(training: Training, recipe: hhr.Recipe | None, references: References, seconds: float) -> dict[str, Any]:
    """Errors of a model, its size, and seconds: of the training, less what was found on the disk, and of the build."""
    given = recipe if training.choice is None else None  # a greedy training has a recipe of its own
    model, built = timed(lambda: training.build(given, checked=False))
    errors = references.errors(model).summaries()
    return {
        "answers": len(training.snapshots.points),
        "unknowns": model.fields.basis.shape[1],
        "conditions": len(model.fields.A_lambda),
        **{f"{kind} {share}": errors[name][share] for kind, name in (("forces", "dual_full_floored"),
           ("displacement", "primal_l2")) for share in ("median", "p95", "max")},
        "training": seconds,
        "build": built,
    }  # fmt: skip


def draw(chosen: dict[str, Training], options: Namespace) -> None:
    """Where greedy trainings of two parameters chose, and what their models were worth on the way."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(4 * len(chosen) + 4, 4), layout="constrained")
    *maps, curves = figure.subplots(1, len(chosen) + 1)
    for axis, (name, training) in zip(maps, chosen.items(), strict=True):
        points, rounds, _ = training.choice
        shown = axis.scatter(*points.T, c=np.arange(len(points)), s=12, cmap="viridis")
        axis.set(xlabel="P1 [MPa]", ylabel="h1 [mm]", title=name)
        figure.colorbar(shown, ax=axis, label="order")
        curves.semilogy([item.answers for item in rounds], [item.worst for item in rounds], ".-", label=name)
    curves.set(xlabel="answers", ylabel="largest indicator")
    curves.legend(fontsize=7)
    figure.savefig(options.out / "chosen.png", dpi=150)


def main() -> None:
    """Train, build, compare; print the tables, write ``report.json`` and ``chosen.png``."""
    options = cli.parse_on_first_rank(cli.demo_parser("greedy_training", __doc__))
    tests, scenes, chosen = 40 if options.quick else 300, {}, {}
    for name, scene, recipe, trainings in plans(options.quick):
        rows, references = [], None
        for label, given in trainings.items():
            train = partial(hhr.train, scene, given, held_out=0, comm=MPI.COMM_SELF, progress=options.progress)
            training, seconds = timed(partial(train, folder=options.out / f"snapshots_{name.replace(' ', '_')}"))
            if references is None:  # one floor for all: that of the usual training
                points = scene.parameters.random(tests, options.seed + 17)
                bar = options.progress(f"{name}, test points")
                references = References.at(points, training.full_order, training.snapshots, bar)
            rows.append({"training on": label, **row_of(training, recipe, references, seconds)})
            if training.choice is not None and name == "pellet":
                chosen[label] = training
        scenes[name] = {"tests": tests, "trainings": rows}
        report.print_rows(f"{name}: errors at {tests} points", rows, options.console)
    draw(chosen, options)
    report.write_report({"seed": options.seed, "scenes": scenes, **report.environment()}, options.out)


if __name__ == "__main__":
    main()
