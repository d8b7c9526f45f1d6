"""Local models: several small reduced models, each for a part of the parameters, in the place of a
large one.

Where contact moves far, one basis for all parameters grows. The thesis (chapter 4) clusters
solutions that are alike and gives each cluster a model of its own: K = 3 on a regular grid of 500
solutions, whose cells say which model answers, and on 200 that a greedy training chose, where a
forest of decision trees says so. Beside these there is an automatic set: the box is split until
models are small, and the full model is asked where estimates of their errors are too large. It is
tried on the pellet, and on the pellet with its materials as parameters, six in all.

What to see: an automatic set is somewhat faster than one model of the same scene at equal errors,
and never wrong by a hundredth where contact grazes. On a grid the thesis' stripe of wrong forces
along the border of two clusters is gone: solutions by a border train the models of both sides. With
six parameters one large model is more exact than the set, and slower. Clusters of few greedy
solutions give models that have no answer at some points.

    python benchmarks/local_models.py [--out DIR] [--quick] [--seed N]
"""

from argparse import Namespace
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import _demos  # noqa: F401 (before the scenes)
import dissimilarity
import local_pictures as pictures
import numpy as np
import pellet_cladding
import pellet_materials
from local_report import local_part
from mpi4py import MPI
from parts import cli

import hhr_dolfinx as hhr
from hhr_dolfinx.certify.accuracy import summary
from hhr_dolfinx.plugins.studies import report
from hhr_dolfinx.plugins.studies.measure import References
from hhr_dolfinx.plugins.studies.points import time_queries
from hhr_dolfinx.timing import timed

TABLE_4_1 = np.array([[170.0, 3.2], [30.0, 5.25]])
"""The two points of table 4.1: 0.03 and 0.02 % primal, 2.0 and 2.4 % dual."""
THESIS = {
    "thesis_regular": {
        "table": "4.2",
        "ell": [31, 39, 36],
        "N_lambda_C": [36, 40, 35],
        "ell_bar": [54, 67, 57],
    },
    "thesis_greedy": {
        "table": "4.4",
        "ell": [27, 35, 23],
        "N_lambda_C": [36, 56, 35],
        "ell_bar": [52, 77, 48],
    },
}
"""Sizes of the thesis' models."""


@dataclass(frozen=True)
class Variant:
    """A scene, how it is trained, and how its models are made.

    Attributes:
        scene, training: see :func:`hhr_dolfinx.train`.
        how: how the training is shared out among models.
        recipe: of each local model.
        one: recipe of the one model beside them.
        checked: whether models are held against answers of the full one, and grow where they must.
    """

    scene: hhr.Scene
    training: Any
    how: Any
    recipe: hhr.Recipe
    one: hhr.Recipe
    checked: bool = False


def variants(quick: bool) -> Iterator[tuple[str, Variant]]:
    """The thesis' two clusterings, and automatic sets of two and of six parameters."""
    mesh: dict[str, Any] = pellet_cladding.QUICK_MESH if quick else {}
    pellet, materials = pellet_cladding.scene(**mesh), pellet_materials.scene(**mesh)
    usual, (small, *others) = hhr.Recipe(), recipes()
    clusters = hhr.Clusters(3, others=tuple(others), modes=60, conditions=45)
    yield (
        "thesis_regular",
        Variant(pellet, (8, 6) if quick else pellet_cladding.GRID, clusters, small, usual),
    )
    greedy = hhr.Greedy(
        budget=24 if quick else 200, tolerance=1e-9, indicator=hhr.Eta(), start=hhr.Sobol(8)
    )
    clusters = hhr.Clusters(3, others=tuple(others), modes=77, conditions=56)
    yield "thesis_greedy", Variant(pellet, greedy, clusters, small, usual)
    fine = hhr.Recipe(hhr.Pod(1e-12, relative=True))
    splitting = hhr.Splitting(40, checks=50) if quick else hhr.Splitting()
    yield "automatic", Variant(pellet, graded(pellet, 8 if quick else 40), splitting, fine, usual)
    nodes = (
        hhr.Deim(hhr.Pod(1e-8, relative=True)),
        hhr.ForceDeim(1e-5, relative=True),
        hhr.LoadNodes(),
    )
    # a larger domain: on a small one K~^-1 is no smooth function of the materials, and is factored
    # for each query
    by_body = hhr.Recipe(hhr.Pod(3e-10, relative=True, by_body=True), nodes, hhr.Rid(3, 6))
    splitting = hhr.Splitting(modes=200, conditions=95, forces=3e-3, checks=60, rounds=2, most=16)
    if quick:
        splitting = replace(splitting, modes=80, checks=20, rounds=0, most=3)
    training = hhr.Sobol(64 if quick else 1024)
    yield (
        "materials",
        Variant(materials, training, splitting, by_body, pellet_materials.RECIPE, checked=True),
    )


def recipes() -> list[hhr.Recipe]:
    """Of small models: fewer nodes than functions, which enrichment makes up for.

    Each cluster takes its best.
    """
    tried = (
        (1e-9, 1e-7, 1e-4, 2, 3.0),
        (1e-9, 1e-7, 1e-4, 2, 6.0),
        (1e-9, 3e-7, 1e-3, 2, 6.0),
        (3e-9, 1e-7, 1e-4, 1, 3.0),
        (1e-8, 1e-8, 1e-4, 2, 3.0),
        (1e-8, 1e-6, 1e-3, 1, 10.0),
    )
    found = []
    for tolerance, nodes, forces, layers, kappa_max in tried:
        chosen = (
            hhr.Deim(hhr.Pod(nodes, relative=True)),
            hhr.ForceDeim(forces, relative=True),
            hhr.LoadNodes(),
        )
        pod, domain = hhr.Pod(tolerance, relative=True), hhr.Rid(layers, layers)
        found.append(hhr.Recipe(pod, chosen, domain, hhr.Enrich(kappa_max)))
    return found


def graded(scene: hhr.Scene, count: int) -> np.ndarray:
    """A grid whose pressures are as far apart as they are large: contact grazes at small ones."""
    (least, low), (most, high) = scene.parameters.lower, scene.parameters.upper
    pressures, heights = np.geomspace(least, most, count), np.linspace(low, high, count + 1)
    return np.array([(pressure, height) for height in heights for pressure in pressures])


def measured(
    name: str, given: Variant, options: Namespace
) -> tuple[dict[str, Any], dict[str, Any]]:
    """What local models of a variant and one model of the same training are worth: for the report,
    and a row.
    """
    folder = options.out / f"snapshots_{given.scene.name}"
    train: Callable = partial(
        hhr.train, held_out=0, comm=MPI.COMM_SELF, progress=options.progress, folder=folder
    )
    training = train(given.scene, given.training)
    local, built = timed(
        lambda: training.local(
            given.how, recipe=given.recipe, checked=given.checked, progress=options.progress
        )
    )
    one, built_one = timed(lambda: training.build(given.one, checked=False))
    full, models = training.full_order, {"local": local, "one": one}
    tests = [
        full.parameters.random(40 if options.quick else 200, options.seed + seed)
        for seed in (7, 77)
    ]
    references = References.at(
        np.vstack(tests), full, training.snapshots, options.progress(f"{name}, test points")
    )
    errors = {label: references.errors(model) for label, model in models.items()}
    # a set is warm when each of its models has been asked; with materials the full order takes a
    # minute for these
    count = 205 if full.problem.varies else 1005
    fresh = full.parameters.random(45 if options.quick else count, options.seed + 1000)
    known = training.snapshots.known_statuses()
    warm = time_queries(
        {
            "fom_best": lambda point: full.solve(point, start=known.active[known.nearest(point)]),
            **{label: model.solve for label, model in models.items()},
        },
        fresh,
    )
    times = {label: summary(values) for label, values in warm.items()}
    hhr.save_model(options.out / f"{name}.npz", local)
    found: dict[str, Any] = {
        "local": local_part(local, references, errors["local"], fresh),
        "training": len(training.snapshots.points),
        "asked": len(local.offline.points),
        "splits": local.offline.splits,
        **parts_of(errors["local"], times, "local"),
        "one": {
            "ell_bar": len(one.problem.stiffness),
            "N_lambda_C": len(one.fields.A_lambda),
            "offline": built_one,
        }
        | parts_of(errors["one"], times, "one"),
        "offline": {"build": built, **local.offline.log.times},
    }
    if name in THESIS:
        found["thesis"] = THESIS[name]
        at = References.at(TABLE_4_1, full, training.snapshots).errors(local).values
        found["table_4_1"] = {
            key: at[key].tolist() for key in ("primal_euclid", "primal_l2", "dual_rid")
        }
    if len(full.parameters.names) == 2:
        pictures.draw(name, training, local, one, options.out, options.quick)
    return found, row_of(name, found)


def parts_of(errors: Any, times: dict[str, Any], label: str) -> dict[str, Any]:
    """Errors, times and ratios of one way to answer, as in every report."""
    ratio = times["fom_best"]["median"] / times[label]["median"]
    return {
        "errors": errors.summaries(),
        "times": {"fom_best": times["fom_best"], "online": times[label]},
        "ratios": {"fom_best/online": ratio},
    }


def row_of(name: str, found: dict[str, Any]) -> dict[str, Any]:
    """A line of the table."""
    forces, one = found["errors"]["dual_full_floored"], found["one"]
    return {
        "models": name,
        "K": found["local"]["K"],
        "modes": max(size["ell_bar"] for size in found["local"]["sizes"]),
        "conditions": max(size["N_lambda_C"] for size in found["local"]["sizes"]),
        **{f"forces {key}": forces[key] for key in ("median", "p95", "max")},
        "x full": found["ratios"]["fom_best/online"],
        "stripe": found["local"]["stripe"],
        "one: modes": one["ell_bar"],
        "p95": one["errors"]["dual_full_floored"]["p95"],
        "one x full": one["ratios"]["fom_best/online"],
    }


def main() -> None:
    """Train, share out, compare; print the table, write ``report.json``, models and pictures."""
    options = cli.parse_on_first_rank(cli.demo_parser("local_models", __doc__))
    rows: list[dict[str, Any]] = []
    found: dict[str, Any] = {
        "scene": "local_models",
        "seed": options.seed,
        "models": {},
        **report.environment(),
    }
    found["figure_2_13"] = dissimilarity.figure_2_13(options.out, options.quick)
    for name, given in variants(options.quick):
        found["models"][name], row = measured(name, given, options)
        rows.append(row)
        # an hour is long: what is there is kept
        report.write_report(found, options.out)
    cli.print_rows("local models", rows, options.console)


if __name__ == "__main__":
    main()
