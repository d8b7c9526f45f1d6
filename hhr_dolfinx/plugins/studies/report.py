"""The report of a study: ``report.json`` and a short table."""

from __future__ import annotations

import json
import platform
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict
from pathlib import Path

from mpi4py import MPI

from hhr_dolfinx import registry
from hhr_dolfinx.certify.accuracy import summary
from hhr_dolfinx.certify.constants import Stability
from hhr_dolfinx.command.console import Console, Table
from hhr_dolfinx.compat import versions
from hhr_dolfinx.files import replacing
from hhr_dolfinx.models.model import KeptModel
from hhr_dolfinx.models.reduced import ReducedModel
from hhr_dolfinx.plain import finite
from hhr_dolfinx.plugins.studies import page
from hhr_dolfinx.plugins.studies.advice import TRAINING_STAGES, advice, in_words
from hhr_dolfinx.plugins.studies.measure import Measurement, Report, Row
from hhr_dolfinx.plugins.studies.of_laws import study_of
from hhr_dolfinx.scene import Scene
from hhr_dolfinx.study.training.train import Training
from hhr_dolfinx.timing import today
from hhr_dolfinx.version import __version__

FROM_FILES = "answers read from files"
"""Stage of a training whose answers existed already."""
FEW_METHODS = 8
"""Methods up to which the table of all of them is in ``report.html`` alone."""
LONGEST_CELL = 160
"""Most characters of a printed cell."""


def make_report(
    training: Training, model: KeptModel, measured: Measurement, rows: list[Report], seed: int
) -> Report:
    """All figures of a study under the keys that scenes share; SI units, seconds, fractions.

    Args:
        training: training of the scene.
        model: model under study.
        measured: errors and times of the models.
        rows: rows of the work-precision table.
        seed: seed of the test points.
    """
    report = {
        **frame(training, model, seed),
        "errors": measured.own.errors.summaries(),
        "kkt": measured.own.errors.residuals,
        **measured.report,
        "work_precision": rows,
    }
    offline = (
        training.log.times
        | model.offline.log.times
        | _read_from_files(training, report["times"]["fom_best"])
    )
    report["times"] = {"offline": offline, **report["times"]}
    report["skipped"] += measured.skipped
    report["break_even"] = break_even(report["times"])
    laws = study_of(training.full_order.scene)
    report["advised"], report["advice"] = advice(report) if laws is None else laws.advice(report)
    return report


def model_report(model: ReducedModel, row: Row) -> Report:
    """One of the ``models`` of a report, with its errors and the seconds of its answers.

    Args:
        model: a reduced model.
        row: its errors and times.
    """
    return {
        "sizes": reduced_sizes(model),
        "stability": _stability(model.offline.stability),
        **errors_and_times(model, row),
    }


def _stability(found: Stability) -> Report:
    """Stability constants; those at the top are the Euclidean ones."""
    report = asdict(found)
    return {**report, **report["euclidean"]}


def errors_and_times(model: KeptModel, row: Row) -> Report:
    """Common part of all ``models`` of a report.

    Args:
        model: a model.
        row: its errors and times.
    """
    return {
        "errors": row.errors.summaries(),
        "unconverged": row.errors.unanswered,
        "kkt": row.errors.residuals,
        "times": {"offline": dict(model.offline.log.times), "online": summary(row.seconds)},
    }


def reduced_sizes(model: ReducedModel) -> dict[str, int]:
    """Numbers of functions, conditions and cells of a reduced model."""
    offline = model.offline
    functions = offline.basis.shape[1]
    # laws cost nothing in cells of the RID without a test function
    cells = offline.sets.cells if model.flow is None else model.flow.cells
    return {
        "ell": functions - len(offline.enrichment.added),
        "ell_bar": functions,
        "N_lambda_C": len(offline.sets.A_lambda),
        "rid_cells": len(cells),
    }


def _read_from_files(training: Training, fom_best: dict[str, float] | None) -> dict[str, float]:
    """A stage for answers that were read from files, with their present cost by the best full
    model.
    """
    if not training.read or fom_best is None:
        return {}
    histories = training.snapshots.histories
    steps = len(training.snapshots.points) / len(histories) if histories else 1.0
    return {FROM_FILES: training.read / steps * fom_best["median"]}


def break_even(times: Report) -> dict[str, float | None]:
    """Queries after which training and reduced answers are cheaper than the best full model.

    None if never.

    Queries are for all forces, or fields and all forces; histories count as a whole. The cost
    includes training answers that were read from files. Forces by condensation need no training.
    """
    offline = sum(times["offline"].values())
    queries = dict[str, float | None](forces=None)
    if "condensed_full" not in times:
        queries["fields"] = _pays(times, offline, "online")
        shared = sum(times["offline"].get(stage, 0.0) for stage in (*TRAINING_STAGES, FROM_FILES))
        spent = shared + sum(times.get("offline_condensed", {}).values())
        return queries | {"fields, condensed": _pays(times, spent, "condensed")}
    for name, kind in {"forces": "online_forces", "fields": "online_full"}.items():
        queries[name] = _pays(times, offline, kind)
    if "offline_condensed" in times:
        stages = times["offline_condensed"]
        spent = times["offline"].get("full_order", 0.0) + stages["compliances"] + stages["starts"]
        queries["forces, condensed"] = _pays(times, spent, "condensed")
    return queries


def _pays(times: Report, spent: float, kind: str) -> float | None:
    """Queries after which the seconds of training are saved.

    None if never, or if there is no such model.
    """
    if times[kind] is None:
        return None
    saved = times["fom_best"]["median"] - times[kind]["median"]
    return spent / saved if saved > 0 else None


def frame(training: Training, model: KeptModel, seed: int) -> Report:
    """Part of a report without measurements.

    Args:
        training: training of the scene.
        model: model under study.
        seed: seed of the test points.
    """
    problem = training.full_order.problem
    offline = model.offline
    report: Report = {
        "scene": training.full_order.scene.name,
        "seed": seed,
        **environment(),
        **_asked(training.full_order.scene),
        "sizes": {
            "N": problem.free.size,
            "N_lambda": problem.contact.shape[0],
            "cells": len(problem.cell_nodes),
            "snapshots": len(training.snapshots.points),
        },
        "skipped": [*training.log.skipped, *offline.log.skipped],
        "refused_before": [],
    }
    if not isinstance(model, ReducedModel):
        return report
    stability = _stability(offline.stability)
    stability |= offline.further
    report["sizes"] |= reduced_sizes(model) | {"layers": offline.layers}
    return report | {
        "stability": {
            **stability,
            # kappa(B~) after each added function; the first row is the basis before any
            "enrichment": [
                {"added": k, "kappa": kappa} for k, kappa in enumerate(offline.enrichment.kappas)
            ],
        },
        "recipe": offline.recipe.described(),
        "refused_before": list(offline.log.refused),
    }


def _asked(scene: Scene) -> Report:
    """The ``parameters`` and ``materials`` parts of a report, in the units of the scene."""
    box = scene.parameters
    units = scene.units
    return {
        "parameters": [
            {"name": name, "from": low, "to": high, "unit": scene.parameter_units.get(name, "")}
            for name, low, high in zip(box.names, box.lower, box.upper, strict=True)
        ],
        "materials": [
            {"body": str(body.tag), "young": body.young, "poisson": body.poisson}
            | ({} if body.law is None else {"law": repr(body.law)})
            for body in scene.bodies
        ],
        "units": None
        if units is None
        else {"length": units.length, "stress": units.stress, "force": units.force},
    }


def environment() -> Report:
    """The ``date``, ``versions`` and ``machine`` parts of a report."""
    return {
        "date": today(),
        "versions": {"hhr_dolfinx": __version__, **versions()},
        "machine": {"cpu": _cpu(), "threads": 1, "ranks": MPI.COMM_WORLD.size},
    }


def write_report(report: Report | list[Report], folder: str | Path, name: str = "report") -> Path:
    """Write ``report.json``, or rows under another name.

    Numbers that are not finite become null, as JSON requires.

    Args:
        report: the report, or rows of a table.
        folder: folder of the file.
        name: name of the file without ending.

    Returns:
        Path of the file.
    """
    path = Path(folder) / f"{name}.json"
    text = json.dumps(finite(report), indent=2, allow_nan=False)
    with replacing(path, text=True) as file:
        file.write(text + "\n")
    return path


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> Table:
    table = Table(*head)
    for row in rows:
        table.add_row(*(cell[:LONGEST_CELL] for cell in row))
    return table


def print_report(report: Report, console: Console) -> None:
    """Print the main figures, in the words of ``report.html``.

    Args:
        report: the report.
        console: console to print to.
    """
    console.print(_sizes_in_words(report))
    console.print(_table(page.ERROR_HEAD, page.error_rows(report["errors"]).values()))
    console.print(_table(page.TIME_HEAD, page.time_rows(report["times"])))
    if "histories" in report or len(report.get("work_precision", ())) > FEW_METHODS:
        console.print(_table(page.METHOD_HEAD, page.method_rows(report["work_precision"])))
    if "outputs" in report:
        console.print(_table(page.OUTPUT_HEAD, page.output_rows(report["outputs"])))
    for name, row in report["times"].items():
        for line in _lines(name, row):
            console.print(line)
    counts = {
        name: count for name, count in report.get("break_even", {}).items() if count is not None
    }
    if counts:
        queries = ", ".join(f"{count:.0f} queries for {name}" for name, count in counts.items())
        console.print(f"cheaper than the best full order, training included, after {queries}")
    if row := report.get("discretisation"):
        # the error of the mesh is the scale of all others; numbers where nothing estimates it any
        # more
        import_path = registry.named("public").get("MeshError")
        console.print(
            registry.load(import_path)(**row).in_words() if import_path else f"mesh: {row}"
        )
    if (row := report.get("time_error", {})).get("max"):
        description = (
            "in the steps of the paths"
            if row["tolerance"] is None
            else f"cut to a tolerance of {row['tolerance']:g}"
        )
        console.print(
            f"time steps of the full order, {description}: off by {row['median']:.2%} of the "
            f"largest stress or displacement by estimate (median of the histories), "
            f"{row['max']:.2%} at worst; small models take the same ones"
        )
    if "advice" in report:
        console.print(report["advice"])
    for entry in report["refused_before"]:
        console.print(f"{entry['layers']} layers refused: {entry['why']}")
    for entry in report.get("models", {}).get("condensed", {}).get("refused_before", []):
        console.print(f"condensed, attempt {entry['attempt']} refused: {entry['why']}")
    for entry in report["skipped"]:
        console.print(f"left out: {entry['stage']}: {entry['why']}")


def _sizes_in_words(report: Report) -> str:
    size = report["sizes"]
    stability = report.get("stability", {})
    head = f"{report['scene']}: {size['N']} dofs, {size['N_lambda']} contacts"
    if "ell_bar" not in size:
        sizes = report["models"]["condensed"].get("sizes")
        small = (
            "all contacts"
            if sizes is None
            else f"{sizes['modes']} modes, all contacts, {sizes['points']} points"
        )
        return f"{head} -> {small}; {size['snapshots']} snapshots"
    shown = {"kappa_B": "kappa(B~)", "cond_K": "cond(K~)", "tangent": "tangents"}
    constants = ", ".join(
        f"{name} {stability[key]:.2g}" for key, name in shown.items() if key in stability
    )
    return (
        f"{head} -> {size['ell_bar']} modes, "
        f"{size['N_lambda_C']} contacts on {size['rid_cells']} of {size['cells']} cells, "
        f"{size['snapshots']} snapshots; {constants}"
    )


def _lines(name: str, row: Report | None) -> Iterator[str]:
    """Seconds by name in words, also of nested tables; summaries have a separate table."""
    if row is None or "median" in row:
        return
    seconds = {key: value for key, value in row.items() if isinstance(value, float)}
    if seconds:
        yield f"{name}: " + ", ".join(f"{key} {in_words(value)}" for key, value in seconds.items())
    for key, value in row.items():
        if isinstance(value, dict):
            yield from _lines(f"{name}, {key}", value)


def _cpu() -> str:
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()
