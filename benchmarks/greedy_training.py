"""Where to train: greedy choices beside a grid and Sobol points, and the indicators of the thesis
beside ours.

The pellet in its cladding with two parameters, whose usual training is a grid of 25 x 20 points,
and with six, whose usual training is 512 Sobol points (``pellet_materials.py``). A greedy training
adds points where a reduced model of those before is worst: by its forces beside a condensed model
(``ForceError``), or by eta (1.73) and eta_2 (2.124) of the thesis. Models are compared with the
full order at random points that none knows, as they are: a check on answers held out would grow the
RID of those that break, or refuse them.

What to see: how many answers of the full order it takes for the force error that a grid or a
sampling gives, and how much of that is due to the finer basis of greedy trainings. On the pellet
150 take the place of a grid of 500 with its usual basis, and not of the same grid with the finer
one. With six parameters 300 are five times as exact as 512 Sobol points with the usual basis, half
as exact as these with the finer one, and seven times as exact as 300 with it.

    python benchmarks/greedy_training.py [--out DIR] [--quick] [--seed N]
"""

from argparse import Namespace
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import Any

import _demos  # noqa: F401 (before the scenes)
import numpy as np
import pellet_cladding
import pellet_materials
from mpi4py import MPI
from parts import cli

import hhr_dolfinx as hhr
from hhr_dolfinx.plugins.studies import report
from hhr_dolfinx.plugins.studies.measure import References
from hhr_dolfinx.study.training.train import Training
from hhr_dolfinx.timing import timed

NEVER = 1e-9
"""Indicator that no training reaches: it spends its budget."""

FINE = 1e-13
"""Tolerance of the POD of greedy trainings: each answer brings what others do not."""


def plans(quick: bool) -> Iterator[tuple[str, hhr.Scene, dict[str, hhr.Recipe], dict[str, Any]]]:
    """Scenes with trainings by name, the usual one first, and recipes by name for those that are
    not greedy.
    """
    mesh: dict[str, Any] = pellet_cladding.QUICK_MESH if quick else {}
    few, more = (24, 40) if quick else (100, 150)
    greedy = partial(hhr.Greedy, tolerance=NEVER)
    pellet = partial(greedy, budget=more, candidates=hhr.Lattice(128) if quick else None)
    yield "pellet", pellet_cladding.scene(**mesh), recipes(hhr.Recipe(), False), {
        "grid": (8, 6) if quick else pellet_cladding.GRID,
        f"Sobol {more}": hhr.Sobol(more),
        f"greedy {few}": pellet(budget=few),
        f"greedy {more}": pellet(),
        f"greedy {more}, eta": pellet(indicator=hhr.Eta()),
        f"greedy {more}, eta_2": pellet(indicator=hhr.Eta2()),
    }  # fmt: skip
    if quick:
        return
    yield (
        "six parameters",
        pellet_materials.scene(),
        recipes(pellet_materials.RECIPE, True),
        {
            "Sobol 512": hhr.Sobol(512),
            "Sobol 300": hhr.Sobol(300),
            "greedy 300": greedy(budget=300, together=50),
        },
    )


def recipes(usual: hhr.Recipe, by_body: bool) -> dict[str, hhr.Recipe]:
    """The usual one, and one with the basis of greedy trainings, by what ends the names of their
    rows.
    """
    return {
        "": usual,
        ", finer basis": replace(usual, basis=hhr.Pod(FINE, relative=True, by_body=by_body)),
    }


def row_of(
    training: Training, recipe: hhr.Recipe, references: References, seconds: float
) -> dict[str, Any]:
    """Errors of a model, its size, and seconds: of the training, less what was found on the disk,
    and of the build.
    """
    model, built = timed(lambda: training.build(recipe, checked=False))
    errors = references.errors(model).summaries()
    return {
        "answers": len(training.snapshots.points),
        "unknowns": len(model.problem.stiffness),
        "conditions": len(model.fields.A_lambda),
        **{
            f"{kind} {share}": errors[name][share]
            for kind, name in (("forces", "dual_full_floored"), ("displacement", "primal_l2"))
            for share in ("median", "p95", "max")
        },
        "training": seconds,
        "build": built,
    }


def draw(chosen: dict[str, Training], options: Namespace) -> None:
    """Where greedy trainings of two parameters chose, and what their models were worth on the
    way.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(4 * len(chosen) + 4, 4), layout="constrained")
    *maps, curves = figure.subplots(1, len(chosen) + 1)
    for axis, (name, training) in zip(maps, chosen.items(), strict=True):
        points, rounds, _ = training.choice
        shown = axis.scatter(*points.T, c=np.arange(len(points)), s=12, cmap="viridis")
        axis.set(xlabel="P1 [MPa]", ylabel="h1 [mm]", title=name)
        figure.colorbar(shown, ax=axis, label="order")
        curves.semilogy(
            [item.answers for item in rounds], [item.worst for item in rounds], ".-", label=name
        )
    curves.set(xlabel="answers", ylabel="largest indicator")
    curves.legend(fontsize=7)
    figure.savefig(options.out / "chosen.png", dpi=150)


def main() -> None:
    """Train, build, compare; print the tables, write ``report.json`` and ``chosen.png``."""
    options = cli.parse_on_first_rank(cli.demo_parser("greedy_training", __doc__))
    tests, scenes, chosen = 40 if options.quick else 400, {}, {}
    for name, scene, others, trainings in plans(options.quick):
        rows, references = [], None
        for label, given in trainings.items():
            train = partial(
                hhr.train, scene, given, held_out=0, comm=MPI.COMM_SELF, progress=options.progress
            )
            training, seconds = timed(
                partial(train, folder=options.out / f"snapshots_{name.replace(' ', '_')}")
            )
            if references is None:  # one floor for all: that of the usual training
                points = scene.parameters.random(tests, options.seed + 17)
                bar = options.progress(f"{name}, test points")
                references = References.at(points, training.full_order, training.snapshots, bar)
            built = others if training.choice is None else {"": training.choice.recipe}
            for end, recipe in built.items():
                rows.append(
                    {"training on": label + end, **row_of(training, recipe, references, seconds)}
                )
            if training.choice is not None and name == "pellet":
                chosen[label] = training
        scenes[name] = {"tests": tests, "trainings": rows}
        cli.print_rows(f"{name}: errors at {tests} points", rows, options.console)
    draw(chosen, options)
    report.write_report(
        {"seed": options.seed, "scenes": scenes, **report.environment()}, options.out
    )


if __name__ == "__main__":
    main()
