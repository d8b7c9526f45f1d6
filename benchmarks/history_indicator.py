"""Histories that tell how far they are off: an indicator with each step, beside its error, on
trained paths and others.

The flowing pellet is trained twice: loaded at two gaps, as in pellet_cladding_plastic.py; and
loaded and unloaded there, so that its trained rates hold those of any slower path and of a hold, of
which it knows nothing. Its small models, HHR and condensed flow, then follow what they were trained
on, other gaps, unloading and loading again, holds, other paces and heights of the load.

What to see: `answer.estimate()` ranks the steps as their errors do, whatever the model; and no path
is silent whose error is more than three times the worst trained one. Where rates and ranges tell
nothing, the signs of a step do.

    python benchmarks/history_indicator.py [--out DIR] [--quick] [--seed N]
"""

import warnings
from argparse import Namespace
from collections.abc import Callable, Iterator
from typing import Any

import _demos  # noqa: F401 (before the scenes)
import numpy as np
import pellet_cladding_plastic as pellet
from mpi4py import MPI
from parts import cli
from pellet_cladding_paths import path_cases
from scipy.stats import spearmanr

import hhr_dolfinx as hhr
from hhr_dolfinx.certify.accuracy import force_floor, relative_error
from hhr_dolfinx.errors import OutsideTrainingWarning, UnstableModelError
from hhr_dolfinx.models.answer import Answer, History, Path
from hhr_dolfinx.plugins.inelastic.condense_flow import CorrectionSettings
from hhr_dolfinx.plugins.paths.compared import largest_errors
from hhr_dolfinx.plugins.studies import report
from hhr_dolfinx.study.training.train import Training
from hhr_dolfinx.timing import timed

GAPS, HELD_OUT = (5.0, 15.0), 8.0
"""Initial gaps in um that are trained, and the one that is held out."""
ERRORS = ("displacement", "forces", "stress", "stress_rr", "plastic_strain")
SHOWN = ("displacement", "forces", "stress")
LARGEST = ("displacement", "forces")


def there_and_back(gap: float, steps: int) -> Path:
    """Loaded within a second, and unloaded within another one."""
    shares = np.arange(steps + 1) / steps
    return pellet.history(np.arange(2 * steps + 1) / steps, np.append(shares, shares[-2::-1]), gap)


def built(options: Namespace) -> hhr.Scene:
    """The scene, coarse if it has to be quick."""
    mesh = (
        {**pellet.QUICK_MESH, "cladding_axial_cells": 15, "cladding_radial_cells": 3}
        if options.quick
        else {}
    )
    return pellet.scene(**mesh)


def solved(
    scene: hhr.Scene, paths: list[Path], held_out: list[Path], options: Namespace
) -> Training:
    """Full histories, each step of which is kept: what was killed goes on."""
    how = {"folder": options.out / "snapshots", "comm": MPI.COMM_SELF, "progress": options.progress}
    return hhr.train(scene, paths, held_out=held_out, **how)


def models(training: Training, options: Namespace) -> Iterator[tuple[str, Any]]:
    """The small models that are not refused."""
    correction = CorrectionSettings(modes=3e-4, cubature=1.5e-4, attempts=1 if options.quick else 4)
    makers: dict[str, Callable[[], Any]] = {
        "HHR": lambda: training.build(pellet.recipe()),
        "condensed flow": lambda: training.condense(correction),
    }
    for name, make in makers.items():
        try:
            yield name, make()
        except UnstableModelError as error:
            options.console.print(f"{name} is refused: {error}")


def errors(full: Any, found: Answer, exact: Answer, floor: float) -> list[float]:
    """Relative errors of one step on the whole mesh, in the order of ``ERRORS``."""
    return [
        relative_error(found.displacement(), exact.displacement(), full.problem.mass),
        relative_error(found.forces(), exact.forces(), floor=floor),
        relative_error(found.stress().ravel(), exact.stress().ravel()),
        relative_error(found.stress()[:, 0], exact.stress()[:, 0]),
        relative_error(found.plastic_strain(), exact.plastic_strain()),
    ]


def followed(model: Any, path: Path) -> tuple[History, list[str]]:
    """A history, and what its model warned of."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        history = model.march(path)
    return history, [
        str(item.message) for item in caught if issubclass(item.category, OutsideTrainingWarning)
    ]


def row_of(full: Any, model: Any, exact: History, floor: float) -> dict[str, Any]:
    """What one model did on a path: estimates and errors of its steps, the largest ones, warnings
    by what saw it.
    """
    (history, said), march = timed(lambda: followed(model, exact.path))
    estimates, seconds = timed(
        lambda: [answer.estimate().primal_relative for answer in history.answers]
    )
    steps = [
        errors(full, *pair, floor) for pair in zip(history.answers, exact.answers, strict=True)
    ]
    by_path = any("is outside what was trained" in message for message in said)
    return {
        "estimates": estimates,
        "errors": steps,
        "largest": dict(zip(ERRORS, np.max(steps, axis=0).tolist(), strict=True)),
        "of the history": dict(
            zip(LARGEST, largest_errors(full, history, exact, floor), strict=True)
        ),
        "by its path": by_path,
        "by its signs": len(said) > by_path,
        "step": march / len(estimates),
        "estimate": seconds / len(estimates),
    }


def measured(
    name: str, training: Training, asked: dict[str, History], options: Namespace
) -> Iterator[dict[str, Any]]:
    """Each model of a training on what is known of it, and on each path that is asked."""
    floor = force_floor(training.full_order.problem, training.snapshots)
    known = [
        ("known", item) for item in (*training.snapshots.histories, *training.held_out.histories)
    ]
    known += [(label.split()[0], item) for label, item in asked.items()]
    for method, model in models(training, options):
        for kind, exact in options.progress(f"{name}, {method}")(known):
            yield {
                "training": name,
                "model": method,
                "kind": kind,
                **row_of(training.full_order, model, exact, floor),
            }


def ranks(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Rank correlation of estimates with each error over all steps of all paths, for each model."""
    found = []
    for training, model, own in grouped(rows, "training", "model"):
        estimates = np.concatenate([row["estimates"] for row in own])
        wrong = np.concatenate([row["errors"] for row in own])
        row: dict[str, Any] = {"training": training, "model": model, "steps": len(estimates)}
        for name, column in zip(ERRORS, wrong.T, strict=True):
            row[name] = float(spearmanr(estimates, column).statistic)
        found.append(
            row
            | {
                what: float(np.median([item[what] for item in own]))
                for what in ("step", "estimate")
            }
        )
    return found


def warnings_of(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """For each model and kind of path: errors over the worst known ones, and which warning saw the
    path.
    """
    found = []
    for training, model, kind, own in grouped(rows, "training", "model", "kind"):
        known = [
            row
            for row in rows
            if (row["training"], row["model"], row["kind"]) == (training, model, "known")
        ]
        row: dict[str, Any] = {
            "training": training,
            "model": model,
            "kind": kind,
            "paths": len(own),
        }
        row |= {said: sum(item[said] for item in own) for said in ("by its path", "by its signs")}
        silent = [item for item in own if not (item["by its path"] or item["by its signs"])]
        for name in SHOWN:
            worst = max(item["largest"][name] for item in known)
            for which, some in (("", own), (", silent", silent)):
                row[f"{name}{which}"] = max(
                    (item["largest"][name] / worst for item in some), default=0.0
                )
        found.append(row)
    return found


def grouped(rows: list[dict[str, Any]], *keys: str) -> Iterator[tuple[Any, ...]]:
    """Rows that share some values, in their order: these values and the rows."""
    groups: dict[tuple, list[dict[str, Any]]] = {}
    for row in rows:
        groups.setdefault(tuple(row[key] for key in keys), []).append(row)
    for values, own in groups.items():
        yield *values, own


def main() -> None:
    """Train, follow paths, compare; print both tables and write ``report.json``."""
    options = cli.parse_on_first_rank(cli.demo_parser("history_indicator", __doc__))
    scene, steps, rows = built(options), 10 if options.quick else 40, []
    cases = list(path_cases(pellet.history, options.seed, *((2, 8) if options.quick else (4, 12))))
    exact = solved(scene, [case.path for case in cases], [], options).snapshots.histories
    asked = {case.name: history for case, history in zip(cases, exact, strict=True)}
    for name, path in (("one way", pellet.path), ("there and back", there_and_back)):
        training = solved(
            scene, [path(gap, steps) for gap in GAPS], [path(HELD_OUT, steps)], options
        )
        rows += measured(name, training, asked, options)
    found = {"ranks": ranks(rows), "warnings": warnings_of(rows)}
    report.write_report({**found, "paths": rows, **report.environment()}, options.out)
    cli.print_rows(
        "rank correlation of estimates and errors of steps, and seconds",
        found["ranks"],
        options.console,
    )
    cli.print_rows(
        "largest errors over the worst known ones, and what warned",
        found["warnings"],
        options.console,
    )


if __name__ == "__main__":
    main()
